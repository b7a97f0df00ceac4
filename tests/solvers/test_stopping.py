"""When the iteration ends: what each way to ask implies, and what holds at the end."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from dolfinx_tresca import ContactStatus
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.solvers.convergence import UNPROVEN, History, NaturalResidual
from dolfinx_tresca.solvers.problem import Point
from scenes.dense import METHODS, DenseProblem, random_problem, run

#: The mesh's error of dense problems.
MESH = 0.05

LOCAL, PART = SolverOptions().local_accuracy, SolverOptions().mesh_part


@dataclass
class UnprovenProblem(DenseProblem):
    """No bound can be had, as where constraints are dependent."""

    def energy_bound(self, x: np.ndarray, r: np.ndarray, error: float) -> float:
        """Return infinity, whatever is asked."""
        return np.inf


def unproven(problem: DenseProblem) -> UnprovenProblem:
    return UnprovenProblem(problem.A, problem.b, problem.feasible_set)


@dataclass
class BoundedProblem(DenseProblem):
    """A bound that is what it is, relative to the norm of u."""

    bound: float = 0.0

    def energy_bound(self, x: np.ndarray, r: np.ndarray, error: float) -> float:
        """Return it, whatever x."""
        return self.bound * self.energy_norm(x, r)


def wanted(problem: DenseProblem, bound: float, **options: float) -> list[float]:
    """What is wanted of a point that is as good as any, but for its bound."""
    one = BoundedProblem(problem.A, problem.b, problem.feasible_set, bound=bound)
    x, r = np.zeros_like(problem.b), -problem.b
    residual = NaturalResidual(one, 1.0)
    history = History(one, SolverOptions(**options), lambda iteration: False, residual)
    wanted = history.measures(Point(x, np.empty(0), r), 0.0, residual=residual.scale)
    return [want for _, want in wanted][1:]  # without the balance of forces


def test_what_is_wanted():
    problem = random_problem(0, 6, 1.0)
    assert wanted(problem, 0.0) == [LOCAL, 0.1, PART * MESH]
    assert wanted(problem, 0.0, mesh_part=0.3) == [LOCAL, 0.1, 0.3 * MESH]
    assert wanted(problem, 0.0, accuracy=1e-3) == [1e-3]
    # a bound as fine as any mesh's needs no estimate of that
    assert wanted(problem, 1e-6, rtol=1e-8) == [1e-8, LOCAL, 0.1]
    assert wanted(problem, 1e-2, rtol=1e-8) == [1e-8, LOCAL, 0.1, PART * MESH]
    assert wanted(problem, np.inf) == [LOCAL, UNPROVEN]
    assert wanted(problem, np.inf, rtol=1e-8) == [1e-8, LOCAL]


@pytest.mark.parametrize("rtol", [None, 0.5, 1e-2])
def test_no_residual_is_too_loose_for_the_default(rtol):
    """Whatever is asked of the residual, the default's criteria hold at the end."""
    for seed in range(4):
        problem = random_problem(seed, 15, 2.0)
        solution = run(problem, rtol=rtol)
        x, r = solution.multipliers, solution.gradient
        assert solution.status is ContactStatus.CONVERGED
        # with a bound below 1e-4 the mesh may not have been asked
        error = problem.energy_bound(x, r, 0.0) / problem.energy_norm(x, r)
        assert error <= PART * MESH
        assert problem.local_error(x, r) <= LOCAL


@pytest.mark.parametrize("options", [{}, {"accuracy": 1e-3}, {"rtol": 1e-6}])
@pytest.mark.parametrize("method", METHODS)
def test_zero_is_the_solution(method, options):
    """Nothing moves, and no bound is needed to see that."""
    some = random_problem(1, 6, 2.0)
    lam = some.feasible_set
    away = some.b.copy()
    away[lam.normal] = -np.abs(away[lam.normal])
    smooth = replace(lam, radius=np.zeros_like(lam.radius))
    for problem in (DenseProblem(some.A, 0.0 * away, lam), DenseProblem(some.A, away, smooth)):
        for one in (problem, unproven(problem)):
            given = {"rtol": None, **options}
            solution = run(one, method, **given)
            assert solution.status is ContactStatus.CONVERGED
            assert solution.iterations == 0
            assert (solution.multipliers == 0.0).all()


def test_an_error_that_cannot_be_proven():
    """Asked for a bound, the iteration says that it has none."""
    problem = unproven(random_problem(2, 15, 2.0))
    solution = run(problem, accuracy=1e-3)
    assert solution.status in (ContactStatus.STAGNATED, ContactStatus.MAX_ITERATIONS)
    default = run(problem, rtol=None)
    assert default.status is ContactStatus.CONVERGED
    assert default.residuals[-1] <= UNPROVEN
