"""Fixed points on the model of A: by Newton's method, and along paths of problems."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from dolfinx_tresca.optimise.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.face_newton import FaceNewton, Point
from dolfinx_tresca.optimise.problem import DualProblem

#: Newton steps on the model from one start at the most, and how many in a row may bring the
#: residual no further than to the part that counts as progress.
MOST_STEPS, IDLE_STEPS, PROGRESS = 30, 5, 0.9

#: First and least step along a path, of which the whole is 1.
FIRST_PART, LEAST_PART = 0.25, 1.0 / 64.0

#: From the part of a path, and the point reached, to Newton's method there and where it starts.
Ahead = Callable[[float, float, Point], tuple[FaceNewton, Point]]


def along_load(
    problem: DualProblem, model: BlockBFGSModel, start: Point, rho: float, tolerance: float
) -> Point:
    """Return where the fixed points of loads on the way to the present one lead.

    The first load is the one next to it for which the start is a fixed point: from the last load
    step that is the path of the process. Newton's method cycles where many nodes change between
    stick and slip at once, as on a belt that is pulled round a drum; along the path few do.

    Collective. Needs no product with A.

    Args:
        problem: the cones and the inner product.
        model: M.
        start: in the cones; its residual does not matter.
        rho: step length with which the natural residual is measured.
        tolerance: wanted natural residual.

    Returns:
        the end of the path; where it was not reached, the last point, with the residual inf.
    """
    x, constraints = start.multipliers, problem.constraints
    at_rest = problem.admissible.section(x).gradient_at_rest(x, start.gradient)
    change = start.gradient - at_rest
    missing = constraints.residual(x, start.c)

    def ahead(part: float, now: float, point: Point) -> tuple[FaceNewton, Point]:
        loaded = dataclasses.replace(point, gradient=point.gradient + (now - part) * change)
        less = constraints.with_less((1.0 - now) * missing)
        return FaceNewton(problem, model, rho, less), loaded

    return _along(ahead, dataclasses.replace(start, gradient=at_rest), tolerance)


def along_friction(
    problem: DualProblem, model: BlockBFGSModel, start: Point, rho: float, tolerance: float
) -> Point:
    """Return where the fixed points of smaller coefficients of friction lead.

    Artificial springs hold bodies that the reduced friction cannot hold; their stiffness goes to
    zero as friction reaches its full value. Arguments and result are as in `along_load`; the start
    is the solution without friction. Collective.
    """
    at_rest = np.zeros_like(start.c)

    def ahead(part: float, now: float, point: Point) -> tuple[FaceNewton, Point]:
        return FaceNewton(problem.relaxed(now, (1.0 - now) * rho, at_rest), model, rho), point

    return _along(ahead, start, tolerance)


def _along(ahead: Ahead, start: Point, tolerance: float) -> Point:
    """Return the end of a path, with steps as long as Newton's method can do; else residual inf."""
    point, part, step = start, 0.0, FIRST_PART
    while step >= LEAST_PART and part < 1.0:
        now = min(part + step, 1.0)
        found = nearest_fixed_point(*ahead(part, now, point), tolerance)
        if found.residual > tolerance:
            step *= 0.5
        else:
            point, part, step = found, now, 2.0 * step
    return point if part == 1.0 else dataclasses.replace(point, residual=float("inf"))


def nearest_fixed_point(newton: FaceNewton, start: Point, tolerance: float) -> Point:
    """Return the iterate of Newton's method with the least residual.

    With equality constraints Newton's method cycles more often. There a second run projects each
    iterate onto the friction cones.
    """
    best = _newton(newton, start, tolerance, confined=False)
    if best.residual <= tolerance or len(start.c) == 0:
        return best
    other = _newton(newton, start, tolerance, confined=True)
    return min(best, other, key=lambda point: point.residual)


def _newton(newton: FaceNewton, start: Point, tolerance: float, confined: bool) -> Point:
    """Return the iterate with the least residual; `confined` projects iterates onto the cones."""
    best = newton.point_without_constraints(start.multipliers, start.c, start.gradient)
    z, c, r = best.multipliers, best.c, best.gradient
    idle = 0
    for _ in range(MOST_STEPS):
        if best.residual <= tolerance or idle == IDLE_STEPS:
            break
        z, c, r = newton.step(z, c, r)
        at = newton.point_without_constraints(z, c, r)
        if confined:
            z, r = at.multipliers, at.gradient
        idle = 0 if at.residual < PROGRESS * best.residual else idle + 1
        best = min(best, at, key=lambda point: point.residual)
    return best
