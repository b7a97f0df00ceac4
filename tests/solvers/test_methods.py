"""All five algorithms: minimisers, KKT conditions, honesty of the status, counting, invariance."""

from __future__ import annotations

import numpy as np
import pytest
from dense import clarabel_minimum, problems
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dolfinx_tresca import ContactStatus
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from scenes.dense import METHODS, DenseProblem, brute_projection, random_problem, run
from scenes.scene import EPS

GUARANTEED = ("projected_newton", "gimssn")
RTOL = 1e-7


def scale_of(problem: DenseProblem, rho: float) -> float:
    """Return the natural residual at zero, which residuals are relative to."""
    return float(np.linalg.norm(brute_projection(problem.feasible_set, rho * problem.b)) / rho)


def check_kkt(problem: DenseProblem, x: np.ndarray, rho: float, rtol: float) -> None:
    """Check (38.2) and (38.3) node by node, u_nu - d = -r_nu and u_tau = -r_tau.

    A natural residual of delta lets multipliers err by rho delta, and jumps by delta.
    """
    lam = problem.feasible_set
    r = problem.A @ x - problem.b
    delta = 1.1 * rtol * scale_of(problem, rho) + 100 * EPS * np.linalg.norm(problem.b)
    assert (x[lam.normal] >= 0.0).all()
    assert (r[lam.normal] >= -delta).all()
    assert (np.minimum(x[lam.normal] / rho, r[lam.normal]) <= delta).all()
    for node, g in enumerate(lam.radius):
        rows = lam.tangential[lam.node == node]
        traction, jump = x[rows], -r[rows]
        size = np.linalg.norm(traction)
        assert size <= g * (1 + 10 * EPS)
        if size < g - rho * delta:
            assert np.linalg.norm(jump) <= delta
        elif g > 2 * rho * delta:
            direction = traction / size
            along = direction @ jump
            assert along >= -2 * delta
            sideways = np.linalg.norm(jump - along * direction)
            assert sideways <= 2 * delta * (1 + rho * np.linalg.norm(jump) / g)


@settings(max_examples=60)
@given(problems(most_decades=2.0), st.sampled_from(GUARANTEED))
def test_methods_with_a_guarantee_converge_to_a_kkt_point(problem, method):
    found = run(problem, method, rtol=RTOL, max_iterations=5000)
    assert found.status is ContactStatus.CONVERGED
    assert problem.natural_residual(found.multipliers, found.rho) <= RTOL * 1.01
    check_kkt(problem, found.multipliers, found.rho, RTOL)


@settings(max_examples=60)
@given(problems(most_decades=2.0), st.sampled_from(["imssn", "mssn", "ssn"]), st.floats(0.3, 10.0))
def test_methods_without_a_guarantee_never_claim_what_is_not_so(problem, method, rho_sigma):
    """CONVERGED exactly where the recomputed residual says so, and then the answer is right."""
    found = run(problem, method, rtol=RTOL, max_iterations=40, rho_sigma=rho_sigma)
    actual = problem.natural_residual(found.multipliers, found.rho)
    rounding = 1e4 * EPS
    assert actual == pytest.approx(found.residuals[-1], rel=1e-3, abs=rounding)
    if found.status is ContactStatus.CONVERGED:
        assert actual <= RTOL * 1.01
        check_kkt(problem, found.multipliers, found.rho, RTOL)
    else:
        assert found.status in (ContactStatus.MAX_ITERATIONS, ContactStatus.STAGNATED)
        assert actual > RTOL * 0.99


