"""A as a sparse matrix, from products that many bodies share, and as a dense matrix."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca.dual.products import compliance
from dolfinx_tresca.dual.products import operator as operators
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

    def sparse_model(operator, local_compliance):
        result.append((operator, operators.sparse_model(operator, local_compliance)))
        return result[-1][1]

    monkeypatch.setattr(compliance, "sparse_model", sparse_model)
    return result


def check_products(comm, operator, matrix) -> None:
    """Compare a matrix with single products, for random vectors."""
    inner = operator.jump.reductions.inner
    for seed in range(3):
        x = np.random.default_rng([seed, comm.rank]).standard_normal(len(matrix.diagonal))
        expected = operator.product(x)[0]
        error = matrix.product(x)[0] - expected
        assert inner(error, error) <= SOLVE**2 * inner(expected, expected)


@pytest.mark.parallel
def test_the_matrix_is_A(comm, found):
    """Against single products with random vectors; 28 solves with K find 200 columns."""
    scene = wall(comm, *SIZE)
    with scene.problem() as problem:
        assert problem.solve(rtol=1e-6).products <= 32
        operator, matrix = found[0]
        check_products(comm, operator, matrix)


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
    """The wall under its weight and pushed: the same displacement; a push takes no product."""
    with_matrix, products = pushed(comm, [0.0, 0.1])
    monkeypatch.setattr(compliance, "sparse_model", lambda *arguments: None)
    without, _ = pushed(comm, [0.0, 0.1])
    # relative residuals of 1e-9; displacements of the wall as a whole magnify them
    assert np.allclose(with_matrix, without, rtol=1e-6)
    assert products <= 32


@pytest.mark.parallel
def test_a_dense_matrix_is_A(comm, monkeypatch):
    """Against single products with random vectors; each column is a product."""
    calls: list = []
    monkeypatch.setattr(compliance, "sparse_model", lambda *arguments: calls.append(arguments))
    with bricks_problem(comm, 2) as problem:
        before = problem.solve(rtol=1e-6).products
        operator, local_compliance = calls[0]
        matrix = operators.dense_model(operator, local_compliance)
        assert operator.products - before == len(matrix)
        check_products(comm, operator, matrix)
