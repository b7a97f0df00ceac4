"""Multipliers of the constraints at an iterate, with friction at the slips of the iterate."""

from __future__ import annotations

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.problem import DualProblem


def multipliers_of_constraints(problem: DualProblem, x: Array, r: Array, rho: float) -> Array:
    """Return the multipliers c (k,) of the constraints in the gradient projection step from x.

    Coefficients of friction are those at the slips of x. The slips do not include the motion of
    floating bodies, which follows from c; slip bounds that depend on the slip are not allowed for
    such bodies. Collective.

    Args:
        problem: the dual problem.
        x: (size,) multipliers.
        r: (size,) gradient A x - b.
        rho: step length.
    """
    cones = problem.admissible.at(x, r, rho)
    return problem.constraints.gradient_step(cones.section(x), x, r, rho)[1]
