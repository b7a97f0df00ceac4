"""SSN: the semi-smooth Newton method without symmetrisation. BiCGSTAB solves its linear systems."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.paper.precision import AdaptivePrecision
from dolfinx_tresca.optimise.paper.start import begin
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.history import Observe, gradient
from dolfinx_tresca.options import SolverOptions


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Solve lambda = P(lambda - rho r(lambda)) by Newton steps with the full slanting function.

    The full derivative of the projection onto the circle makes the systems non-symmetric. Table
    38.1 of the paper compares its methods with this variant. Convergence is not guaranteed.

    Collective.
    """
    feasible_set = problem.feasible_set
    history, multipliers, r = begin(problem, start, options, observe)
    precision = AdaptivePrecision(history, options)
    while True:
        status, projected, r_projected = history.check_convergence_of_projection(multipliers, r)
        if status is not None:
            return history.solution(projected, r_projected, status)
        y = multipliers - history.residual.rho * r
        derivative = feasible_set.projection_derivative(y)

        def image(v: Array, derivative: Callable[[Array], Array] = derivative) -> Array:
            return v - derivative(v - history.residual.rho * problem.operator.apply(v))

        step = _bicgstab(
            problem,
            image,
            feasible_set.project(y) - multipliers,
            history.residual.rho * precision.next(),
        )
        multipliers = multipliers + step
        r = gradient(problem, multipliers)


def _bicgstab(
    problem: DualProblem,
    image: Callable[[Array], Array],
    right: Array,
    tolerance: float,
    most: int = 500,
) -> Array:
    """Return x with |right - image(x)| <= tolerance, or the best x of `most` steps."""
    x = np.zeros_like(right)
    residual = right.copy()
    shadow = right
    direction = residual
    shadow_residual = float(problem.inner(shadow, residual))
    best, best_norm = x, float(np.sqrt(problem.inner(right, right)))
    for _ in range(most):
        if best_norm <= tolerance or shadow_residual == 0.0:
            break
        v = image(direction)
        denominator = float(problem.inner(shadow, v))
        if denominator == 0.0:
            break
        alpha = shadow_residual / denominator
        half = residual - alpha * v
        t = image(half)
        tt = float(problem.inner(t, t))
        omega = float(problem.inner(t, half)) / tt if tt > 0.0 else 0.0
        x = x + alpha * direction + omega * half
        residual = half - omega * t
        norm = float(np.sqrt(problem.inner(residual, residual)))
        if not np.isfinite(norm):
            break
        if norm < best_norm:
            best, best_norm = x, norm
        if omega == 0.0:
            break
        before, shadow_residual = shadow_residual, float(problem.inner(shadow, residual))
        direction = residual + (shadow_residual / before) * (alpha / omega) * (
            direction - omega * v
        )
    return best
