"""Conjugate gradients on the free multipliers, and CGM_feas, which ends before it leaves Lambda."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.optimise.problem import DualProblem


@dataclass(frozen=True)
class FaceSolution:
    """The end of a CG run.

    Attributes:
        step: (size,) s, zero where multipliers are not free.
        product: (size,) A s in all rows, from the recurrence.
    """

    step: Array
    product: Array


def conjugate_gradients(
    problem: DualProblem,
    free: Mask,
    gradient: Array,
    tolerance: float,
    *,
    feasible: Callable[[Array], bool] | None = None,
    most: int = 1000,
) -> FaceSolution:
    """Minimise q over steps s of the free multipliers, (38.14).

    Collective. The result does not say which of the limits ended the iteration: the caller judges
    the step.

    Args:
        problem: the dual problem (38.4), for A and the inner product.
        free: (size,) True for multipliers that may change.
        gradient: (size,) r at s = 0.
        tolerance: norm of r + A s in the free rows at which the iteration ends.
        feasible: function that returns whether the multipliers after a step s lie in Lambda, with
            the same result on all ranks. The iteration ends before the first step that leaves
            Lambda (CGM_feas).
        most: limit on the number of products.
    """
    step = np.zeros_like(gradient)
    product = np.zeros_like(gradient)
    residual = np.where(free, -gradient, 0.0)
    direction = np.zeros_like(gradient)
    squared = float(problem.inner(residual, residual))
    before = np.inf
    for _ in range(most):
        if np.sqrt(squared) <= tolerance:
            break
        direction = residual + (squared / before) * direction
        image = problem.operator.apply(direction)
        curvature = float(problem.inner(direction, image))
        if curvature <= 0.0:  # rounding only: A is positive definite
            break
        alpha = squared / curvature
        if feasible is not None and not feasible(step + alpha * direction):
            break
        step += alpha * direction
        product += alpha * image
        residual -= alpha * np.where(free, image, 0.0)
        before, squared = squared, float(problem.inner(residual, residual))
    return FaceSolution(step, product)
