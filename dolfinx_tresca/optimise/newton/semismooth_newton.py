"""The semismooth Newton method for the laws of contact and friction with a model of A."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.forcing import FORCING
from dolfinx_tresca._base.patience import PATIENCE, PROGRESS
from dolfinx_tresca.optimise.models.model import Model
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.record.residual import NaturalResidual
from dolfinx_tresca.optimise.record.slips import cones_at
from dolfinx_tresca.optimise.reductions import norm

#: Product of the step length rho in the active sets (38.12), (38.13) and the diagonal D of the
#: model. With the value 1, each node would take the state that minimises q for fixed multipliers of
#: the other nodes; with a smaller value, nodes change their states less often.
RHO_DIAGONAL = 0.2

#: Limit on the number of Newton steps. Twice the value serves no scene.
MOST_STEPS = 200

#: Limit on the number of halvings of a step that does not reduce the residual. With 5, four of 29
#: standing piles of stones (`scenes/pile.py`, seeds 0 to 59) are not solved.
MOST_HALVINGS = 10

#: The softness of the constraints is multiplied by `SOFTER` after a step of which no part reduces
#: the residual, and divided by `SOFTER` after a step that reduces the residual to less than
#: `GOOD_STEP` times its value.
SOFTER, GOOD_STEP = 3.0, 0.5

#: The model is solved more accurately while the natural residual of its solution exceeds this
#: fraction of the residual of the present point, and factor on the tolerance each time. (A wall of
#: 52 bricks is pushed in accepted steps. Some of the steps end with NO_FIXED_POINT both with 0.5
#: and with 0.03. With 0.1 in place of 0.01, the push of a wall of 1,025 bricks takes six times as
#: many Newton systems: the next run starts from the projection of a less accurate point.)
REDUCTION, REFINEMENT = 0.003, FORCING**2


@dataclass(frozen=True)
class NewtonPoint:
    """A point of Newton's method, and its projection onto the friction cones.

    Attributes:
        z: (size,) multipliers, which may lie outside Lambda.
        c: (k,) multipliers of the equality constraints.
        r: (size,) gradient M z - b - G c with the model M of A.
        multipliers: (size,) projection of z onto the friction cones.
        gradient: (size,) gradient at the projection.
        residual: natural residual of the projection, with the residual of the constraints.
    """

    z: Array
    c: Array
    r: Array
    multipliers: Array
    gradient: Array
    residual: float


class SemismoothNewton:
    """Newton's method for multipliers x and c of the contact problem with a model M of A.

    The equations are those of Alart and Curnier (1991), with the equilibrium of floating bodies:

        x = P_g(x - rho r),  r = M x - b - G c,  G'x + S c = e,

    where P_g projects onto the section of the friction cones at the pressures of x; for Tresca's
    law this is Lambda. A step takes the active sets (38.12), (38.13) of the point that a gradient
    step from x reaches. On this face, the multipliers of slipping nodes only move along the circles
    that bound their friction discs. At the solution on the face, slipping nodes satisfy
    r + kappa x = 0 with kappa = |r| / g, where g is the slip bound. Hence

        (P M P + diag(kappa)) s - P G c = -P r

    is the exact Newton system of the face, with the projector P onto the face. For Tresca's law the
    system is symmetric. The convergence is quadratic once the active sets no longer change
    (docs/theory/algorithms.md). If slip bounds grow with the pressure, the multiplier of a slipping
    node also moves outwards with its pressure: s is replaced by P s + Q s on the left-hand side,
    where Q contains the slope of g. If g also depends on the slip v, which is the component of -r
    along the radius of the disc, the radial component of s solves s = Q s + h (change of v) with
    the slope h = dg/dv.

    A step is halved until it reduces the residual. If no part of a step does, contact on this face
    holds some bodies only weakly, or not at all: then S is softened for the steps that follow, as
    in the method of Levenberg and Marquardt, and stiffened again after good steps.

    Methods are collective, and need no product with A.
    """

    def __init__(self, problem: DualProblem, model: Model, rho: float) -> None:
        """Prepare steps.

        Args:
            problem: admissible multipliers, constraints and inner product.
            model: model M of A.
            rho: step length with which natural residuals are measured.
        """
        self._problem, self._model, self._rho = problem, model, rho
        size = problem.feasible_set.mean_over_discs(model.size)
        self._step_lengths = np.asarray(RHO_DIAGONAL / size, dtype=np.float64)

    def point(self, z: Array, c: Array, r: Array) -> NewtonPoint:
        """Return the point with multipliers z (size,), c (k,) and the gradient r (size,) at z."""
        problem, rho = self._problem, self._rho
        projected = problem.admissible.at(z, r, rho).project(z)
        gradient = r + self._model.apply(projected - z)
        section = problem.admissible.at(projected, gradient, rho).section(projected)
        change = projected - section.project(projected - rho * gradient)
        unbalanced = np.linalg.norm(problem.constraints.residual(projected, c))
        residual = float(np.hypot(norm(problem, change), unbalanced)) / rho
        return NewtonPoint(z, c, r, projected, gradient, residual)

    def step(self, point: NewtonPoint, softness: float) -> tuple[Array, Array, Array]:
        """Return the changes of z, c and r by a whole Newton step from a point.

        Args:
            point: the point.
            softness: softness that is added to S for the change of c only, as in a proximal point
                method: solutions of the problem remain solutions.
        """
        problem, model, rho = self._problem, self._model, self._step_lengths
        constraints, z, c, r = problem.constraints, point.z, point.c, point.r
        admissible = problem.admissible.at(z, r, rho)
        section = admissible.section(z)
        face = section.face(z - rho * r)
        settled = section.on_face(z, face)
        r = r + model.apply(settled - z)
        change, change_c = model.solve_on(
            face,
            section.circle_stiffness(r, face),
            -r - admissible.slip_along(face),
            constraints.columns,
            constraints.softened(softness, c).softness,
            constraints.residual(settled, c),
            admissible.with_bound_change(settled, face, model.diagonal),
        )
        end = settled + change
        force = constraints.columns @ change_c
        if admissible.has_curves:
            admissible = admissible.at(end, r + model.apply(change) - force, rho)
        end = admissible.section(end).to_circle(end, face)
        return end - z, change_c, r + model.apply(end - settled) - force - point.r

    def solve(self, start: NewtonPoint, tolerance: float) -> NewtonPoint:
        """Return the point with the least residual; the method ends at the tolerance.

        Args:
            start: initial guess.
            tolerance: requested residual.
        """
        point = best = start
        least = softness = self._model.proximal_softness
        idle = 0
        for _ in range(MOST_STEPS):
            if best.residual <= tolerance or idle == PATIENCE:
                break
            before, point = point, self._part_of_step(point, softness)
            if point.residual > before.residual:
                softness *= SOFTER
            elif point.residual < GOOD_STEP * before.residual:
                softness = max(softness / SOFTER, least)
            idle = 0 if point.residual < PROGRESS * best.residual else idle + 1
            best = min(best, point, key=lambda candidate: candidate.residual)
        return best

    def _part_of_step(self, point: NewtonPoint, softness: float) -> NewtonPoint:
        """Return the end of the longest part 2^-n of a step that reduces the residual.

        If no part does, the end with the least residual is returned.
        """
        step = self.step(point, softness)
        trials = []
        for halvings in range(MOST_HALVINGS + 1):
            start = point.z, point.c, point.r
            trials.append(
                self.point(*(a + 0.5**halvings * b for a, b in zip(start, step, strict=True)))
            )
            if trials[-1].residual < PROGRESS * point.residual:
                break
        return min(trials, key=lambda trial: trial.residual)


def solve_model(
    problem: DualProblem,
    model: Model,
    multipliers: Array,
    gradient: Array,
    residual: NaturalResidual,
    tolerance: float,
) -> tuple[Array, NewtonPoint | None]:
    """Return multipliers that approximately solve the contact problem with a model of A.

    Newton's method measures the errors of the equilibrium, and of the laws of contact and friction,
    as two independent equations. The natural residual contains a projection that satisfies the
    equilibrium exactly. Where bodies slide as a whole, few tractions can satisfy the equilibrium,
    and the natural residual is a hundred times larger than the errors that Newton's method
    measures. The model is then solved more accurately, from the projected point; the natural
    residual decides which of the points is returned.

    Collective. Needs no product with A.

    Args:
        problem: the dual problem, with friction cones and constraints.
        model: model M of A.
        multipliers: (size,) point in the cones.
        gradient: (size,) gradient A x - b at this point.
        residual: the natural residual.
        tolerance: requested natural residual, with the slip bounds at the point itself.

    Returns:
        the multipliers (size,), which lie in the cones and satisfy the constraints; and None, or
        the last point of Newton's method if it has not reached the tolerance.
    """
    newton, rho = SemismoothNewton(problem, model, residual.rho), residual.rho
    constraints, rounding = problem.constraints, ROUNDING * norm(problem, problem.b)
    wanted = REDUCTION * residual.at(multipliers, gradient) if len(constraints) else np.inf
    result, least, x, r = multipliers, np.inf, multipliers, gradient
    while True:
        _, c = cones_at(problem, x, r, rho)
        point = newton.solve(newton.point(x, c, r - constraints.columns @ c), tolerance)
        missed = point.residual > max(tolerance, rounding)
        cones = problem.admissible.at(point.multipliers, point.gradient, rho)
        x = constraints.project(cones, point.multipliers, point.c, rho)[0]
        r = gradient + model.apply(x - multipliers)
        reached = residual.at(x, r)
        if reached < least:
            result, least = x, reached
        if missed or reached > least or least <= wanted or tolerance <= rounding:
            return result, point if missed else None
        tolerance *= REFINEMENT
