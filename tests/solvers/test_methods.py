"""All five algorithms: minimisers, KKT conditions, honesty of the status, invariance."""

from __future__ import annotations

import numpy as np
import pytest
from dense import clarabel_minimum, problems
from hypothesis import given, settings
from hypothesis import strategies as st

from dolfinx_tresca import ContactStatus, SolverOptions
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
def test_no_multiplier_at_all(method):
    """A rank, or a scene, may have none."""
    empty = np.zeros(0, dtype=np.intp)
    problem = DenseProblem(
        np.zeros((0, 0)), np.zeros(0), FeasibleSet(0, empty, empty, empty, np.zeros(0))
    )
    assert run(problem, method).status is ContactStatus.CONVERGED


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("stiffness", "load"), [(1.0, 4.0**20), (1.0, 4.0**-20), (4.0**15, 1.0), (4.0**-15, 1.0)]
)
def test_units_of_load_change_nothing(method, stiffness, load):
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


@pytest.mark.parametrize("rtol", [None, 0.5, 1e-2])
def test_no_residual_is_too_loose_for_the_default(rtol):
    """Whatever is asked of the residual, the default's criteria hold at the end."""
    asked, mesh = SolverOptions(), 0.05
    for seed in range(4):
        problem = random_problem(seed, 15, 2.0)
        solution = run(problem, rtol=rtol)
        x, r = solution.multipliers, solution.gradient
        assert solution.status is ContactStatus.CONVERGED
        # with a bound below 1e-4 the mesh may not have been asked
        error = problem.energy_bound(x, r, 0.0) / problem.energy_norm(x, r)
        assert error <= asked.mesh_part * mesh
        assert problem.local_error(x, r) <= asked.local_accuracy
