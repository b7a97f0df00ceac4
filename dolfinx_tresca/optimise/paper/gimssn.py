"""GIMSSN: the symmetrised, inexact, globally convergent semi-smooth Newton method."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.paper.cg import conjugate_gradients
from dolfinx_tresca.optimise.paper.precision import AdaptivePrecision
from dolfinx_tresca.optimise.paper.start import begin
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.history import Observe
from dolfinx_tresca.options import SolverOptions


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM GIMSSN (section 38.4).

    Each iteration takes a gradient projection step, which alone gives the R-linear rate of
    Theorem 38.1, then CG steps on the free multipliers until one leaves Lambda. The method
    converges from any start, but slowly if many nodes slip: CG does not change directions of slip.

    Collective.
    """
    feasible_set = problem.feasible_set
    history, multipliers, r = begin(problem, start, options, observe)
    precision = AdaptivePrecision(history, options)
    while (status := history.check_convergence(multipliers, r)) is None:
        target = multipliers - history.residual.rho * r
        projected = feasible_set.project(target)
        move = projected - multipliers
        product = problem.operator.apply(move)
        curvature = float(problem.inner(product, move) / problem.inner(move, move))
        # the Lanczos iteration missed an eigenvalue whose eigenvector is almost orthogonal to b
        if curvature * history.residual.rho >= 2.0:
            history.residual.set_rho(options.step_factor / curvature)
            continue
        active = feasible_set.face(target).active
        r = r + product

        def feasible(step: Array, base: Array = projected) -> bool:
            moved = base + step
            outside = moved - feasible_set.project(moved)
            # rounding alone may move the traction of a slipping node off its circle
            return bool(
                problem.inner(outside, outside)
                <= np.finfo(float).eps ** 2 * problem.inner(moved, moved)
            )

        inner = conjugate_gradients(
            problem,
            active,
            r,
            precision.next(),
            feasible=feasible,
        )
        multipliers = feasible_set.project(projected + inner.step)
        r = r + inner.product
    return history.solution(multipliers, r, status)
