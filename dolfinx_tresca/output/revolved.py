"""Grids of bodies of revolution, made from grids of their meridian."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.number import real
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.output.grid import Grid

#: Largest angle between neighbouring meridians [degrees]. With 6 a circle has 60 corners, and its
#: chords lie up to 0.14 % of the radius inside the circle.
STEP = 6.0

#: VTK's cell type of the meridian -> type of the revolved cell.
_REVOLVED = {3: 9, 5: 13, 9: 12}


def checked_angle(revolve: Any, axisymmetric: bool) -> float:
    """Return an angle of revolution in degrees; 0 for none.

    Args:
        revolve: the user's angle [degrees]; None: no revolution.
        axisymmetric: whether the bodies are bodies of revolution.

    Raises:
        InputError: the angle is no number above 0 and up to 360, or the bodies have no axis.
    """
    if revolve is None:
        return 0.0
    angle = real(revolve)
    if angle is None or not 0.0 < angle <= 360.0:
        raise InputError(
            f"revolve must be an angle in degrees, above 0 and up to 360, found {shown(revolve)}."
        )
    if not axisymmetric:
        raise InputError(
            "revolve is for bodies of revolution: create the problem with axisymmetric=True."
        )
    return angle


def revolved(grid: Grid, angle: float) -> Grid:
    """Return the grid of degree 1 that a meridian in the plane of x and y sweeps about the y axis.

    The meridian of `grid` is the first meridian of the new grid; further meridians are turned from
    x towards -z, so that the open part of an incomplete turn is in front. Vectors and tensors are
    turned as well. Triangles become wedges, quadrilaterals hexahedra, and lines quadrilaterals. Not
    collective.

    Args:
        grid: the meridian, of degree 1.
        angle: angle of revolution [degrees], above 0 and up to 360.
    """
    layers = math.ceil(angle / STEP)
    count = layers if angle == 360.0 else layers + 1  # a whole turn ends at its first meridian
    turn = np.deg2rad(angle) * np.arange(count) / layers
    rotation = np.zeros((count, 3, 3))
    rotation[:, 0, 0] = rotation[:, 2, 2] = np.cos(turn)
    rotation[:, 0, 2], rotation[:, 2, 0] = np.sin(turn), -np.sin(turn)
    rotation[:, 1, 1] = 1.0

    def at_nodes(values: npt.NDArray[Any], turns: Array) -> npt.NDArray[Any]:
        if values.ndim == 1:
            return np.tile(values, len(turns))
        if values.shape[1] == 3:
            return np.asarray(np.einsum("lij,nj->lni", turns, values).reshape(-1, 3))
        tensors = values.reshape(-1, 3, 3)
        turned = np.einsum("lij,njk,lmk->lnim", turns, tensors, turns, optimize=True)
        return np.asarray(turned.reshape(-1, 9))

    size, corners = len(grid.points), grid.cells[:, 1:]
    first = corners + size * np.arange(layers)[:, None, None]
    last = corners + size * (np.arange(1, layers + 1) % count)[:, None, None]
    if corners.shape[1] == 2:
        cells = np.concatenate([first, last[..., ::-1]], axis=-1)
    else:
        x, y = np.moveaxis(grid.points[corners][..., :2], -1, 0)
        area = np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
        # VTK wants the first face anticlockwise as seen from the second one; seen from +z, the next
        # meridian is behind
        behind = area > 0.0
        pair = np.where(behind[:, None], last, first), np.where(behind[:, None], first, last)
        cells = np.concatenate(pair, axis=-1)
    cells = cells.reshape(-1, cells.shape[-1])
    middle = rotation if angle == 360.0 else rotation[:-1]
    return replace(
        grid,
        dim=3,
        points=at_nodes(grid.points, rotation),
        cells=np.insert(cells, 0, cells.shape[1], axis=1),
        cell_types=np.tile([_REVOLVED[int(kind)] for kind in grid.cell_types], layers),
        values={name: at_nodes(values, rotation) for name, values in grid.values.items()},
        cell_values={name: at_nodes(values, middle) for name, values in grid.cell_values.items()},
    )