@settings(max_examples=40)
@given(problems(most_decades=2.0))
def test_methods_agree_where_they_converge_and_with_clarabel(problem):
    """q(x) - q* <= rho |residual| |r| off the face, and 1/2 sigma_min |x - x*|^2 <= q(x) - q*."""
    values = np.linalg.eigvalsh(problem.A)
    reference = brute_projection(
        problem.feasible_set, clarabel_minimum(problem.A, problem.b, problem.feasible_set)
    )
    converged = []
    for method in METHODS:
        found = run(problem, method, rtol=RTOL, max_iterations=3000 if method == "gimssn" else 40)
        if found.status is ContactStatus.CONVERGED:
            converged.append(method)
            x = found.multipliers
            # interior-point tolerance 1e-10 and the projection after it; then our residual
            tolerance = 1e-8 * max(abs(problem.q(x)), problem.b @ problem.b)
            delta = RTOL * scale_of(problem, found.rho)
            tolerance += found.rho * delta * np.linalg.norm(found.gradient)
            assert problem.q(x) == pytest.approx(problem.q(reference), abs=tolerance)
            # |x - x*| <= sqrt(2 error in q / sigma_min), on both sides
            assert np.linalg.norm(x - reference) <= 3 * np.sqrt(2 * tolerance / values[0])
    assert set(GUARANTEED) <= set(converged)


def test_every_method_converges_somewhere():
    """The comparison above would be empty for a method that never converged."""
    problem = random_problem(3, 6, 0.5)
    for method in METHODS:
        assert run(problem, method, rtol=RTOL).status is ContactStatus.CONVERGED


@pytest.mark.parametrize("method", GUARANTEED)
def test_tight_tolerances_are_reached(method):
    """A relative residual of 1e-10 is 1e6 times above rounding for cond(A) = 10."""
    for seed in range(20):
        problem = random_problem(seed, 5, 1.0)
        found = run(problem, method, rtol=1e-10, max_iterations=2000)
        assert found.status is ContactStatus.CONVERGED, (seed, found.residuals[-1])


@pytest.mark.parametrize("method", METHODS)
def test_stagnates_below_what_double_precision_gives(method):
    """A tolerance below rounding ends in STAGNATED, or in a residual that happens to be zero."""
    statuses = []
    for seed in range(3):
        problem = random_problem(seed, 30, 1.0)
        found = run(problem, method, rtol=1e-18, max_iterations=3000)
        statuses.append(found.status)
        if found.status is ContactStatus.CONVERGED:
            assert problem.natural_residual(found.multipliers, found.rho) <= 100 * EPS
        else:
            assert found.status is ContactStatus.STAGNATED
            assert 0.0 < found.residuals[-1]
    assert ContactStatus.STAGNATED in statuses


@pytest.mark.parametrize("method", METHODS)
def test_iteration_limit(method):
    problem = random_problem(5, 10, 2.0)
    found = run(problem, method, rtol=1e-10, max_iterations=1)
    assert found.status is ContactStatus.MAX_ITERATIONS
    assert found.iterations == 1
    assert len(found.residuals) == len(found.q) == 2


@pytest.mark.parametrize("method", METHODS)
def test_the_observer_sees_each_iterate_and_stops(method):
    problem = random_problem(5, 10, 2.0)
    seen = []

    def observe(iteration):
        seen.append(iteration)
        return iteration.number == 2

    found = run(problem, method, observe=observe, rtol=1e-10)
    assert found.status is ContactStatus.STOPPED
    assert found.iterations == 2
    assert [at.number for at in seen] == [0, 1, 2]
    assert tuple(at.residual for at in seen) == found.residuals
    assert tuple(at.q for at in seen) == found.q
    products = [at.products for at in seen]
    assert products == sorted(products) and products[-1] == problem.products


@settings(max_examples=30)
@given(problems(), st.sampled_from(METHODS))
def test_reported_numbers_belong_to_the_answer(problem, method):
    """q, gradient and residual are those of the returned multipliers, recomputed."""
    found = run(problem, method, max_iterations=15, rtol=1e-6)
    x = found.multipliers
    gradient = problem.A @ x - problem.b
    size = np.linalg.norm(problem.b) + np.abs(problem.A).sum(axis=1).max() * np.linalg.norm(x)
    assert np.linalg.norm(found.gradient - gradient) <= 1e4 * EPS * size
    assert found.q[-1] == pytest.approx(problem.q(x), abs=1e4 * EPS * size * np.linalg.norm(x))
    assert found.iterations == len(found.residuals) - 1


