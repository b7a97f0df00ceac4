"""Search for facets along the normals of other facets, by enclosing balls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.pairing.search.box import Box

#: Number of lines in a block that is searched at once, which bounds the memory.
LINES_AT_ONCE = 4096


def expanded_ranges(starts: Indices, numbers: Indices) -> tuple[Indices, Indices]:
    """Concatenate the integer ranges starts[i], ..., starts[i] + numbers[i] - 1.

    Args:
        starts: (n,) first members of the ranges.
        numbers: (n,) lengths of the ranges.

    Returns:
        The index i (m,) of the range of each member, and the members (m,).
    """
    owner = np.repeat(np.arange(len(numbers)), numbers)
    first = np.cumsum(numbers) - numbers
    return owner, np.arange(len(owner)) + (starts - first)[owner]


def flattened(lists: Sequence[Sequence[int]]) -> tuple[Indices, Indices]:
    """Concatenate lists; return the index (m,) of each member's list, and the members (m,)."""
    counts = np.fromiter(map(len, lists), dtype=np.intp, count=len(lists))
    together = np.fromiter(chain.from_iterable(lists), dtype=np.intp, count=counts.sum())
    return np.repeat(np.arange(len(lists)), counts), together


def blocks(count: int) -> Iterator[slice]:
    """Yield slices of 0, ..., count - 1 with at most `LINES_AT_ONCE` members each."""
    for start in range(0, count, LINES_AT_ONCE):
        yield slice(start, min(start + LINES_AT_ONCE, count))


class Balls:
    """A set of balls with a fast search for the balls that lie along normals."""

    def __init__(self, centres: Array, radii: Array) -> None:
        """Build trees for the search `on_normals`.

        Args:
            centres: (m, 3) centres of the balls [length].
            radii: (m,) radii of the balls [length].
        """
        self._centres, self._radii = centres, radii
        # one tree for each power of two of the radius: large balls do not widen the search for
        # small ones
        _, exponent = np.frexp(radii)
        self._classes = [
            _SimilarBalls.of(np.flatnonzero(exponent == size), centres, radii)
            for size in np.unique(exponent)
        ]

    def on_normals(
        self, centres: Array, normals: Array, radii: Array, limit: Array | float
    ) -> tuple[Indices, Indices]:
        """Find all balls of the set that given balls would meet if they moved along their normals.

        The search advances along a line as far as the distance to the nearest ball allows. The
        work is proportional to the number of balls times the logarithm of their distance.

        Args:
            centres: (n, 3) centres of the moving balls [length].
            normals: (n, 3) unit normals of the moving balls.
            radii: (n,) radii of the moving balls [length].
            limit: search distance in both directions [length]; balls slightly beyond it may be
                found, too. A number, or an array (n,).

        Returns:
            The pairs as indices (m,) of the moving balls, ascending, and indices (m,) of the balls
            that they meet.
        """
        found = [np.zeros(0, dtype=np.int64)]
        for some in self._classes:
            first, second = some.near_lines(centres, normals, radii + some.radius, limit)
            offset = self._centres[second] - centres[first]
            along = np.einsum("ni,ni->n", offset, normals[first])
            across = np.linalg.norm(offset - along[:, None] * normals[first], axis=1)
            keep = across <= (radii[first] + self._radii[second]) * (1.0 + 1e-9)
            found.append(first[keep] * len(self._centres) + second[keep])
        pairs = np.unique(np.concatenate(found))
        return pairs // len(self._centres), pairs % len(self._centres)


@dataclass(frozen=True)
class _SimilarBalls:
    """Balls whose radii differ by a factor of two at most.

    Attributes:
        members: (m,) indices of the balls.
        radius: the largest radius [length].
        box: bounding box of the centres.
        tree: search tree of the centres.
    """

    members: Indices
    radius: float
    box: Box
    tree: cKDTree

    @classmethod
    def of(cls, members: Indices, centres: Array, radii: Array) -> _SimilarBalls:
        """Build the tree of the balls `members` (m,) among all balls."""
        points = centres[members]
        return cls(members, float(radii[members].max()), Box.around(points), cKDTree(points))

    def near_lines(
        self,
        origins: Array,
        directions: Array,
        reach: Array,
        limit: float | Array,
    ) -> tuple[Indices, Indices]:
        """Find pairs of a line and a ball whose centre is near the line.

        The pairs, as indices (m,) of lines and (m,) of balls, include every ball whose centre is
        within `reach` (n,) of a line, and may include others. Lines (n,) extend to a distance of
        `limit` from their origins, in both directions.
        """
        start, end = self.box.line_intervals(origins, directions, reach)
        start, end = np.maximum(start, -limit - reach), np.minimum(end, limit + reach)
        # A ball of radius sqrt(2) r around a point of the line contains the part from -r to r of
        # the cylinder of radius r around the line. If the centre nearest to the point has the
        # distance d, the cylinder is empty from -sqrt(d^2 - r^2) to sqrt(d^2 - r^2).
        place = start + reach
        lines = np.flatnonzero(start <= end)
        first, second = [], []
        while len(lines):
            x = origins[lines] + place[lines, None] * directions[lines]
            r = reach[lines]
            d = self.tree.query(x)[0]
            clear = np.sqrt(np.maximum(d**2 - r**2, 0.0))
            near = clear <= r
            lists = self.tree.query_ball_point(x[near], np.sqrt(2.0) * r[near] * (1.0 + 1e-9))
            line, ball = flattened(lists)
            first.append(lines[near][line])
            second.append(ball)
            covered = place[lines] + np.where(near, r, clear)
            place[lines] = covered + r
            lines = lines[covered < end[lines]]
        none: Indices = np.zeros(0, dtype=np.intp)
        found = np.concatenate([*second, none])
        return np.concatenate([*first, none]), self.members[found]
