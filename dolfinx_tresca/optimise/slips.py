"""Slip bounds at the slips of multipliers."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.friction_cones import FrictionCones
from dolfinx_tresca.optimise.problem import DualProblem

#: Limit on successive slips of floating bodies, and their relative change after which they end.
MOST_SLIPS, SETTLED = 20, 1e-12


def cones_at(
    problem: DualProblem, x: Array, r: Array, rho: float
) -> tuple[FeasibleSet | FrictionCones, Array]:
    """Return the admissible set with the slips at x, and multipliers c (k,) of the constraints.

    The motion of floating bodies follows from c, which is that of the gradient projection step; it
    depends on the slip bounds, which may depend on the slip. Collective.

    Args:
        problem: the dual problem.
        x: (size,) multipliers.
        r: (size,) the gradient there, A x - b.
        rho: step length.
    """
    constraints, cones = problem.constraints, problem.admissible.at(x, r, rho)
    c = constraints.multipliers(cones.section(x), x, r, rho)
    if len(constraints) == 0 or not cones.has_curves:
        return cones, c
    for _ in range(MOST_SLIPS):
        before = c
        cones = cones.at(x, r - constraints.columns @ c, rho)
        c = constraints.multipliers(cones.section(x), x, r, rho)
        if np.linalg.norm(c - before) <= SETTLED * np.linalg.norm(c):
            break
    return cones, c
