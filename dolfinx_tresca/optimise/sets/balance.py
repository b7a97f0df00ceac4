"""A search for multipliers in Lambda that satisfy linear equations. Numpy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import diags_array, issparse

from dolfinx_tresca._base.arrays import ROUNDING, Array, Matrix
from dolfinx_tresca._base.patience import MOST_STEPS
from dolfinx_tresca.optimise.sets.constraint_matrix import ConstraintMatrix
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.sets.friction_cones import FrictionCones
from dolfinx_tresca.optimise.sets.positive_definite import factored

#: The search ends without a solution if the rounding error of G z, relative to the terms of the
#: equation, exceeds this number: z goes to infinity if the equation has no solution, or if all its
#: solutions are on the boundary of Lambda. `balancing_multipliers` explains G, z, C and phi.
LOST = 1e-6

#: First, least and largest value of the damping, which is the fraction of the diagonal of the
#: majorant G'G + C that is added to the Hessian. After a whole step, the damping is multiplied by
#: `RELAXATION`, since the next step may be longer where phi is flat; if rounding makes the matrix
#: indefinite, the damping is multiplied by `MORE_DAMPING`.
DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 1e-4, 1e-16, 1.0
RELAXATION, MORE_DAMPING = 1e-3, 10.0

#: Relative and absolute accuracy of the part of a step that minimises phi. The kinks of phi may be
#: at parts of any order of magnitude.
PART_ACCURACY, LEAST_PART = 1e-6, 1e-30


@dataclass(frozen=True)
class Balance:
    """The result of `balancing_multipliers`.

    Attributes:
        shift: (k,) the solution z; the multipliers are P(G z).
        excess: (k,) residual of the equation.
        satisfied: whether the residual is at most the rounding error of the equation's terms. The
            rounding error of G z may be larger; a residual of that size does not prove that a
            solution exists.
        unbounded: whether phi fell below -depth, where `depth` is an argument of the function.
    """

    shift: Array
    excess: Array
    satisfied: bool
    unbounded: bool = False


def balancing_multipliers(
    feasible_set: FeasibleSet | FrictionCones,
    matrix: ConstraintMatrix,
    softness: Matrix,
    target: Array,
    sizes: Array,
    depth: float,
) -> Balance:
    """Return z with G'P(G z) + C z = target, where P projects onto Lambda. Collective.

    The solution z minimises the convex function

        phi(z) = 1/2 |x|^2 - 1/2 |x - P(x)|^2 + 1/2 z'C z - z'target,    x = G z,

    whose gradient is the residual of the equation. The method is Newton's with damping, and with
    the part of each step that minimises phi. Where no pressure acts, phi is flat; there the damping
    is reduced from step to step, and steps grow until z has left the flat region.

    Args:
        feasible_set: Lambda.
        matrix: G (size, k).
        softness: (k, k) C, symmetric and positive semidefinite.
        target: (k,) right-hand side of the equation.
        sizes: (k,) sums of the absolute values of the terms of `target`, from which rounding errors
            are estimated.
        depth: the search ends if phi falls below -depth. All x in Lambda and c with G'x + C c =
            target then have |x|^2 + c'C c > 2 depth (weak duality).
    """
    agreed = matrix.reductions.from_first_rank
    scale = 1.0 / np.sqrt((matrix.gram + softness).diagonal())

    def excess(z: Array) -> Array:
        """Return the gradient of phi."""
        p = feasible_set.project(matrix.columns @ z)
        return agreed(matrix.along(p) + softness @ z - target)

    def rounding(z: Array) -> tuple[Array, Array]:
        """Return two rounding errors (k,) of the residual: from summing it, and from G z."""
        p = feasible_set.project(matrix.columns @ z)
        moved = np.where(p != 0.0, matrix.absolute @ np.abs(z), 0.0)
        terms, cancelled = matrix.along_absolute(np.column_stack([np.abs(p), moved])).T
        summed = ROUNDING * (terms + abs(softness) @ np.abs(z) + sizes)
        return agreed(summed), agreed(np.finfo(float).eps * cancelled)

    z, damping = np.zeros_like(target), DAMPING
    for _ in range(MOST_STEPS):
        gradient = excess(z)
        small, cancelled = rounding(z)
        if ROUNDING * cancelled.max() > LOST * small.max():
            break
        if (np.abs(gradient) <= small + cancelled).all():
            return Balance(z, gradient, bool((np.abs(gradient) <= small).all()))
        if -_dot(z, gradient) > depth:  # phi(0) = 0 and phi is convex: phi(z) <= z'gradient
            return Balance(z, gradient, satisfied=False, unbounded=True)
        derivative = feasible_set.projection_derivative(matrix.columns @ z)
        hessian = matrix.hessian(derivative) + softness
        scaling = diags_array(scale) if issparse(hessian) else np.diag(scale)
        step = -agreed(
            scale * _damped_solution(scaling @ hessian @ scaling, scale * gradient, damping)
        )

        def slope(part: float, z: Array = z, step: Array = step) -> float:
            return _dot(step, excess(z + part * step))

        part = 1.0
        if slope(1.0) > 0.0 > slope(0.0):
            part = brentq(slope, 0.0, 1.0, xtol=LEAST_PART, rtol=PART_ACCURACY, maxiter=1000)
        z = z + part * step
        damping = RELAXATION * damping if part == 1.0 else damping / part
        damping = min(max(damping, LEAST_DAMPING), LARGEST_DAMPING)
    return Balance(z, excess(z), satisfied=False)


def _damped_solution(matrix: Matrix, right: Array, damping: float) -> Array:
    """Return (M + d I)^-1 b for M >= 0; d is increased until the factorisation exists."""
    unit = diags_array(np.ones(len(right))) if issparse(matrix) else np.eye(len(right))
    while damping < np.inf:
        solve = factored(matrix + damping * unit)
        if solve is not None:
            x = solve(right)
            if _dot(x, right) >= 0.0:  # else rounding made a pivot negative
                return x
        damping *= MORE_DAMPING
    raise np.linalg.LinAlgError("the Hessian of a projection is not finite")


def _dot(x: Array, y: Array) -> float:
    """Return x'y, summed in a fixed order, so that ranks on different processors agree."""
    return float(np.cumsum(x * y)[-1])
