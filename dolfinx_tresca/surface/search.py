"""Which facets a facet may face along its normal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from dolfinx_tresca.surface.box import Box
from dolfinx_tresca.surface.facets import FloatArray

Indices = npt.NDArray[np.intp]


def members(starts: Indices, numbers: Indices) -> tuple[Indices, Indices]:
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


def facing(
    centres: FloatArray,
    normals: FloatArray,
    radii: FloatArray,
    other_centres: FloatArray,
    other_radii: FloatArray,
    limit: float | FloatArray,
) -> tuple[Indices, Indices]:
    """Return all pairs of balls of which the second lies on the line along the first's normal.

    Lines are walked with steps as long as the distance to the nearest ball allows, so that the
    work is proportional to the number of balls, times the logarithm of their distance.

    Args:
        centres: (n, 3) centres of the first balls.
        normals: (n, 3) unit normals there.
        radii: (n,) their radii.
        other_centres: (m, 3) centres of the second balls.
        other_radii: (m,) their radii.
        limit: distance along the normals up to which to look, both ways; of all or (n,) of each.

    Returns:
        indices of first and second balls, sorted by the first.
    """
    # a tree for each power of two of the radius: large balls do not widen the search for small ones
    _, exponent = np.frexp(other_radii)
    found = [np.zeros(0, dtype=np.int64)]
    for size in np.unique(exponent):
        members = np.flatnonzero(exponent == size)
        reach = radii + other_radii[members].max()
        first, second = _along(centres, normals, reach, other_centres[members], limit)
        second = members[second]
        way = other_centres[second] - centres[first]
        along = np.einsum("ni,ni->n", way, normals[first])
        across = np.linalg.norm(way - along[:, None] * normals[first], axis=1)
        keep = across <= (radii[first] + other_radii[second]) * (1.0 + 1e-9)
        found.append(first[keep] * len(other_centres) + second[keep])
    pairs = np.unique(np.concatenate(found))
    return pairs // len(other_centres), pairs % len(other_centres)


def _along(
    origins: FloatArray,
    directions: FloatArray,
    reach: FloatArray,
    points: FloatArray,
    limit: float | FloatArray,
) -> tuple[Indices, Indices]:
    """Return pairs (line, point), among them all with a distance of at most `reach`."""
    tree = cKDTree(points)
    start, end = Box.round(points).crossed(origins, directions, reach)
    start, end = np.maximum(start, -limit - reach), np.minimum(end, limit + reach)
    # a ball of radius sqrt(2) reach around a place on the line holds what lies along the line up to
    # one reach away; a nearest point at the distance d means that nothing is up to `clear` away
    place = start + reach
    lines = np.flatnonzero(start <= end)
    first, second = [], []
    while len(lines):
        x = origins[lines] + place[lines, None] * directions[lines]
        r = reach[lines]
        d = tree.query(x)[0]
        clear = np.sqrt(np.maximum(d**2 - r**2, 0.0))
        near = clear <= r
        lists = tree.query_ball_point(x[near], np.sqrt(2.0) * r[near] * (1.0 + 1e-9))
        line, found = flattened(lists)
        first.append(lines[near][line])
        second.append(found)
        covered = place[lines] + np.where(near, r, clear)
        place[lines] = covered + r
        lines = lines[covered < end[lines]]
    return np.concatenate([*first, [0][:0]]).astype(np.intp), np.concatenate(
        [*second, [0][:0]]
    ).astype(np.intp)
