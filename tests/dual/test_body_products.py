"""A of many bodies as a sparse matrix, from products that all bodies share."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca.dual import body_products, compliance
from scenes.scene import EPS
from scenes.two_bricks import bricks_problem
from scenes.wall import HEIGHT, wall

#: Rounding of a solve with K, whose condition number is about 1e4 on these meshes.
SOLVE = 1e6 * EPS

#: Bricks in a course and courses.
SIZE = 3, 5


@pytest.fixture
def found(monkeypatch) -> list:
    """The operators of later solves, each with A as a sparse matrix or None."""
    result: list = []

    def sparse_model(operator):
        result.append((operator, body_products.sparse_model(operator)))
        return result[-1][1]

    monkeypatch.setattr(compliance, "sparse_model", sparse_model)
    return result


@pytest.mark.parallel
def test_the_matrix_is_A(comm, found):
    """Against single products with random vectors; 28 solves with K find 200 columns."""
    scene = wall(comm, *SIZE)
    with scene.problem() as problem:
        assert problem.solve(rtol=1e-6).products <= 32
        operator, matrix = found[0]
        for seed in range(3):
            x = np.random.default_rng([seed, comm.rank]).standard_normal(len(matrix.diagonal))
            inner = operator.jump.reductions.inner
            expected = operator.product(x)[0]
            error = matrix.product(x) - expected
            assert inner(error, error) <= SOLVE**2 * inner(expected, expected)


def pushed(comm, parts: list[float]) -> tuple[np.ndarray, int]:
    """Displacements of the wall's top at the end of accepted load steps, and products."""
    scene = wall(comm, *SIZE)
    course = scene.data.weights.sum() / SIZE[1]
    products = 0
    with scene.problem() as problem:
        for part in parts:
            scene.data.push.value = part * course / HEIGHT
            solution = problem.solve(rtol=1e-9)
            solution.raise_if_failed()
            products += solution.products
            problem.accept()
        u = solution.u.x.petsc_vec
        return np.array([u.norm(), u.sum()]), products


@pytest.mark.parallel
def test_solutions_are_those_without_the_matrix(comm, monkeypatch):
    """The wall under its weight and pushed: the same displacement, with fewer products."""
    with_matrix, few = pushed(comm, [0.0, 0.1])
    monkeypatch.setattr(compliance, "sparse_model", lambda operator: None)
    without, many = pushed(comm, [0.0, 0.1])
    # relative residuals of 1e-9; displacements of the wall as a whole magnify them
    assert np.allclose(with_matrix, without, rtol=1e-6)
    assert few <= 32 < many


def test_two_bodies_have_none(found):
    """Each of two bodies has all multipliers: A is full."""
    with bricks_problem(MPI.COMM_SELF, 2) as problem:
        problem.solve(rtol=1e-6)
    assert found
    assert all(matrix is None for _, matrix in found)


def test_bodies_with_many_multipliers_have_none(found, monkeypatch):
    monkeypatch.setattr(body_products, "MOST_ON_BODY", 10)
    with wall(MPI.COMM_SELF, 2, 3).problem() as problem:
        problem.solve(rtol=1e-6)
    assert [matrix for _, matrix in found] == [None]
