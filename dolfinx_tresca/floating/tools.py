"""Rigid motions that given forces determine: of obstacles held by forces, and of cut bolts.

A tool is like a floating body without deformation. Let it be moved by V c, with a column of V for
each free motion. Then its contact forces balance the given forces e, and the gaps follow c:

    G'lambda = e,    r = (d; s) - B u - G c,    where a column of -G is the jump of a motion.

These are the equations of floating bodies (`floating/equilibrium.py`) with U = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca.floating.rigid_modes import NAMED_PART
from dolfinx_tresca.scene.rigid_motion import RigidMotion


class FreeMotion(NamedTuple):
    """A motion of a rigid tool, for which a force is given.

    Attributes:
        tool: name of the tool, for messages.
        name: name of the motion, for messages.
        pairs: numbers of the pairs whose primary side the tool is.
        direction: (6,) translation, then rotation about `point`, of a unit of the motion.
        point: (3,) point about which the tool turns [length].
        force: work of the given forces in a unit of the motion.
    """

    tool: str
    name: str
    pairs: list[int]
    direction: Array
    point: Array
    force: float


@dataclass(frozen=True)
class Tools:
    """The k free motions of all tools of a problem.

    Attributes:
        motions: the motions; those of a tool follow one another.
        bodies: the bodies of the mesh.
        jumps: (size, k) G, sparse.
    """

    motions: list[FreeMotion]
    bodies: Bodies
    jumps: csr_array

    @classmethod
    def from_rows(
        cls, motions: list[FreeMotion], bodies: Bodies, by_pair: Sequence[Any], stress_scale: Array
    ) -> Tools:
        """Compute G. Not collective.

        Args:
            motions: the motions.
            bodies: the bodies of the mesh.
            by_pair: `JumpOperator.by_pair`.
            stress_scale: `JumpOperator.stress_scale`.
        """
        G = np.zeros((len(stress_scale), len(motions)))
        for column, motion in zip(G.T, motions, strict=True):
            for rows in (by_pair[pair] for pair in motion.pairs):
                nodes, dim = rows.operators, rows.operators.normals.shape[1]
                arm = np.zeros((len(nodes.places), 3)) - motion.point
                arm[:, :dim] += nodes.places
                moved = motion.direction[:3] + np.cross(motion.direction[3:], arm)
                moved = moved[:, :dim] * nodes.weights[:, None]
                i, j = nodes.normal_node, nodes.tangent_node
                column[rows.normal] -= np.einsum("ni,ni->n", moved[i], nodes.normals[i])
                column[rows.tangential] -= np.einsum("ni,ni->n", moved[j], nodes.tangents)
        return cls(motions, bodies, csr_array(stress_scale[:, None] * G))

    def names(self, components: Array) -> str:
        """Return the tools, and their motions, in a joint motion with components (k, ...)."""
        sizes = np.linalg.norm(components.reshape(len(self.motions), -1), axis=1)
        moving: dict[str, list[str]] = {}
        for k in np.flatnonzero(sizes > NAMED_PART * sizes.max()):
            moving.setdefault(self.motions[k].tool, []).append(self.motions[k].name)
        return "; ".join(f"{tool}: {', '.join(names)}" for tool, names in moving.items())

    def places(self, c: Array, before: Array) -> Array:
        """Return the motions (pairs, 3, 4) of the tools of all pairs, as `RigidMotion.matrix`.

        Args:
            c: (k,) the motions of a solve.
            before: (pairs, 3, 4) motions at the start of the solve.
        """
        result, moved = before.copy(), np.zeros((len(before), 6))
        for motion, amount in zip(self.motions, c, strict=True):
            moved[motion.pairs] += amount * motion.direction
        for motion in self.motions:
            for pair in motion.pairs:
                step = RigidMotion.about(motion.point, moved[pair, 3:], moved[pair, :3])
                result[pair] = step.after(RigidMotion.from_matrix(before[pair])).matrix
        return result
