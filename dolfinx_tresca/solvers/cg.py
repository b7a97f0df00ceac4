"""Conjugate gradients on a face of Lambda: plain, preconditioned, and stopped at the boundary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.solvers.problem import DualProblem


@dataclass(frozen=True)
class FaceSolution:
    """The end of a CG run.

    Attributes:
        step: s, along the face.
        product: A s (all rows, also off the face), from the recurrence.
    """

    step: Array
    product: Array


def conjugate_gradients(
    problem: DualProblem,
    project: Callable[[Array], Array],
    gradient: Array,
    tolerance: float,
    *,
    stiffness: Array | None = None,
    precondition: Callable[[Array], Array] | None = None,
    feasible: Callable[[Array], bool] | None = None,
    record: Callable[[Array, Array], None] | None = None,
    most: int = 1000,
) -> FaceSolution:
    """Solve P (A + C) P s = -P gradient for s along a face.

    Collective.

    Args:
        problem: gives A and the inner product.
        project: P, the orthogonal projection onto the directions along the face.
        gradient: (size,) r at s = 0.
        tolerance: stop when |P (r + (A + C) s)| is at most this.
        stiffness: (size,) the diagonal C >= 0; none: zero.
        precondition: approximate inverse of P (A + C) P, applied to vectors along the face.
        feasible: whether the iterate with this s lies in Lambda, the same answer on all ranks.
            The loop ends before the first iterate that does not (CGM_feas).
        record: is told each search direction p and its product A p.
        most: limit on the number of products.
    """
    step = np.zeros_like(gradient)
    product = np.zeros_like(gradient)
    residual = -project(gradient)
    direction = np.zeros_like(gradient)
    rz_before = np.inf
    for _ in range(most):
        if float(np.sqrt(problem.inner(residual, residual))) <= tolerance:
            break
        z = residual if precondition is None else precondition(residual)
        rz = float(problem.inner(residual, z))
        direction = z + (rz / rz_before) * direction
        rz_before = rz
        applied = problem.apply(direction)
        if record is not None:
            record(direction, applied)
        image = applied if stiffness is None else applied + stiffness * direction
        curvature = float(problem.inner(direction, image))
        if curvature <= 0.0:  # rounding only: A is positive definite
            break
        alpha = rz / curvature
        if feasible is not None and not feasible(step + alpha * direction):
            break
        step += alpha * direction
        product += alpha * applied
        residual -= alpha * project(image)
    return FaceSolution(step, product)
