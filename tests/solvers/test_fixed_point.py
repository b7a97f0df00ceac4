"""Bounds that depend on the pressure: what is claimed is so, and is Tresca's solution."""

from __future__ import annotations

import numpy as np
import pytest
from dense import clarabel_minimum
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from dolfinx_tresca import ContactStatus, InputError
from dolfinx_tresca.solvers import iteration
from dolfinx_tresca.solvers.constraints import EqualityConstraints
from dolfinx_tresca.solvers.feasible_set import FeasibleSet, FrictionCones
from scenes.dense import (
    METHODS,
    DenseProblem,
    OneRank,
    brute_projection,
    random_cone_problem,
    random_dry_problem,
    run,
)
from scenes.scene import EPS

RTOL = 1e-7
FEW = settings(max_examples=30)


@st.composite
def cone_problems(draw, most: float = 1.0, most_decades: float = 3.0):
    """Problems with coefficients of friction up to a number."""
    return random_cone_problem(
        draw(st.integers(0, 10**6)),
        draw(st.integers(1, 12)),
        draw(st.floats(0.0, most_decades)),
        draw(st.floats(0.05, most)),
    )


def check_fixed_point(problem: DenseProblem, x: np.ndarray, rtol: float, rho: float) -> None:
    """Check that x minimises q over the set with its own bounds, as a conic solver finds it.

    By the strong monotonicity of Tresca's problem, |x - x*| <= (1 + rho L) residual / sigma_min.
    """
    values = np.linalg.eigvalsh(problem.A)
    wanted = clarabel_minimum(problem.A, problem.b, problem.cones.section(x))
    scale = np.linalg.norm(problem.b)
    tolerance = (1.0 + rho * values[-1]) * rtol * scale / values[0]
    # accuracy of the reference: 1e-10 in q
    tolerance += 3 * np.sqrt(1e-9 * scale**2 / values[0] ** 2)
    assert np.linalg.norm(x - wanted) <= tolerance


@FEW
@given(cone_problems())
def test_the_default_method_finds_the_fixed_point(problem):
    """At coefficients up to 1 always; and no product is paid for what the model can tell."""
    found = run(problem, rtol=RTOL)
    assert found.status is ContactStatus.CONVERGED
    assert problem.natural_residual(found.multipliers, found.rho) <= 1.01 * RTOL
    check_fixed_point(problem, found.multipliers, RTOL, found.rho)


@pytest.mark.parametrize(
    ("number", "least"), [(40, 3.0), pytest.param(300, 0.0, marks=pytest.mark.long)]
)
def test_fixed_points_that_exist_are_found(number, least):
    """At least 95 % of problems with F up to 3 and condition numbers up to 1e4 are solved.

    A fixed point exists in all of them: Tresca's solution depends continuously on the bounds, and
    its pressures are bounded whatever the bounds are, so that Brouwer's theorem applies.
    """
    rng = np.random.default_rng(7)
    lost = []
    for seed in range(number):
        nodes, decades = int(rng.integers(1, 9)), float(rng.uniform(0.0, 4.0))
        problem = random_dry_problem(seed, nodes, decades, float(rng.uniform(least, 3.0)))
        found = run(problem, rtol=RTOL)
        if found.status is not ContactStatus.CONVERGED:
            lost.append(seed)
        else:
            assert problem.natural_residual(found.multipliers, found.rho) <= 1.01 * RTOL
    assert len(lost) <= 0.05 * number, lost


@FEW
@given(cone_problems(most=30.0))
def test_converged_means_what_it_says(problem):
    """The status agrees with the recomputed residual, whatever the coefficient is."""
    found = run(problem, rtol=RTOL, max_iterations=60)
    actual = problem.natural_residual(found.multipliers, found.rho)
    assert actual == pytest.approx(found.residuals[-1], rel=1e-3, abs=1e4 * EPS)
    if found.status is ContactStatus.CONVERGED:
        assert actual <= 1.01 * RTOL
    else:
        assert actual > 0.99 * RTOL
    inside = problem.cones.section(found.multipliers)
    moved = brute_projection(inside, found.multipliers) - found.multipliers
    assert np.linalg.norm(moved) <= 100 * EPS * np.linalg.norm(found.multipliers)


def test_methods_of_the_paper_are_refused():
    """The algorithms of the paper are for slip bounds that are given."""
    problem = random_cone_problem(3, 6, 0.5, 0.3)
    for method in METHODS[1:]:
        with pytest.raises(InputError, match=f"method='{method}' needs slip bounds that are given"):
            run(problem, method)


@pytest.mark.parametrize(
    "seed, nodes, decades, most",
    [(39, 3, 3.0, 0.5), (35, 3, 3.0, 0.5), (13, 5, 4.0, 1.0), (43, 3, 4.0, 3.0)],
)
def test_skewed_problems_with_one_fixed_point_far_from_zero(seed, nodes, decades, most):
    """Newton's method needs shortened steps, and patience, in each of these problems."""
    problem = random_cone_problem(seed, nodes, decades, most)
    found = run(problem, rtol=RTOL)
    assert found.status is ContactStatus.CONVERGED
    check_fixed_point(problem, found.multipliers, RTOL, found.rho)


def test_where_there_is_no_fixed_point_none_is_claimed():
    """A node is pressed by 1 and pulled by 1, with a coefficient of friction of 0.5.

    A pressure of 2 balances the loads, but nothing brings it about. The status does not blame a
    lack of digits.
    """
    problem = wedge(0.5)
    problem.A, problem.b = np.eye(2), np.array([1.0, 0.0])
    problem.constraints = EqualityConstraints(
        csr_array([[0.0], [1.0]]), csr_array((1, 1)), np.ones(1), np.ones(1), OneRank()
    )
    found = run(problem, rtol=RTOL)
    assert found.status is ContactStatus.NO_FIXED_POINT
    assert problem.products <= 40
    # a step that leads nowhere and tells nothing of A ends it; rounding may let one more be tried
    assert found.iterations <= 4 < iteration.PATIENCE


def wedge(coefficient: float) -> DenseProblem:
    """One node in two dimensions that jams: pressure and traction of a skewed A."""
    rows = np.array([0]), np.array([1]), np.array([0])
    lam = FeasibleSet(2, *rows, np.array([0.0]), normal_of=np.array([0]))
    A = np.array([[1.0, 0.9], [0.9, 1.0]])
    values = np.array([coefficient]), np.array([np.inf])
    problem = DenseProblem(A, np.array([1.0, 2.0]), lam)
    problem.cones = FrictionCones(*vars(lam).values(), *values)
    return problem
