"""Friction with bounds that depend on the pressure, as a fixed point of Tresca problems."""

from __future__ import annotations

import dataclasses

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.forcing import FORCING, ROUGH
from dolfinx_tresca._base.patience import PATIENCE, PROGRESS
from dolfinx_tresca.optimise.models.model import Model
from dolfinx_tresca.optimise.newton import face_newton
from dolfinx_tresca.optimise.newton.continuation import (
    along_friction,
    nearest_fixed_point,
)
from dolfinx_tresca.optimise.newton.face_newton import FaceNewton, Point
from dolfinx_tresca.optimise.newton.iterate import Step
from dolfinx_tresca.optimise.newton.near_model import SolveModel
from dolfinx_tresca.optimise.newton.projected_newton import ProjectedNewton
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution, FrictionDeficit
from dolfinx_tresca.optimise.record.history import Observe
from dolfinx_tresca.optimise.record.slips import cones_at
from dolfinx_tresca.optimise.reductions import norm
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus

#: `MOST_SWEEPS` limits the number of sweeps, which are Tresca problems with the bounds of the last
#: solution. `SPRINGS` is the softness of the springs that support bodies in sweeps, divided by the
#: softness of the bodies.
MOST_SWEEPS, SPRINGS = 5, 0.01

#: Factor that makes slip bounds practically infinite.
LARGE = 1e100

#: A step is taken if the residual after the step is at most this multiple of the residual before.
WORSE = 2.0

#: The model is solved more accurately while the natural residual of its fixed point exceeds this
#: fraction of the residual of the present point. (A wall of 52 bricks is pushed in accepted steps.
#: Some of the steps end with NO_FIXED_POINT both with 0.5 and with 0.03.)
REDUCTION = 0.003

#: Factor on the tolerance each time the model is solved more accurately. With FORCING, the push of
#: a wall of 1,025 bricks (`tests/validation/test_many_bodies.py`) takes six times as many Newton
#: systems: the next iteration starts from the projection of a less accurate point, from which
#: Newton's method makes no progress. With FORCING**4, rounding is reached, and 2,046 bricks under
#: their weight take 87 systems in place of 31.
REFINEMENT = FORCING**2

