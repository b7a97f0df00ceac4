"""Newton's method on the faces of Lambda, for the model of A."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.solvers.problem import DualProblem
from dolfinx_tresca.solvers.recycling import RecycledModel

#: rho D in the sets (38.12), (38.13): small, so that a node leaves its set only when it must.
RHO_DIAGONAL = 0.2
#: Newton steps without much progress after which gradient steps set the iteration right.
PATIENCE = 2
#: What much progress is: the residual falls to this part.
PROGRESS = 0.7
#: Gradient steps in a row.
GRADIENT_STEPS = 10
#: Newton steps altogether.
MOST = 60


@dataclass(frozen=True)
class _Point:
    """A feasible point, the gradient there, and its natural residual."""

    multipliers: Array
    gradient: Array
    residual: float


def minimise(
    problem: DualProblem,
    model: RecycledModel,
    multipliers: Array,
    gradient: Array,
    rho: float,
    tolerance: float,
) -> Array:
    """Return a point of Lambda that nearly minimises the model of q.

    That is gradient'd + 1/2 d'M d, where d is the way there from `multipliers`.

    On a face the multipliers of slipping nodes move along their circle only. There the solution has
    r + kappa lambda = 0 with kappa = |r| / g, so that

        (P M P + diag(kappa)) s = -P r

    is the exact Newton system of the face, symmetric and positive definite, and the convergence is
    quadratic once the sets have settled (NUMERICS section 3). The steps are not confined to Lambda:
    a multiplier that leaves it tells that the sets must change. Where they do not settle, gradient
    projection steps, which always descend, bring the iteration back on course.

    Collective. Needs no product with A.

    Args:
        problem: Lambda and the inner product.
        model: M.
        multipliers: (size,) in Lambda.
        gradient: (size,) there.
        rho: step length with which the natural residual is measured.
        tolerance: wanted natural residual.
    """
    feasible_set = problem.feasible_set

    def point(z: Array, r: Array) -> _Point:
        """Project z onto Lambda."""
        projected = feasible_set.project(z)
        r = r + model.apply(projected - z)
        rest = projected - feasible_set.project(projected - rho * r)
        return _Point(projected, r, float(np.sqrt(problem.inner(rest, rest))) / rho)

    def energy(at: _Point) -> float:
        """Return what is minimised."""
        return 0.5 * float(problem.inner(at.multipliers - multipliers, at.gradient + gradient))

    best = current = point(multipliers, gradient)
    remaining = MOST
    while remaining > 0:
        z, r = current.multipliers, current.gradient
        best = current
        waited = 0
        while waited < PATIENCE and remaining > 0:
            remaining -= 1
            face = feasible_set.face(z - RHO_DIAGONAL / model.diagonal * r)
            settled = feasible_set.settle(z, face)
            r = r + model.apply(settled - z)
            stiffness = feasible_set.circle_stiffness(r, face)
            moved = feasible_set.to_circle(settled + model.solve_on(face, stiffness, -r), face)
            z, r = moved, r + model.apply(moved - settled)
            candidate = point(z, r)
            waited = 0 if candidate.residual < PROGRESS * best.residual else waited + 1
            if candidate.residual < best.residual:
                best = candidate
            if best.residual <= tolerance:
                return best.multipliers
        if energy(best) < energy(current):
            current = best
        z, r = current.multipliers, current.gradient
        for _ in range(GRADIENT_STEPS):
            moved = feasible_set.project(z - 0.5 * rho * r)
            z, r = moved, r + model.apply(moved - z)
        current = point(z, r)
        if current.residual <= tolerance:
            return current.multipliers
    return current.multipliers
