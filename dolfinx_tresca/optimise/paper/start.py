"""The start of the paper's algorithms: step length rho, first multipliers and gradient."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.paper.spectrum import largest_eigenvalue
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.record.history import History, Observe, gradient
from dolfinx_tresca.optimise.record.residual import NaturalResidual
from dolfinx_tresca.options import SolverOptions


def begin(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> tuple[History, Array, Array]:
    """Begin a solve by an algorithm of the paper. Collective.

    Returns:
        the history, with rho from an estimate of sigma_max; the first multipliers (size,); and the
        gradient at them. The first multipliers are the projected start, or zero if the residual at
        zero is smaller, for example after the load was removed.
    """
    problem.response.refine_b()  # every gradient contains b
    rho = options.step_factor / largest_eigenvalue(problem)
    zero, at_zero = np.zeros_like(start), -problem.b
    residual = NaturalResidual(problem, rho, zero, at_zero)
    history = History(problem, options, observe, residual)
    x = problem.feasible_set.project(start)
    r = gradient(problem, x)
    if residual.at(x, r) > residual.scale:
        x, r = zero, at_zero
    return history, x, r
