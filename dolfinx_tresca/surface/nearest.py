"""The nearest of several layers that lie over each other."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca.surface.facets import FloatArray
from dolfinx_tresca.surface.search import Indices, members

#: Area over that of a piece up to which its overlaps do not cover each other: rounding.
ONCE = 1.0 + 1e-8


def nearest_layer(
    piece: Indices,
    pair: Indices,
    simplices: FloatArray,
    size: FloatArray,
    places: FloatArray,
    apart: FloatArray,
    weight: FloatArray,
    piece_area: FloatArray,
) -> FloatArray:
    """Return quadrature weights (points,) without points that something nearer covers.

    Args:
        piece: (pairs,) the first piece of each pair, ascending.
        pair: (simplices,) the pair of each, ascending.
        simplices: (simplices, d + 1, d) in the planes of the first pieces.
        size: (simplices,) their sizes.
        places: (points, d) as many in each simplex.
        apart: (points,) distance of the second piece along the normal.
        weight: (points,) 0 where a point does not count already.
        piece_area: sizes of all first pieces.
    """
    if len(pair) == 0:
        return weight
    count = len(places) // len(pair)
    alive = weight.reshape(-1, count).any(axis=1)
    covered = np.bincount(piece[pair], size * alive, minlength=len(piece_area))
    crowded = np.flatnonzero((covered[piece[pair]] > ONCE * piece_area[piece[pair]]) & alive)
    if len(crowded) == 0:
        return weight
    # all pairs (a, b) of simplices of the same piece: does b, if nearer, hold points of a?
    owner = piece[pair[crowded]]
    starts = np.searchsorted(owner, owner, side="left")
    numbers = np.searchsorted(owner, owner, side="right") - starts
    a, b = (crowded[places] for places in members(starts, numbers))
    other = pair[a] != pair[b]
    a, b = a[other], b[other]
    distance = np.abs(apart).reshape(-1, count)
    nearer = distance[b].mean(axis=1) < distance[a].mean(axis=1)
    a, b = a[nearer], b[nearer]
    inside = _inside(simplices[b], places.reshape(-1, count, places.shape[1])[a])
    result = weight.reshape(-1, count).copy()
    simplex, point = np.nonzero(inside)
    result[a[simplex], point] = 0.0
    return result.ravel()


def _inside(simplices: FloatArray, points: FloatArray) -> FloatArray:
    """Return whether points (n, q, d) lie in simplices (n, d + 1, d), (n, q)."""
    sides = np.swapaxes(simplices[:, 1:] - simplices[:, :1], 1, 2)
    coordinates = np.linalg.solve(sides[:, None], (points - simplices[:, :1])[..., None])[..., 0]
    return np.asarray((coordinates > 0.0).all(axis=2) & (coordinates.sum(axis=2) < 1.0))
