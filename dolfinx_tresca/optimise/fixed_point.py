"""Friction whose bound depends on the pressure: the fixed point of Tresca's problem."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise import face_newton
from dolfinx_tresca.optimise.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.face_newton import FaceNewton
from dolfinx_tresca.optimise.history import Observe
from dolfinx_tresca.optimise.iterate import Step
from dolfinx_tresca.optimise.near_model import SolveModel
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.projected_newton import ProjectedNewton
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus

#: Newton steps on the model from one start at the most, and how many in a row may bring the
#: residual no further than to the part that counts as progress.
MOST_STEPS, IDLE_STEPS, PROGRESS = 30, 5, 0.9

#: Starts of Newton's method on the model, and residual to which Tresca's problem is solved for the
#: next one, over that of the best point.
STARTS, SWEEP = 3, 0.1

#: Residual after a step over that before it, from which on the step is not taken.
WORSE = 2.0

#: Iterations after which the residual must have made progress.
PATIENCE = 15


def fixed_point_of_model(
    problem: DualProblem,
    model: BlockBFGSModel,
    multipliers: Array,
    gradient: Array,
    rho: float,
    tolerance: float,
) -> Array:
    """Return a fixed point of the model's Tresca problems, about, in the cones.

    Where Newton's method does not find it, it starts again from the solution of the Tresca problem
    with the bounds of the best point.

    Collective. Needs no product with A.

    Args:
        problem: the cones and the inner product.
        model: M.
        multipliers: (size,) in the cones.
        gradient: (size,) there.
        rho: step length with which the natural residual is measured.
        tolerance: wanted natural residual, with the bounds at the point itself.
    """
    newton, none = FaceNewton(problem, model, rho), np.zeros(len(problem.constraints))
    best = newton.point(multipliers, none, gradient)
    z, c, r = best.multipliers, best.c, best.gradient
    for start in range(STARTS):
        if start > 0:
            bounded, enough = problem.section(best.multipliers), SWEEP * best.residual
            z = face_newton.minimise(bounded, model, multipliers, gradient, rho, enough)
            z, c, r = z, none, gradient + model.apply(z - multipliers)
        idle = 0
        for _ in range(MOST_STEPS):
            z, c, r = newton.step(z, c, r)
            candidate = newton.point(z, c, r)
            idle = 0 if candidate.residual < PROGRESS * best.residual else idle + 1
            best = min(best, candidate, key=lambda point: point.residual)
            if best.residual <= tolerance:
                return best.multipliers
            if idle == IDLE_STEPS:
                break
    return best.multipliers


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

    refused = False

    @property
    def solve_model(self) -> SolveModel:
        """What finds the fixed point of a model of A."""
        return fixed_point_of_model

    def accepted(self, newton: Array) -> Step:
        """Return the step, or none where it leads to a much larger residual."""
        at = self.at
        whole = at.step(newton)
        residual = self.residual.at(at.multipliers + newton, at.r + whole.product)
        self.refused = not residual <= WORSE * self.history.error
        if not self.refused:
            return whole
        at.tighten()
        return at.zero_step()

    def judge(self) -> ContactStatus | None:
        """Judge the present point, and whether residuals still fall."""
        status, residuals = super().judge(), self.history.residuals
        idle = len(residuals) > PATIENCE and (
            min(residuals[-PATIENCE:]) > PROGRESS * min(residuals[:-PATIENCE])
        )
        if (status is None and idle) or (status is ContactStatus.STAGNATED and self.refused):
            return ContactStatus.NO_FIXED_POINT
        return status
