"""Overlaps of facets along a normal: the nearest of them, and nothing behind a body."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.pairing.search.balls import AT_ONCE, Pieces, expanded_ranges, flattened
from dolfinx_tresca.pairing.search.facets import (
    CREDIBLE_PART,
    MISMATCH,
    NEGLIGIBLE,
    SHALLOW_DEPTH,
)


class Occluders(NamedTuple):
    """Facets of one side that may cross segments from secondary pieces to primary points.

    There is a row for each pair of an occluder and a piece whose projections onto the plane of the
    piece overlap.

    Attributes:
        piece: (n,) index of the occluder among the pieces of its side.
        target: (n,) index of the secondary piece in the list that was asked for, ascending.
        corners: (n, corners, d) corners of the occluder, projected onto the plane [length].
        height: (n,) height of the centre of the occluder over the plane [length].
        slope: (n, d) gradient of the height of the occluder over the plane.
        outward: (n,) whether the normals of both are on the same side of the plane.
    """

    piece: Indices
    target: Indices
    corners: Array
    height: Array
    slope: Array
    outward: Mask


class Visibility:
    """Decides which points of the primary side are hidden from points of the secondary side.

    A point x of the secondary side with outward normal n may touch a point y = x + s n of the
    primary side, whose normal is opposed, if the segment from x to y crosses no facet of either
    side in the wrong direction. A crossing either enters or leaves the body behind the facet:

    * s > 0, gap: the segment is outside of both bodies. It must not enter the secondary body, nor
      leave any body.
    * s < 0, penetration: the segment is inside both bodies, which overlap. It must not leave the
      secondary body, nor enter the primary body.

    If edges of two bodies overlap, the segment may also run inside both bodies along a face. So x
    is also not paired with y if the distance of x from the primary surface, in any direction, is
    much smaller than the penetration |s|.

    On a surface that touches itself, both sides consist of all facets. A facet in the way of a
    segment then counts as secondary if it is on the body of x, and as primary otherwise. If x and y
    are on one body, a segment enters or leaves this body at y, which does not hide y.

    If surfaces touch, crossings within rounding of an end of the segment count as follows: entering
    counts at x, leaving counts at y. Among several visible points the nearest one is paired, see
    `nearest_layer_weights`.
    """

    def __init__(self, pieces: Pieces, partners: Pieces, body: Indices | None = None) -> None:
        """Keep the pieces of both sides.

        Args:
            pieces: pieces of the secondary side.
            partners: pieces of the primary side.
            body: (n,) the body of each piece of a surface that touches itself, where `partners` are
                the same pieces; None for two surfaces.
        """
        self._pieces, self._others, self._body = pieces, partners, body

    def hidden(
        self,
        piece: Indices,
        places: Array,
        start: Array,
        end: Array,
        partner: Indices | None = None,
    ) -> Mask:
        """Return whether each primary point is hidden from the opposite secondary point, (n,).

        Args:
            piece: (n,) the secondary piece of each point, ascending.
            places: (n, d) position of each point in the plane of the piece, relative to the centre
                of the piece [length].
            start: (n,) height of the secondary side over the plane, along the normal [length].
            end: (n,) height of the primary side over the plane [length].
            partner: (n,) the primary piece of each point; needed on a surface that touches itself.
        """
        result, in_one_body = np.zeros((2, len(piece)), dtype=np.bool_)
        # the piece of the primary point, if it may be on `own`
        end_piece: Indices = np.full(len(piece), -1)
        if self._body is not None and partner is not None:
            in_one_body, end_piece = self._body[piece] == self._body[partner], partner
        apart = np.flatnonzero(np.abs(end - start) > NEGLIGIBLE * self._pieces.radii[piece])
        if len(apart) == 0:
            return result
        targets, starts, target = np.unique(piece[apart], return_index=True, return_inverse=True)
        reach = np.maximum.reduceat(np.maximum(np.abs(start), np.abs(end))[apart], starts)
        for own in (True, False):
            occluders = self._occluders(own, targets, reach)
            begin = np.searchsorted(occluders.target, target)
            numbers = np.searchsorted(occluders.target, target, side="right") - begin
            block = np.cumsum(numbers) // (50 * AT_ONCE)
            for chunk in np.split(np.arange(len(apart)), np.flatnonzero(np.diff(block)) + 1):
                # all pairs of a point and a possible occluder
                owner, occluder = expanded_ranges(begin[chunk], numbers[chunk])
                place = apart[chunk[owner]]
                if own:  # the end of a segment is on its piece, or near it if the facet is curved
                    passed = occluders.piece[occluder] != end_piece[place]
                    occluder, place = occluder[passed], place[passed]
                around = occluders.corners[occluder] - places[place][:, None]
                crosses = _around_origin(around)
                occluder, place, middle = occluder[crosses], place[crosses], around[crosses]
                middle = middle.mean(axis=1)
                crossing = occluders.height[occluder]
                crossing = crossing - np.einsum("nd,nd->n", occluders.slope[occluder], middle)
                outward = occluders.outward[occluder]
                gap = end[place] > start[place]
                leaves = outward == gap  # whether the segment leaves the body behind the facet
                matters = leaves | gap if own else leaves == gap
                distance = (crossing - start[place]) * np.where(gap, 1.0, -1.0)
                touch = NEGLIGIBLE * self._pieces.radii[piece[place]]
                place_on_line = np.where(leaves, distance - touch, distance + touch)
                length = np.abs(end - start)[place]
                between = (place_on_line > 0.0) & (place_on_line <= length)
                result[place[matters & between]] = True
        apart = apart[~in_one_body[apart]]
        result[apart] |= self._is_too_deep(piece[apart], places[apart], start[apart], end[apart])
        return result

    def _is_too_deep(self, piece: Indices, places: Array, start: Array, end: Array) -> Mask:
        """Return whether points (n,) penetrate far more than their distance from the primary side.

        This is so if the distance is less than `CREDIBLE_PART` times the penetration. On a surface
        that touches itself only other bodies count as primary side. The arguments are those of
        `hidden`.
        """
        result = np.zeros(len(piece), dtype=np.bool_)
        deep = np.flatnonzero(start - end > SHALLOW_DEPTH * self._pieces.radii[piece])
        if len(deep) == 0:
            return result
        local = np.column_stack([places, start])[deep]
        points = self._pieces.centres[piece[deep]]
        points = points + np.einsum("nd,ndi->ni", local, self._pieces.frames[piece[deep]])
        limit = CREDIBLE_PART * (start - end)[deep]
        near = cKDTree(self._others.centres).query_ball_point(
            points, limit + self._others.radii.max()
        )
        point, partner = flattened(near)
        if self._body is not None:
            elsewhere = self._body[partner] != self._body[piece[deep]][point]
            point, partner = point[elsewhere], partner[elsewhere]
        within = self._others.distances(partner, points[point]) < limit[point]
        result[deep[point[within]]] = True
        return result

    def _occluders(self, own: bool, targets: Indices, reach: Array) -> Occluders:
        """Return the facets of one side that may cross segments from pieces to primary points.

        Args:
            own: whether the occluders are on the secondary side.
            targets: (m,) secondary pieces, along whose normals the segments run.
            reach: (m,) largest distance of the segments' ends from the plane of each piece
                [length].
        """
        pieces, side = self._pieces, self._pieces if own else self._others
        target, occluder = side.balls.on_normals(
            pieces.centres[targets], pieces.normals[targets], pieces.radii[targets],
            reach + pieces.radii[targets],
        )  # fmt: skip
        keep = self._may_hide(own, targets[target], occluder)
        target, occluder = target[keep], occluder[keep]
        # whose projection onto the plane of the piece overlaps the piece
        piece = targets[target]
        corners = pieces.local_coordinates(piece, side.points[occluder])
        flat = corners[:, :, :-1]
        own_flat = pieces.local_coordinates(piece, pieces.points[piece])[:, :, :-1]
        low = np.maximum(flat.min(axis=1), own_flat.min(axis=1))
        high = np.minimum(flat.max(axis=1), own_flat.max(axis=1))
        keep = (high - low > MISMATCH * np.ptp(own_flat, axis=1)).all(axis=1)
        target, occluder, piece, corners = target[keep], occluder[keep], piece[keep], corners[keep]
        normals = np.einsum("ni,ndi->nd", side.normals[occluder], pieces.frames[piece])
        return Occluders(
            occluder,
            target,
            corners[:, :, :-1],
            corners[:, :, -1].mean(axis=1),
            -normals[:, :-1] / normals[:, -1:],
            normals[:, -1] > 0.0,
        )

    def _may_hide(self, own: bool, piece: Indices, occluder: Indices) -> Mask:
        """Return whether facets (n,) of one side, near the normal of a piece, may hide its points.

        Segments end at primary facets whose normals are opposed, so these hide nothing. Of the
        secondary side the piece itself, and facets in its plane, hide nothing; nor do facets with a
        common node and a similar normal, which a segment crosses at its own start.

        Args:
            own: whether the occluders are on the secondary side.
            piece: (n,) the secondary piece.
            occluder: (n,) the facet among the pieces of its side.
        """
        pieces, side = self._pieces, self._pieces if own else self._others
        normal, their_normal = pieces.normals[piece], side.normals[occluder]
        cosine = np.einsum("ni,ni->n", normal, their_normal)
        result: Mask = cosine > NEGLIGIBLE
        if own:
            offset = side.centres[occluder] - pieces.centres[piece]
            height = np.abs(np.einsum("ni,ni->n", offset, normal))
            height += side.radii[occluder] * np.linalg.norm(normal - their_normal, axis=1)
            result &= height > NEGLIGIBLE * pieces.radii[piece]
            similar = np.flatnonzero(result)
            nodes = pieces.nodes[piece[similar]], side.nodes[occluder[similar]]
            result[similar] = ~(nodes[0][:, :, None] == nodes[1][:, None]).any(axis=(1, 2))
            result |= cosine < -NEGLIGIBLE
        if self._body is not None:
            result &= (self._body[occluder] == self._body[piece]) == own
        return result


def _around_origin(corners: Array) -> Mask:
    """Return whether the origin lies in segments or polygons (n, corners, d), or on their edges."""
    if corners.shape[2] == 1:
        low, high = corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
        slack = MISMATCH * (high - low)
        return np.asarray((low <= slack) & (high >= -slack))
    following = np.roll(corners, -1, axis=1)
    turns = corners[..., 0] * following[..., 1] - corners[..., 1] * following[..., 0]
    slack = MISMATCH * np.abs(turns).sum(axis=1, keepdims=True)
    return np.asarray((turns >= -slack).all(axis=1) | (turns <= slack).all(axis=1))


def overlaps(own: Array, partners: Array, *, centred: bool = False) -> tuple[Array, Array, Indices]:
    """Intersect pairs of segments or convex polygons and cut the intersections into simplices.

    Args:
        own: (n, a, d) corners of the first segments (d = 1, a = 2) or convex polygons (d = 2),
            clockwise or counter-clockwise.
        partners: (n, b, d) corners of the second segments or polygons, in either order.
        centred: whether polygons are cut into triangles round their centroid, instead of a fan of
            triangles from one of their corners. This gives more triangles, but they do not depend
            on rounding or on the order of the corners.

    Returns:
        The simplices (m, d + 1, d), their sizes (m,) [length^d], and the index (m,) of their pair,
        ascending. Pairs with an empty intersection have no simplices.
    """
    low = np.maximum(own.min(axis=1), partners.min(axis=1))
    high = np.minimum(own.max(axis=1), partners.max(axis=1))
    if own.shape[2] == 1:
        size = (high - low)[:, 0]
        pair = np.flatnonzero(size > 0.0)
        return np.stack([low, high], axis=1)[pair], size[pair], pair
    near = np.flatnonzero((low < high).all(axis=1))  # bounding boxes intersect
    windows = own[near]
    sides = windows - windows[:, :1]
    clockwise = _cross(sides[:, 1:-1], sides[:, 2:]).sum(axis=1) < 0.0
    windows[clockwise] = windows[clockwise, ::-1]
    polygons = clip(partners[near], windows)
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
    overlaid = (covered > (1.0 + MISMATCH) * piece_area)[piece[pair]]
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
