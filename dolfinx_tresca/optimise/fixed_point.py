"""Friction whose bound depends on the pressure: the fixed point of Tresca's problem."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise import face_newton
from dolfinx_tresca.optimise.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.continuation import (
    PROGRESS,
    along_friction,
    along_load,
    nearest_fixed_point,
)
from dolfinx_tresca.optimise.face_newton import FaceNewton, Point
from dolfinx_tresca.optimise.history import Observe
from dolfinx_tresca.optimise.iterate import Step
from dolfinx_tresca.optimise.near_model import SolveModel
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution, FrictionDeficit
from dolfinx_tresca.optimise.projected_newton import ProjectedNewton
from dolfinx_tresca.optimise.reductions import norm
from dolfinx_tresca.optimise.residual import RESIDUAL_ROUNDING
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus

#: Tresca problems with the bounds of the one before at the most, and the springs that hold bodies
#: in them, over some that are as soft as the bodies.
MOST_SWEEPS, SPRINGS = 5, 0.01

#: Pressure whose bounds are as good as none, over any that occurs.
LARGE = 1e100

#: Residual after a step over that before it, from which on the step is not taken.
WORSE = 2.0

#: Parts of a step that are tried, the shorter ones for a residual that is not larger.
PARTS = (1.0, 0.5, 0.25, 0.125)

#: Iterations after which the residual must have made progress.
PATIENCE = 25

#: Iterations in a row in which friction is too weak on the model, from which on it counts as too
#: weak. (Of a bolted joint beyond its limit the model says so from the first product on.)
FAILURES = 2


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Find the multipliers that minimise q over the section of the cones at their own pressures.

    That is the fixed point g = G(lambda_nu(g)) of the map that takes bounds g to the solution
    lambda(g) of Tresca's problem (Haslinger 1983, Approximation of the Signorini problem with
    friction, obeying the Coulomb law). A, b and the gradient do not depend on g. So the whole fixed
    point is found on the model of A (see `projected_newton`), where it costs no products, and by
    Newton's method (Alart and Curnier 1991), which needs no contraction; then one product tells A
    on the step to it, the model learns, and so on. All iterates lie in the cones, hence each in
    its own section: the natural residual, the energy bound and the nodes' states are those of
    Tresca's problem with the bounds G(lambda_nu) of the same lambda.

    Nothing decreases with certainty: a step after which the residual is twice as large serves the
    model only, and where residuals do not fall the iteration ends with NO_FIXED_POINT.

    Collective.
    """
    return _FixedPointNewton(problem, start, options, observe).run()


class _FixedPointNewton(ProjectedNewton):
    """Steps to the fixed point of the model."""

    #: Whether the last step led nowhere, and told nothing of A: the next one would not either.
    has_stalled = False

    #: Iterations in a row in which friction was too weak for the constraints on the model.
    failures = 0
    #: By how much, and where, in the last one; None if it was not.
    deficit: FrictionDeficit | None = None

    @property
    def solve_model(self) -> SolveModel:
        """The function that finds the fixed point with a model of A."""
        return self._fixed_point_of_model

    def _fixed_point_of_model(self, problem: DualProblem, *arguments: Any) -> Array:
        """Return a fixed point of the model, or note that friction is too weak."""
        multipliers, swept = fixed_point_of_model(problem, *arguments)
        self.deficit = None if swept is None else friction_deficit(problem, swept)
        return multipliers

    def target(self) -> Array:
        """Return the fixed point of the model, about."""
        result = super().target()
        self.failures = 0 if self.deficit is None else self.failures + 1
        return result

    def run(self) -> DualSolution:
        """Iterate to the end; say what friction lacks where that is why there is no fixed point."""
        found = super().run()
        lost = found.status is ContactStatus.NO_FIXED_POINT
        return dataclasses.replace(found, deficit=self.deficit if lost else None)

    def is_useful_start(self, start: Array, r: Array) -> bool:
        """Whether the iteration begins at a start: in a process always.

        There may be several fixed points, and a process goes on with the nearest: friction holds a
        wedge that was driven in and let go, though no pressure anywhere would satisfy the law too.
        """
        if not self.problem.is_load_step:
            return super().is_useful_start(start, r)
        if self.residual.at(start, r) > self.residual.scale:
            self.residual.count(r + self.problem.b)
        return True

    def accepted(self, newton: Array) -> Step:
        """Return the step, or where it leads to a much larger residual a part or none of it."""
        at = self.at
        known = len(self.store)
        whole = at.step(newton)
        learned = not self.problem.exact or len(self.store) != known
        for part in PARTS:
            step = Step(part * whole.direction, part * whole.product, part * whole.error)
            residual = self.residual.at(at.multipliers + step.direction, at.r + step.product)
            if residual <= (WORSE if part == 1.0 else 1.0) * self.history.error:
                self.has_stalled = not learned and float(self.problem.inner(newton, newton)) == 0.0
                return step
        self.has_stalled = not learned
        at.increase_accuracy()
        return at.zero_step()

    def check_convergence(self) -> ContactStatus | None:
        """Judge the present point, and whether residuals still fall."""
        status, residuals = super().check_convergence(), self.history.since_restart
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
        return None  # steps that are not taken teach the model


