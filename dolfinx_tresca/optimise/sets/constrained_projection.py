"""Projection onto Lambda under equality constraints. Numpy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array

from dolfinx_tresca._base.arrays import ROUNDING, Array, Matrix
from dolfinx_tresca._base.patience import MOST_STEPS
from dolfinx_tresca.optimise.sets.constraint_matrix import ConstraintMatrix
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.sets.friction_cones import FrictionCones
from dolfinx_tresca.optimise.sets.positive_definite import factored

#: The iteration ends without a solution if the rounding error of G z, relative to the terms of the
#: equation, exceeds this number: z goes to infinity if the equation has no solution, or if all its
#: solutions are on the boundary of Lambda. `constrained_projection` explains G, z, C and phi.
LOST = 1e-6

#: First, least and largest value of the damping, which is the fraction of the diagonal of the
#: majorant G'G + C that is added to the Hessian.
DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 1e-4, 1e-16, 1.0

#: Factors on the damping. `RELAXATION` is applied after a whole step, since the next step may be
#: longer where phi is flat. `MORE_DAMPING` is applied if rounding makes the matrix indefinite.
RELAXATION, MORE_DAMPING = 1e-3, 10.0

#: Line search for the part t of a step s. Let g(t) be the gradient of phi at this part, and l the
#: longest part known to be too short. A part t is too long if (t - l) s'g(t) exceeds OVERSHOOT
#: times the larger one of slope^2 / curvature and -l s'g(l), which is a lower bound of the descent
#: at l. A shortened step is too short if the slope at its end is steeper than SLOPE_LEFT times the
#: slope at its start.
OVERSHOOT, SLOPE_LEFT = 0.25, 0.5


@dataclass(frozen=True)
class ConstrainedProjection:
    """The result of `constrained_projection`.

    Attributes:
        shift: (k,) the solution z.
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


