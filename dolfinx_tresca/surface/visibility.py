"""What stands between a facet and another one that it faces: nothing pairs through a body."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dolfinx_tresca.surface.facets import FloatArray
from dolfinx_tresca.surface.pieces import Pieces
from dolfinx_tresca.surface.search import Indices, facing

#: Least cosine between the normals of surfaces that face each other, one reversed.
FACING = 0.1

#: Distance over the size of a facet up to which surfaces touch.
TOUCH = 1e-6

#: Cosine between a line and the normal of a facet up to which it does not cross the facet.
ALONG = 1e-6

#: Places with a facet that may stand before them that are treated at once, to bound the memory.
CHUNK = 100_000

#: Places in a facet's own coordinates, over its size, that are rounding.
ROUNDING = 1e-9


class Visibility:
    """Tells which places of the other side are hidden from places of the secondary side.

    A place x with the outward normal n may touch a place y = x + s n of the other side, where the
    normal is opposed, if the line between them crosses no facet of either side the wrong way.
    Facets are crossed into or out of their body:

    * s > 0, a gap: the line runs outside of both bodies. It must not enter the secondary side's
      body again, nor leave any body.
    * s < 0, penetration: the line from x back to y lies in both bodies where they overlap. It must
      not leave the secondary side's body, nor enter that of the other side.

    Where surfaces touch, a crossing in the very place of x or of y counts by what it means: to
    enter counts at x, to leave at y. Of what is visible the nearest counts, see surface/nearest.py.
    """

    def __init__(self, pieces: Pieces, others: Pieces) -> None:
        """Prepare for two sides."""
        self._pieces = pieces
        self._sides = ((pieces, True), (others, False))
        self._frames = pieces.frames()

    def hidden(
        self, piece: Indices, places: FloatArray, start: FloatArray, end: FloatArray
    ) -> npt.NDArray[np.bool_]:
        """Return whether something stands between, (n,).

        Args:
            piece: (n,) secondary pieces, ascending.
            places: (n, d) in the planes of these, relative to their centres.
            start: (n,) heights there of the secondary side over these planes, along the normal.
            end: (n,) heights of the other side.
        """
        result = np.zeros(len(piece), dtype=np.bool_)
        apart = np.flatnonzero(np.abs(end - start) > TOUCH * self._pieces.radii[piece])
        if len(apart) == 0:
            return result
        lines, first, line = np.unique(piece[apart], return_index=True, return_inverse=True)
        reach = np.maximum.reduceat(np.maximum(np.abs(start), np.abs(end))[apart], first)
        for side, own in self._sides:
            line_of, blocker = self._candidates(side, own, lines, reach)
            begin = np.searchsorted(line_of, line)
            numbers = np.searchsorted(line_of, line, side="right") - begin
            block = np.cumsum(numbers) // CHUNK
            for some in np.split(np.arange(len(apart)), np.flatnonzero(np.diff(block)) + 1):
                # all pairs of a place and a candidate of its piece
                count = numbers[some]
                place = np.repeat(apart[some], count)
                offset = np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)
                other = blocker[np.repeat(begin[some], count) + offset]
                height, out, crosses = self._crossing(side, other, piece[place], places[place])
                gap = end[place] > start[place]
                leaves = out == gap  # the body that is crossed, on the way from start to end
                matters = leaves | gap if own else leaves == gap
                way = (height - start[place]) * np.where(gap, 1.0, -1.0)
                touch = TOUCH * self._pieces.radii[piece[place]]
                at = np.where(leaves, way - touch, way + touch)
                between = (at > 0.0) & (at <= np.abs(end - start)[place])
                result[place[crosses & matters & between]] = True
        return result

    def _candidates(
        self, side: Pieces, own: bool, lines: Indices, reach: FloatArray
    ) -> tuple[Indices, Indices]:
        """Return positions in `lines`, ascending, and pieces of a side that may be crossed."""
        pieces = self._pieces
        line, blocker = facing(
            pieces.centres[lines], pieces.normals[lines], pieces.radii[lines],
            side.centres, side.radii, reach + pieces.radii[lines],
        )  # fmt: skip
        piece = lines[line]
        normal, other = pieces.normals[piece], side.normals[blocker]
        cosine = np.einsum("ni,ni->n", normal, other)
        if not own:  # where normals are opposed it is what is looked for
            keep = cosine > ALONG
            return line[keep], blocker[keep]
        way = side.centres[blocker] - pieces.centres[piece]
        height = np.abs(np.einsum("ni,ni->n", way, normal))
        height += side.radii[blocker] * np.linalg.norm(normal - other, axis=1)
        # the surface round the place: it is crossed in the place alone
        same = cosine > ALONG
        keep = np.where(same, height > TOUCH * pieces.radii[piece], cosine < -ALONG)
        line, blocker, piece, same = line[keep], blocker[keep], piece[keep], same[keep]
        common = pieces.nodes[piece][:, :, None] == side.nodes[blocker][:, None]
        keep = ~(same & common.any(axis=(1, 2)))
        return line[keep], blocker[keep]

    def _crossing(
        self, side: Pieces, blocker: Indices, piece: Indices, places: FloatArray
    ) -> tuple[FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Return where the lines through places (n, d) along normals of pieces cross others.

        Returns:
            heights (n,) over the planes of the pieces, whether the normal there points along the
            line, and whether they cross at all.
        """
        frames = self._frames[piece]
        relative = side.points[blocker] - self._pieces.centres[piece][:, None]
        seen = np.einsum("nci,ndi->ncd", relative, frames)
        normal = np.einsum("ni,ndi->nd", side.normals[blocker], frames)
        out = normal[:, -1] > 0.0
        corners = seen[:, :, :-1] - places[:, None]
        if places.shape[1] == 1:
            low, high = corners[:, :, 0].min(axis=1), corners[:, :, 0].max(axis=1)
            slack = ROUNDING * (high - low)
            crosses = (low <= slack) & (high >= -slack)
        else:
            following = np.roll(corners, -1, axis=1)
            turns = corners[..., 0] * following[..., 1] - corners[..., 1] * following[..., 0]
            slack = ROUNDING * np.abs(turns).sum(axis=1, keepdims=True)
            crosses = (turns >= -slack).all(axis=1) | (turns <= slack).all(axis=1)
        middle = corners.mean(axis=1)
        rise = np.einsum("nd,nd->n", normal[:, :-1], middle) / normal[:, -1]
        return seen[:, :, -1].mean(axis=1) + rise, out, crosses
