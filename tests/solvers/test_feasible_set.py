"""Lambda: its projection, the slant derivative (38.8), and its faces."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.dense import brute_projection, random_set
from scenes.scene import EPS

#: Rounding of some thirty operations on numbers, over the size of the largest of them.
ROUNDING = 32 * EPS

BOUNDED = settings(max_examples=60)


@st.composite
def cases(draw):
    """A set and a generator for points."""
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    return random_set(rng, draw(st.integers(1, 15))), rng


@BOUNDED
@given(cases())
def test_projection_is_that_of_the_definition(case):
    lam, rng = case
    y = rng.standard_normal(lam.size) * rng.choice([0.01, 1.0, 100.0])
    assert np.allclose(lam.project(y), brute_projection(lam, y), rtol=ROUNDING, atol=0.0)


@BOUNDED
@given(cases())
def test_derivative_of_the_projection_agrees_with_differences(case):
    lam, rng = case
    y = 2 * rng.standard_normal(lam.size)
    norms = lam.norms(y)
    h = 1e-6
    # stay away from the kinks: |y_nu| = 0 and |y_tau| = g
    kink = np.minimum(
        np.abs(y[lam.normal]).min(initial=np.inf),
        np.abs(norms - lam.radius)[lam.node].min(initial=np.inf),
    )
    v = rng.standard_normal(lam.size)
    if kink < 10 * h * np.abs(v).max():
        return
    difference = (brute_projection(lam, y + h * v) - brute_projection(lam, y - h * v)) / (2 * h)
    shortest = norms[lam.node].min(initial=np.inf)
    # rounding of the difference and its curvature
    tolerance = 1e-8 + 10 * (h / min(shortest, 1.0)) ** 2 * np.linalg.norm(v) ** 3
    assert np.linalg.norm(lam.projection_derivative(y)(v) - difference) <= tolerance


@BOUNDED
@given(cases())
def test_faces_are_those_of_the_definition(case):
    """(38.12), (38.13): contact, stick and slip, and the direction out of the disc."""
    lam, rng = case
    y = rng.standard_normal(lam.size)
    face = lam.face(y)
    assert np.array_equal(face.active[lam.normal], y[lam.normal] >= 0.0)
    expected = np.zeros(lam.size)
    for node, g in enumerate(lam.radius):
        rows = lam.tangential[lam.node == node]
        inside = np.linalg.norm(y[rows]) <= g
        assert bool(face.stick[node]) == (inside and g > 0.0)
        assert bool(face.slip[node]) == (not inside and g > 0.0)
        assert face.active[rows].all() == (bool(face.stick[node]) or len(rows) == 0)
        if face.slip[node]:
            expected[rows] = y[rows] / np.linalg.norm(y[rows])
    assert np.allclose(face.radial, expected, atol=4 * EPS)
    parts, v = rng.standard_normal(len(lam.radius)), rng.standard_normal(lam.size)
    assert np.isclose(parts @ face.radial_parts(v), face.along_radius(parts) @ v)


@BOUNDED
@given(cases())
def test_circle_stiffness_is_never_negative_and_is_the_multiplier_of_the_circle(case):
    lam, rng = case
    y = rng.standard_normal(lam.size)
    face = lam.face(y)
    r = rng.standard_normal(lam.size)
    kappa = lam.circle_stiffness(r, face)
    assert (kappa >= 0.0).all()
    assert (kappa[lam.normal] == 0.0).all()
    for node in np.flatnonzero(face.slip):
        rows = lam.tangential[lam.node == node]
        if len(rows) == 0:
            continue
        out = y[rows] / np.linalg.norm(y[rows])
        assert np.allclose(kappa[rows], max(0.0, -out @ r[rows]) / lam.radius[node], rtol=100 * EPS)
