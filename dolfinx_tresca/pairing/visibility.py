"""Which facets may meet: overlaps, points that a body hides, self-contact.

On a surface that touches itself, a point where two facets meet is seen from both, but must be
constrained only once. An order of the facets (`SelfContact`) decides which of two is secondary, by
the undeformed mesh only: so the roles are the same in all positions, on any number of ranks.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask, dots
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.pairing.facets import FACING_COSINE, MISMATCH, NEGLIGIBLE, Facets, SurfaceNodes
from dolfinx_tresca.pairing.pieces import AT_ONCE, CREDIBLE_PART, Pieces

#: Penetration, relative to the radius of a facet, that is always accepted: facets of curved
#: surfaces penetrate each other by a part of their size.
SHALLOW_DEPTH = 0.1

#: Ratio of the mean facet sizes of two bodies below which the finer body is secondary. With 1,
#: rounding would decide between equal bricks.
FINER = 2.0**-0.5
#: Direction that orders the facets of one body, parallel to no face of a usual slit: on a slit with
#: faces along it, rounding would decide the roles, and most nodes would lose their multipliers.
ORDER = np.array([0.49, 0.63, 0.60])

#: Least distance of the two faces of a wall, relative to the undeformed one: no wall gets thinner.
WALL_PART = 0.5


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
    is not paired with y if its distance from the primary surface is much smaller than |s|.

    On a surface that touches itself, both sides consist of all facets. A facet in the way counts as
    secondary if it is on the body of x, else as primary; if x and y are on one body, the facet of y
    does not hide y. Within rounding of the ends, entering counts at x, and leaving at y.
    """

    def __init__(self, pieces: Pieces, partners: Pieces, body: Indices | None = None) -> None:
        """Keep the pieces of both sides, and if the surface touches itself each piece's `body`."""
        self._pieces, self._partners, self._body = pieces, partners, body

    def hidden(
        self, piece: Indices, places: Array, start: Array, end: Array, partner: Indices
    ) -> Mask:
        """Return whether each primary point is hidden from the opposite secondary point, (n,).

        Both are on the normal of the secondary `piece` (n,), ascending, through `places` (n, d) in
        its plane, relative to its centre: the secondary point at the height `start` (n,), and the
        primary point at the height `end` (n,), on the piece `partner` (n,) [length].
        """
        result, in_one_body = np.zeros((2, len(piece)), dtype=np.bool_)
        if self._body is not None:
            in_one_body = self._body[piece] == self._body[partner]
        touch, length = NEGLIGIBLE * self._pieces.radii[piece], np.abs(end - start)
        apart = np.flatnonzero(length > touch)
        if len(apart) == 0:
            return result
        reach = np.maximum(np.abs(start), np.abs(end))[apart]
        for own in (True, False):
            crossings = self._crossings(own, piece[apart], places[apart], reach)
            for crossing, facet, height, outward in crossings:
                point = apart[crossing]
                gap = end[point] > start[point]
                leaves = outward == gap  # whether the segment leaves the body behind the facet
                if own:  # leaving hides, in a gap entering, too
                    matters = leaves | gap
                    # the end of a segment is on its piece, or near it if the facet is curved
                    matters &= ~in_one_body[point] | (facet != partner[point])
                else:  # leaving a body hides in a gap, entering one where bodies overlap
                    matters = leaves == gap
                distance = (height - start[point]) * np.where(gap, 1.0, -1.0)
                distance += np.where(leaves, -touch[point], touch[point])
                between = (distance > 0.0) & (distance <= length[point])
                result[point[matters & between]] = True

        # a deep penetration is not credible if the primary side is much nearer (`CREDIBLE_PART`),
        # in self-contact that of another body
        depth = start - end
        is_deep = depth > SHALLOW_DEPTH * self._pieces.radii[piece]
        deep = apart[(is_deep & ~in_one_body)[apart]]
        if len(deep):
            local = np.column_stack([places, start])[deep]
            steps = np.einsum("nd,ndi->ni", local, self._pieces.frames[piece[deep]])
            points = self._pieces.centres[piece[deep]] + steps
            point, near = self._partners.near(points, CREDIBLE_PART * depth[deep])
            if self._body is not None:
                point = point[self._body[near] != self._body[piece[deep]][point]]
            result[deep[point]] = True
        return result

    def _crossings(
        self, own: bool, piece: Indices, places: Array, reach: Array
    ) -> Iterator[tuple[Indices, Indices, Array, Mask]]:
        """Yield where lines through points, along the normals of their pieces, cross facets.

        The facets are those of the points' `own` side, or of the other side, that may hide a point.
        For `piece` (n,) and `places` (n, d) see `hidden`; crossings farther from the plane than
        `reach` (n,) [length] do not matter, and may be missing.

        Yields:
            for a block of m crossings: the points; the facets, as pieces of their side; the heights
            over the planes of the points [length]; and whether the normals of the facet and of the
            piece point to the same side of the plane.
        """
        pieces, side = self._pieces, self._pieces if own else self._partners
        targets, starts, counts = np.unique(piece, return_index=True, return_counts=True)
        radii = pieces.radii[targets]
        far = np.maximum.reduceat(reach, starts) + radii
        line, facet = side.on_normals(pieces.centres[targets], pieces.normals[targets], radii, far)
        # primary facets whose normals are opposed hide nothing, since segments end there
        target = targets[line]
        normal, its_normal = pieces.normals[target], side.normals[facet]
        cosine = dots(normal, its_normal)
        keep: Mask = cosine > NEGLIGIBLE
        if own:
            # facets hide nothing if a segment crosses them at its own start: the piece itself,
            # facets in its plane, and facets with a common node and a similar normal
            height = np.abs(dots(side.centres[facet] - pieces.centres[target], normal))
            height += side.radii[facet] * np.linalg.norm(normal - its_normal, axis=1)
            keep &= height > NEGLIGIBLE * pieces.radii[target]
            similar = np.flatnonzero(keep)
            nodes, its_nodes = pieces.nodes[target[similar]], side.nodes[facet[similar]]
            are_equal = nodes[:, :, None] == its_nodes[:, None]
            keep[similar] = ~are_equal.any(axis=(1, 2))
            keep |= cosine < -NEGLIGIBLE
        if self._body is not None:
            keep &= (self._body[facet] == self._body[target]) == own
        line, facet = line[keep], facet[keep]

        # corners and normals of these facets in the frames of the pieces
        corners = pieces.local_coordinates(targets[line], side.points[facet])
        normals = np.einsum("ni,ndi->nd", side.normals[facet], pieces.frames[targets[line]])
        # All pairs of a facet and a point of the piece in front of it. Points are ordered by piece:
        # those of the piece `targets[k]` are the `counts[k]` numbers from `starts[k]` on
        pairs = np.cumsum(counts[line])
        blocks = np.flatnonzero(np.diff(pairs // (50 * AT_ONCE))) + 1
        for block in np.split(np.arange(len(line)), blocks):
            numbers = counts[line[block]]
            row = np.repeat(block, numbers)
            ahead = starts[line[block]] + numbers - np.cumsum(numbers)
            point: Indices = np.arange(len(row)) + np.repeat(ahead, numbers)
            around = corners[row, :, :-1] - places[point][:, None]
            crosses = _around_origin(around)
            row, point = row[crosses], point[crosses]
            # the height of the plane of the facet over the point
            middle = around[crosses].mean(axis=1)
            slope = dots(normals[row, :-1], middle) / normals[row, -1]
            height = corners[row, :, -1].mean(axis=1) + slope
            yield point, facet[row], height, normals[row, -1] > 0.0


def _around_origin(corners: Array) -> Mask:
    """Return which segments or convex polygons (n, corners, d) contain the origin, with edges."""
    if corners.shape[2] == 1:
        low, high = corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
        slack = MISMATCH * (high - low)
        return np.asarray((low <= slack) & (high >= -slack))
    # seen from inside, all sides turn in the same sense
    turns = _cross(corners, np.roll(corners, -1, axis=1))
    slack = MISMATCH * np.abs(turns).sum(axis=1, keepdims=True)
    return np.asarray((turns >= -slack).all(axis=1) | (turns <= slack).all(axis=1))


def overlaps(own: Array, partners: Array) -> tuple[Array, Array, Indices]:
    """Intersect pairs of segments or convex polygons and cut the intersections into simplices.

    The corners are (n, a, d) and (n, b, d), of segments (d = 1) or convex polygons (d = 2). An
    intersection of polygons is cut into triangles round its centroid, so that these depend neither
    on rounding nor on the order of the corners. Return the simplices (m, d + 1, d), their areas
    (m,) [length^d], and the index (m,) of their pair, ascending.
    """
    low = np.maximum(own.min(axis=1), partners.min(axis=1))
    high = np.minimum(own.max(axis=1), partners.max(axis=1))
    if own.shape[2] == 1:
        length = (high - low)[:, 0]
        pair = np.flatnonzero(length > 0.0)
        return np.stack([low, high], axis=1)[pair], length[pair], pair
    near = np.flatnonzero((low < high).all(axis=1))  # bounding boxes intersect
    # each partner is clipped at all sides of its window, which turns counter-clockwise
    windows, polygons = own[near], partners[near]
    clockwise = _cross(windows, np.roll(windows, -1, axis=1)).sum(axis=1) < 0.0
    windows[clockwise] = windows[clockwise, ::-1]
    sides = np.roll(windows, -1, axis=1) - windows
    for corner in range(windows.shape[1]):
        polygons = _clipped(polygons, windows[:, corner], sides[:, corner])
    following = np.roll(polygons, -1, axis=1)
    start, end = polygons - polygons[:, :1], following - polygons[:, :1]
    turns = np.abs(_cross(start, end))  # twice the areas of triangles with the first corner
    moment = np.einsum("nc,nci->ni", turns, start + end)
    total = 3.0 * turns.sum(axis=1)[:, None]
    # the centroid of a polygon without area is undefined: take its first corner
    offset = np.divide(moment, total, out=np.zeros_like(moment), where=total > 0.0)
    centroid = np.broadcast_to((polygons[:, 0] + offset)[:, None], polygons.shape)
    fans = np.stack([centroid, polygons, following], axis=2)
    areas = 0.5 * np.abs(_cross(polygons - centroid, following - centroid))
    pair, place = np.nonzero(areas > 0.0)  # corners that are repeated have triangles without area
    return fans[pair, place], areas[pair, place], near[pair]


def _clipped(polygons: Array, start: Array, along: Array) -> Array:
    """Return the part (n, c, 2) of each convex polygon (n, k, 2) on the left of its line.

    Lines go through `start` (n, 2) along `along` (n, 2) (Sutherland and Hodgman 1974). Parts with
    fewer than c corners repeat their last one, and all corners of an empty polygon are equal. A
    polygon whose corners coincide up to rounding may cross its line more than twice.
    """
    n, corners, _ = polygons.shape
    following = np.roll(polygons, -1, axis=1)
    height = _cross(along[:, None], polygons - start[:, None])
    next_height = np.roll(height, -1, axis=1)
    inside = height >= 0.0
    crosses = inside != (next_height >= 0.0)
    share = np.divide(height, height - next_height, out=np.zeros_like(height), where=crosses)
    crossing = polygons + share[:, :, None] * (following - polygons)
    # candidates in turn: a corner, kept if it is inside, and the crossing on the side that follows
    points = np.stack([polygons, crossing], axis=2).reshape(n, 2 * corners, 2)
    dropped = np.stack([~inside, ~crosses], axis=2).reshape(n, 2 * corners)
    # a stable sort puts the candidates that are kept first, in their order
    count = 2 * corners - dropped.sum(axis=1, keepdims=True)
    place = np.minimum(np.arange(count.max(initial=1)), np.maximum(count - 1, 0))
    candidate = np.take_along_axis(np.argsort(dropped, axis=1, kind="stable"), place, axis=1)
    return np.take_along_axis(points, candidate[:, :, None], axis=1)


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products (...) of plane vectors (..., 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


class SelfContact:
    """Decides which facets of a surface that touches itself may meet, and which is secondary.

    Attributes `body`, `size`, `centre`, `normal` and `radius` are `facet_origins`, undeformed;
    `present_centre` and `present_normal` (n, 3) displaced; `corners` (n, corners) node numbers.
    """

    def __init__(self, facets: Facets) -> None:
        columns = np.split(facets.origins, [1, 2, 5, 8], axis=1)
        body, size, self.centre, self.normal, radius = columns
        self.body, self.size, self.radius = body[:, 0].astype(np.intp), size[:, 0], radius[:, 0]
        self.corners = facets.nodes[:, : facets.corners]
        self.present_centre = facets.points[:, : facets.corners].mean(axis=1)
        self.present_normal = facets.mean_normals

    def may_meet(self, facet: Indices, partner: Indices) -> Mask:
        """Return, for pairs of facets (m,), whether the two may come into contact, (m,).

        Facets of two bodies may. Those of one body may not if they are neighbours, or the two faces
        of a wall. Neighbours share a corner and, unlike the lips of a crack at its tip, do not face
        each other in the undeformed mesh. Two facets are the faces of a wall if each is behind the
        other, both in the undeformed mesh and at present: deeper than facets of curved surfaces
        penetrate each other (`SHALLOW_DEPTH`) or, if they share a corner, deeper than touching lips
        (`NEGLIGIBLE`). The present depth must also exceed `WALL_PART` of the undeformed one.
        """
        f, g = facet, partner
        common = (self.corners[f][:, :, None] == self.corners[g][:, None]).any(axis=(1, 2))
        neighbours = common & (dots(self.normal[f], self.normal[g]) >= -FACING_COSINE)
        shallow = np.where(common, NEGLIGIBLE, SHALLOW_DEPTH) * (self.radius[f] + self.radius[g])
        undeformed = _least_depth(self.centre, self.normal, f, g)
        present = _least_depth(self.present_centre, self.present_normal, f, g)
        wall = (undeformed > shallow) & (present > np.maximum(shallow, WALL_PART * undeformed))
        return np.asarray((self.body[f] != self.body[g]) | ~(neighbours | wall))

    def is_secondary(self, facet: Indices, partner: Indices) -> Mask:
        """Return, for pairs of facets (m,), whether the first one is secondary, (m,).

        Of two bodies see `is_secondary_body`. If two facets of one body have opposed normals in the
        undeformed mesh, as in a slit, it is the facet whose normal is more along `ORDER`; else, as
        on a folded sheet, the facet that comes first in this direction.
        """
        f, g = facet, partner
        of_bodies = is_secondary_body(self.body[f], self.body[g], self.size[f], self.size[g])
        faced = dots(self.normal[f], self.normal[g])[:, None] < -FACING_COSINE
        turned, ahead = self.normal[f] - self.normal[g], self.centre[g] - self.centre[f]
        towards = np.where(faced, turned, ahead)
        return np.where(self.body[f] == self.body[g], towards @ ORDER > 0.0, of_bodies)


def is_secondary_body(body: Any, partner: Any, size: Any, partner_size: Any) -> Mask:
    """Return whether the first of two bodies (...) is secondary, which depends on facet sizes.

    It is the body with finer facets; if neither is finer (`FINER`), that with the lower number.
    """
    finer, coarser = np.sort([size, partner_size], axis=0)
    return np.asarray(np.where(finer > FINER * coarser, body < partner, size < partner_size))


def _least_depth(centre: Array, normal: Array, facet: Indices, partner: Indices) -> Array:
    """Return the smaller depth (m,) of two facets' centres, each behind the other's plane."""
    offset = centre[partner] - centre[facet]
    return np.minimum(-dots(offset, normal[facet]), dots(offset, normal[partner]))


def facet_origins(V: Any, facets: Facets) -> Array:
    """Return `Facets.origins` of this rank's undeformed facets. Collective.

    Rows have the body, the mean size of its facets on the surface [length], and the facet's centre
    (3) [length], outward unit normal (3) and radius [length], for `SelfContact`.
    """
    comm = V.mesh.comm
    labels = label_bodies(V)
    body = labels[V.dofmap.index_map.global_to_local(facets.nodes[:, 0])]
    bodies = int(reduce_array(comm, labels.max(initial=-1), MPI.MAX)) + 1
    count = reduce_array(comm, np.bincount(body, minlength=bodies))
    area = reduce_array(comm, np.bincount(body, facets.areas, minlength=bodies))
    size = (area / np.maximum(count, 1)) ** (1.0 / facets.dim)
    corners = facets.points[:, : facets.corners]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1, initial=0.0)
    return np.column_stack([body, size[body], centre, facets.mean_normals, radius])


def redundant_nodes(nodes: SurfaceNodes, paired: Indices, exchanged: Indices) -> Mask:
    """Return a mask (n,) of nodes that need no multiplier on a surface that touches itself.

    Nodes count as opposite if facets at them overlap. Where the choice of `SelfContact` changes
    from facet to facet, two opposite nodes may each be secondary on one facet and primary on the
    next. Both would have the same jump: the node that comes first in the mesh file has the
    multiplier, and the second one is redundant. So is a node that is opposite to itself, such as
    the tip of a crack, which has no jump. Valid for nodes with all facets on this rank.

    The facet pairs are those of `MortarIntegrals`: `paired` (p, 2) have the secondary facet first,
    `exchanged` (q, 2) the primary one.
    """
    count, in_file = nodes.facets.corners, nodes.facets.file_numbers

    def rows(pairs: Indices) -> Indices:
        """Return rows (node of a first facet, its number in the file, that of an opposite node)."""
        own, theirs = pairs.T
        node = np.repeat(nodes.facet_nodes[own], count, axis=1)
        number = np.repeat(in_file[own], count, axis=1)
        result: Indices = np.stack([node, number, np.tile(in_file[theirs], count)], axis=2)
        return np.unique(result.reshape(-1, 3), axis=0)

    # a row of both kinds of pairs is of a node that is secondary on one facet, primary on another
    together = np.concatenate([rows(paired), rows(exchanged)])
    seen, times = np.unique(together, axis=0, return_counts=True)
    own, theirs = seen[:, 1], seen[:, 2]
    is_redundant = (own == theirs) | (times > 1) & (own > theirs)
    return np.isin(np.arange(len(nodes.numbers)), seen[is_redundant, 0])
