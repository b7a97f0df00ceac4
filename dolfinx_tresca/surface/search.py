"""Which facets a facet may face along its normal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.surface.box import Box

#: Lines that are searched at once, to bound the memory.
LINES_AT_ONCE = 4096


def expanded_ranges(starts: Indices, numbers: Indices) -> tuple[Indices, Indices]:
    """Return all members of ranges of integers: which range (m,) each is of, and itself (m,).

    Args:
        starts: (n,) their first members.
        numbers: (n,) how many they have.
    """
    owner = np.repeat(np.arange(len(numbers)), numbers)
    first = np.cumsum(numbers) - numbers
    return owner, np.arange(len(owner)) + (starts - first)[owner]


def flattened(lists: Sequence[Sequence[int]]) -> tuple[Indices, Indices]:
    """Return all members of lists of integers: which list (m,) each is of, and itself (m,)."""
    counts = np.fromiter(map(len, lists), dtype=np.intp, count=len(lists))
    together = np.fromiter(chain.from_iterable(lists), dtype=np.intp, count=counts.sum())
    return np.repeat(np.arange(len(lists)), counts), together


def blocks(count: int) -> Iterator[slice]:
    """Yield ranges of so many lines in turn, to bound the memory of what is found for them."""
    for start in range(0, count, LINES_AT_ONCE):
        yield slice(start, min(start + LINES_AT_ONCE, count))


class Balls:
    """Balls, for the search of those on lines."""

    def __init__(self, centres: Array, radii: Array) -> None:
        """Keep balls with centres (m, 3) and radii (m,)."""
        self._centres, self._radii = centres, radii
        # a tree for each power of two of the radius: large ones do not widen the search for small
        _, exponent = np.frexp(radii)
        self._classes = [
            _Balls.of(np.flatnonzero(exponent == size), centres, radii)
            for size in np.unique(exponent)
        ]

    def facing(
        self, centres: Array, normals: Array, radii: Array, limit: Array | float
    ) -> tuple[Indices, Indices]:
        """Return all pairs of balls of which the second, one of these, is on the first's normal.

        Lines are walked with steps as long as the distance to the nearest ball allows, so that the
        work is proportional to the number of balls, times the logarithm of their distance.

        Args:
            centres: (n, 3) centres of the first balls.
            normals: (n, 3) unit normals there.
            radii: (n,) their radii.
            limit: distance along the normals up to which to look, both ways; of all or (n,) of
                each.

        Returns:
            indices of first and second balls, sorted by the first.
        """
        found = [np.zeros(0, dtype=np.int64)]
        for some in self._classes:
            first, second = some.along(centres, normals, radii + some.radius, limit)
            offset = self._centres[second] - centres[first]
            along = np.einsum("ni,ni->n", offset, normals[first])
            across = np.linalg.norm(offset - along[:, None] * normals[first], axis=1)
            keep = across <= (radii[first] + self._radii[second]) * (1.0 + 1e-9)
            found.append(first[keep] * len(self._centres) + second[keep])
        pairs = np.unique(np.concatenate(found))
        return pairs // len(self._centres), pairs % len(self._centres)


@dataclass(frozen=True)
class _Balls:
    """Balls of about the same size.

    Attributes:
        members: (m,) their numbers.
        radius: the largest radius.
        box: round their centres.
        tree: of these.
    """

    members: Indices
    radius: float
    box: Box
    tree: cKDTree

    @classmethod
    def of(cls, members: Indices, centres: Array, radii: Array) -> _Balls:
        points = centres[members]
        return cls(members, float(radii[members].max()), Box.around(points), cKDTree(points))

    def along(
        self,
        origins: Array,
        directions: Array,
        reach: Array,
        limit: float | Array,
    ) -> tuple[Indices, Indices]:
        """Return pairs (line, ball), among them all with a distance of at most `reach`."""
        start, end = self.box.crossed(origins, directions, reach)
        start, end = np.maximum(start, -limit - reach), np.minimum(end, limit + reach)
        # a ball of radius sqrt(2) reach around a place on the line holds what lies along the line
        # up to one reach away; a nearest point at the distance d means that nothing is up to
        # `clear` away
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
