"""Overlaps of segments on a line and of convex polygons in a plane, many at once."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices


def overlaps(first: Array, second: Array, *, centred: bool = False) -> tuple[Array, Array, Indices]:
    """Return the overlap of each pair, cut into simplices.

    Args:
        first: (n, a, d) for d = 1 segments (a = 2), for d = 2 convex polygons in any direction.
        second: (n, b, d) likewise.
        centred: whether to cut polygons round their centroids, not from a corner: that is more
            triangles, but which they are does not depend on the order of corners, or on rounding.

    Returns:
        simplices (m, d + 1, d), their sizes (m,), and the pair (m,) of each, ascending. Empty
        overlaps have none.
    """
    if first.shape[2] == 1:
        low = np.maximum(first.min(axis=1), second.min(axis=1))
        high = np.minimum(first.max(axis=1), second.max(axis=1))
        size = (high - low)[:, 0]
        pair = np.flatnonzero(size > 0.0)
        return np.stack([low, high], axis=1)[pair], size[pair], pair
    polygons = clip(second, _counter_clockwise(first))
    fans, areas = _fan(polygons[:, 0], polygons[:, 1:-1], polygons[:, 2:])
    if centred:
        total = areas.sum(axis=1)
        moment = np.einsum("nt,ntci->ni", areas, fans) / 3.0
        # a polygon without area may be a line, far from the origin
        centroid = np.where(total[:, None] > 0.0, moment, polygons[:, 0])
        centroid = centroid / np.where(total > 0.0, total, 1.0)[:, None]
        fans, areas = _fan(centroid, polygons, np.roll(polygons, -1, axis=1))
    pair, place = np.nonzero(areas > 0.0)
    return fans[pair, place], areas[pair, place], pair


def _fan(tip: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Return triangles (n, t, 3, 2) from tips (n, 2) and sides (n, t, 2), and their areas."""
    fans = np.stack([np.broadcast_to(tip[:, None], start.shape), start, end], axis=2)
    areas = 0.5 * np.abs(_cross(start - tip[:, None], end - tip[:, None]))
    return fans, areas


def clip(polygons: Array, windows: Array) -> Array:
    """Return the parts of convex polygons within convex windows (Sutherland and Hodgman 1974).

    Args:
        polygons: (n, a, 2).
        windows: (n, b, 2), counter-clockwise.

    Returns:
        polygons (n, as many as one needs, 2); the last corner is repeated where there are fewer,
        and all corners are the same where nothing is left.
    """
    for corner in range(windows.shape[1]):
        start = windows[:, corner]
        along = windows[:, (corner + 1) % windows.shape[1]] - start
        polygons = _cut(polygons, start, along)
    return polygons


def _cut(polygons: Array, start: Array, along: Array) -> Array:
    """Return what is left (n, c, 2) of polygons (n, a, 2) on the left of a line each.

    A convex polygon has one corner more at most. Where corners coincide but for rounding it may
    cross the line more than twice, and all crossings must stay.
    """
    n, a, _ = polygons.shape
    following = np.roll(polygons, -1, axis=1)
    height = _cross(along[:, None], polygons - start[:, None])
    next_height = np.roll(height, -1, axis=1)
    inside = height >= 0.0
    crosses = inside != (next_height >= 0.0)
    share = np.divide(height, height - next_height, out=np.zeros_like(height), where=crosses)
    crossing = polygons + share[:, :, None] * (following - polygons)
    # each corner gives itself, if it is inside, and then the crossing on the side that follows it
    points = np.stack([polygons, crossing], axis=2).reshape(n, 2 * a, 2)
    given = np.stack([inside, crosses], axis=2).reshape(n, 2 * a)
    place = np.cumsum(given, axis=1)
    number = place[:, -1]
    row, column = np.nonzero(given)
    count = max(int(number.max(initial=1)), 1)
    result = np.zeros((n, count, 2))
    result[row, place[row, column] - 1] = points[row, column]
    slot = np.minimum(np.arange(count), np.maximum(number - 1, 0)[:, None])
    return np.take_along_axis(result, slot[:, :, None], axis=1)


def _counter_clockwise(polygons: Array) -> Array:
    """Return polygons (n, a, 2) with all corners in counter-clockwise order."""
    sides = polygons - polygons[:, :1]
    area = _cross(sides[:, 1:-1], sides[:, 2:]).sum(axis=1)
    return np.where((area < 0.0)[:, None, None], polygons[:, ::-1], polygons)


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products of vectors in the plane (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
