"""Intersection of segments or convex polygons, and the nearest of those that cover each other."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.pairing.search.balls import flattened

#: The overlaps of a piece are taken not to cover each other if their total area is at most this
#: times the area of the piece: 1 plus rounding.
COVERED_ONCE = 1.0 + 1e-8


def overlaps(first: Array, second: Array, *, centred: bool = False) -> tuple[Array, Array, Indices]:
    """Intersect pairs of segments or convex polygons and cut the intersections into simplices.

    Args:
        first: (n, a, d) corners of the first segments (d = 1, a = 2) or convex polygons (d = 2),
            clockwise or counter-clockwise.
        second: (n, b, d) corners of the second segments or polygons, in either order.
        centred: whether polygons are cut into triangles round their centroid, instead of a fan of
            triangles from one of their corners. This gives more triangles, but they do not depend
            on rounding or on the order of the corners.

    Returns:
        The simplices (m, d + 1, d), their sizes (m,) [length^d], and the index (m,) of their pair,
        ascending. Pairs with an empty intersection have no simplices.
    """
    if first.shape[2] == 1:
        low = np.maximum(first.min(axis=1), second.min(axis=1))
        high = np.minimum(first.max(axis=1), second.max(axis=1))
        size = (high - low)[:, 0]
        pair = np.flatnonzero(size > 0.0)
        return np.stack([low, high], axis=1)[pair], size[pair], pair
    low, high = np.maximum(first.min(1), second.min(1)), np.minimum(first.max(1), second.max(1))
    near = np.flatnonzero((low < high).all(axis=1))  # bounding boxes intersect
    windows = first[near]
    sides = windows - windows[:, :1]
    clockwise = _cross(sides[:, 1:-1], sides[:, 2:]).sum(axis=1) < 0.0
    windows[clockwise] = windows[clockwise, ::-1]
    polygons = clip(second[near], windows)
    fans, areas = _triangle_fan(polygons[:, 0], polygons[:, 1:-1], polygons[:, 2:])
    if centred:
        total = areas.sum(axis=1)
        moment = np.einsum("nt,ntci->ni", areas, fans) / 3.0
        # the centroid of a polygon without area is undefined: take its first corner
        centroid = np.where(total[:, None] > 0.0, moment, polygons[:, 0])
        centroid = centroid / np.where(total > 0.0, total, 1.0)[:, None]
        fans, areas = _triangle_fan(centroid, polygons, np.roll(polygons, -1, axis=1))
    pair, place = np.nonzero(areas > 0.0)
    return fans[pair, place], areas[pair, place], near[pair]


def _triangle_fan(tip: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Return triangles (n, t, 3, 2) between `tip` (n, 2) and sides, and their areas (n, t).

    The sides lead from `start` to `end`, (n, t, 2).
    """
    fans = np.stack([np.broadcast_to(tip[:, None], start.shape), start, end], axis=2)
    areas = 0.5 * np.abs(_cross(start - tip[:, None], end - tip[:, None]))
    return fans, areas


def clip(polygons: Array, windows: Array) -> Array:
    """Clip convex polygons by convex windows (Sutherland and Hodgman 1974).

    Args:
        polygons: (n, a, 2) corners of the polygons.
        windows: (n, b, 2) corners of the windows, counter-clockwise.

    Returns:
        Polygons (n, c, 2), where c is the largest number of corners. Polygons with fewer corners
        repeat their last corner; all corners of an empty polygon are equal.
    """
    for corner in range(windows.shape[1]):
        start = windows[:, corner]
        along = windows[:, (corner + 1) % windows.shape[1]] - start
        polygons = _clip_by_line(polygons, start, along)
    return polygons


def _clip_by_line(polygons: Array, start: Array, along: Array) -> Array:
    """Return the part (n, c, 2) of each polygon on the left of its line.

    The line of each polygon goes through a point `start` (n, 2) in the direction `along` (n, 2). A
    convex polygon gains at most one corner. If corners coincide up to rounding, a polygon may cross
    its line more than twice; all crossings are kept.
    """
    n, a, _ = polygons.shape
    following = np.roll(polygons, -1, axis=1)
    height = _cross(along[:, None], polygons - start[:, None])
    next_height = np.roll(height, -1, axis=1)
    inside = height >= 0.0
    crosses = inside != (next_height >= 0.0)
    share = np.divide(height, height - next_height, out=np.zeros_like(height), where=crosses)
    crossing = polygons + share[:, :, None] * (following - polygons)
    # candidates in turn: a corner, kept if it is inside, and the crossing on the side that follows
    points = np.stack([polygons, crossing], axis=2).reshape(n, 2 * a, 2)
    kept = np.stack([inside, crosses], axis=2).reshape(n, 2 * a)
    place = np.cumsum(kept, axis=1)
    number = place[:, -1]
    row, column = np.nonzero(kept)
    count = max(int(number.max(initial=1)), 1)
    result = np.zeros((n, count, 2))
    result[row, place[row, column] - 1] = points[row, column]
    slot = np.minimum(np.arange(count), np.maximum(number - 1, 0)[:, None])
    return np.take_along_axis(result, slot[:, :, None], axis=1)


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products (...) of plane vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


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
    inner = places.reshape(-1, count, places.shape[1])[crowded].reshape(-1, places.shape[1])
    # a tree for the planes of all pieces, far apart along one more axis
    middles = simplices[crowded].mean(axis=1)
    reach = np.linalg.norm(simplices[crowded] - middles[:, None], axis=2).max()
    plane = 4.0 * reach * piece[pair[crowded]]
    tree = cKDTree(np.column_stack([middles, plane]))
    points = np.column_stack([inner, np.repeat(plane, count)])
    point, b = flattened(tree.query_ball_point(points, reach * (1.0 + 1e-9)))
    a, b, place = crowded[point // count], crowded[b], inner[point]
    # a point of simplex a is dropped if it lies in a nearer simplex b of another pair
    distance = np.abs(gap).reshape(-1, count).mean(axis=1)
    nearer = (pair[a] != pair[b]) & (distance[b] < distance[a])
    point, a, b, place = point[nearer], a[nearer], b[nearer], place[nearer]
    sides = np.swapaxes(simplices[b, 1:] - simplices[b, :1], 1, 2)
    reference = np.linalg.solve(sides, (place - simplices[b, 0])[..., None])[..., 0]
    inside = (reference > 0.0).all(axis=1) & (reference.sum(axis=1) < 1.0)
    result = weight.reshape(-1, count).copy()
    result[a[inside], point[inside] % count] = 0.0
    return result.ravel()