def fixed_point_of_model(
    problem: DualProblem,
    model: BlockBFGSModel,
    multipliers: Array,
    gradient: Array,
    rho: float,
    tolerance: float,
) -> tuple[Array, Array | None]:
    """Return a fixed point of the model's Tresca problems, about, in the cones.

    Newton's method looks for it from the present point. Then it follows the fixed points of smaller
    coefficients of friction, while springs as soft as the bodies hold what these do not: from
    Tresca's problem without friction, which has one solution. Then it follows the load, from the
    one that the present point is a fixed point of: in a process first, which goes on from there.
    (Elsewhere only where products are exact.) Then it starts where all nodes stick. Then from
    solutions of Tresca's problem, each with the bounds of the one before: these come nearer where
    friction is too weak to turn pressures round, whatever sets do meanwhile. Such bounds may let
    bodies slide that contact is to hold; springs hold these where they were in the problem before,
    as in the method of multipliers. If no fixed point is found, the last of these
    solutions is returned: its product with A may improve the model.

    Collective. Needs no product with A.

    Args:
        problem: the cones and the inner product.
        model: M.
        multipliers: (size,) in the cones.
        gradient: (size,) there.
        rho: step length with which the natural residual is measured.
        tolerance: wanted natural residual, with the bounds at the point itself.

    Returns:
        the fixed point (size,), and None; or the best that there is, and the solution (size,) of
        the last Tresca problem, in which springs may have held what friction does not.
    """
    cones, constraints = problem.admissible, problem.constraints
    enough = max(tolerance, RESIDUAL_ROUNDING * norm(problem, problem.b))
    newton = FaceNewton(problem, model, rho)

    def solution(tresca: DualProblem) -> Point:
        z = face_newton.minimise(tresca, model, multipliers, gradient, rho, tolerance)
        r = gradient + model.apply(z - multipliers)
        return Point(z, np.zeros(len(constraints)), r, float("inf"))

    def swept(before: Point) -> Point:
        tresca = problem.relaxed(1.0, SPRINGS * rho, before.c).section(before.multipliers)
        at = solution(tresca)
        c = tresca.constraints.soft_multipliers(at.multipliers)
        return dataclasses.replace(at, c=c, gradient=at.gradient - constraints.columns @ c)

    c = constraints.multipliers(cones.section(multipliers), multipliers, gradient, rho)
    start = Point(multipliers, c, gradient - constraints.columns @ c, float("inf"))
    found = nearest_fixed_point(newton, start, tolerance)
    last = found

    def by_load() -> Point:
        return along_load(problem, model, start, rho, tolerance)

    def by_friction() -> Point:
        weak = problem.relaxed(0.0, rho, np.zeros_like(c)).section(np.zeros_like(multipliers))
        return along_friction(problem, model, solution(weak), rho, tolerance)

    def from_stick() -> Point:
        stuck = solution(problem.section(np.full_like(multipliers, LARGE)))
        return nearest_fixed_point(newton, stuck, tolerance)

    if problem.is_load_step:
        ways = [by_load, by_friction, from_stick]
    elif problem.exact:
        ways = [by_friction, by_load, from_stick]
    else:  # far from the start, what rough products tell has fixed points that A has not
        ways = [by_friction, from_stick]
    for way in ways:
        if found.residual > enough:
            found = way()
    for _ in range(MOST_SWEEPS):
        if found.residual <= enough:
            break
        last = swept(last)
        found = nearest_fixed_point(newton, last, tolerance)
    missed = found.residual > enough
    best = last if missed else found
    result = constraints.project(cones, best.multipliers, best.c, rho)[0]
    return result, last.multipliers if missed else None


def friction_deficit(problem: DualProblem, x: Array) -> FrictionDeficit | None:
    """Return along which motion friction is too weak for the constraints. Collective.

    Args:
        problem: the cones and the constraints.
        x: (size,) whose pressures friction has.

    Returns:
        None where some multipliers with the bounds of x satisfy the constraints.
    """
    constraints, section = problem.constraints, problem.admissible.section(x)
    if len(constraints) == 0:  # K holds all bodies
        return None
    found = constraints.balance(section)
    if found.satisfied:
        return None
    motion = found.shift / np.linalg.norm(found.shift)
    slip = constraints.columns @ motion
    friction = section.project(LARGE * slip)
    friction[section.normal] = 0.0
    held = float(problem.inner(friction, slip))
    return FrictionDeficit(motion, float(constraints.values @ motion), held)
