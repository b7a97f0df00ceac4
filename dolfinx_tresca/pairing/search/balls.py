"""Search for facets along the normals of other facets, by enclosing boxes and balls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, Indices, Mask

#: Number of lines in a block that is searched at once, which bounds the memory.
LINES_AT_ONCE = 2048


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


def bounding_box(points: Array) -> Array:
    """Return the least and the greatest coordinates (2, 3) of points (n, 3) [length].

    Without points they are infinite and -infinite.
    """
    return np.stack([points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)])


def within_reach(box: Array, points: Array, reach: Array) -> Mask:
    """Return a mask (n,) of the points (n, 3) within a distance `reach` (n,) of a box (2, 3)."""
    outside = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
    return np.asarray(np.linalg.norm(outside, axis=1) <= reach)


def line_intervals(
    box: Array, origins: Array, directions: Array, reach: Array
) -> tuple[Array, Array]:
    """Intersect lines with a box (2, 3), widened on all sides.

    Args:
        box: the least and the greatest coordinates [length].
        origins: (n, 3) the point of each line whose parameter is 0 [length].
        directions: (n, 3) unit vectors along the lines.
        reach: (n,) distance by which the box is widened for each line [length].

    Returns:
        The parameters (n,) at which the lines enter the box, and the parameters (n,) at which they
        leave it [length]. If a line misses the box, its first parameter is the greater one.
    """
    low, high = box[0] - reach[:, None] - origins, box[1] + reach[:, None] - origins
    with np.errstate(divide="ignore", invalid="ignore"):
        at_low, at_high = low / directions, high / directions
    flat, inside = directions == 0.0, (low <= 0.0) & (high >= 0.0)
    enter = np.where(flat, np.where(inside, -np.inf, np.inf), np.minimum(at_low, at_high))
    leave = np.where(flat, np.where(inside, np.inf, -np.inf), np.maximum(at_low, at_high))
    return enter.max(axis=1), leave.min(axis=1)


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
        classes = [np.flatnonzero(exponent == size) for size in np.unique(exponent)]
        self._classes = [(members, cKDTree(centres[members])) for members in classes]

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
        pairs = [np.zeros(0, dtype=np.int64)]
        for members, tree in self._classes:
            reach = radii + self._radii[members].max()
            box = np.stack([tree.mins, tree.maxes])
            start, end = line_intervals(box, centres, normals, reach)
            start, end = np.maximum(start, -limit - reach), np.minimum(end, limit + reach)
            # A ball of radius sqrt(2) r around a point of the line contains the part from -r to r
            # of the cylinder of radius r around the line. If the centre nearest to the point has
            # the distance d, the cylinder is empty from -sqrt(d^2 - r^2) to sqrt(d^2 - r^2).
            place = start + reach
            lines = np.flatnonzero(start <= end)
            while len(lines):
                x = centres[lines] + place[lines, None] * normals[lines]
                r = reach[lines]
                clear = np.sqrt(np.maximum(tree.query(x)[0] ** 2 - r**2, 0.0))
                near = clear <= r
                lists = tree.query_ball_point(x[near], np.sqrt(2.0) * r[near] * (1.0 + 1e-9))
                line, ball = flattened(lists)
                pairs.append(lines[near][line] * len(self._centres) + members[ball])
                covered = place[lines] + np.where(near, r, clear)
                place[lines] = covered + r
                lines = lines[covered < end[lines]]
        moving, met = np.divmod(np.unique(np.concatenate(pairs)), max(len(self._centres), 1))
        offset = self._centres[met] - centres[moving]
        along = np.einsum("ni,ni->n", offset, normals[moving])
        across = np.linalg.norm(offset - along[:, None] * normals[moving], axis=1)
        meet = across <= (radii[moving] + self._radii[met]) * (1.0 + 1e-9)
        return moving[meet], met[meet]
