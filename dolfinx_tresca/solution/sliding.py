"""A check that sliding is small where nodes keep their normals and partners."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import log, reduce_array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.scene.obstacle import RigidObstacle, RigidPlane
from dolfinx_tresca.scene.pair import ContactPair

#: Largest ratio of a pressed node's slip to the local mesh size at which sliding counts as small.
LARGE = 1.0


class Sliding:
    """The displacement at which surfaces were paired, and a check of the slip since then.

    A warning of large slip is logged once, and never after surfaces were paired again.

    Attributes:
        origin: displacement at which the surfaces were paired [length].
    """

    def __init__(self, V: Any) -> None:
        self.origin = fem.Function(V)
        self._warned = False

    def begin(self, u: fem.Function) -> None:
        """Note the displacement at which surfaces are paired again. Not collective."""
        self.origin = u.copy()
        self._warned = True  # no warning: surfaces are paired again on purpose

    @property
    def moved_by(self) -> fem.Function | None:
        """The displacement at which surfaces were paired; None if it is zero. Collective."""
        return None if self.began_at(fem.Function(self.origin.function_space)) else self.origin

    def began_at(self, u: fem.Function) -> bool:
        """Return whether surfaces were paired at a displacement. Collective."""
        same = np.array_equal(self.origin.x.array, u.x.array)
        return bool(self.origin.function_space.mesh.comm.allreduce(same, op=MPI.LAND))

    def over_mesh_size(
        self,
        jump: JumpOperator,
        pairs: Sequence[ContactPair],
        u: fem.Function,
        multipliers: Array,
    ) -> float:
        """Return the largest ratio of a pressed node's slip to the mesh size. Collective.

        Some pairs are left out: pairs with finite sliding, bonded pairs, pairs with a plane, which
        has only one normal, and two deformable surfaces without friction, which have no tangential
        rows.
        """
        dim = u.function_space.mesh.geometry.dim
        moved = fem.Function(u.function_space)
        moved.x.array[:] = u.x.array - self.origin.x.array
        vectors = moved.x.array.reshape(-1, dim)
        slip = jump.of_displacement(moved) * jump.length_scale
        largest = 0.0
        for pair, one, (n, t) in zip(pairs, jump.pairs, jump.slices, strict=True):
            far = pair.sliding == "finite"
            if far or one.bonded or isinstance(pair.primary, RigidPlane):
                continue
            if isinstance(pair.primary, RigidObstacle):
                at = vectors[one.nodes]
                along = at - np.einsum("ni,ni->n", at, one.normals)[:, None] * one.normals
            else:
                along = one.tangential_vectors(slip[t])
            pressed = one.normal_node[multipliers[n] > 0.0]
            # the mesh size is the size of whole facets: the part in contact may be a sliver at an
            # edge
            distance = np.linalg.norm(along, axis=1) / one.sizes
            largest = max(largest, distance[pressed].max(initial=0.0))
        return float(reduce_array(jump.comm, largest, MPI.MAX))

    def warn(
        self,
        jump: JumpOperator,
        pairs: Sequence[ContactPair],
        u: fem.Function,
        multipliers: Array,
    ) -> None:
        """Log a warning if sliding is not small, once for each problem. Collective.

        Args:
            jump: the operator B.
            pairs: the pairs.
            u: displacement of a solution [length].
            multipliers: (size,) multipliers of the solution.
        """
        if self._warned:
            return
        found = self.over_mesh_size(jump, pairs, u, multipliers)
        if found > LARGE:
            self._warned = True
            log(
                jump.comm,
                "pressed nodes have slid by %.1f times the size of the mesh, but keep their "
                "normals and partners, which is accurate for small sliding only. "
                'Take ContactPair(..., sliding="finite").',
                found,
                level=logging.WARNING,
            )
