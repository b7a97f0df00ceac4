"""The parts of the algorithms: CGM_feas, store products, the eigenvalue, (Step 3.1)."""

from __future__ import annotations

import numpy as np
import pytest
from dense import problems
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from dolfinx_tresca import SolverOptions
from dolfinx_tresca.solvers.convergence import History, NaturalResidual
from dolfinx_tresca.solvers.feasible_set import Face, FeasibleSet
from dolfinx_tresca.solvers.linear_algebra import NodalMaps
from dolfinx_tresca.solvers.paper import (
    adaptive_precision,
    conjugate_gradients,
    largest_eigenvalue,
)
from dolfinx_tresca.solvers.problem import Point
from dolfinx_tresca.solvers.products import BlockBFGSModel, ProductStore
from scenes.dense import DenseProblem, brute_projection, random_problem
from scenes.scene import EPS

BOUNDED = settings(max_examples=50)


def inside(lam, x) -> bool:
    """Whether x lies in Lambda, up to rounding."""
    return bool(np.linalg.norm(x - brute_projection(lam, x)) <= 32 * EPS * np.linalg.norm(x))


@BOUNDED
@given(problems(), st.integers(0, 10**6))
def test_feasible_cg_ends_inside_and_never_raises_q(problem, seed):
    """CGM_feas ends before the first iterate outside Lambda; the one returned is inside."""
    rng = np.random.default_rng(seed)
    lam = problem.feasible_set
    x = brute_projection(lam, rng.standard_normal(lam.size))
    r = problem.A @ x - problem.b
    active = lam.face(x - r).active
    step, product = conjugate_gradients(
        problem,
        active,
        r,
        1e-10 * np.linalg.norm(problem.b),
        feasible=lambda s: inside(lam, x + s),
    )
    assert inside(lam, x + step)
    assert not step[~active].any()
    end = x + step
    terms = sum(np.abs(z) @ (np.abs(problem.A) @ np.abs(z) + np.abs(problem.b)) for z in (x, end))
    assert problem.q(end) <= problem.q(x) + 100 * EPS * terms
    assert np.allclose(product, problem.A @ step, atol=1e4 * EPS * np.linalg.norm(problem.b))


@BOUNDED
@given(problems(most_decades=2.0), st.integers(0, 10**6))
def test_cg_minimises_over_the_free_multipliers(problem, seed):
    """(38.14) against a dense solve with the free rows and columns of A."""
    rng = np.random.default_rng(seed)
    free = rng.random(len(problem.b)) < 0.7
    r = rng.standard_normal(len(problem.b))
    expected = np.zeros_like(r)
    expected[free] = -np.linalg.solve(problem.A[np.ix_(free, free)], r[free])
    tolerance = 1e-10 * np.linalg.norm(r)
    step, product = conjugate_gradients(problem, free, r, tolerance)
    smallest = np.linalg.eigvalsh(problem.A)[0]
    assert np.linalg.norm(step - expected) <= 1.1 * tolerance / smallest
    assert not step[~free].any()
    assert np.allclose(product, problem.A @ step, atol=1e4 * EPS * np.linalg.norm(r))


def test_cg_stops_at_its_limit():
    problem = random_problem(1, 10, 3.0)
    free = np.ones(len(problem.b), dtype=bool)
    conjugate_gradients(problem, free, problem.b, 0.0, most=3)
    assert problem.products == 3


def test_cg_needs_no_product_where_nothing_is_free():
    problem = random_problem(1, 10, 3.0)
    step, _ = conjugate_gradients(problem, np.zeros(len(problem.b), dtype=bool), problem.b, 0.0)
    assert problem.products == 0 and not step.any()


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


def bonded_face(x: np.ndarray) -> Face:
    """Return a face without restrictions."""
    return FeasibleSet(len(x), *(np.empty(0, dtype=np.intp),) * 3, np.empty(0)).face(x)


@BOUNDED
@given(problems(most_decades=2.0), st.integers(0, 10**6), st.integers(0, 12))
def test_the_model_is_inverted_on_any_face(problem, seed, number):
    """A step on a face against a dense solve of (P M P + C) s = P right on the range of P."""
    rng = np.random.default_rng(seed)
    lam = problem.feasible_set
    store = filled(problem, rng, number)
    model = store.model()
    M = np.column_stack([model.apply(e) for e in np.eye(lam.size)])
    face = lam.face(rng.standard_normal(lam.size))
    P = face.project(np.eye(lam.size))
    C = lam.circle_stiffness(rng.standard_normal(lam.size), face)
    right = rng.standard_normal(lam.size)
    values, vectors = np.linalg.eigh(P)
    basis = vectors[:, values > 0.5]
    system = basis.T @ (M + np.diag(C)) @ basis
    expected = basis @ np.linalg.solve(system, basis.T @ right)
    none = csr_array((len(right), 0))
    maps = NodalMaps.on_face(lam, right, face, model.diagonal, C)
    found, _ = model.solve_between(maps, right, none, csr_array((0, 0)), np.empty(0))
    condition = np.linalg.cond(system) if len(system) else 1.0
    tolerance = 1e5 * EPS * max(condition, 1e3) * max(np.linalg.norm(expected), 1e-300)
    assert np.linalg.norm(found - expected) <= tolerance


def test_full_knowledge_makes_the_model_exact():
    problem = random_problem(3, 6, 2.0)
    store = ProductStore(problem, problem.diagonal)
    for e in np.eye(len(problem.b)):
        store.add(e, problem.A @ e)
    assert len(store) == len(problem.b)
    model = store.model()
    M = np.column_stack([model.apply(e) for e in np.eye(len(problem.b))])
    assert np.allclose(M, problem.A, atol=1e4 * EPS)
    assert store.largest_ritz_value == pytest.approx(np.linalg.eigvalsh(problem.A)[-1], rel=1e-10)


