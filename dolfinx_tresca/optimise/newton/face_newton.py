"""Newton's method on the faces of Lambda, for the model of A."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.patience import IDLE_STEPS, MOST_STEPS, PROGRESS
from dolfinx_tresca.optimise.models.model import Model
from dolfinx_tresca.optimise.newton.interior_point import central_path
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.reductions import norm

#: Product of the step length rho in the active sets (38.12), (38.13) and the diagonal D of the
#: model. With the value 1, each node would take the state that minimises q for fixed multipliers of
#: the other nodes; with a smaller value, nodes change their states less often.
RHO_DIAGONAL = 0.2

#: A point whose natural residual is at most this fraction of the tolerance is accepted even if the
#: model of q has not decreased. With twice the value, no number of products of
#: benchmarks/ablation.py changes; with 0.1, a cube held by springs with 1e-6 of its stiffness takes
#: 160 products in place of 20.
GOOD_ENOUGH = 1e-2


@dataclass(frozen=True)
class Point:
    """Feasible multipliers, multipliers c of the constraints, gradient and natural residual.

    The gradient includes the term -G c of the constraints.
    """

    multipliers: Array
    c: Array
    gradient: Array
    residual: float


class FaceNewton:
    """Newton's method on the faces of Lambda, or of the sections of cones, for the model of A.

    On a face, the multipliers of slipping nodes only move along the circles that bound their
    friction discs. At the solution on the face, slipping nodes satisfy r + kappa lambda = 0 with
    kappa = |r| / g, where g is the slip bound. Hence

        (P M P + diag(kappa)) s = -P r

    is the exact Newton system of the face, with the projector P onto the face and the model M of A.
    The system is symmetric and positive definite; equality constraints add rows and columns. The
    convergence is quadratic once the active sets no longer change (docs/theory/algorithms.md). If
    slip bounds grow with the pressure, the multiplier of a slipping node also moves outwards with
    its pressure: s is replaced by P s + Q s on the left-hand side, where Q contains the slope of g.
    The number of equations and the cost stay the same, but the system is no longer symmetric. If g
    also depends on the slip v, which is the component of -r along the radius of the disc, the
    radial component of s solves s = Q s + h (change of v) with the slope h = dg/dv. Steps may leave
    Lambda: a multiplier outside Lambda changes the active sets of the next step.

    Methods are collective, and need no product with A.
    """

    def __init__(
        self,
        problem: DualProblem,
        model: Model,
        rho: float,
    ) -> None:
        """Prepare steps.

        Args:
            problem: admissible multipliers, constraints and inner product.
            model: model M of A.
            rho: step length with which natural residuals are measured.
        """
        self._problem, self._model, self._rho = problem, model, rho
        self._size = problem.feasible_set.mean_over_discs(model.size)

    def point(self, z: Array, c: Array, r: Array) -> Point:
        """Return the projection of multipliers z onto cones and constraints, with its residual.

        The multipliers c of the constraints and the gradient r are given at z. The result contains
        their values at the projection.
        """
        admissible, constraints = self._problem.admissible, self._problem.constraints
        G, rho = constraints.columns, self._rho
        # Open nodes stay open unless c closes them. Otherwise rounding of c would cause pressures
        # at open nodes, and the work of these pressures across a wide gap would exceed the work of
        # small loads.
        normal = self._problem.feasible_set.normal
        slack = np.zeros_like(z)
        slack[normal] = np.where(z[normal] > 0.0, 0.0, rho * np.maximum(r[normal], 0.0))
        projected, step_c = constraints.project(admissible, z - slack, c, rho)
        c, r = c + step_c, r + self._model.apply(projected - z) - G @ step_c
        lam = admissible.section(projected)
        moved, step_c = constraints.project(lam, projected - rho * r, c, rho)
        residual = norm(self._problem, projected - moved) / rho
        return Point(projected, c + step_c, r - G @ step_c, residual)

    def point_without_constraints(self, z: Array, c: Array, r: Array) -> Point:
        """Return the projection of multipliers z onto the friction cones only, with its residual.

        The residual contains the residual of the constraints. This function costs less than
        `point`, which projects onto the constraints as well. Unlike `point`, it does not require
        that the section of z contains a point that satisfies the constraints.
        """
        admissible, constraints = self._problem.admissible, self._problem.constraints
        projected = admissible.at(z, r, self._rho).project(z)
        r = r + self._model.apply(projected - z)
        lam = admissible.at(projected, r, self._rho).section(projected)
        moved = lam.project(projected - self._rho * r)
        missing = np.linalg.norm(constraints.residual(projected, c))
        residual = float(np.hypot(norm(self._problem, projected - moved), missing)) / self._rho
        return Point(projected, c, r, residual)

    @property
    def proximal_softness(self) -> float:
        """Softness to add to the constraints after a step that failed; 0: none.

        The softness keeps steps short on faces whose system is nearly singular.
        """
        return self._model.proximal_softness

    def step(
        self, z: Array, c: Array, r: Array, softness: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Return the end of a Newton step on a face, with c and the gradient at the end.

        The active sets are those of the point that a gradient step from z reaches.

        Args:
            z: (size,) multipliers.
            c: (k,) multipliers of the constraints.
            r: (size,) gradient at z.
            softness: softness that is added to the constraints, but acts on the step in c only, as
                in a proximal point method: solutions of the problem remain solutions.
        """
        model, constraints = self._model, self._problem.constraints
        rho = np.asarray(RHO_DIAGONAL / self._size, dtype=np.float64)
        admissible = self._problem.admissible.at(z, r, rho)
        lam = admissible.section(z)
        face = lam.face(z - rho * r)
        settled = lam.on_face(z, face)
        r = r + model.apply(settled - z)
        step, step_c = model.solve_on(
            face,
            lam.circle_stiffness(r, face),
            -r - admissible.slip_along(face),
            constraints.columns,
            constraints.softened(softness, c).softness,
            constraints.residual(settled, c),
            admissible.with_bound_change(settled, face, model.diagonal),
        )
        end = settled + step
        if admissible.has_curves:
            at_end = r + model.apply(step) - constraints.columns @ step_c
            admissible = admissible.at(end, at_end, rho)
        moved = admissible.section(end).to_circle(end, face)
        return moved, c + step_c, r + model.apply(moved - settled) - constraints.columns @ step_c


