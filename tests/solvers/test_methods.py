"""All five algorithms: minimisers, honesty of the status, invariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dense import clarabel_minimum, problems
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from dolfinx_tresca import ContactStatus, SolverOptions
from dolfinx_tresca.solvers.constraints import balance
from dolfinx_tresca.solvers.convergence import History, NaturalResidual
from dolfinx_tresca.solvers.paper import adaptive_precision
from scenes.dense import (
    METHODS,
    DenseProblem,
    brute_projection,
    random_balanced_problem,
    random_problem,
    run,
)
from scenes.scene import EPS

GUARANTEED = ("projected_newton", "gimssn")
RTOL = 1e-7


def scale_of(problem: DenseProblem, rho: float) -> float:
    """Return the natural residual at zero, which residuals are relative to."""
    return float(np.linalg.norm(brute_projection(problem.feasible_set, rho * problem.b)) / rho)


@settings(max_examples=60)
@given(problems(most_decades=2.0), st.sampled_from(["imssn", "mssn", "ssn"]), st.floats(0.3, 10.0))
def test_methods_without_a_guarantee_never_claim_what_is_not_so(problem, method, rho_sigma):
    """CONVERGED exactly where the recomputed residual says so."""
    found = run(problem, method, rtol=RTOL, max_iterations=40, rho_sigma=rho_sigma)
    actual = problem.natural_residual(found.multipliers, found.rho)
    rounding = 1e4 * EPS
    assert actual == pytest.approx(found.residuals[-1], rel=1e-3, abs=rounding)
    if found.status is ContactStatus.CONVERGED:
        assert actual <= RTOL * 1.01
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
            assert problem.natural_residual(x, found.rho) <= 1.01 * RTOL
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
            stiffness * problem.A, load * problem.b, replace(lam, radius=unit * lam.radius)
        )
        second = run(scaled, method, max_iterations=30)
        assert (first.iterations, problem.products) == (second.iterations, scaled.products)
        assert first.status is second.status
        assert np.allclose(second.multipliers / unit, first.multipliers, rtol=100 * EPS)


@settings(max_examples=50)
@given(
    st.lists(st.floats(1e-12, 1e3), min_size=2, max_size=12),
    st.floats(0.01, 0.99),
    st.floats(0.01, 0.99),
)
def test_adaptive_precision_is_step_3_1(errors, r_tol, c_fact):
    """tol^{k+1} = min(r_tol err^k / err^0, c_fact tol^k), tol^0 = r_tol / c_fact, times err^0."""
    problem = random_problem(1, 4, 1.0)
    options = SolverOptions(r_tol=r_tol, c_fact=c_fact)
    residual = NaturalResidual(problem, 1.0)
    history = History(problem, options, lambda iteration: False, residual)
    scale = np.linalg.norm(brute_projection(problem.feasible_set, problem.b))
    precision = adaptive_precision(history, options)
    tol = r_tol / c_fact
    for error in errors:
        history.residual_norms.append(error * scale)
        tol = min(r_tol * error / errors[0], c_fact * tol)
        assert precision() == pytest.approx(tol * errors[0] * scale, rel=100 * EPS)


def test_motions_with_negative_stiffness_do_not_end_the_search_for_balanced_multipliers():
    """A free body that is pressed may resist its rotation negatively, as rollers of a bearing do.

    Where the equations are soft with a positive stiffness, the multipliers balance them.
    """
    problem = random_balanced_problem(3, 8, 2, 2.0, 0.0)
    constraints = replace(problem.constraints, softness=csr_array(np.diag([-1e3, 1e-2])))
    x = np.zeros(len(problem.b))
    section = problem.section_at(x, x)
    shift = balance(constraints, section, x, softness_factor=1.0).shift
    balanced = constraints.along(section.project(constraints.columns @ shift))
    balanced[1] += 1e-2 * shift[1]
    assert np.allclose(balanced, constraints.values, rtol=1e-8)
