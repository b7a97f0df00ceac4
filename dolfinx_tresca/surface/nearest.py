"""The nearest of several layers that lie over each other."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.surface.search import expanded_ranges

#: Area of a piece's overlaps, over its own, up to which none lies over another: 1 and rounding.
COVERED_ONCE = 1.0 + 1e-8


def nearest_layer(
    piece: Indices,
    pair: Indices,
    simplices: Array,
    size: Array,
    places: Array,
    apart: Array,
    weight: Array,
    piece_area: Array,
) -> Array:
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
    overlaid = (covered > COVERED_ONCE * piece_area)[piece[pair]]
    crowded = np.flatnonzero(overlaid & alive)
    if len(crowded) == 0:
        return weight
    inner = places.reshape(-1, count, places.shape[1])[crowded]
    point, b = _beside(piece[pair[crowded]], simplices[crowded], inner)
    a, b, place = crowded[point // count], crowded[b], inner.reshape(-1, inner.shape[2])[point]
    # does b, if nearer, hold a point of a?
    distance = np.abs(apart).reshape(-1, count).mean(axis=1)
    nearer = (pair[a] != pair[b]) & (distance[b] < distance[a])
    point, a, b, place = point[nearer], a[nearer], b[nearer], place[nearer]
    inside = _inside(simplices[b], place)
    result = weight.reshape(-1, count).copy()
    result[a[inside], point[inside] % count] = 0.0
    return result.ravel()


def _beside(owner: Indices, simplices: Array, points: Array) -> tuple[Indices, Indices]:
    """Return pairs of a point and a simplex, among them all where the one may hold the other.

    For each owner a grid of about as many cells as it has simplices says which are near: the work
    is proportional to their number, unless many large ones lie over each other.

    Args:
        owner: (n,) of each simplex, ascending.
        simplices: (n, d + 1, d).
        points: (n, count, d) in these.

    Returns:
        numbers of points, count for each simplex, and of simplices of the same owner.
    """
    dim = simplices.shape[2]
    low, high = simplices.min(axis=1), simplices.max(axis=1)
    _, starts, group, numbers = np.unique(
        owner, return_index=True, return_inverse=True, return_counts=True
    )
    corner, end = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    cells = np.ceil(numbers ** (1.0 / dim)).astype(np.intp)
    scale = cells[:, None] / (end - corner)
    first_cell = np.cumsum(cells**dim) - cells**dim

    def cell(group: Indices, x: Array) -> Indices:
        """Return the cells (..., d) along each axis of points (..., d)."""
        place = np.floor((x - corner[group]) * scale[group]).astype(np.intp)
        return np.asarray(np.clip(place, 0, cells[group][..., None] - 1))

    def numbered(group: Indices, place: Indices) -> Indices:
        """Return the numbers (...) of cells (..., d)."""
        line = place[..., 0]
        line = line if dim == 1 else line * cells[group] + place[..., 1]
        return np.asarray(first_cell[group] + line)

    # the cells that each simplex reaches into
    least, most = cell(group, low), cell(group, high)
    extent = most - least + 1
    simplex, inner = expanded_ranges(np.zeros(len(owner), dtype=np.intp), extent.prod(axis=1))
    across = extent[simplex, -1]
    shift = inner[:, None] if dim == 1 else np.stack([inner // across, inner % across], axis=1)
    reached = numbered(group[simplex], least[simplex] + shift)
    order = np.argsort(reached, kind="stable")
    # and those that points are in
    count = points.shape[1]
    of_point = np.repeat(group, count)
    wanted = numbered(of_point, cell(of_point, points.reshape(-1, dim)))
    begin = np.searchsorted(reached[order], wanted)
    found = np.searchsorted(reached[order], wanted, side="right") - begin
    point, place = expanded_ranges(begin, found)
    return point, simplex[order[place]]


def _inside(simplices: Array, points: Array) -> Mask:
    """Return which points (n, d) lie in simplices (n, d + 1, d)."""
    sides = np.swapaxes(simplices[:, 1:] - simplices[:, :1], 1, 2)
    coordinates = np.linalg.solve(sides, (points - simplices[:, 0])[..., None])[..., 0]
    return np.asarray((coordinates > 0.0).all(axis=1) & (coordinates.sum(axis=1) < 1.0))
