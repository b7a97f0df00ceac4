"""Fixed points of Coulomb's law with the model of A, by Newton's method and by continuation."""

from __future__ import annotations

import dataclasses

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.patience import IDLE_STEPS, MOST_STEPS, PROGRESS
from dolfinx_tresca.optimise.models.model import Model
from dolfinx_tresca.optimise.newton.face_newton import FaceNewton, Point
from dolfinx_tresca.optimise.problem import DualProblem

#: First and least step of the factor on the coefficients of friction, which goes from 0 to 1.
FIRST_PART, LEAST_PART = 0.25, 1.0 / 64.0

#: Limit on the number of halvings of a Newton step that does not reduce the residual.
MOST_HALVINGS = 5

#: The softness of the constraints is multiplied by `SOFTER` after a step of which no part reduces
#: the residual, and divided by `SOFTER` after a step that reduces the residual to less than
#: `GOOD_STEP` times its value.
SOFTER, GOOD_STEP = 3.0, 0.5

#: For each run of Newton's method: the softness of the constraints in its first step, divided by
#: the least softness, and the factor that takes the place of `SOFTER`. Without the second run, one
#: of 216 standing piles (`tests/validation/test_random_piles.py`) is not solved, and the others
#: take twice the time. Without the third run, one of the piles and a tilted wall of 20 bricks
#: (`tests/validation/test_many_bodies.py`) are not solved. If the third run comes first, the push
#: of 2,046 bricks takes six times the time, but a push of 1,025 bricks with F = 0.4 takes a sixth
#: of the time.
RUNS = (1.0, SOFTER), (100.0, SOFTER), (0.0, 1.0)

#: The runs from a start that is nearly a fixed point: the run with exact constraints comes first.
#: In the order of `RUNS`, an arch whose springings slide ends with NO_FIXED_POINT
#: (`tests/validation/test_arch.py`, F = 0.39).
REFINING_RUNS = RUNS[2], *RUNS[:2]

#: Multipliers, multipliers of the constraints, and gradient.
Iterate = tuple[Array, Array, Array]


def along_friction(
    problem: DualProblem,
    model: Model,
    start: Point,
    rho: float,
    tolerance: float,
) -> Point:
    """Follow the fixed points from zero friction to the given coefficients of friction.

    The step of the coefficients is halved if Newton's method fails, and doubled if it converges.
    Artificial springs hold bodies that the reduced friction cannot hold; the stiffness of the
    springs goes to zero as friction reaches its full value. Collective. Needs no product with A.

    Args:
        problem: the dual problem, with friction cones and constraints.
        model: model M of A.
        start: the solution without friction.
        rho: step length with which the natural residual is measured.
        tolerance: requested natural residual.

    Returns:
        the end of the path; if it was not reached, the last point, with the residual inf.
    """
    no_force = np.zeros_like(start.c)
    point, part, step = start, 0.0, FIRST_PART
    while step >= LEAST_PART and part < 1.0:
        now = min(part + step, 1.0)
        weaker = problem.relaxed(now, (1.0 - now) * rho, no_force)
        found = nearest_fixed_point(FaceNewton(weaker, model, rho), point, tolerance)
        if found.residual > tolerance:
            step *= 0.5
        else:
            point, part, step = found, now, 2.0 * step
    return point if part == 1.0 else dataclasses.replace(point, residual=float("inf"))


def nearest_fixed_point(
    newton: FaceNewton, start: Point, tolerance: float, *, refine: bool = False
) -> Point:
    """Return the iterate with the least residual of up to three runs of Newton's method.

    The method begins with softened constraints and softens them further after each step that fails,
    as in the method of Levenberg and Marquardt. If this does not converge, a second run begins with
    softer constraints. In a third run, the constraints are exact until a step fails, and softened
    by a constant from then on. If the model has no softness, there is one run, with exact
    constraints.

    Args:
        newton: Newton's method on the faces, with its problem.
        start: initial guess.
        tolerance: requested natural residual.
        refine: whether the start is nearly a fixed point: the third run then comes first.
    """
    least, found = newton.proximal_softness, []
    for part, growth in REFINING_RUNS if refine else RUNS:
        found.append(_nearest_fixed_point(newton, start, tolerance, part * least, growth))
        if found[-1].residual <= tolerance or least == 0.0:
            break
    return min(found, key=lambda point: point.residual)


def _nearest_fixed_point(
    newton: FaceNewton, start: Point, tolerance: float, softness: float, growth: float
) -> Point:
    """Return the iterate with the least residual of one run of Newton's method.

    A step is shortened if it does not reduce the residual. If no part of the step reduces the
    residual, contact on this face may hold some bodies only weakly, or not at all. With exact
    constraints, the step is then repeated with softened constraints. With softened constraints, the
    part of the step with the least residual is taken.

    Args:
        newton: Newton's method on the faces, with its problem.
        start: initial guess.
        tolerance: requested natural residual.
        softness: softness of the constraints in the first step.
        growth: factor by which the softness is multiplied after a step that fails, and divided
            after a step that reduces the residual to less than `GOOD_STEP` times its value.
    """
    best = at = newton.point_without_constraints(start.multipliers, start.c, start.gradient)
    iterate = at.multipliers, at.c, at.gradient
    least, idle = newton.proximal_softness, 0
    for _ in range(MOST_STEPS):
        if best.residual <= tolerance or idle == IDLE_STEPS:
            break
        before, end = at.residual, newton.step(*iterate, softness)
        reached, there = _part_of_step(newton, iterate, end, before)
        if there.residual > before and softness < least:
            softness = least
            continue
        iterate, at = reached, there
        if at.residual > before:
            softness *= growth
        elif at.residual < GOOD_STEP * before and softness > least:
            softness = max(softness / growth, least)
        idle = 0 if at.residual < PROGRESS * best.residual else idle + 1
        best = min(best, at, key=lambda point: point.residual)
    return best


def _part_of_step(
    newton: FaceNewton, start: Iterate, end: Iterate, residual: float
) -> tuple[Iterate, Point]:
    """Return the end of a part of a step, and this end projected onto the cones. Collective.

    The projection is `FaceNewton.point_without_constraints`, which need not satisfy the equality
    constraints. The whole step, its half, its quarter and so on are tried until one reduces the
    residual; if none does, the part with the least residual is returned.

    Args:
        newton: Newton's method on the faces, with its problem.
        start: multipliers, multipliers of the constraints, and gradient at the start.
        end: the same three arrays at the end of the step; the gradient is linear between start and
            end.
        residual: residual at the start.
    """
    found: list[tuple[Iterate, Point]] = []
    for halvings in range(MOST_HALVINGS + 1):
        z, c, r = (a + 0.5**halvings * (b - a) for a, b in zip(start, end, strict=True))
        found.append(((z, c, r), newton.point_without_constraints(z, c, r)))
        if found[-1][1].residual < PROGRESS * residual:
            return found[-1]
    return min(found, key=lambda one: one[1].residual)