def from_face_to_face(newton: FaceNewton, start: Point, good: Callable[[Point], bool]) -> Point:
    """Return the iterate of Newton's method on faces with the least residual. Collective.

    Args:
        newton: Newton's method on the faces, with its problem.
        start: first point.
        good: whether a point is accurate enough.
    """
    best = start
    z, c, r = start.multipliers, start.c, start.gradient
    # the first step may increase the residual: progress is counted from the end of this step
    idle, least = 0, float("inf")
    for _ in range(MOST_STEPS):
        z, c, r = newton.step(z, c, r)
        candidate = newton.point(z, c, r)
        idle = 0 if candidate.residual < PROGRESS * least else idle + 1
        least = min(least, candidate.residual)
        best = min(best, candidate, key=lambda point: point.residual)
        if good(best) or idle == IDLE_STEPS:
            break
    return best


def minimise(
    problem: DualProblem,
    model: Model,
    multipliers: Array,
    gradient: Array,
    rho: float,
    tolerance: float,
) -> Array:
    """Return an approximate minimiser in Lambda of the model of q.

    The model is gradient'd + 1/2 d'M d with the step d from `multipliers`. If the active sets of
    Newton's method do not settle, an interior-point method (`interior_point`) provides other
    starting points, from which they settle. Near the minimiser, the points of the interior-point
    method are less accurate than the initial guess: a strip of 150 nodes that is pulled to and fro
    ends with STAGNATED if the interior-point method takes over after two idle steps.

    Collective. Needs no product with A.

    Args:
        problem: Lambda and the inner product.
        model: model M of A.
        multipliers: (size,) point of Lambda.
        gradient: (size,) gradient at this point.
        rho: step length with which the natural residual is measured.
        tolerance: requested natural residual.
    """
    constraints = problem.constraints
    G, newton = constraints.columns, FaceNewton(problem, model, rho)

    def energy(at: Point) -> float:
        """Return the model of q minus its value at the start."""
        step = at.multipliers - multipliers
        change = 0.5 * float(problem.inner(step, at.gradient + G @ at.c + gradient))
        soft = constraints.slope(multipliers, step) + 0.5 * constraints.curvature(step)
        return change + soft

    def good(at: Point) -> bool:
        """Return whether a point is accurate enough, and the model of q decreased."""
        return at.residual <= tolerance and (
            energy(at) < 0.0 or at.residual <= GOOD_ENOUGH * tolerance
        )

    start = newton.point(multipliers, np.zeros(len(constraints)), gradient)
    best = from_face_to_face(newton, start, good)
    if good(best):
        return best.multipliers
    best = min(best, start, key=energy)
    path = central_path(problem, model, multipliers, gradient)
    for inside in islice(path, MOST_STEPS):
        candidate = newton.point(*newton.step(inside.multipliers, inside.c, inside.gradient))
        if energy(candidate) < energy(best):
            best = candidate
        if good(candidate):
            return candidate.multipliers
    return best.multipliers