#: The solve ends after this number of consecutive iterations in which friction, computed with the
#: model in place of A, is too weak to hold a body. (For a bolted joint beyond its limit, friction
#: is too weak from the first product on.)
FAILURES = 2


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Find the multipliers that minimise q over the section of the cones at their own pressures.

    Their slip bounds are the fixed point g = G(lambda_nu(g)), where lambda(g) is the solution of
    Tresca's problem with the bounds g, and G(p) are the bounds at the pressures p (Haslinger 1983,
    Approximation of the Signorini problem with friction, obeying the Coulomb law). A, b and the
    gradient do not depend on g. In each iteration, Newton's method (Alart and Curnier 1991)
    computes the fixed point for the model of A (see `projected_newton`). This costs no products
    with A and requires no contraction. The product of A with the step to this point then improves
    the model. All iterates lie in the cones, hence each in its own section: the natural residual,
    the energy bound and the nodes' states are those of Tresca's problem with the bounds
    G(lambda_nu) that follow from the iterate itself.

    No quantity is guaranteed to decrease. A step that more than doubles the residual is not taken,
    and its product only improves the model; if residuals stop decreasing, the iteration ends with
    NO_FIXED_POINT.

    Collective.
    """
    return _FixedPointNewton(problem, options, observe).run(start)


class _FixedPointNewton(ProjectedNewton):
    """Projected Newton method whose target is the fixed point of the model."""

    #: Whether the last step changed neither residual nor model: the next step would be the same.
    has_stalled = False

    #: Number of consecutive iterations in which friction on the model was too weak for the
    #: constraints.
    failures = 0
    #: Deficit of friction in the last iteration; None if friction was strong enough.
    deficit: FrictionDeficit | None = None

    @property
    def solve_model(self) -> SolveModel:
        """The function that computes the fixed point for a model of A."""
        return self._fixed_point_of_model

    def _fixed_point_of_model(
        self,
        problem: DualProblem,
        model: Model,
        multipliers: Array,
        gradient: Array,
        rho: float,
        tolerance: float,
    ) -> Array:
        """Return a fixed point of the model; if none is found, record how much friction is missing.

        Newton's method on the model treats the equilibrium, and the laws of contact and friction,
        as two independent equations, and measures the error of each. The natural residual contains
        a projection that satisfies the equilibrium exactly. Where bodies slide as a whole, few
        tractions can satisfy the equilibrium, and the natural residual is a hundred times larger
        than the errors that Newton's method measures. The model is then solved more accurately,
        from the projected point; the natural residual decides which of the points is returned.
        """
        found, last_sweep = fixed_point_of_model(
            problem, model, multipliers, gradient, rho, tolerance
        )
        self.deficit = None
        if last_sweep is not None:
            z = last_sweep.multipliers
            self.deficit = friction_deficit(problem.at(z, last_sweep.gradient, rho), z)
        if last_sweep is not None or len(problem.constraints) == 0:
            return found
        least = ROUNDING * norm(problem, problem.b)
        at_found = gradient + model.apply(found - multipliers)
        left, newton = self.residual.at(found, at_found), FaceNewton(problem, model, rho)
        while tolerance > least and left > REDUCTION * self.history.error:
            tolerance *= REFINEMENT
            start = point_at(problem, found, at_found, rho)
            point = nearest_fixed_point(newton, start, tolerance, refine=True)
            better = projected(problem, point, rho)
            at_better = gradient + model.apply(better - multipliers)
            rest = self.residual.at(better, at_better)
            if rest < left:
                found, at_found, left = better, at_better, rest
            if point.residual > tolerance:
                break
        return found

    def target(self) -> Array:
        """Return an approximate fixed point of the model."""
        result = super().target()
        self.failures = 0 if self.deficit is None else self.failures + 1
        return result

    def run(self, start: Array) -> DualSolution:
        """Iterate until the end; return the deficit of friction if there is no fixed point."""
        found = super().run(start)
        lost = found.status is ContactStatus.NO_FIXED_POINT
        return dataclasses.replace(found, deficit=self.deficit if lost else None)

    def is_useful_start(self, start: Array, r: Array) -> bool:
        """Return whether the iteration begins at the given start; in a load step it always does.

        There may be several fixed points, and a process continues with the nearest fixed point. For
        example, friction keeps a wedge in place after the force that pushed it in is removed,
        although zero tractions satisfy the law of friction as well.
        """
        if not self.problem.is_load_step:
            return super().is_useful_start(start, r)
        if self.residual.at(start, r) > self.residual.scale:
            self.residual.count(r + self.problem.b)
        return True

    def accepted(self, newton: Array) -> Step:
        """Return the whole Newton step, or a zero step if the residual would increase too much."""
        at = self.at
        step = at.step(newton)
        residual = self.residual.at(at.multipliers + newton, at.r + step.product)
        if residual <= WORSE * self.history.error:
            same = abs(residual - self.history.error) <= ROUGH * self.history.error
            self.has_stalled = same and not at.learned
            return step
        self.has_stalled = not at.learned
        at.increase_accuracy()
        return at.zero_step()

    def check_convergence(self) -> ContactStatus | None:
        """Check convergence at the present point, and whether residuals decrease."""
        status, residuals = super().check_convergence(), self.history.residuals
        idle = len(residuals) > PATIENCE and (
            min(residuals[-PATIENCE:]) > PROGRESS * min(residuals[:-PATIENCE])
        )
        if status not in (None, ContactStatus.STAGNATED):
            return status
        if self.failures >= FAILURES:
            return ContactStatus.NO_FIXED_POINT
        digits = self.residual.is_limited_by_rounding(self.history.error)
        if digits and status is ContactStatus.STAGNATED:
            return status
        if idle or self.has_stalled:
            return ContactStatus.STAGNATED if digits else ContactStatus.NO_FIXED_POINT
        return None  # a stagnating iteration continues, since products still improve the model


def fixed_point_of_model(
    problem: DualProblem,
    model: Model,
    multipliers: Array,
    gradient: Array,
    rho: float,
    tolerance: float,
) -> tuple[Array, Point | None]:
    """Return multipliers in the cones that are approximately a fixed point of the model.

    Newton's method is started from the following initial guesses in turn until it converges:

    * the present point;
    * continuation in the coefficients of friction (`along_friction`), from Tresca's problem without
      friction, which has one solution; bodies that the reduced friction cannot support are held by
      springs as soft as the bodies;
    * the solution with all nodes sticking;
    * sweeps: solutions of Tresca's problem, each with the bounds of the previous solution. They
      converge if friction changes the pressures only little. The slip bounds of a sweep may be too
      small to support a floating body; springs then support the body at its position in the
      previous sweep, as in the method of multipliers.

    If no fixed point is found, the solution of the last sweep is returned: its product with A may
    improve the model.

    Collective. Needs no product with A.

    Args:
        problem: the dual problem, with friction cones and constraints.
        model: model M of A.
        multipliers: (size,) point in the cones.
        gradient: (size,) gradient at this point.
        rho: step length with which the natural residual is measured.
        tolerance: requested natural residual, with the slip bounds that follow from the point
            itself.

    Returns:
        the fixed point (size,) and None; or, if none was found, the point of the last sweep
        projected onto cones and constraints, and the same point before the projection, where
        springs may contribute to the equilibrium.
    """
    constraints = problem.constraints
    enough = max(tolerance, ROUNDING * norm(problem, problem.b))
    newton = FaceNewton(problem, model, rho)

    def solution(tresca: DualProblem) -> Point:
        z = face_newton.minimise(tresca, model, multipliers, gradient, rho, tolerance)
        r = gradient + model.apply(z - multipliers)
        return Point(z, np.zeros(len(constraints)), r, float("inf"))

    def sweep(previous: Point) -> Point:
        x, softer = previous.multipliers, problem.relaxed(1.0, SPRINGS * rho, previous.c)
        tresca = softer.at(x, previous.gradient, rho).section(x)
        at = solution(tresca)
        c = tresca.constraints.soft_multipliers(at.multipliers)
        return dataclasses.replace(at, c=c, gradient=at.gradient - constraints.columns @ c)

    start = point_at(problem, multipliers, gradient, rho)
    found = nearest_fixed_point(newton, start, tolerance)
    last = found

    def by_friction() -> Point:
        weak = problem.relaxed(0.0, rho, np.zeros_like(start.c)).section(np.zeros_like(multipliers))
        return along_friction(problem, model, solution(weak), rho, tolerance)

    def from_stick() -> Point:
        sticking = problem.relaxed(LARGE, 0.0, np.zeros_like(start.c))
        stuck = solution(sticking.section(np.ones_like(multipliers)))
        return nearest_fixed_point(newton, stuck, tolerance)

    for strategy in (by_friction, from_stick):
        if found.residual > enough:
            found = strategy()
    for _ in range(MOST_SWEEPS):
        if found.residual <= enough:
            break
        last = sweep(last)
        found = nearest_fixed_point(newton, last, tolerance)
    missed = found.residual > enough
    result = projected(problem, last if missed else found, rho)
    return result, last if missed else None


def point_at(problem: DualProblem, multipliers: Array, gradient: Array, rho: float) -> Point:
    """Return the `Point` for multipliers (size,) and the gradient there. Collective."""
    _, c = cones_at(problem, multipliers, gradient, rho)
    return Point(multipliers, c, gradient - problem.constraints.columns @ c, float("inf"))


def projected(problem: DualProblem, point: Point, rho: float) -> Array:
    """Return the projection (size,) of a point onto the cones and the constraints. Collective."""
    cones = problem.admissible.at(point.multipliers, point.gradient, rho)
    return problem.constraints.project(cones, point.multipliers, point.c, rho)[0]


def friction_deficit(problem: DualProblem, x: Array) -> FrictionDeficit | None:
    """Return the motion along which friction is too weak for the constraints. Collective.

    Args:
        problem: the dual problem, with friction cones and constraints.
        x: (size,) multipliers whose pressures determine the slip bounds.

    Returns:
        the motion, with the work of the loads and of friction along it; None if some multipliers
        with the slip bounds of x satisfy the constraints.
    """
    constraints, section = problem.constraints, problem.admissible.section(x)
    if len(constraints) == 0:  # no body floats
        return None
    found = constraints.balance(section)
    if found.satisfied:
        return None
    motion = found.shift / np.linalg.norm(found.shift)
    slip = constraints.columns @ motion
    friction = section.project(LARGE * slip)
    friction[section.normal] = 0.0
    available = float(problem.inner(friction, slip))
    return FrictionDeficit(motion, float(constraints.values @ motion), available)
