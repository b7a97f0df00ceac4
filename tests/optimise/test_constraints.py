"""Multipliers that balance loads: the projection, and projected Newton, against other solvers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from dense import clarabel_minimum
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

import dolfinx_tresca.optimise.sets.constraints as module
from dolfinx_tresca import ContactStatus, InputError, SolverOptions
from dolfinx_tresca.floating.equilibrium import equilibrium_constraints
from dolfinx_tresca.optimise.newton.iterate import Iterate
from dolfinx_tresca.optimise.newton.projected_newton import ProjectedNewton
from dolfinx_tresca.optimise.record.energy import best_part, energy_norm
from dolfinx_tresca.optimise.sets.constraint_matrix import stored
from dolfinx_tresca.optimise.sets.constraints import EqualityConstraints
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.sets.positive_definite import is_positive_definite
from scenes.dense import (
    DenseProblem,
    OneRank,
    brute_projection,
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
@given(balanced(), st.integers(0, 10**6), st.sampled_from([1e-3, 1.0, 1e3, 1e9]))
def test_the_projection_is_the_nearest_point(problem, seed, scale):
    """The same as that of an interior-point method; it is in the set, to rounding."""
    lam, constraints = problem.feasible_set, problem.constraints
    y = scale * np.random.default_rng(seed).standard_normal(lam.size)
    nearest, c = constraints.project(lam, y, np.zeros(len(constraints)), 1.0)
    size = np.linalg.norm(y) + np.linalg.norm(nearest) + np.linalg.norm(constraints.sizes)
    check_member(lam, constraints, nearest, c, size)
    other = clarabel_minimum(np.eye(lam.size), y, lam, TOLERANCE, constraints)
    assert np.linalg.norm(nearest - other) <= DISTANCE * size
    # again: it stays, but for rounding, and so does c
    again, change = constraints.project(lam, nearest, c, 1.0)
    assert np.linalg.norm(again - nearest) <= 1e3 * EPS * size
    assert np.linalg.norm(constraints.softness @ change) <= 1e3 * EPS * size


@settings(max_examples=10)
@given(balanced())
def test_projected_newton_finds_the_minimum(problem):
    found = run(problem, rtol=1e-9)
    assert found.status is ContactStatus.CONVERGED
    lam, constraints, rho = problem.feasible_set, problem.constraints, found.rho
    r = problem.A @ found.multipliers - problem.b
    c = constraints.multipliers(lam, found.multipliers, r, rho)
    size = np.linalg.norm(problem.b) + np.linalg.norm(found.multipliers)
    assert np.linalg.norm(constraints.residual(found.multipliers, c)) <= 1e-7 * size
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
        equilibrium_constraints(
            lam,
            csr_array(jumps),
            csr_array((2, 2)),
            np.array([1.1 * limit + 0.1, 0.0]),
            np.full(2, 1.1 * limit + 0.1),
            np.zeros(2, dtype=int),
            OneRank(),
            describe,
        )
    motion = told[-1]
    opening = jumps @ motion
    work = (1.1 * limit + 0.1) * motion[0]
    size = np.linalg.norm(opening)
    assert (opening[lam.normal] <= 1e-6 * size).all()
    assert work > float(lam.radius @ lam.norms(opening)) - 1e-6 * size


def test_a_motion_that_nothing_resists_is_told():
    rng = np.random.default_rng(5)
    lam = random_set(rng, 6)
    jumps = rng.standard_normal((lam.size, 3))
    jumps[:, 2] = jumps[:, 0] - 2.0 * jumps[:, 1]

    def describe(motions: np.ndarray) -> str:
        assert np.linalg.norm(jumps @ motions) <= 1e-6 * np.linalg.norm(motions)
        return "it"

    with pytest.raises(InputError, match="nothing holds it, and no contact resists that"):
        equilibrium_constraints(
            lam,
            csr_array(jumps),
            csr_array((3, 3)),
            np.zeros(3),
            np.zeros(3),
            np.zeros(3, dtype=int),
            OneRank(),
            describe,
        )


def pulled(work: float) -> tuple[FeasibleSet, EqualityConstraints]:
    """Half of the normals press and balance loads; the rest opens, and loads do work on that."""
    rng = np.random.default_rng(7)
    lam = dataclasses.replace(random_set(rng, 8), radius=np.zeros(8))
    opening, pressed = np.array_split(lam.normal, 2)
    jumps = rng.standard_normal((lam.size, 2))
    jumps[opening, 0], jumps[pressed, 0] = -rng.uniform(0.1, 1.0, len(opening)), 0.0
    inside = np.zeros(lam.size)
    inside[pressed] = rng.uniform(0.1, 1.0, len(pressed))
    sizes = np.full(2, float(np.abs(jumps[:, 1]) @ inside))
    loads = np.array([work * sizes[0], jumps[:, 1] @ inside])
    none = csr_array((2, 2))
    return lam, equilibrium_constraints(
        lam, csr_array(jumps), none, loads, sizes, np.zeros(2, dtype=int), OneRank(), str
    )[0]


def test_resultants_that_are_rounding_are_balanced():
    """Loads that cancel leave some 1e-16 of their sizes, which may pull where nothing holds."""
    for work in (1e-16, 1e-12):
        lam, constraints = pulled(work)
        x, c = constraints.project(lam, np.zeros(lam.size), np.zeros(2), 1.0)
        check_member(lam, constraints, x, c, np.linalg.norm(constraints.sizes))
    with pytest.raises(InputError, match="no contact forces balance"):
        pulled(1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_sparse_and_dense_hessians_have_the_same_projection(seed):
    problem = random_balanced_problem(seed, 8, 3, 0.0, 1e-2 * (seed % 2))
    lam, constraints = problem.feasible_set, problem.constraints
    y, c = np.random.default_rng(seed).standard_normal(lam.size), np.zeros(len(constraints))
    found = []
    for kind in (np.asarray, csr_array):
        matrix = dataclasses.replace(constraints.matrix, columns=kind(constraints.columns))
        fresh = dataclasses.replace(constraints, matrix=matrix, softness=kind(constraints.softness))
        found.append(fresh.project(lam, y, c, 1.0)[0])
    size = np.linalg.norm(y) + np.linalg.norm(constraints.sizes)
    assert np.linalg.norm(found[1] - found[0]) <= 100 * EPS * size


def test_signs_of_pivots_tell_positive_definite_matrices():
    Q, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 6)))
    for least in (1e-12, 1.0):
        values = np.array([least, 1.0, 1.0, 2.0, 3.0, 4.0])
        for sign in (1.0, -1.0):
            values[0] = sign * least
            assert is_positive_definite(csr_array((Q * values) @ Q.T)) == (sign > 0.0)


def test_a_projection_that_is_repeated_is_computed_once(monkeypatch):
    """Residual, multipliers and errors of an iterate need the same one; other bounds another."""
    lam, constraints = pulled(1e-12)
    computed = []
    original = module.constrained_projection
    monkeypatch.setattr(
        module, "constrained_projection", lambda *a, **k: computed.append(1) or original(*a, **k)
    )
    y, c = np.linspace(-1.0, 1.0, lam.size), np.zeros(2)
    once = constraints.project(lam, y, c, 1.0)
    twice = constraints.project(lam, y.copy(), c, 1.0)
    assert len(computed) == 1 and twice is once
    wider = dataclasses.replace(lam, radius=lam.radius + 1.0)
    for k, arguments in enumerate([(wider, y, c, 1.0), (wider, y, c, 2.0), (wider, y + 1, c, 2.0)]):
        constraints.project(*arguments)
        assert len(computed) == 2 + k


def energy_of(problem: DenseProblem, x: np.ndarray) -> float:
    """Return q, and the energy (e - G'x)'S^-1 (e - G'x) / 2 of soft equations."""
    constraints = problem.constraints
    missing = constraints.values - constraints.matrix.along(np.eye(len(x))) @ x
    return problem.q(x) + 0.5 * float(missing @ np.linalg.solve(constraints.softness, missing))


def test_rounding_of_soft_equations_is_no_energy():
    """A softness that is negative by rounding adds nothing to the energy norm."""
    problem = random_balanced_problem(4, 8, 2, 2.0, 0.0)
    x, c = np.zeros(len(problem.b)), np.ones(len(problem.constraints))
    rigid = energy_norm(problem, x, -problem.b, c)
    negative = stored(csr_array(-EPS * np.eye(len(c))))
    problem.constraints = dataclasses.replace(problem.constraints, softness=negative)
    assert energy_norm(problem, x, -problem.b, c) == rigid


def test_slope_and_curvature_of_soft_equations_are_those_of_the_energy():
    """Against differences, which are exact for a quadratic function."""
    problem = random_balanced_problem(4, 8, 2, 2.0, 0.3)
    x, step = np.random.default_rng(5).standard_normal((2, len(problem.b)))
    newton = ProjectedNewton(problem, SolverOptions(), lambda iteration: False)
    newton.at = Iterate.of(problem, problem.known_products())
    newton.at.move_to(x, problem.A @ x - problem.b, 0.0)
    below, here, above = (energy_of(problem, x + part * step) for part in (-1.0, 0.0, 1.0))
    rounding = 100 * EPS * max(abs(below), abs(here), abs(above))
    assert abs(newton.slope(step) - 0.5 * (above - below)) <= rounding
    curvature = newton.curvature(step, problem.A @ step)
    assert abs(curvature - (above - 2.0 * here + below)) <= 4 * rounding


@pytest.mark.parametrize("seed", range(6))
def test_the_best_part_of_a_step_has_the_least_energy(seed):
    """Of uphill steps, too short ones, too long ones, and of none."""
    problem = random_balanced_problem(seed, 8, 2, 2.0, 0.3)
    x, step = np.random.default_rng(seed).standard_normal((2, len(problem.b)))
    r = problem.A @ x - problem.b
    for length in (-10.0, -1.0, -0.1, 0.0, 0.1, 1.0, 10.0):
        way = length * step
        part = best_part(problem, x, r, way, problem.A @ way)
        assert 0.0 <= part <= 1.0
        others = [energy_of(problem, x + other * way) for other in np.linspace(0.0, 1.0, 101)]
        rounding = 100 * EPS * max(map(abs, others))
        assert energy_of(problem, x + part * way) <= min(others) + rounding
