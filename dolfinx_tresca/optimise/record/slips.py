"""Friction cones with the coefficients of friction at the slips of an iterate."""

from __future__ import annotations

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.sets.friction_cones import FrictionCones


def cones_at(
    problem: DualProblem, x: Array, r: Array, rho: float
) -> tuple[FeasibleSet | FrictionCones, Array]:
    """Return the admissible set with coefficients of friction at the slips of x, and c (k,).

    The multipliers c of the constraints are those of the gradient projection step. The slips do not
    include the motion of floating bodies, which follows from c; slip bounds that depend on the slip
    are not allowed for such bodies. Collective.

    Args:
        problem: the dual problem.
        x: (size,) multipliers.
        r: (size,) gradient A x - b.
        rho: step length.
    """
    cones = problem.admissible.at(x, r, rho)
    return cones, problem.constraints.gradient_step(cones.section(x), x, r, rho)[1]
