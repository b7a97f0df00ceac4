"""Newton's method on the faces of Lambda, for the model of A."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.solvers.problem import DualProblem
from dolfinx_tresca.solvers.recycling import RecycledModel

#: rho D in the sets (38.12), (38.13): small, so that a node leaves its set only when it must.
RHO_DIAGONAL = 0.2
#: The same for steps that stay inside of Lambda, and the part to which these are cut at most.
CLOSE, SHORTEST = 1e-3, 1e-3
#: Newton steps without much progress after which gradient steps set the iteration right.
PATIENCE = 2
#: What much progress is: the residual falls to this part.
PROGRESS = 0.7
#: Part of the wanted residual that is good enough even where the model of q does not fall.
FINEST = 1e-2
#: How often gradient steps may set the iteration right before steps stay inside of Lambda.
ROUNDS = 2
#: Gradient steps in a row.
GRADIENT_STEPS = 10
#: Newton steps altogether.
MOST = 60


@dataclass(frozen=True)
class _Point:
    """A feasible point, the rigid motions of loose bodies, the gradient, and natural residual."""

    multipliers: Array
    rigid: Array
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

    is the exact Newton system of the face (with rigid motions of loose bodies: bordered by the
    balance of their loads), symmetric and positive definite, and the convergence is
    quadratic once the sets have settled (NUMERICS section 3). The steps are not confined to Lambda:
    a multiplier that leaves it tells that the sets must change. Where they do not settle, gradient
    projection steps and Newton steps that end at the boundary, which always descend, bring the
    iteration back on course.

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
    jumps = feasible_set.rigid_jumps

    size = feasible_set.mean_over_discs(model.size)

    def point(z: Array, c: Array, r: Array) -> _Point:
        """Project z onto Lambda, with loads in balance, and let rigid motions c settle."""
        projected, by = feasible_set.project_balanced(z, c, rho)
        c, r = c + by, r + model.apply(projected - z) - jumps @ by
        moved, by = feasible_set.project_balanced(projected - rho * r, c, rho)
        rest = projected - moved
        residual = float(np.sqrt(problem.inner(rest, rest))) / rho
        return _Point(projected, c + by, r - jumps @ by, residual)

    def newton(
        z: Array, c: Array, r: Array, reach: float, inside: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Return where a Newton step on a face leads, and the gradient there.

        Nodes join the sets that they reach by a gradient step. If `inside` is positive the step is
        at most this part of the whole, and ends where the first of them would leave its set.
        """
        face = feasible_set.face(z - reach / size * r)
        settled = feasible_set.settle(z, face)
        r = r + model.apply(settled - z)
        step, by = model.solve_on(
            face,
            feasible_set.circle_stiffness(r, face),
            -r,
            jumps,
            feasible_set.rigid_stiffness,
            feasible_set.imbalance(settled, c),
        )
        if inside > 0.0:
            part = min(inside, problem.least(feasible_set.largest_part(settled, step, face)))
            step, by = part * step, part * by
        moved = feasible_set.to_circle(settled + step, face)
        return moved, c + by, r + model.apply(moved - settled) - jumps @ by

    def energy(at: _Point) -> float:
        """Return what is minimised."""
        way = at.multipliers - multipliers
        change = 0.5 * float(problem.inner(way, at.gradient + jumps @ at.rigid + gradient))
        springs = feasible_set.rigid_work(multipliers, way) + 0.5 * feasible_set.rigid_curvature(
            way
        )
        return change + springs

    def good(at: _Point) -> bool:
        """Whether to end here: a small residual does not imply that the model of q fell."""
        return at.residual <= tolerance and (energy(at) < 0.0 or at.residual <= FINEST * tolerance)

    best = current = point(multipliers, np.zeros(jumps.shape[1]), gradient)
    remaining, rounds = MOST, 0
    while remaining > 0:
        z, c, r = current.multipliers, current.rigid, current.gradient
        best = current
        waited = 0
        while waited < PATIENCE and remaining > 0:
            remaining -= 1
            z, c, r = newton(z, c, r, RHO_DIAGONAL)
            candidate = point(z, c, r)
            waited = 0 if candidate.residual < PROGRESS * best.residual else waited + 1
            if candidate.residual < best.residual:
                best = candidate
            if good(best):
                return best.multipliers
        if energy(best) < energy(current):
            current = best
        z, c, r = current.multipliers, current.rigid, current.gradient
        length = 0.5 * rho
        for _ in range(GRADIENT_STEPS):
            moved, by = feasible_set.project_balanced(z - length * r, c, length)
            way, change = moved - z, model.apply(moved - z)
            if problem.inner(way, change) * length > problem.inner(way, way):
                length *= 0.1  # M may be larger than A
            else:
                z, c, r = moved, c + by, r + change - jumps @ by
        current = point(z, c, r)
        rounds += 1
        part = 1.0 if rounds > ROUNDS else 0.0  # sets seem to alternate
        while remaining > 0 and part > SHORTEST and not good(current):
            remaining -= 1
            candidate = point(
                *newton(current.multipliers, current.rigid, current.gradient, CLOSE, part)
            )
            if energy(candidate) < energy(current):
                current, part = candidate, 1.0
            else:
                part *= 0.25
        if good(current):
            return current.multipliers
    return current.multipliers
