"""Multipliers that balance loads: the search for them, and Newton, against other solvers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from dense import clarabel_minimum
from hypothesis import given, settings
from hypothesis import strategies as st

from dolfinx_tresca import ContactStatus, InputError
from dolfinx_tresca.solvers.constraints import EqualityConstraints, balance
from dolfinx_tresca.solvers.feasible_set import FeasibleSet
from scenes.dense import (
    DenseProblem,
    brute_projection,
    equilibrium,
    random_balanced_problem,
    random_set,
    run,
)
from scenes.scene import EPS

#: Of clarabel, and what that leaves in multipliers of size 1 where cond(A) is 100.
TOLERANCE, DISTANCE = 1e-10, 1e-5


@st.composite
def balanced(draw: st.DrawFn) -> DenseProblem:
    nodes = draw(st.integers(4, 12))
    return random_balanced_problem(
        draw(st.integers(0, 10**6)),
        nodes,
        draw(st.integers(1, 3)),
        draw(st.floats(0.0, 2.0)),
        draw(st.sampled_from([0.0, 1e-12, 1e-8, 1e-4, 1e-2, 1.0])),
    )


def check_member(
    lam: FeasibleSet, constraints: EqualityConstraints, x: np.ndarray, c: np.ndarray, size: float
) -> None:
    """Check that x is in Lambda and satisfies the constraints with c, to rounding."""
    assert np.linalg.norm(x - brute_projection(lam, x)) <= 32 * EPS * size
    assert np.linalg.norm(constraints.residual(x, c)) <= 100 * EPS * size


@settings(max_examples=60)
@given(balanced(), st.sampled_from([1e-3, 1.0, 1e9]))
def test_the_balance_is_the_least(problem, scale):
    """Of all multipliers that satisfy the equations, as those of an interior-point method."""
    # all soft equations are equally soft
    soft = 1.0 * (problem.constraints.softness > 0.0)
    constraints = dataclasses.replace(
        problem.constraints,
        softness=soft,
        values=scale * problem.constraints.values,
        sizes=scale * problem.constraints.sizes,
    )
    lam = dataclasses.replace(problem.feasible_set, radius=scale * problem.feasible_set.radius)
    found = balance(constraints, lam)
    x = lam.project(constraints.columns @ found.shift)
    assert found.satisfied
    size = np.linalg.norm(x) + np.linalg.norm(constraints.sizes)
    check_member(lam, constraints, x, found.shift, size)
    unit = dataclasses.replace(problem.constraints, softness=soft)
    other = clarabel_minimum(np.eye(lam.size), 0.0 * x, problem.feasible_set, TOLERANCE, unit)
    assert np.linalg.norm(x - scale * other) <= DISTANCE * (np.linalg.norm(x) + scale)


@settings(max_examples=10)
@given(balanced())
def test_projected_newton_finds_the_minimum(problem):
    found = run(problem, rtol=1e-9)
    assert found.status is ContactStatus.CONVERGED
    lam, constraints, rho = problem.feasible_set, problem.constraints, found.rho
    size = np.linalg.norm(problem.b) + np.linalg.norm(found.multipliers)
    check_member(lam, constraints, found.multipliers, found.c, size)
    other = clarabel_minimum(problem.A, problem.b, lam, TOLERANCE, constraints)
    assert np.linalg.norm(found.multipliers - other) <= DISTANCE * size
    # the gradient that comes with it is that of plain Lambda: the motions are in it
    plain = brute_projection(lam, found.multipliers - rho * found.gradient)
    assert np.linalg.norm(found.multipliers - plain) <= rho * 1e-8 * size


@settings(max_examples=8)
@given(st.integers(0, 10**6), st.integers(4, 12), st.integers(1, 3), st.floats(0.0, 2.0))
def test_rigid_motions_in_b_make_no_difference(seed, nodes, motions, decades):
    """Where nothing but contact holds bodies, b is known up to G c."""
    problem = random_balanced_problem(seed, nodes, motions, decades, 0.0)
    constraints = problem.constraints
    c = np.random.default_rng(seed).standard_normal(len(constraints))
    moved = dataclasses.replace(problem, b=problem.b + constraints.columns @ c, arguments=[])
    first, second = run(problem, rtol=1e-9), run(moved, rtol=1e-9)
    size = np.linalg.norm(problem.b) + np.linalg.norm(c) + np.linalg.norm(first.multipliers)
    # an error of the gradient of 1e-9, times cond(A) and what the scale may differ by
    assert np.linalg.norm(first.multipliers - second.multipliers) <= 1e-6 * size


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(5, 12))
def test_loads_that_nothing_balances_are_told_with_their_motion(seed, nodes):
    """The motion named takes energy from the loads that contact cannot take (Farkas)."""
    rng = np.random.default_rng(seed)
    lam = random_set(rng, nodes)
    jumps = rng.standard_normal((lam.size, 2))
    jumps[lam.normal, 0] = -rng.uniform(0.1, 1.0, len(lam.normal))  # opens everywhere
    limit = float(lam.radius @ lam.norms(jumps[:, 0]))
    told = []

    def describe(motion: np.ndarray) -> str:
        told.append(motion)
        return "it"

    with pytest.raises(InputError, match="no contact forces balance the loads on it"):
        work = 1.1 * limit + 0.1
        equilibrium(lam, jumps, np.array([work, 0.0]), np.full(2, work), describe=describe)
    motion = told[-1]
    opening = jumps @ motion
    work = (1.1 * limit + 0.1) * motion[0]
    size = np.linalg.norm(opening)
    assert (opening[lam.normal] <= 1e-6 * size).all()
    assert work > float(lam.radius @ lam.norms(opening)) - 1e-6 * size
