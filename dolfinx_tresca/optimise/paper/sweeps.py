"""Friction with bounds that depend on the pressure, as a sequence of Tresca problems."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.patience import PROGRESS
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.history import Observe, error_of_product, gradient
from dolfinx_tresca.optimise.record.residual import EXHAUSTED, NaturalResidual
from dolfinx_tresca.optimise.record.stopping import Stopping
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus

#: A method for Tresca's problem.
Solve: TypeAlias = Callable[[DualProblem, Array, SolverOptions, Observe], DualSolution]

#: Requested accuracy of each Tresca problem, divided by the requested accuracy of the fixed point.
INNER = 0.3

#: Least value of the relaxation factor, which is halved after each sweep without `PROGRESS`.
LEAST_PART = 1.0 / 16.0

#: Limit on the number of sweeps.
MOST_SWEEPS = 60


def solve(
    problem: DualProblem,
    start: Array,
    options: SolverOptions,
    observe: Observe,
    tresca: Solve,
) -> DualSolution:
    """Find the fixed point by sweeps: Tresca problems with the slip bounds of the last pressures.

    The authors of the paper use this method, which extends algorithms for Tresca's problem to
    Coulomb's law; `fixed_point` needs far fewer products. If sweeps do not contract, only a part of
    the change by each sweep is taken. The result has the iterations and residuals of all sweeps.
    The last residual is measured with the slip bounds that follow from the last pressures
    themselves. `tresca` is the method for the Tresca problems.

    Collective.
    """
    strict = dataclasses.replace(
        options,
        accuracy=(
            options.accuracy if isinstance(options.accuracy, str) else INNER * options.accuracy
        ),
        rtol=None if options.rtol is None else INNER * options.rtol,
        local_accuracy=INNER * options.local_accuracy,
    )
    x = problem.admissible.project(start)
    part, iterations = 1.0, 0
    errors: list[float] = []
    residuals, q = [np.nan], [np.nan]
    while True:
        found = tresca(problem.section(x), x, strict, observe)
        x = x + part * (problem.admissible.project(found.multipliers) - x)
        r = gradient(problem, x)
        problem = problem.at(x, r, found.rho)
        residual = NaturalResidual(problem, found.rho, np.zeros_like(x), -problem.b)
        errors.append(residual.at(x, r))
        if len(errors) > 1 and errors[-1] > PROGRESS * errors[-2]:
            part = max(0.5 * part, LEAST_PART)
        iterations += found.iterations
        residuals[-1:], q[-1:] = found.residuals, found.q
        status = found.status
        if status not in (ContactStatus.CONVERGED, ContactStatus.STAGNATED):
            break
        error = error_of_product(problem, x, r)
        if Stopping(problem, options, residual).reached(x, r, error)[2]:
            status = ContactStatus.CONVERGED
        elif status is ContactStatus.STAGNATED and residual.relative(errors[-1]) <= EXHAUSTED:
            pass
        elif len(errors) == MOST_SWEEPS:
            status = ContactStatus.NO_FIXED_POINT
        elif iterations >= options.max_iterations:
            status = ContactStatus.MAX_ITERATIONS
        else:
            continue
        break
    residuals[-1] = residual.relative(errors[-1])
    return dataclasses.replace(
        found,
        multipliers=x,
        gradient=r,
        status=status,
        iterations=iterations,
        residuals=tuple(residuals),
        q=tuple(q),
        sweeps=len(errors),
    )
