"""What stands between a facet and another one that it faces: nothing pairs through a body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.surface.distance import distances
from dolfinx_tresca.surface.pieces import Pieces
from dolfinx_tresca.surface.search import Balls, expanded_ranges, flattened

#: Least cosine between the normals of facets that face each other, one reversed: 84 degrees. Nearer
#: to a right angle an overlap, as seen along the normal, stands for ten times its area and more.
FACING_COSINE = 0.1

#: Distance of surfaces over the radius of a facet up to which they touch: above rounding, and far
#: below what a mesh resolves.
TOUCHING_DISTANCE = 1e-6

#: Penetration over the radius of a facet up to which it is taken for what it is: facets of curved
#: surfaces overlap by a part of their size.
SHALLOW_DEPTH = 0.1

#: Least distance of a place from the other side's surface, in any direction, over its penetration
#: along the normal. It is 1 where surfaces are parallel, and 0 where the line runs along a face.
CREDIBLE_PART = 0.1

#: Cosine between a line and the normal of a facet up to which they run in parallel: rounding.
PARALLEL_COSINE = 1e-6

#: Pairs of a place and a facet that may stand before it that are treated at once, to bound the
#: memory.
CROSSINGS_AT_ONCE = 100_000

#: Length in a facet's plane, over its size, that is rounding.
POSITION_ROUNDING = 1e-9


class Visibility:
    """Tells which places of the other side are hidden from places of the secondary side.

    A place x with the outward normal n may touch a place y = x + s n of the other side, where the
    normal is opposed, if the line between them crosses no facet of either side the wrong way.
    Facets are crossed into or out of their body:

    * s > 0, a gap: the line runs outside of both bodies. It must not enter the secondary side's
      body again, nor leave any body.
    * s < 0, penetration: the line from x back to y lies in both bodies where they overlap. It must
      not leave the secondary side's body, nor enter that of the other side.

    Where edges of two bodies overlap, the line may lie in both of them along a face as well: a
    place that penetrates much deeper along its normal than the surface of the other side is far
    from it in any direction does not touch what is there.

    Where surfaces touch, a crossing in the very place of x or of y counts by what it means: to
    enter counts at x, to leave at y. Of what is visible the nearest counts, see surface/nearest.py.
    """

    def __init__(self, pieces: Pieces, others: Pieces) -> None:
        """Prepare for two sides."""
        self._pieces, self._others = pieces, others
        self._frames = pieces.frames()
        # no normal of the first side is more than an angle from their mean: which ones of the other
        # side may be less than a right angle from any of them?
        mean = pieces.normals.sum(axis=0) / max(len(pieces.normals), 1)
        least = (pieces.normals @ mean).min(initial=float(mean @ mean))
        sine = np.sqrt(np.maximum(mean @ mean - np.square(least), 0.0))
        may = (least <= 0.0) | (others.normals @ mean > -sine - PARALLEL_COSINE)
        #: those pieces of the other side
        self._turned_away = np.flatnonzero(may)

    @cached_property
    def _own_balls(self) -> Balls:
        """All pieces of the first side."""
        return Balls(self._pieces.centres, self._pieces.radii)

    @cached_property
    def _other_balls(self) -> Balls:
        """Those of the other side that may stand before something."""
        some = self._turned_away
        return Balls(self._others.centres[some], self._others.radii[some])

    def hidden(self, piece: Indices, places: Array, start: Array, end: Array) -> Mask:
        """Return whether something stands between, (n,).

        Args:
            piece: (n,) secondary pieces, ascending.
            places: (n, d) in the planes of these, relative to their centres.
            start: (n,) heights there of the secondary side over these planes, along the normal.
            end: (n,) heights of the other side.
        """
        result = np.zeros(len(piece), dtype=np.bool_)
        apart = np.flatnonzero(np.abs(end - start) > TOUCHING_DISTANCE * self._pieces.radii[piece])
        if len(apart) == 0:
            return result
        lines, first, line = np.unique(piece[apart], return_index=True, return_inverse=True)
        reach = np.maximum.reduceat(np.maximum(np.abs(start), np.abs(end))[apart], first)
        for own in (True, False):
            occluders = self._occluders(own, lines, reach)
            begin = np.searchsorted(occluders.line, line)
            numbers = np.searchsorted(occluders.line, line, side="right") - begin
            block = np.cumsum(numbers) // CROSSINGS_AT_ONCE
            for some in np.split(np.arange(len(apart)), np.flatnonzero(np.diff(block)) + 1):
                # all pairs of a place and a facet that may stand before it
                owner, occluder = expanded_ranges(begin[some], numbers[some])
                place = apart[some[owner]]
                place, height, out = occluders.crossed(occluder, place, places[place])
                gap = end[place] > start[place]
                leaves = out == gap  # the body that is crossed, on the way from start to end
                matters = leaves | gap if own else leaves == gap
                distance = (height - start[place]) * np.where(gap, 1.0, -1.0)
                touch = TOUCHING_DISTANCE * self._pieces.radii[piece[place]]
                at = np.where(leaves, distance - touch, distance + touch)
                between = (at > 0.0) & (at <= np.abs(end - start)[place])
                result[place[matters & between]] = True
        result[apart] |= self._too_deep(piece[apart], places[apart], start[apart], end[apart])
        return result

    def _too_deep(self, piece: Indices, places: Array, start: Array, end: Array) -> Mask:
        """Return whether bodies overlap less deeply elsewhere, see `hidden`."""
        result = np.zeros(len(piece), dtype=np.bool_)
        deep = np.flatnonzero(start - end > SHALLOW_DEPTH * self._pieces.radii[piece])
        if len(deep) == 0:
            return result
        local = np.column_stack([places, start])[deep]
        points = self._pieces.centres[piece[deep]]
        points = points + np.einsum("nd,ndi->ni", local, self._frames[piece[deep]])
        limit = CREDIBLE_PART * (start - end)[deep]
        near = cKDTree(self._others.centres).query_ball_point(
            points, limit + self._others.radii.max()
        )
        point, other = flattened(near)
        within = distances(self._others, other, points[point]) < limit[point]
        result[deep[point[within]]] = True
        return result

    def _occluders(self, own: bool, lines: Indices, reach: Array) -> _Occluders:
        """Return what of a side may stand before the pieces `lines`, up to a distance `reach`."""
        pieces, side = self._pieces, self._pieces if own else self._others
        # a facet of the other side with opposed normal is what lines end at, and hides nothing
        balls = self._own_balls if own else self._other_balls
        line, occluder = balls.facing(
            pieces.centres[lines], pieces.normals[lines], pieces.radii[lines],
            reach + pieces.radii[lines],
        )  # fmt: skip
        occluder, piece = occluder if own else self._turned_away[occluder], lines[line]
        normal, other = pieces.normals[piece], side.normals[occluder]
        cosine = np.einsum("ni,ni->n", normal, other)
        if own:
            offset = side.centres[occluder] - pieces.centres[piece]
            height = np.abs(np.einsum("ni,ni->n", offset, normal))
            height += side.radii[occluder] * np.linalg.norm(normal - other, axis=1)
            apart = height > TOUCHING_DISTANCE * pieces.radii[piece]
            keep = (cosine < -PARALLEL_COSINE) | (cosine > PARALLEL_COSINE) & apart
        else:
            keep = cosine > PARALLEL_COSINE
        line, occluder, piece, cosine = line[keep], occluder[keep], piece[keep], cosine[keep]
        if own:  # the surface round a place is crossed in the place alone
            common = pieces.nodes[piece][:, :, None] == side.nodes[occluder][:, None]
            keep = (cosine < 0.0) | ~common.any(axis=(1, 2))
            line, occluder, piece = line[keep], occluder[keep], piece[keep]
        return _Occluders.of(
            line,
            pieces.local_coordinates(self._frames, piece, side.points[occluder]),
            np.einsum("ni,ndi->nd", side.normals[occluder], self._frames[piece]),
            pieces.local_coordinates(self._frames, piece, pieces.points[piece]),
        )


@dataclass(frozen=True)
class _Occluders:
    """Facets that may stand before places, as seen along the normals of the places' pieces.

    Attributes:
        line: (n,) for what line, ascending.
        corners: (n, corners, d) in the plane of its piece.
        height: (n,) of their middle over that plane.
        slope: (n, d) of their planes over it.
        out: (n,) whether their normals point along the line.
    """

    line: Indices
    corners: Array
    height: Array
    slope: Array
    out: Mask

    @classmethod
    def of(cls, line: Indices, seen: Array, normals: Array, own: Array) -> _Occluders:
        """Keep those that may lie over a part of the piece itself.

        Args:
            line: (n,).
            seen: (n, corners, d + 1) corners in the frame of the piece.
            normals: (n, d + 1) likewise.
            own: (n, corners, d + 1) corners of the piece.
        """
        flat, mine = seen[:, :, :-1], own[:, :, :-1]
        low, high = np.maximum(flat.min(1), mine.min(1)), np.minimum(flat.max(1), mine.max(1))
        keep = (high - low > POSITION_ROUNDING * np.ptp(mine, axis=1)).all(axis=1)
        line, seen, normals = line[keep], seen[keep], normals[keep]
        slope = -normals[:, :-1] / normals[:, -1:]
        return cls(line, seen[:, :, :-1], seen[:, :, -1].mean(axis=1), slope, normals[:, -1] > 0.0)

    def crossed(
        self, occluder: Indices, place: Indices, places: Array
    ) -> tuple[Indices, Array, Mask]:
        """Return which lines are crossed, of all pairs of an occluder and a place.

        Args:
            occluder: (n,) which ones.
            place: (n,) numbers of the places.
            places: (n, d) where these are in the planes.

        Returns:
            of those where they are: the number of the place, the height over the plane, and whether
            the normal points along the line.
        """
        corners = self.corners[occluder] - places[:, None]
        if places.shape[1] == 1:
            low, high = corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
            slack = POSITION_ROUNDING * (high - low)
            inside = (low <= slack) & (high >= -slack)
        else:
            following = np.roll(corners, -1, axis=1)
            turns = corners[..., 0] * following[..., 1] - corners[..., 1] * following[..., 0]
            slack = POSITION_ROUNDING * np.abs(turns).sum(axis=1, keepdims=True)
            inside = (turns >= -slack).all(axis=1) | (turns <= slack).all(axis=1)
        occluder, middle = occluder[inside], corners[inside].mean(axis=1)
        above_plane = np.einsum("nd,nd->n", self.slope[occluder], middle)
        return place[inside], self.height[occluder] - above_plane, self.out[occluder]
