"""The projection onto Lambda under equality constraints. Numpy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, eye_array

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.constraint_matrix import ConstraintMatrix
from dolfinx_tresca.optimise.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.friction_cones import FrictionCones
from dolfinx_tresca.optimise.positive_definite import factored

#: Newton steps at most, and cuts of one of them; ten are many.
MOST_STEPS = 100

EPS = float(np.finfo(float).eps)

#: What is left of an equation, over the sum of its terms' absolute values, that is rounding.
EXCESS_ROUNDING = 64 * EPS

#: What rounding of G z leaves of the equation, over its terms, from which on z tells nothing: it
#: goes to infinity where there is no solution, or none but on the boundary of Lambda.
LOST = 1e-6

#: Damping: the part of the diagonal of the majorant G'G + C that is added to the Hessian at first,
#: at least, at most.
DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 1e-4, 1e-16, 1.0

#: Factor on the damping after a whole step: where phi is flat the next one may be longer; and where
#: the matrix is not positive definite to rounding.
RELAXATION, MORE_DAMPING = 1e-3, 10.0

#: Number of equations from which on sparse matrices are faster than dense ones.
MANY = 100

#: Part of the guaranteed descent up to which a step may have gone too far, and part of the slope
#: that may be left where a step was cut.
OVERSHOOT, SLOPE_LEFT = 0.25, 0.5


@dataclass(frozen=True)
class ConstrainedProjection:
    """The result of `constrained_projection`.

    Attributes:
        shift: (k,) z.
        excess: (k,) what is left of the equation.
        satisfied: whether that is rounding in the equation's terms; what rounding of G z leaves is
            more, and may hide that there is no solution.
        unbounded: whether the function fell below its bound.
    """

    shift: Array
    excess: Array
    satisfied: bool
    unbounded: bool = False


def constrained_projection(
    feasible_set: FeasibleSet | FrictionCones,
    matrix: ConstraintMatrix,
    softness: Array,
    y: Array,
    target: Array,
    sizes: Array,
    depth: float = np.inf,
) -> ConstrainedProjection:
    """Return z with G'P(y + G z) + C z = target, where P projects onto Lambda. Collective.

    It minimises the convex function

        phi(z) = 1/2 |x|^2 - 1/2 |x - P(x)|^2 + 1/2 z'C z - z'target,    x = y + G z,

    whose gradient g is what is left of the equation: by Newton's method, with a damping that lets
    it leave regions where phi is flat, for nothing presses there, by steps that grow until it does.
    phi is nowhere more curved than G'G + C; so a step s, of which a part t leads to a point with
    t s'g(t) <= (s'g(0))^2 / (4 s'(G'G + C) s), descends by as much at least. That is all that
    convergence needs, and it is judged by gradients: values of phi differ by rounding near the end.

    Args:
        feasible_set: Lambda.
        matrix: G (size, k).
        softness: (k, k) C, symmetric and positive semidefinite.
        y: (size,).
        target: (k,).
        sizes: (k,) of what target is the sum of.
        depth: with y = 0 end where phi is below -depth. Any x in Lambda and c that solve the
            equation would have |x|^2 + c'C c > 2 depth (weak duality).
    """
    inner, agreed = matrix.reductions.inner, matrix.reductions.from_first_rank
    G, lengths = matrix.sparse, matrix.absolute
    product, identity = inner, np.eye(len(target))
    if len(target) >= MANY:
        product, identity = matrix.reductions.sparse_inner, eye_array(len(target))
        softness = csr_array(softness)
    majorant = matrix.gram + softness
    scale = 1.0 / np.sqrt(majorant.diagonal())
    floor = EXCESS_ROUNDING * (inner(lengths, np.abs(y)) + sizes)

    def at(z: Array) -> tuple[Array, Array, Array]:
        x = y + G @ z
        p = feasible_set.project(x)
        return x, p, agreed(inner(G, p) + softness @ z - target)

    def rounding(z: Array, p: Array) -> tuple[Array, Array]:
        """Return what it leaves of the equation (k,): in its terms and y, and in G z."""
        terms = inner(lengths, np.abs(p)) + abs(softness) @ np.abs(z)
        cancelled = inner(lengths, np.where(p != 0.0, lengths @ np.abs(z), 0.0))
        return agreed(EXCESS_ROUNDING * terms + floor), agreed(EPS * cancelled)

    def newton(x: Array, excess: Array, damping: float) -> Array:
        hessian = product(G, feasible_set.projection_jacobian(x) @ G) + softness
        scaled = hessian * scale[:, None] * scale
        return -agreed(scale * _damped_solution(scaled, identity, scale * excess, damping))

    z, damping = np.zeros_like(target), DAMPING
    x, p, excess = at(z)
    for _ in range(MOST_STEPS):
        small, cancelled = rounding(z, p)
        if EXCESS_ROUNDING * cancelled.max() > LOST * small.max():
            return ConstrainedProjection(z, excess, satisfied=False)
        if (np.abs(excess) <= small + cancelled).all():
            if z.any():  # from z = 0 rounding would press nodes that are open
                # one more step, kept if it leaves less: times the multipliers c, what is left of
                # the equation adds to the energy of every step that follows
                step = newton(x, excess, EXCESS_ROUNDING)
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
        # the slope grows along the step: from parts that are too short to ones that are too long
        low, below, high, above, root = 0.0, slope, 1.0, 0.0, 0.0
        for attempt in range(MOST_STEPS):
            after = _dot(step, moved[2])
            gained = max(OVERSHOOT * slope**2 / curvature, -OVERSHOOT * low * below)
            if (part - low) * after > gained:
                if above > after:  # where the line through the last two has a part of the slope
                    incline = (above - after) / (high - part)
                    root = part - (after - 0.5 * SLOPE_LEFT * slope) / incline
                high, above = part, after
            elif part == 1.0 or after >= SLOPE_LEFT * slope:
                break
            else:
                low, below = part, after
            if low == 0.0:
                part = min(slope / (slope - after), 0.5) * part
            else:  # kinks may be at any distance
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


def _damped_solution(
    matrix: Array | csr_array, identity: Array | csr_array, right: Array, damping: float
) -> Array:
    """Return (M + d I)^-1 b for a positive semidefinite M, and more damping if rounding asks it."""
    while True:
        damped = matrix + damping * identity
        solve = factored(damped)
        if solve is not None:
            x = solve(right)
            if _dot(x, right) >= 0.0:  # sparse factors do not tell when rounding turns a pivot
                return x
        if not np.isfinite(damped.sum()):  # no damping cures that
            raise np.linalg.LinAlgError("the Hessian of a projection is not finite")
        damping *= MORE_DAMPING


def _dot(x: Array, y: Array) -> float:
    """Return x'y, summed one after the other: the same on ranks whose processors differ."""
    return float(np.cumsum(x * y)[-1])
