"""Energies of an iterate: q, and the displacement's energy norm with a bound of its error."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.problem import DualProblem


def change_of_q(
    problem: DualProblem, x: Array, r: Array, origin: Array, origin_gradient: Array
) -> float:
    """Return q(x) - q(origin) [energy], soft constraints included. Collective.

    Args:
        problem: the dual problem (38.4).
        x: (size,) multipliers.
        r: (size,) gradient at x.
        origin: (size,) multipliers with which x is compared.
        origin_gradient: (size,) gradient at the origin.
    """
    step, constraints = x - origin, problem.constraints
    change = 0.5 * float(problem.inner(step, r + origin_gradient))
    return change + constraints.slope(origin, step) + 0.5 * constraints.curvature(step)


def best_part(problem: DualProblem, x: Array, r: Array, direction: Array, product: Array) -> float:
    """Return the part t of a step, in [0, 1], at whose end q is least. Collective.

    Here q includes soft constraints.

    Args:
        problem: the dual problem (38.4).
        x: (size,) multipliers at the start of the step.
        r: (size,) gradient at x.
        direction: (size,) the step.
        product: (size,) A times the direction.
    """
    soft = problem.constraints
    slope = float(problem.inner(direction, r)) + soft.slope(x, direction)
    curvature = float(problem.inner(direction, product)) + soft.curvature(direction)
    return min(max(-slope / curvature, 0.0), 1.0) if curvature > 0.0 else 0.0


def energy_norm(problem: DualProblem, x: Array, r: Array, c: Array, error: float = 0.0) -> float:
    """Return |u|_K [energy^(1/2)] of the displacement u; 0 if less than its error. Collective.

    Args:
        problem: the dual problem (38.4).
        x: (size,) multipliers.
        r: (size,) gradient at x.
        c: (k,) multipliers of the equality constraints.
        error: error of r in the norm sqrt(e'A^-1 e).
    """
    soft = float(c @ problem.constraints.softness @ c)
    return float(np.hypot(problem.response.energy_norm(x, r, error), np.sqrt(max(soft, 0.0))))


def energy_error(problem: DualProblem, x: Array, r: Array, c: Array, error: float = 0.0) -> float:
    """Return a bound of the displacement's relative error in the energy norm. Collective.

    Args:
        problem: the dual problem (38.4).
        x: (size,) multipliers in Lambda.
        r: (size,) gradient at x.
        c: (k,) multipliers of the equality constraints.
        error: error of r in the norm sqrt(e'A^-1 e).
    """
    constraints = problem.constraints
    bound = problem.energy_bound(
        x, r - constraints.columns @ c, error + constraints.violation(x, c)
    )
    return relative_error(problem, bound, energy_norm(problem, x, r, c, error))


def relative_error(problem: DualProblem, bound: float, norm: float) -> float:
    """Return an error bound divided by the norm of the displacement; 0 if both are rounding.

    If the contact carries all loads and no body deforms, the displacement and its error are both
    only rounding errors of displacements that cancel, and their ratio has no meaning.

    Collective.

    Args:
        problem: the dual problem (38.4).
        bound: bound of the error in the energy norm [energy^(1/2)].
        norm: energy norm of the displacement [energy^(1/2)].
    """
    if bound == 0.0 or max(bound, norm) <= problem.response.energy_resolution():
        return 0.0
    return bound / norm if norm > 0.0 else float("inf")
