"""Cones of friction that grows with the pressure: projection and sections."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from dolfinx_tresca.solvers.feasible_set import FrictionCones
from scenes.dense import random_cone_problem
from scenes.scene import EPS

#: Rounding of some thirty operations on numbers, over the size of the largest of them.
ROUNDING = 32 * EPS

BOUNDED = settings(max_examples=60)


@st.composite
def cases(draw):
    """Cones, and a generator for points."""
    seed = draw(st.integers(0, 10**6))
    cones = random_cone_problem(seed, draw(st.integers(1, 12)), 0.0, draw(st.floats(0.1, 10))).cones
    return cones, np.random.default_rng(seed)


def bound(cones: FrictionCones, disc: int, pressure: float) -> float:
    """Return c + min(F p, l) of a node."""
    grown = min(cones.coefficient[disc] * pressure, cones.limit[disc])
    return float(cones.radius[disc] + (grown if cones.normal_of[disc] >= 0 else 0.0))


def brute_nearest(cones: FrictionCones, y: np.ndarray) -> np.ndarray:
    """The nearest point, node by node: over all pressures, the disc that belongs to it."""
    z = y.copy()
    z[cones.normal] = np.maximum(y[cones.normal], 0.0)
    for disc, normal in enumerate(cones.normal_of):
        rows = cones.tangential[cones.node == disc]
        if len(rows) == 0:
            continue
        s = float(np.linalg.norm(y[rows]))
        if normal < 0:
            best = 0.0
        else:

            def distance(pressure: float, p=y[normal], s=s, disc=disc) -> float:
                return (pressure - p) ** 2 + max(s - bound(cones, disc, pressure), 0.0) ** 2

            # convex: the bound is concave
            high = max(y[normal], 0.0) + s
            found = minimize_scalar(
                distance, bounds=(0.0, high), method="bounded", options={"xatol": 1e-14}
            ).x
            best = min((0.0, max(y[normal], 0.0), found), key=distance)
            z[normal] = best
        z[rows] *= min(1.0, bound(cones, disc, best) / s) if s > 0.0 else 1.0
    return z


@BOUNDED
@given(cases())
def test_projection_is_the_nearest_point(case):
    """The search for the minimum, a reference, ends with the square root of rounding."""
    cones, rng = case
    y = rng.standard_normal(cones.size) * rng.choice([0.01, 1.0, 100.0])
    found, wanted = cones.project(y), brute_nearest(cones, y)
    size = np.linalg.norm(y)
    assert np.linalg.norm(found - wanted) <= 10 * np.sqrt(EPS) * size
    assert np.linalg.norm(y - found) <= np.linalg.norm(y - wanted) + ROUNDING * size


@BOUNDED
@given(cases())
def test_sections_have_the_bounds_of_the_law(case):
    cones, rng = case
    x = rng.standard_normal(cones.size)
    section = cones.section(x)
    for disc, normal in enumerate(cones.normal_of):
        pressure = max(float(x[normal]), 0.0) if normal >= 0 else 0.0
        assert section.radius[disc] == bound(cones, disc, pressure)
    assert section.section(x) is section


def cone(constant: float, coefficient: float, limit: float) -> FrictionCones:
    """A node with the pressure first, and two tangential multipliers."""
    values = [np.array([value]) for value in (coefficient, limit)]
    rows = 3, np.array([0]), np.array([1, 2]), np.array([0, 0])
    return FrictionCones(*rows, np.array([constant]), np.array([0]), *values)


@pytest.mark.parametrize(
    ("terms", "y", "wanted"),
    [
        ((0.0, 1.0, np.inf), (0.0, 2.0, 0.0), (1.0, 1.0, 0.0)),  # on the slope
        ((0.0, 1.0, np.inf), (-3.0, 2.0, 0.0), (0.0, 0.0, 0.0)),  # the polar cone
        ((0.0, 1.0, 0.5), (2.0, 0.0, 3.0), (2.0, 0.0, 0.5)),  # the level
        ((0.0, 1.0, 0.5), (0.4, 3.0, 0.0), (0.5, 0.5, 0.0)),  # the corner
        ((1.0, 0.0, np.inf), (-1.0, 3.0, 4.0), (0.0, 0.6, 0.8)),  # Tresca
        ((np.inf, 0.0, np.inf), (-1.0, 3.0, 4.0), (0.0, 3.0, 4.0)),
        ((np.inf, 0.5, np.inf), (-1.0, 3.0, 4.0), (0.0, 3.0, 4.0)),
        ((0.0, 0.0, np.inf), (1.0, 3.0, 4.0), (1.0, 0.0, 0.0)),
        ((0.0, 0.5, 0.0), (1.0, 3.0, 4.0), (1.0, 0.0, 0.0)),
        ((1.0, 1.0, np.inf), (-0.5, 0.5, 0.0), (0.0, 0.5, 0.0)),  # the axis
    ],
)
def test_special_points(terms, y, wanted):
    cones = cone(*terms)
    assert np.allclose(cones.project(np.array(y)), wanted, atol=10 * EPS)
    assert np.isfinite(cones.projection_derivative(np.array(y)) @ np.ones(3)).all()