def constrained_projection(
    feasible_set: FeasibleSet | FrictionCones,
    matrix: ConstraintMatrix,
    softness: Matrix,
    y: Array,
    target: Array,
    sizes: Array,
    depth: float = np.inf,
    guess: Array | None = None,
) -> ConstrainedProjection:
    """Return z with G'P(y + G z) + C z = target, where P projects onto Lambda. Collective.

    The solution z minimises the convex function

        phi(z) = 1/2 |x|^2 - 1/2 |x - P(x)|^2 + 1/2 z'C z - z'target,    x = y + G z,

    whose gradient g is the residual of the equation. The method is Newton's with damping. Where no
    pressure acts, phi is flat; there the damping is reduced from step to step, and steps grow until
    z has left the flat region. The Hessian of phi is nowhere larger than G'G + C. If the gradient
    g(t) at the part t of a step s satisfies t s'g(t) <= (s'g(0))^2 / (4 s'(G'G + C) s), phi
    decreases by at least the right-hand side, which is sufficient for convergence. The test uses
    gradients, since near the solution values of phi differ only by rounding.

    Args:
        feasible_set: Lambda.
        matrix: G (size, k).
        softness: (k, k) C, symmetric and positive semidefinite.
        y: (size,) constant part of x.
        target: (k,) right-hand side of the equation.
        sizes: (k,) sums of the absolute values of the terms of `target`, from which rounding errors
            are estimated.
        depth: the iteration ends if phi falls below -depth. With y = 0, all x in Lambda and c with
            G'x + C c = target then have |x|^2 + c'C c > 2 depth (weak duality).
        guess: (k,) first z, used if its residual is smaller than the residual of zero; None: zero.
    """
    agreed = matrix.reductions.from_first_rank
    if not isinstance(matrix.gram, np.ndarray):
        softness = csc_array(softness)
    majorant, stiff = matrix.gram + softness, abs(softness)
    scale = 1.0 / np.sqrt(majorant.diagonal())
    floor = ROUNDING * (matrix.along_absolute(np.abs(y)) + sizes)

    def at(z: Array) -> tuple[Array, Array, Array]:
        x = y + matrix.columns @ z
        p = feasible_set.project(x)
        return x, p, agreed(matrix.along(p) + softness @ z - target)

    def rounding(z: Array, p: Array) -> tuple[Array, Array]:
        """Return two rounding errors (k,) of the residual: from summing it, and from y + G z."""
        changes = np.where(p != 0.0, matrix.absolute @ np.abs(z), 0.0)
        terms, cancelled = matrix.along_absolute(np.column_stack([np.abs(p), changes])).T
        return agreed(ROUNDING * (terms + stiff @ np.abs(z)) + floor), agreed(
            np.finfo(float).eps * cancelled
        )

    def newton(x: Array, excess: Array, damping: float) -> Array:
        hessian = matrix.hessian(feasible_set.projection_derivative(x)) + softness
        return -agreed(scale * _damped_solution(_scaled(hessian, scale), scale * excess, damping))

    z, damping = np.zeros_like(target), DAMPING
    x, p, excess = at(z)
    if guess is not None:
        there = at(guess)
        if _dot(there[2], there[2]) < _dot(excess, excess):
            z, (x, p, excess) = guess, there
    for _ in range(MOST_STEPS):
        small, cancelled = rounding(z, p)
        if ROUNDING * cancelled.max() > LOST * small.max():
            return ConstrainedProjection(z, excess, satisfied=False)
        if (np.abs(excess) <= small + cancelled).all():
            if z.any():  # from z = 0, this step would press open nodes by rounding
                # one more step, kept if it reduces the residual: the residual times the
                # multipliers c enters the energy of every later step
                step = newton(x, excess, ROUNDING)
                last = at(z + step)[2]
                if _dot(last, last) < _dot(excess, excess):
                    z, excess = z + step, last
            return ConstrainedProjection(z, excess, bool((np.abs(excess) <= small).all()))
        # phi(0) = 0, and phi is convex: phi(z) <= z'g
        if -_dot(z, excess) > depth:
            return ConstrainedProjection(z, excess, satisfied=False, unbounded=True)
        step = newton(x, excess, damping)
        slope, curvature = _dot(step, excess), _dot(step, agreed(majorant @ step))
        part, moved = 1.0, at(z + step)
        # the slope grows along the step: `low` is the longest part known to be too short, `high`
        # the shortest part known to be too long
        low, below, high, above, root = 0.0, slope, 1.0, 0.0, 0.0
        for attempt in range(MOST_STEPS):
            after = _dot(step, moved[2])
            gained = max(OVERSHOOT * slope**2 / curvature, -OVERSHOOT * low * below)
            if (part - low) * after > gained:
                if above > after:  # where the secant of the slope reaches half of `SLOPE_LEFT`
                    incline = (above - after) / (high - part)
                    root = part - (after - 0.5 * SLOPE_LEFT * slope) / incline
                high, above = part, after
            elif part == 1.0 or after >= SLOPE_LEFT * slope:
                break
            else:
                low, below = part, after
            if low == 0.0:
                part = min(slope / (slope - after), 0.5) * part
            else:  # kinks of the slope may be at parts of any order of magnitude
                part = root if attempt % 2 and low < root < high else float(np.sqrt(low * high))
            moved = at(z + part * step)
        else:
            return ConstrainedProjection(z, excess, satisfied=False)
        z = z + part * step
        x, p, excess = moved
        if part < 1.0:
            damping = min(damping / part, LARGEST_DAMPING)
        else:
            damping = max(RELAXATION * damping, LEAST_DAMPING)
    return ConstrainedProjection(z, excess, satisfied=False)


def _scaled(matrix: Array | csc_array, scale: Array) -> Array | csc_array:
    """Return a symmetric matrix with its rows and columns multiplied by a scale (k,).

    The values of a sparse matrix are overwritten; a dense matrix is copied.
    """
    if isinstance(matrix, np.ndarray):
        return matrix * scale[:, None] * scale
    matrix.data *= scale[matrix.indices] * np.repeat(scale, np.diff(matrix.indptr))
    return matrix


def _damped_solution(matrix: Array | csc_array, right: Array, damping: float) -> Array:
    """Return (M + d I)^-1 b for M >= 0; d is increased until the factorisation exists."""
    diagonal = matrix.diagonal()
    while True:
        damped = matrix.copy()
        if isinstance(damped, np.ndarray):
            np.fill_diagonal(damped, diagonal + damping)
        else:
            damped.setdiag(diagonal + damping)
        solve = factored(damped)
        if solve is not None:
            x = solve(right)
            if _dot(x, right) >= 0.0:  # else rounding made a pivot negative
                return x
        if not np.isfinite(damped.sum()):  # no damping makes it finite
            raise np.linalg.LinAlgError("the Hessian of a projection is not finite")
        damping *= MORE_DAMPING


def _dot(x: Array, y: Array) -> float:
    """Return x'y, summed in a fixed order, so that ranks on different processors agree."""
    return float(np.cumsum(x * y)[-1])
