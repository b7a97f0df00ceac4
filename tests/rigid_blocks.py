"""Limit analysis of rigid blocks with friction in 2D, by linear programmes.

Independent of the package's solver: two sides of polygons that face each other touch along the
overlap of one on the other, and forces at both ends of the overlap represent any distribution of
pressure on it (`of_joints`); or forces act at the nodes of the mesh (`at_nodes`). They are within
cones of friction (Livesley 1978, "Limit analysis of structures formed from rigid blocks",
International Journal for Numerical Methods in Engineering 12).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from dolfinx import fem


@dataclass(frozen=True)
class RigidBlocks:
    """Blocks with their contacts.

    Attributes:
        normal: (3 n, m) forces and moments about the origin on n blocks by unit normal forces, of
            compression, at m points.
        tangential: (3 n, m) like `normal`, by unit tangential forces.
        friction: coefficient of friction.
    """

    normal: np.ndarray
    tangential: np.ndarray
    friction: float

    @classmethod
    def of_joints(cls, corners, on_floor, friction, distance, shorter=0.0):
        """Find the joints of blocks with counter-clockwise corners (n, c, 2).

        The first side of a block stands on the floor where `on_floor` (n,) is True. Sides touch up
        to a distance; joints are `shorter` at both ends.
        """
        joints = [
            (one[0], one[1], np.array([0.0, -1.0]), k, -1)
            for k, one in enumerate(corners)
            if on_floor[k]
        ]
        sides = [
            (k, a, b)
            for k, one in enumerate(corners)
            for a, b in zip(one, np.roll(one, -1, axis=0), strict=True)
        ]
        for (k, a, b), (other, c, d) in itertools.combinations(sides, 2):
            along, back = ((q - p) / np.linalg.norm(q - p) for p, q in ((a, b), (c, d)))
            normal = np.array([along[1], -along[0]])
            ends = np.array([d - a, c - a])
            low, high = max(0.0, ends[0] @ along), min((b - a) @ along, ends[1] @ along)
            if other == k or along @ back > -0.99 or high - low < 1e-9:
                continue
            gap = np.interp([low, high], ends @ along, ends @ normal)
            if np.abs(gap).max() < distance:
                joints.append((a + low * along, a + high * along, normal, k, other))
        result = np.zeros((2, len(corners), 3, 2 * len(joints)))
        for j, (a, b, normal, k, other) in enumerate(joints):
            cut = min(shorter, 0.499 * np.linalg.norm(b - a)) * (b - a) / np.linalg.norm(b - a)
            for end, x in enumerate((a + cut, b - cut)):
                for kind, force in enumerate((-normal, np.array([normal[1], -normal[0]]))):
                    wrench = np.array([*force, x[0] * force[1] - x[1] * force[0]])
                    result[kind, k, :, 2 * j + end] = wrench
                    if other >= 0:
                        result[kind, other, :, 2 * j + end] = -wrench
        return cls(*result.reshape(2, 3 * len(corners), -1), friction)

    @classmethod
    def at_nodes(cls, scene, body_of_cell, friction):
        """Take the nodes of a scene with one law of friction: rows of N and T on rigid motions.

        Args:
            scene: of one rank.
            body_of_cell: (cells,) the block of each cell.
            friction: coefficient of friction.
        """
        motions = rigid_motions(scene.V, body_of_cell)
        normal, tangential = [], []
        for one in (scene.operators(pair) for pair in scene.pairs):
            normal.append(-motions.T @ one.N.toarray().T)
            tangential.append(np.zeros_like(normal[-1]))  # stays at corners between two faces
            columns = np.searchsorted(one.normal_node, one.tangent_node)
            tangential[-1][:, columns] = -motions.T @ one.T.toarray().T
        return cls(np.hstack(normal), np.hstack(tangential), friction)

    @property
    def unresisted(self) -> bool:
        """Whether no contact resists some motion of the blocks."""
        both = np.hstack([self.normal, self.tangential * (self.friction > 0.0)])
        # rows of a block are of one size, since moments are about the origin of small scenes
        sizes = np.linalg.svd(both, compute_uv=False)
        return len(sizes) < len(both) or sizes[-1] < 1e-6 * sizes[0]

    def imbalance(self, loads) -> float:
        """Return the least sum of forces and moments that contact leaves, over those of loads.

        Args:
            loads: (3 n,) forces and moments about the origin.
        """
        size, m, rows = np.abs(loads).sum(), self.normal.shape[1], len(loads)
        if not size:
            return 0.0
        left = np.hstack([np.eye(rows), -np.eye(rows)])
        found = linprog(
            np.append(np.zeros(2 * m), np.ones(2 * rows)),
            np.hstack([self._slides(), np.zeros((2 * m, 2 * rows))]),
            np.zeros(2 * m),
            np.hstack([self.normal, self.tangential, left]),
            -loads / size,
            [(0.0, None)] * m + [(None, None)] * m + [(0.0, None)] * 2 * rows,
        )
        assert found.status == 0, found.message
        return float(found.fun)

    def factor(self, dead, live) -> float | None:
        """Return the largest t such that forces balance dead + t live, or None.

        Args:
            dead: (3 n,) forces and moments about the origin.
            live: (3 n,) like `dead`.
        """
        size, m = np.abs(dead).sum(), self.normal.shape[1]
        found = linprog(
            np.append(np.zeros(2 * m), -1.0),
            np.hstack([self._slides(), np.zeros((2 * m, 1))]),
            np.zeros(2 * m),
            np.hstack([self.normal, self.tangential, live[:, None] / size]),
            -dead / size,
            [(0.0, None)] * m + [(None, None)] * m + [(0.0, None)],
        )
        assert found.status in (0, 2), found.message
        return float(found.x[-1]) if found.status == 0 else None

    def _slides(self) -> np.ndarray:
        """Return the rows of |t| <= F p for the unknowns p, t."""
        one = np.eye(self.normal.shape[1])
        return np.block([[-self.friction * one, one], [-self.friction * one, -one]])


def rigid_motions(V, body_of_cell) -> np.ndarray:
    """Return the rigid motions (dofs, 3 n): translations, and the rotation about the origin."""
    x = V.tabulate_dof_coordinates()[:, :2]
    result = np.zeros((len(x), 2, body_of_cell.max() + 1, 3))
    node, body = V.dofmap.list, np.asarray(body_of_cell)[:, None]
    result[node, 0, body, 0] = result[node, 1, body, 1] = 1.0
    result[node, 0, body, 2], result[node, 1, body, 2] = -x[node, 1], x[node, 0]
    return result.reshape(2 * len(x), -1)


def loads_of(scene, body_of_cell) -> np.ndarray:
    """Return forces and moments (3 n,) about the origin of a scene's loads on its blocks."""
    f = fem.assemble_vector(fem.form(scene.L)).array
    return rigid_motions(scene.V, body_of_cell).T @ f
