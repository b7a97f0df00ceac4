"""The interior-point method for the model, against an independent one."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from dense import clarabel_minimum
from scipy.sparse import csr_array
from scipy.sparse.linalg import spsolve

from dolfinx_tresca._base.patience import MOST_STEPS
from dolfinx_tresca.optimise.models.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.models.sparse_model import SparseModel
from dolfinx_tresca.optimise.newton.interior_point import InteriorPoint, central_path
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.sets.friction_cones import FrictionCones
from scenes.dense import DenseProblem, random_balanced_problem, random_problem
from scenes.scene import EPS

#: Relative error of the reference's q, times the problem's size: its tolerance.
REFERENCE = 1e-8

#: Steps within which q is as exact as that, whatever the condition.
STEPS = 30

NODES = 12


def only_normal(lam: FeasibleSet) -> FeasibleSet:
    """Other multipliers are free."""
    none = lam.tangential[:0]
    return replace(lam, tangential=none, node=none, radius=lam.radius[:0])


def free(lam: FeasibleSet) -> FeasibleSet:
    """No inequality is left."""
    return replace(only_normal(lam), normal=lam.normal[:0])


KINDS = {
    "discs, some of radius zero": lambda lam: lam,
    "radii of zero": lambda lam: replace(lam, radius=0.0 * lam.radius),
    "frictionless": only_normal,
    "free": free,
}


def exact_model(problem: DenseProblem) -> BlockBFGSModel:
    """M = A, from as many pairs as there are multipliers."""
    W = np.linalg.inv(np.linalg.cholesky(problem.A)).T
    return BlockBFGSModel(problem, problem.diagonal, W, problem.A @ W)


def path_of(problem: DenseProblem, start: np.ndarray) -> list[InteriorPoint]:
    """As much of the path as the method takes at the most."""
    path = central_path(problem, exact_model(problem), start, problem.A @ start - problem.b)
    return list(islice(path, MOST_STEPS))


def starts(problem: DenseProblem, seed: int) -> list[np.ndarray]:
    """Zero, and points far from it on which many constraints are active."""
    rng = np.random.default_rng(seed)
    far = 10.0 ** rng.uniform(-3.0, 3.0) * rng.standard_normal(problem.feasible_set.size)
    return [np.zeros_like(far), problem.feasible_set.project(far)]


@pytest.mark.parametrize("decades", [0.0, 4.0, 8.0])
@pytest.mark.parametrize("kind", KINDS)
def test_the_path_ends_at_the_minimum(kind, decades):
    """In a number of steps that grows neither with the condition nor with the start's distance."""
    if decades > 4.0 and kind in ("frictionless", "free"):
        pytest.skip(
            "multipliers of 1e8 where nothing bounds them: rounding in the model is as large"
        )
    for seed in range(4):
        problem = random_problem(seed, NODES, decades)
        problem.feasible_set = KINDS[kind](problem.feasible_set)
        least = problem.q(
            clarabel_minimum(problem.A, problem.b, problem.feasible_set, tolerance=1e-9)
        )
        for start in starts(problem, seed):
            energies = [problem.q(point.multipliers) for point in path_of(problem, start)]
            assert min(energies[:STEPS]) <= least + REFERENCE * NODES * abs(least)
            assert min(energies) >= least - REFERENCE * NODES * abs(least)


def test_the_path_is_the_same_with_a_sparse_model():
    """Of the same matrix: the dense model is that of the sparse one's, with its shift."""
    for seed in range(4):
        problem = random_problem(seed, NODES, 2.0)
        lam, discs = problem.feasible_set, NODES
        infinite = np.full(discs, np.inf)
        cones = FrictionCones(lam, np.full(discs, -1), lam.radius, np.zeros(discs), infinite)
        model = SparseModel(problem, csr_array(problem.A), 0, cones.nodes(), spsolve)
        problem.A = model.apply(np.eye(lam.size))
        model.diagonal = problem.diagonal  # decides where the path begins
        for start in starts(problem, seed):
            gradient = problem.A @ start - problem.b
            sparse = central_path(problem, model, start, gradient)
            for one, other in islice(zip(sparse, path_of(problem, start), strict=False), 6):
                error = np.linalg.norm(one.multipliers - other.multipliers)
                # condition numbers of a hundred times those of the barrier
                assert error <= 1e6 * EPS * np.linalg.norm(other.multipliers)


def test_points_are_inside():
    """Strictly, whatever rounding does, and the gradient is the model's."""
    for seed in range(4):
        problem = random_problem(seed, NODES, 6.0)
        lam = problem.feasible_set
        for start in starts(problem, seed):
            for point in path_of(problem, start)[:-1]:
                x = point.multipliers
                assert (x[lam.normal] > 0.0).all()
                assert (lam.norms(x) <= lam.radius).all()
                size = np.abs(problem.A) @ np.abs(x) + np.abs(problem.b)
                # the model's product is a sum over pairs whose vectors have lengths up to 1e3
                assert np.abs(point.gradient - (problem.A @ x - problem.b)).max() <= (
                    1e6 * EPS * size.max()
                )


def test_sticking_everywhere():
    """Radii without bound: a linear system but for the pressures."""
    for seed in range(4):
        problem = random_problem(seed, NODES, 3.0)
        lam = problem.feasible_set
        least = problem.q(clarabel_minimum(problem.A, problem.b, only_normal(lam)))
        problem.feasible_set = replace(lam, radius=np.full_like(lam.radius, np.inf))
        for start in starts(problem, seed):
            energies = [problem.q(point.multipliers) for point in path_of(problem, start)]
            assert min(energies[:STEPS]) == pytest.approx(least, rel=REFERENCE * NODES)


@pytest.mark.parametrize("softness", [0.0, 0.1])
def test_loads_in_balance(softness):
    """Points of the path balance loads in the limit, with the rigid motions that go with them."""
    for seed in range(4):
        problem = random_balanced_problem(seed, NODES, 2, 3.0, softness)
        lam = problem.feasible_set
        constraints = problem.constraints
        exact = clarabel_minimum(problem.A, problem.b, lam, constraints=constraints)
        last = path_of(problem, np.zeros(lam.size))[-1]
        size = np.linalg.norm(constraints.values)
        assert np.linalg.norm(constraints.residual(last.multipliers, last.c)) <= 1e-8 * size
        # q lies flat about the minimum: the root of its error, and of the condition
        near = np.sqrt(REFERENCE * NODES * 1e3)
        assert np.linalg.norm(last.multipliers - exact) <= near * np.linalg.norm(exact)


def test_rounding_ends_it():
    """Where circles are met exactly there is no inside any more."""
    problem = random_problem(0, NODES, 3.0)
    start = np.zeros_like(problem.b)
    path = central_path(problem, exact_model(problem), start, -problem.b)
    assert len(list(islice(path, 1000))) < 1000


def test_nothing_is_loaded():
    """Zero is the minimum; there is no scale from which a barrier could begin."""
    problem = random_problem(1, 3, 1.0)
    problem.b[:] = 0.0
    for point in path_of(problem, np.zeros_like(problem.b)):
        assert np.isfinite(point.multipliers).all()
