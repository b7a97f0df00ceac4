"""The model of A that is known whole: its solutions on a face and inside, against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.linalg import spsolve

from dolfinx_tresca.solvers.linear_algebra import NodalMaps
from dolfinx_tresca.solvers.products import SHIFT, WholeModel
from scenes.dense import cones_over, random_problem, row_nodes
from scenes.scene import EPS


@pytest.mark.parametrize("matrix_type", [csr_array, np.asarray])
@pytest.mark.parametrize("coefficient", [0.0, 0.5])
def test_solutions_along_a_face(coefficient, matrix_type):
    """P (M + C) s - P G c = P r and G's + S c = e with s = (I + Q) P s, also with a singular A."""
    rng = np.random.default_rng(0)
    problem = random_problem(1, 8, 2.0)
    lam, size = problem.feasible_set, len(problem.b)
    values, vectors = np.linalg.eigh(problem.A)
    A = vectors[:, 3:] * values[3:] @ vectors[:, 3:].T
    cones = cones_over(lam, coefficient)
    local = rng.uniform(0.5, 1.0, size)
    model = WholeModel(problem, matrix_type(A), 0, row_nodes(cones), local, spsolve)
    M = model.apply(np.eye(size))
    assert np.allclose(M, A + SHIFT * np.diag(local), atol=16 * EPS * np.abs(A).max())

    x = rng.standard_normal(size)
    x[lam.normal] = np.abs(x[lam.normal]) * (rng.random(len(lam.normal)) < 0.7)
    section = cones.section(x)
    face = section.face(3.0 * x)
    assert face.slip.any()
    stiffness = lam.mean_over_discs(rng.random(size))
    follow = cones.with_bound_change(x, face, model.diagonal)
    G = np.linalg.qr(rng.standard_normal((size, 2)))[0]
    right, missing, softness = rng.standard_normal(size), rng.standard_normal(2), 0.1 * np.eye(2)
    maps = NodalMaps.on_face(cones, x, face, model.diagonal, stiffness)
    s, c = model.solve_between(maps, right, G, softness, missing)

    P = face.project(np.eye(size))
    V = follow(P, np.zeros_like(P))
    first = P @ (M @ s + stiffness * (P @ s) - G @ c - right)
    second = G.T @ s + softness @ c - missing
    size_of_terms = np.abs(M).max() * np.abs(s).max() + np.abs(c).max() + np.abs(right).max()
    # conditions of M are up to 1 / SHIFT
    rounding = 1e3 * EPS / SHIFT * size_of_terms
    assert np.abs(s - V @ (P @ s)).max() <= rounding
    assert np.abs(second).max() <= rounding + 1e-8 * np.abs(c).max()
    assert np.abs(first + P @ (stiffness * (s - P @ s))).max() <= rounding
