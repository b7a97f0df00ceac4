"""The natural residual: a measure of the distance of multipliers from a solution of (38.4)."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca.solvers.problem import DualProblem, Point
from dolfinx_tresca.solvers.reductions import norm

#: Rounding may be the cause of a stagnation if the residual, divided by its scale or by |b|, is at
#: most this number.
EXHAUSTED = float(np.sqrt(np.finfo(float).eps))


class NaturalResidual:
    """The residual |lambda - P(lambda - rho r)| / rho, the norm of the paper's reduced gradient.

    With equality constraints, |e - G'lambda - S c| / rho is the other component of the residual.
    The relative residual is this residual divided by its scale. The scale is the residual at
    lambda = 0, so that the relative residual does not depend on units, on the size of the load, or
    on the initial guess. In a load step whose initial multipliers x have a larger residual than
    zero, the scale is at least |A x|. An example is a wedge that friction keeps in place after its
    load is removed: the residual at zero is zero.

    Attributes:
        rho: step length.
        scale: the divisor of relative residuals, see above.
        zero_is_solution: whether the residual at lambda = 0 is rounding.
        rounding: largest residual that counts as rounding.
        zero: lambda = 0.
    """

    def __init__(self, problem: DualProblem, rho: float, error: float = 0.0) -> None:
        """Measure the scale. Collective.

        Args:
            problem: the dual problem (38.4).
            rho: step length.
            error: error of the gradient at zero, in the norm sqrt(e'A^-1 e), if the solver cannot
                reduce this error further; residuals below the error count as zero.
        """
        self._problem, self._error, self._counted, self.rho = problem, error, 0.0, rho
        self.set_constraint_multipliers(np.zeros(len(problem.constraints)))

    def set_constraint_multipliers(self, c: Array) -> None:
        """Measure the scale with multipliers c (k,) of constraints: b is known up to G c."""
        b = self._problem.b
        self.zero = Point(np.zeros_like(b), c, -b - self._problem.constraints.columns @ c)
        self.set_rho(self.rho)

    def set_rho(self, rho: float) -> None:
        """Change the step length with which residuals are measured. Collective."""
        self.rho = rho
        self.scale = self.norm_at(self.zero)
        # the constraints' multipliers c may cancel b: the terms of G c have rounding errors as well
        moved = self._problem.constraints.absolute @ np.abs(self.zero.c)
        self._terms = norm(self._problem, self._problem.response.b_terms)
        size = self._terms + norm(self._problem, moved)
        self.rounding = max(ROUNDING * size, self._error / float(np.sqrt(rho)))
        self.zero_is_solution = self.scale <= self.rounding
        self.scale = max(0.0 if self.zero_is_solution else self.scale, self._counted)

    def count(self, product: Array) -> None:
        """Increase the scale to the norm of a product A x (size,), if it is larger. Collective."""
        self._counted = norm(self._problem, product)
        self.scale = max(self.scale, self._counted)

    def zero_is_undecided(self, error: float) -> bool:
        """Return whether the gradient is too inaccurate to decide if zero is the solution.

        Collective.

        Args:
            error: error of the gradient at zero, in the norm sqrt(e'A^-1 e).
        """
        # |e| is at most sqrt(sigma_max) times the norm sqrt(e'A^-1 e)
        largest, zero = error / float(np.sqrt(self.rho)), self.zero
        return self.scale <= largest and self.norm_at(Point(zero.x, zero.c, zero.r - largest)) > 0.0

    def projection(self, point: Point) -> Array:
        """Return the gradient projection P(x - rho r) (size,) with the bounds at a point."""
        cones = self._problem.admissible.at_point(point.x, point.r)
        return cones.section(point.x).project(point.x - self.rho * point.r)

    def norm_at(self, point: Point) -> float:
        """Return the natural residual, not divided by its scale. Collective."""
        change = norm(self._problem, point.x - self.projection(point))
        unbalanced = np.linalg.norm(self._problem.constraints.residual(point.x, point.c))
        return float(np.hypot(change, unbalanced)) / self.rho

    def is_limited_by_rounding(self, residual: float) -> bool:
        """Return whether rounding may keep a residual from decreasing. Not collective.

        This is possible if the residual is small compared with its scale or with b. The size of b
        matters if the loads move the bodies much less than the width of a gap: then the scale
        follows from the loads, but rounding errors follow from the gap.
        """
        return residual <= EXHAUSTED * max(self.scale, self._terms)

    def relative(self, residual: float) -> float:
        """Return a natural residual divided by its scale. Not collective."""
        return residual / self.scale if self.scale > 0.0 else residual
