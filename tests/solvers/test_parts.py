"""Parts of the algorithms: products that are kept, the model of A, (Step 3.1)."""

from __future__ import annotations

import numpy as np
import pytest
from dense import problems
from hypothesis import given, settings
from hypothesis import strategies as st

from dolfinx_tresca import SolverOptions
from dolfinx_tresca.solvers.convergence import History, NaturalResidual
from dolfinx_tresca.solvers.paper import adaptive_precision
from dolfinx_tresca.solvers.products import BlockBFGSModel, ProductStore
from scenes.dense import DenseProblem, brute_projection, random_problem
from scenes.scene import EPS

BOUNDED = settings(max_examples=50)


def filled(problem, rng, number: int, capacity: int = 120) -> ProductStore:
    """Return pairs from random vectors, some of them nearly dependent or zero."""
    store = ProductStore(problem, problem.diagonal, capacity)
    x = np.zeros(len(problem.b))
    for _ in range(number):
        choice = rng.integers(4)
        if choice == 0:
            x = x + 1e-3 * rng.standard_normal(len(x))  # close to the one before
        elif choice < 3:
            x = rng.standard_normal(len(x)) * 10.0 ** rng.uniform(-8, 8)
        store.add(x, problem.A @ x)
    return store


@BOUNDED
@given(problems(), st.integers(0, 10**6), st.integers(1, 20))
def test_recycled_pairs_are_orthonormal_and_the_model_is_exact_on_them(problem, seed, number):
    rng = np.random.default_rng(seed)
    store = filled(problem, rng, number)
    W, Y = store.W, store.Y
    # NEW = 1e-10 in energy allows rounding to grow by 1e5, the condition number by its root
    rounding = 1e5 * 1e3 * EPS
    assert np.allclose(W.T @ problem.A @ W, np.eye(len(store)), atol=rounding)
    assert np.allclose(Y, problem.A @ W, atol=rounding * np.abs(Y).max(initial=0.0))

    model = BlockBFGSModel(problem, problem.diagonal, W, Y)
    dense = np.column_stack([model.apply(e) for e in np.eye(len(problem.b))])
    size = np.abs(dense).max()
    assert np.allclose(dense, dense.T, atol=rounding * size)
    assert np.linalg.eigvalsh(0.5 * (dense + dense.T))[0] > 0.0
    assert np.allclose(dense @ W, Y, atol=rounding * size * np.abs(W).max(initial=0.0))


def test_capacity_keeps_the_largest_ritz_values():
    rng = np.random.default_rng(0)
    problem = random_problem(8, 30, 3.0)
    store = ProductStore(problem, problem.diagonal, capacity=20)
    before = 0.0
    for number in range(45):
        x = rng.standard_normal(len(problem.b))
        store.add(x, problem.A @ x)
        assert len(store) <= 20
        after = store.largest_ritz_value
        assert after >= before * (1 - 1e-10), number
        before = after
    assert np.allclose(store.W.T @ problem.A @ store.W, np.eye(len(store)), atol=1e-9)
    assert np.allclose(store.Y, problem.A @ store.W, atol=1e-9)


def history_of(problem: DenseProblem, options: SolverOptions, rho: float) -> History:
    """A history that begins at zero."""
    residual = NaturalResidual(problem, rho)
    return History(problem, options, lambda iteration: False, residual)


@BOUNDED
@given(
    st.lists(st.floats(1e-12, 1e3), min_size=2, max_size=12),
    st.floats(0.01, 0.99),
    st.floats(0.01, 0.99),
)
def test_adaptive_precision_is_step_3_1(errors, r_tol, c_fact):
    """tol^{k+1} = min(r_tol err^k / err^0, c_fact tol^k), tol^0 = r_tol / c_fact, times err^0."""
    problem = random_problem(1, 4, 1.0)
    options = SolverOptions(r_tol=r_tol, c_fact=c_fact)
    history = history_of(problem, options, 1.0)
    scale = np.linalg.norm(brute_projection(problem.feasible_set, problem.b))
    precision = adaptive_precision(history, options)
    tol = r_tol / c_fact
    for error in errors:
        history.errors.append(error * scale)
        tol = min(r_tol * error / errors[0], c_fact * tol)
        assert precision() == pytest.approx(tol * errors[0] * scale, rel=100 * EPS)
