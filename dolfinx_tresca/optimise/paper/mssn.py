"""MSSN and IMSSN: the symmetrised semi-smooth Newton method, exact and inexact."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.paper.cg import conjugate_gradients
from dolfinx_tresca.optimise.paper.precision import AdaptivePrecision
from dolfinx_tresca.optimise.paper.start import begin
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.history import History, Observe
from dolfinx_tresca.options import SolverOptions

#: Inner residual of "exact" solves, divided by the outer residual at the start.
INNER_RESIDUAL = 1e-12


def solve_exactly(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM MSSN (section 38.3.1), with accurate inner solves.

    The inner CG iterations end at 1e-12 times the residual at the start. The method converges fast
    if most nodes stick. Convergence is not guaranteed: Lemma 38.1 only states that the limit, if
    there is one, is the solution. Collective.
    """
    return _iterate(
        problem,
        start,
        options,
        observe,
        lambda history: lambda: INNER_RESIDUAL * history.first_error,
    )


def solve_inexactly(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM IMSSN: MSSN with the precision control of (Step 3.1).

    The method is fast if it converges, but may cycle if many nodes stick. Collective.
    """
    return _iterate(
        problem, start, options, observe, lambda history: AdaptivePrecision(history, options).next
    )


def _iterate(
    problem: DualProblem,
    start: Array,
    options: SolverOptions,
    observe: Observe,
    precision: Callable[[History], Callable[[], float]],
) -> DualSolution:
    """Run Steps 1 to 4 of the paper's algorithm. Collective.

    `precision(history)` is a function that returns the tolerance of the next inner iteration each
    time it is called.
    """
    feasible_set = problem.feasible_set
    history, multipliers, r = begin(problem, start, options, observe)
    tolerance = precision(history)
    while True:
        status, projected, r_projected = history.check_convergence_of_projection(multipliers, r)
        if status is not None:
            return history.solution(projected, r_projected, status)
        target = multipliers - history.residual.rho * r
        face = feasible_set.face(target)
        fixed = np.where(face.active, multipliers, feasible_set.project(target))
        r = r + problem.operator.apply(fixed - multipliers)
        inner = conjugate_gradients(problem, face.active, r, tolerance())
        multipliers = fixed + inner.step
        r = r + inner.product
