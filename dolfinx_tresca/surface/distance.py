"""Distances of points from flat facets."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.surface.pieces import Pieces


def distances(pieces: Pieces, chosen: Indices, points: Array) -> Array:
    """Return the distance (n,) of each point (n, 3) from a piece of its own, `chosen` (n,)."""
    corners = pieces.points[chosen] - points[:, None]
    normals = pieces.normals[chosen]
    along = np.roll(corners, -1, axis=1) - corners
    # the nearest place of each side
    part = -np.einsum("nci,nci->nc", corners, along) / np.einsum("nci,nci->nc", along, along)
    part = np.clip(part, 0.0, 1.0)
    result = np.linalg.norm(corners + part[:, :, None] * along, axis=2).min(axis=1)
    if corners.shape[1] > 2:
        turns = np.einsum("nci,ni->nc", np.cross(corners, along), normals)
        over = (turns >= 0.0).all(axis=1) | (turns <= 0.0).all(axis=1)
        height = np.abs(np.einsum("ni,ni->n", corners.mean(axis=1), normals))
        result = np.where(over, height, result)
    return np.asarray(result)
