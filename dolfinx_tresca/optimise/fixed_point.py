"""Friction whose bound depends on the pressure: the fixed point of Tresca's problem."""

from __future__ import annotations

import dataclasses

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise import face_newton
from dolfinx_tresca.optimise.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.history import History, Observe
from dolfinx_tresca.optimise.iterate import Step
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.projected_newton import ProjectedNewton
from dolfinx_tresca.optimise.reductions import norm
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus

#: Sweeps on the model at the most.
MOST_SWEEPS = 40

#: Part to which a sweep must bring the residual; where it does not, the next one goes half as far,
#: down to the least part of the way.
CONTRACTION, LEAST_PART = 0.9, 1.0 / 16.0

#: Residual after a step over that before it, from which on the step is not taken.
WORSE = 2.0

#: Steps after which the residual must have been less than before by the factor above.
PATIENCE = 15


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Find the multipliers that minimise q over the section of the cones at their own pressures.

    Haslinger's fixed point: g = G(lambda_nu(g)), where lambda(g) solves Tresca's problem with the
    bounds g. A, b and the gradient do not depend on g. So the whole fixed point is found on the
    model of A (see `projected_newton`), without products; then one product tells A on the step to
    it, the model learns, and so on. All iterates lie in the cones, hence in their own section, so
    that the natural residual and the energy bound are those of Tresca's problem with the bounds
    G(lambda_nu) of the same lambda.

    Nothing decreases with certainty here: steps after which the residual is twice as large serve
    the model only, and where residuals do not fall the iteration ends as NOT_CONTRACTING.

    Collective.
    """
    return _FixedPointNewton(problem, start, options, observe).run()


class _FixedPointNewton(ProjectedNewton):
    """Steps to the fixed point of the model."""

    def target(self) -> Array:
        """Return the fixed point of the model, about."""
        return fixed_point_of_model(
            self.problem,
            self.store.model(),
            self.at.multipliers,
            self.at.r,
            self.residual.rho,
            self.options.r_tol * self.history.error,
        )

    def accepted(self, newton: Array) -> Step:
        """Return the step, or none where it leads to a much larger residual."""
        at = self.at
        whole = at.step(newton)
        residual = self.residual.at(at.multipliers + newton, at.r + whole.product)
        if residual <= WORSE * self.history.error:
            return whole
        at.tighten()
        return at.zero_step()

    def judge(self) -> ContactStatus | None:
        """Judge the present point, and whether residuals still fall."""
        status = super().judge()
        residuals = self.history.residuals
        if status is None and len(residuals) > PATIENCE:
            before, recent = min(residuals[:-PATIENCE]), min(residuals[-PATIENCE:])
            if recent > CONTRACTION * before:
                return ContactStatus.STAGNATED
        return status


def fixed_point_of_model(
    problem: DualProblem,
    model: BlockBFGSModel,
    multipliers: Array,
    gradient: Array,
    rho: float,
    tolerance: float,
) -> Array:
    """Return a fixed point of the model's Tresca problems, about, in the cones. Collective.

    Args:
        problem: the cones and the inner product.
        model: M.
        multipliers: (size,) in the cones.
        gradient: (size,) there.
        rho: step length with which the natural residual is measured.
        tolerance: wanted natural residual, with the bounds at the point itself.
    """
    x, r = multipliers, gradient
    error = natural_residual(problem, x, r, rho)
    best, least = x, error
    part = 1.0
    for _ in range(MOST_SWEEPS):
        if error <= tolerance:
            return x
        section = problem.section(x)
        z = face_newton.minimise(section, model, x, r, rho, max(0.1 * error, 0.3 * tolerance))
        z = problem.constraints.project(problem.admissible, z, np.zeros(len(problem.constraints)), rho)[0]
        step = part * (z - x)
        x, r = x + step, r + model.apply(step)
        before, error = error, natural_residual(problem, x, r, rho)
        if error > CONTRACTION * before:
            part = max(0.5 * part, LEAST_PART)
        if error < least:
            best, least = x, error
    return best


def natural_residual(problem: DualProblem, x: Array, r: Array, rho: float) -> float:
    """Return |x - P(x - rho r)| / rho with the bounds at x, as `NaturalResidual`. Collective."""
    constraints = problem.constraints
    lam = problem.admissible.section(x)
    return norm(problem, x - constraints.project(lam, x - rho * r, np.zeros(len(constraints)), rho)[0]) / rho
