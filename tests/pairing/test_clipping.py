"""Intersections of segments and of convex polygons."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, QhullError

from dolfinx_tresca.pairing.search.visibility import overlaps
from scenes.scene import EPS

SEEDS = settings(max_examples=60)


def convex(rng: np.random.Generator, number: int, corners: int) -> np.ndarray:
    """Return random convex polygons (number, corners, 2), with their corners on ellipses."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, (number, corners)), axis=1)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=2)
    shapes = np.eye(2) + 0.5 * rng.standard_normal((number, 2, 2))
    return np.einsum("nij,ncj->nci", shapes, circle) + 0.4 * rng.standard_normal((number, 1, 2))


def total(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the size (n,) of each intersection."""
    _, size, pair = overlaps(first, second)
    return np.bincount(pair, size, minlength=len(first))


def within(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return which points lie in a convex polygon."""
    side = np.roll(polygon, -1, axis=0) - polygon
    offset = points[:, None] - polygon
    turn = side[:, 0] * offset[..., 1] - side[:, 1] * offset[..., 0]
    return (turn >= 0.0).all(axis=1) | (turn <= 0.0).all(axis=1)


def hull_area(a: np.ndarray, b: np.ndarray) -> float:
    """Return the area of the convex hull of inner corners and of crossings of sides."""
    points = [*a[within(b, a)], *b[within(a, b)]]
    for p, q in zip(a, np.roll(a, -1, axis=0), strict=True):
        for r, s in zip(b, np.roll(b, -1, axis=0), strict=True):
            matrix = np.column_stack([q - p, r - s])
            if abs(np.linalg.det(matrix)) > 1e-12:
                t = np.linalg.solve(matrix, r - p)
                if (t >= 0.0).all() and (t <= 1.0).all():
                    points.append(p + t[0] * (q - p))
    try:
        return float(ConvexHull(points).volume) if len(points) > 2 else 0.0
    except QhullError:  # all on a line
        return 0.0


@SEEDS
@given(st.integers(0, 10**6), st.sampled_from([3, 4]), st.sampled_from([3, 4]))
def test_area_equals_area_of_convex_hull_of_inner_corners_and_crossings(seed, corners, others):
    rng = np.random.default_rng(seed)
    a, b = convex(rng, 5, corners), convex(rng, 5, others)
    found = total(a, b)
    expected = [hull_area(*two) for two in zip(a, b, strict=True)]
    assert np.allclose(found, expected, rtol=0.0, atol=1e5 * EPS)


def test_triangles_that_coincide_up_to_rounding():
    """With corners that coincide up to rounding a polygon may cross a line more than twice."""
    first = np.array([
        [-111.11111111091031, 166.66666666657434],
        [222.22222222227202, 166.66666666657434],
        [-111.11111111136182, -333.33333333314835],
    ])  # fmt: skip
    second = np.array([
        [-111.11111111136182, -333.33333333314846],
        [222.22222222227202, 166.66666666657434],
        [-111.11111111091037, 166.66666666657457],
    ])  # fmt: skip
    area = 0.5 * 333.333333333 * 500.0
    assert overlaps(first[None], second[None])[1].sum() == pytest.approx(area, rel=1e-9)
    rng = np.random.default_rng(1)
    many = rng.standard_normal((2000, 3, 2))
    shaken = many[:, [2, 0, 1]] * (1.0 + 4 * EPS * rng.standard_normal((2000, 3, 2)))
    sides = many[:, 1:] - many[:, :1]
    areas = 0.5 * np.abs(np.linalg.det(sides))
    _, size, pair = overlaps(many, shaken)
    assert (
        np.abs(np.bincount(pair, size, 2000) - areas).max() <= 1e3 * EPS * np.abs(many).max() ** 2
    )
