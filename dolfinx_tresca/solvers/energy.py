"""Energies of an iterate: q, and the displacement's energy norm with a bound of its error."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca.solvers.problem import DualProblem, Point


def dual_energy(problem: DualProblem, point: Point) -> float:
    """Return q = x'A x / 2 - b'x, plus the energy c'S c / 2 of soft constraints. Collective."""
    constraints, c = problem.constraints, point.c
    image = point.r + constraints.columns @ c - problem.b
    return 0.5 * (float(problem.inner(point.x, image)) + float(c @ constraints.softness @ c))


def energy_norm(problem: DualProblem, point: Point, error: float = 0.0) -> float:
    """Return |u|_K [energy^(1/2)] of the displacement u; 0 if less than its error. Collective.

    Args:
        problem: the dual problem (38.4).
        point: multipliers with their gradient.
        error: error of the gradient in the norm sqrt(e'A^-1 e).
    """
    constraints, c = problem.constraints, point.c
    soft = float(c @ constraints.softness @ c)
    elastic = problem.response.energy_norm(point.x, point.r + constraints.columns @ c, error)
    return float(np.hypot(elastic, np.sqrt(max(soft, 0.0))))


def energy_error(problem: DualProblem, point: Point, error: float = 0.0) -> float:
    """Return a bound of the displacement's relative error in the energy norm. Collective.

    Args:
        problem: the dual problem (38.4).
        point: multipliers in Lambda, with their gradient.
        error: error of the gradient in the norm sqrt(e'A^-1 e).
    """
    missing = problem.constraints.violation(point.x, point.c)
    bound = problem.energy_bound(point.x, point.r, error + missing)
    return relative_error(problem, bound, energy_norm(problem, point, error))


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
