"""Friction with bounds that depend on the pressure, as a fixed point of Tresca problems."""

from __future__ import annotations

import dataclasses

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import ROUGH
from dolfinx_tresca._base.patience import PATIENCE, PROGRESS
from dolfinx_tresca.optimise.newton.iterate import Step
from dolfinx_tresca.optimise.newton.projected_newton import ProjectedNewton
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution, FrictionDeficit
from dolfinx_tresca.optimise.record.history import Observe
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus

#: Factor that makes slip bounds practically infinite.
LARGE = 1e100

#: A step is taken if the residual after the step is at most this multiple of the residual before.
WORSE = 2.0

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
    #: Number of iterates when the rest of A was computed; 0 before.
    completed_at = 0
    #: Deficit of friction in the last iteration; None if friction was strong enough.
    deficit: FrictionDeficit | None = None

    def target(self) -> Array:
        """Return an approximate fixed point of the model; record how much friction is missing."""
        result, self.deficit = super().target(), None
        if self.missed is not None:
            x = self.missed.x
            self.deficit = friction_deficit(self.problem.at(x, self.missed.r, self.residual.rho), x)
        self.failures = 0 if self.deficit is None else self.failures + 1
        return result

    def complete_products(self) -> bool:
        """Compute the rest of A unless it is known or too large; return whether it was done."""
        completed = super().complete_products()
        if completed:
            self.failures, self.has_stalled = 0, False
            self.completed_at = len(self.history.residuals)
        return completed

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
        status = super().check_convergence()
        residuals = self.history.residuals[self.completed_at :]
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