@pytest.mark.parametrize("method", METHODS)
def test_no_multiplier_at_all(method):
    """A rank, or a scene, may have none."""
    empty = np.zeros(0, dtype=np.intp)
    problem = DenseProblem(
        np.zeros((0, 0)), np.zeros(0), FeasibleSet(0, empty, empty, empty, np.zeros(0))
    )
    assert run(problem, method).status is ContactStatus.CONVERGED


@pytest.mark.parametrize("method", METHODS)
def test_start_at_the_solution_needs_no_step(method):
    problem = random_problem(4, 6, 0.5)
    best = run(problem, rtol=1e-9).multipliers
    assert run(problem, method, best, rtol=1e-6).iterations == 0


@pytest.mark.parametrize("method", METHODS)
def test_an_infeasible_start_is_allowed(method):
    problem = random_problem(4, 6, 0.5)
    best = run(problem, rtol=1e-9).multipliers
    found = run(problem, method, -10.0 * np.ones_like(best), rtol=RTOL)
    assert found.status is ContactStatus.CONVERGED
    assert np.linalg.norm(found.multipliers - best) <= 100 * RTOL * np.linalg.norm(best)


def other_units_change_nothing(method: str, stiffness: float, load: float) -> None:
    """A and b times powers of 4: the same steps, to the last bit but rounding."""
    for seed in range(4):
        problem = random_problem(seed, 8, 1.5)
        first = run(problem, method, max_iterations=30)
        lam = problem.feasible_set
        unit = load / stiffness  # of the multipliers, so that of the radii
        scaled = DenseProblem(
            stiffness * problem.A,
            load * problem.b,
            FeasibleSet(lam.size, lam.normal, lam.tangential, lam.node, unit * lam.radius),
        )
        second = run(scaled, method, max_iterations=30)
        assert (first.iterations, problem.products) == (second.iterations, scaled.products)
        assert first.status is second.status
        assert np.allclose(second.multipliers / unit, first.multipliers, rtol=100 * EPS)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("power", [20, -20])
def test_units_of_load_change_nothing(method, power):
    """Load and bound times 4^20 = 1.1e12."""
    other_units_change_nothing(method, stiffness=1.0, load=4.0**power)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("power", [15, -15])
def test_units_of_stiffness_change_nothing(method, power):
    """A times 4^15 = 1.1e9, with b the same: lambda is divided by it, so g is too."""
    other_units_change_nothing(method, stiffness=4.0**power, load=1.0)


def test_projected_newton_keeps_every_product():
    """All that was paid for is in the store pairs, or held nothing new."""
    problem = random_problem(9, 8, 1.0)
    run(problem)
    store = problem.store
    assume_new = np.linalg.matrix_rank(np.array(problem.arguments), tol=1e-8)
    assert len(store) <= problem.products
    for x in problem.arguments:
        rest = x - store.W @ (store.Y.T @ x)
        # NEW = 1e-10 in energy, 1e-5 in the norm, times the root of the condition number
        assert np.linalg.norm(rest) <= 1e-4 * np.linalg.norm(x)
    assert len(store) >= assume_new - 1


def test_projected_newton_starts_again_for_less():
    """With the pairs of the first solve the second, for another load, needs fewer products."""
    problem = random_problem(21, 12, 2.0)
    run(problem)
    first = problem.products
    problem.b = problem.b * 1.1
    found = run(problem, keep=True)
    assert found.status is ContactStatus.CONVERGED
    assert problem.products - first < first


@settings(max_examples=20)
@given(problems(most_decades=1.0), st.integers(0, 10**6))
def test_a_poor_diagonal_costs_speed_only(problem, seed):
    """`diagonal` steers speed, not results."""
    assume(len(problem.b) > 2)
    good = run(problem, rtol=RTOL)
    factor = np.random.default_rng(seed).uniform(0.1, 10.0)

    class Poor(DenseProblem):
        @property
        def diagonal(self) -> np.ndarray:
            return factor * super().diagonal

    poor = Poor(problem.A, problem.b, problem.feasible_set)
    found = run(poor, rtol=RTOL, max_iterations=500)
    assert found.status is ContactStatus.CONVERGED
    assert poor.q(found.multipliers) == pytest.approx(
        problem.q(good.multipliers), abs=1e-10 * (1.0 + abs(good.q[-1]))
    )