def test_what_is_known_already_is_not_kept_again():
    problem = random_problem(3, 6, 1.0)
    store = ProductStore(problem, problem.diagonal)
    x = problem.b
    for factor in (1.0, -3.0, 1e-9, 0.0):
        store.add(factor * x, factor * (problem.A @ x))
    assert len(store) == 1


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


def dense_model(problem: DenseProblem, A: np.ndarray) -> BlockBFGSModel:
    """Return a model that is A > 0."""
    values, vectors = np.linalg.eigh(A)
    W = vectors / np.sqrt(values)
    return BlockBFGSModel(problem, np.ones(len(A)), W, A @ W)


@BOUNDED
@given(problems(most_decades=4.0))
def test_largest_eigenvalue_is_an_estimate_from_few_products(problem):
    """Never above, and for a rough b not far below.

    It cannot know eigenvectors that b hides: test_theorem.py asks that this does no harm.
    """
    exact = np.linalg.eigvalsh(problem.A)[-1]
    assert 0.8 * exact <= largest_eigenvalue(problem) <= exact * (1 + 1e-10)
    assert problem.products <= 20


def test_largest_eigenvalue_without_a_load():
    problem = random_problem(3, 6, 1.0)
    problem.b = np.zeros_like(problem.b)
    exact = np.linalg.eigvalsh(problem.A)[-1]
    assert 0.95 * exact <= largest_eigenvalue(problem) <= exact * (1 + 1e-10)


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


def test_history_judges_by_the_residual_of_the_definition():
    problem = random_problem(6, 6, 1.0)
    for rho in (0.1, 1.0, 5.0):
        history = history_of(problem, SolverOptions(rtol=1e-6), rho)
        x = brute_projection(problem.feasible_set, problem.b)
        history.check_convergence(Point(x, np.empty(0), problem.A @ x - problem.b), 0.0)
        assert history.residuals[0] == pytest.approx(problem.natural_residual(x, rho), rel=1e-12)
        terms = np.abs(x) @ (np.abs(problem.A) @ np.abs(x) + np.abs(problem.b))
        assert history.q[0] == pytest.approx(problem.q(x), abs=1e3 * EPS * terms)
        at_zero = history_of(problem, SolverOptions(rtol=1e-6), rho)
        at_zero.check_convergence(Point(0 * x, np.empty(0), -problem.b), 0.0)
        assert at_zero.residuals[0] == pytest.approx(1.0, rel=1e-14)


def test_known_products_are_told_with_their_error():
    """What lies in the span of the pairs is exact; of the rest the error is its energy, about."""
    problem = random_problem(3, 12, 2.0)
    rng = np.random.default_rng(0)
    known = rng.standard_normal((len(problem.b), 5))
    for x in known.T:
        problem.store.add(x, problem.A @ x)
    inside, outside = known @ rng.standard_normal(5), rng.standard_normal(len(problem.b))
    size = np.sqrt(inside @ problem.A @ inside)
    product, error = problem.store.product(inside)
    np.testing.assert_allclose(product, problem.A @ inside, rtol=1e-10, atol=1e-10 * size)
    assert error <= 1e-8 * size
    product, error = problem.store.product(inside + outside)
    missing = problem.A @ (inside + outside) - product
    assert error == pytest.approx(np.sqrt(missing @ np.linalg.solve(problem.A, missing)), rel=0.9)


def test_a_model_on_another_one():
    """It is exact on its own pairs, and like its base on what is A-orthogonal to them."""
    problem = random_problem(5, 12, 2.0)
    rng = np.random.default_rng(0)
    stores = [ProductStore(problem, problem.diagonal) for _ in range(2)]
    for store in stores:
        for x in rng.standard_normal((4, len(problem.b))):
            store.add(x, problem.A @ x)
    base, updated = stores[0].model(), stores[1].model(stores[0].model())
    W, Y = stores[1].W, stores[1].Y
    np.testing.assert_allclose(updated.apply(W), Y, atol=1e-10 * np.abs(Y).max())
    x, y = (stores[1].split(v)[0] for v in rng.standard_normal((2, len(problem.b))))
    assert y @ updated.apply(x) == pytest.approx(y @ base.apply(x), rel=1e-8)
    none = csr_array((len(x), 0))
    face = bonded_face(x)
    maps = NodalMaps.on_face(face.discs, x, face, updated.diagonal, 0.0 * x)
    solved, _ = updated.solve_between(maps, x, none, csr_array((0, 0)), np.empty(0))
    np.testing.assert_allclose(updated.apply(solved), x, atol=1e-8 * np.abs(x).max())


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_ritz_values_of_a_store_are_lower_bounds(size):
    """Of the largest eigenvalue, in any unit; nothing is known before the first product."""
    problem = random_problem(4, 8, 2.0)
    problem.A *= size
    problem.forget()
    store, rng = problem.known_products(), np.random.default_rng(5)
    assert store.largest_ritz_value == 0.0
    largest = np.linalg.eigvalsh(problem.A)[-1]
    for _ in range(4):
        before, x = store.largest_ritz_value, rng.standard_normal(len(problem.b))
        store.add(x, problem.A @ x)
        after = store.largest_ritz_value
        assert before * (1.0 - 100 * EPS) <= after <= largest * (1.0 + 100 * EPS)
        assert after >= x @ problem.A @ x / (x @ x) * (1.0 - 100 * EPS)
