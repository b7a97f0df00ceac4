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


def moments(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the integral (n, d) of x over each intersection."""
    simplices, size, pair = overlaps(first, second)
    result = np.zeros((len(first), first.shape[2]))
    np.add.at(result, pair, size[:, None] * simplices.mean(axis=1))
    return result


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


@SEEDS
@given(st.integers(0, 10**6), st.sampled_from([3, 4]), st.sampled_from([3, 4]))
def test_intersection_is_independent_of_order_of_polygons_and_corners(seed, corners, others):
    """Neither the order of the two polygons, nor orientation, nor first corner matter."""
    rng = np.random.default_rng(seed)
    a, b = convex(rng, 8, corners), convex(rng, 8, others)
    for function in (total, moments):
        expected = function(a, b)
        for pair in ((b, a), (a[:, ::-1], b), (a, b[:, ::-1]), (np.roll(a, 1, axis=1), b)):
            assert np.allclose(function(*pair), expected, rtol=0.0, atol=1e4 * EPS)


SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@pytest.mark.parametrize(
    ("shift", "area"),
    [
        ((0.0, 0.0), 1.0),
        ((0.25, 0.5), 0.375),
        ((1.0, 0.0), 0.0),  # with a common side
        ((1.0, 1.0), 0.0),  # with a common corner
        ((3.0, 0.5), 0.0),
        ((1.0 - 1e-9, 0.0), 1e-9),
    ],
)
def test_two_squares(shift, area):
    assert total(SQUARE[None], SQUARE[None] + np.array(shift))[0] == pytest.approx(
        area, rel=1e-6, abs=0.0
    )


def test_empty_intersections_have_no_simplices():
    first = np.stack([SQUARE, SQUARE, SQUARE])
    second = np.stack([SQUARE + 5.0, SQUARE, SQUARE - 5.0])
    simplices, size, pair = overlaps(first, second)
    assert set(pair.tolist()) == {1} and (np.diff(pair) >= 0).all()
    assert size.sum() == pytest.approx(1.0, rel=10 * EPS)
    assert simplices.shape == (len(size), 3, 2)
    simplices, size, pair = overlaps(first[:0], second[:0])
    assert len(simplices) == len(size) == len(pair) == 0


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


@SEEDS
@given(st.integers(0, 10**6))
def test_segments(seed):
    a, b = np.random.default_rng(seed).uniform(-1.0, 1.0, (2, 20, 2, 1))
    low = np.maximum(a.min(axis=1), b.min(axis=1))[:, 0]
    high = np.minimum(a.max(axis=1), b.max(axis=1))[:, 0]
    assert np.allclose(total(a, b), np.maximum(high - low, 0.0), atol=EPS)
    simplices, size, pair = overlaps(a, b)
    assert np.allclose(np.abs(simplices[:, 1] - simplices[:, 0])[:, 0], size)
    assert np.allclose(simplices.min(axis=1)[:, 0], low[pair])
