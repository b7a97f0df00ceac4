"""Forces between bodies as points with vectors, for arrows in files and pictures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.solution.resultants import Resultant

#: VTK's number for cells that consist of one point.
VERTEX = 1

#: Name of the block.
NAME = "forces_between_bodies"


def grid_of_forces(between_bodies: Mapping[tuple[int, int], Resultant], here: bool) -> Grid:
    """Return a grid of points, one for each pair of bodies, where their contact force acts.

    Not collective.

    The values are "force", the force on the body with the lower number, and the numbers of both
    bodies, counted from 1: "on_body" (the lower number) and "by_body".

    Args:
        between_bodies: (i, j) -> resultant on body i by body j, for i < j.
        here: whether the points are in this rank's grid, which is empty otherwise.
    """
    found = between_bodies if here else {}
    points, forces = np.zeros((2, len(found), 3))
    for k, one in enumerate(found.values()):
        points[k, : len(one.point)], forces[k, : len(one.force)] = one.point, one.force
    bodies = 1 + np.array([*found], dtype=np.int32).reshape(-1, 2)
    number = np.arange(len(found))
    return Grid(
        dim=len(next(iter(between_bodies.values())).point),
        degree=1,
        points=points,
        cells=np.column_stack([np.ones_like(number), number]),
        cell_types=np.full(len(found), VERTEX, dtype=np.uint8),
        values={"force": forces, "on_body": bodies[:, 0].copy(), "by_body": bodies[:, 1].copy()},
    )
