"""Selection of the nearest one of several layers of facets that cover each other."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.pairing.search.search import expanded_ranges

#: The overlaps of a piece are taken not to cover each other if their total area is at most this
#: times the area of the piece: 1 plus rounding.
COVERED_ONCE = 1.0 + 1e-8


def nearest_layer_weights(
    piece: Indices,
    pair: Indices,
    simplices: Array,
    size: Array,
    places: Array,
    gap: Array,
    weight: Array,
    piece_area: Array,
) -> Array:
    """Set the weights of quadrature points to zero where a nearer simplex covers the point.

    The overlap of each pair of pieces is cut into simplices, each with the same number of
    quadrature points. Where simplices of two pairs overlap, the simplex with the smaller mean |gap|
    counts.

    Args:
        piece: (pairs,) the secondary piece of each pair, ascending.
        pair: (simplices,) the pair of each simplex, ascending.
        simplices: (simplices, d + 1, d) corners in the plane of the secondary piece [length].
        size: (simplices,) sizes of the simplices [length^d].
        places: (points, d) quadrature points in the plane of the secondary piece [length].
        gap: (points,) gap along the normal [length], positive if open.
        weight: (points,) quadrature weights, 0 for points that are already excluded.
        piece_area: (pieces,) sizes of all secondary pieces [length^d].

    Returns:
        The new weights (points,).
    """
    if len(pair) == 0:
        return weight
    count = len(places) // len(pair)
    counts = weight.reshape(-1, count).any(axis=1)
    covered = np.bincount(piece[pair], size * counts, minlength=len(piece_area))
    overlaid = (covered > COVERED_ONCE * piece_area)[piece[pair]]
    crowded = np.flatnonzero(overlaid & counts)
    if len(crowded) == 0:
        return weight
    inner = places.reshape(-1, count, places.shape[1])[crowded]
    point, b = _candidate_pairs(piece[pair[crowded]], simplices[crowded], inner)
    a, b, place = crowded[point // count], crowded[b], inner.reshape(-1, inner.shape[2])[point]
    # a point of simplex a is dropped if it lies in a nearer simplex b of another pair
    distance = np.abs(gap).reshape(-1, count).mean(axis=1)
    nearer = (pair[a] != pair[b]) & (distance[b] < distance[a])
    point, a, b, place = point[nearer], a[nearer], b[nearer], place[nearer]
    inside = _inside(simplices[b], place)
    result = weight.reshape(-1, count).copy()
    result[a[inside], point[inside] % count] = 0.0
    return result.ravel()


def _candidate_pairs(owner: Indices, simplices: Array, points: Array) -> tuple[Indices, Indices]:
    """Find all pairs of a point and a simplex of the same owner that may contain the point.

    The caller drops points that lie in a nearer simplex, where primary facets overlap.

    Each owner has a grid with about as many cells as simplices. The work is proportional to the
    number of simplices, unless many large simplices cover each other.

    Args:
        owner: (n,) the owner of each simplex, a secondary piece, ascending.
        simplices: (n, d + 1, d) corners of the simplices.
        points: (n, count, d) points in each simplex.

    Returns:
        The indices (m,) of the points, numbered from 0 to n count - 1 simplex by simplex, and the
        indices (m,) of the simplices that may contain them.
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

    def grid_indices(group: Indices, x: Array) -> Indices:
        """Return the grid indices (..., d) of the cells that contain points (..., d)."""
        place = np.floor((x - corner[group]) * scale[group]).astype(np.intp)
        return np.asarray(np.clip(place, 0, cells[group][..., None] - 1))

    def cell_numbers(group: Indices, place: Indices) -> Indices:
        """Return the numbers (...) of cells with grid indices (..., d)."""
        line = place[..., 0]
        line = line if dim == 1 else line * cells[group] + place[..., 1]
        return np.asarray(first_cell[group] + line)

    # the cells that the bounding box of each simplex covers
    least, most = grid_indices(group, low), grid_indices(group, high)
    extent = most - least + 1
    simplex, inner = expanded_ranges(np.zeros(len(owner), dtype=np.intp), extent.prod(axis=1))
    across = extent[simplex, -1]
    shift = inner[:, None] if dim == 1 else np.stack([inner // across, inner % across], axis=1)
    simplex_cell = cell_numbers(group[simplex], least[simplex] + shift)
    order = np.argsort(simplex_cell, kind="stable")
    # the cells that contain the points
    count = points.shape[1]
    point_group = np.repeat(group, count)
    point_cell = cell_numbers(point_group, grid_indices(point_group, points.reshape(-1, dim)))
    begin = np.searchsorted(simplex_cell[order], point_cell)
    found = np.searchsorted(simplex_cell[order], point_cell, side="right") - begin
    point, place = expanded_ranges(begin, found)
    return point, simplex[order[place]]


def _inside(simplices: Array, points: Array) -> Mask:
    """Return whether each point (n, d) lies inside its simplex (n, d + 1, d)."""
    sides = np.swapaxes(simplices[:, 1:] - simplices[:, :1], 1, 2)
    coordinates = np.linalg.solve(sides, (points - simplices[:, 0])[..., None])[..., 0]
    return np.asarray((coordinates > 0.0).all(axis=1) & (coordinates.sum(axis=1) < 1.0))
