"""The natural residual: a measure of the distance of multipliers from a solution of (38.4)."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.reductions import norm

#: Rounding may be the cause of a stagnation if the residual, divided by its scale or by |b|, is at
#: most this number.
EXHAUSTED = float(np.sqrt(np.finfo(float).eps))


class NaturalResidual:
    """The residual |lambda - P(lambda - rho r)| / rho, the norm of the paper's reduced gradient.

    The relative residual is this residual divided by its scale. The scale is the residual at
    lambda = 0, so that the relative residual does not depend on units, on the size of the load, or
    on the initial guess. If zero does not satisfy the equality constraints, the origin, which is
    the nearest point to zero that satisfies them, takes the place of zero. The scale is then at
    least |A lambda| at the origin. In a load step whose initial multipliers have a larger residual
    than the origin, the scale is also at least |A lambda| at these multipliers. An example is a
    wedge that friction keeps in place after its load is removed: the residual at zero is zero.

    Attributes:
        rho: step length.
        scale: the divisor of relative residuals, see above.
        origin_is_solution: whether the residual at the origin is rounding.
        rounding: largest residual that counts as rounding.
        origin: (size,) the nearest point to zero in Lambda that satisfies the constraints.
        origin_gradient: (size,) gradient at the origin.
    """

    def __init__(
        self,
        problem: DualProblem,
        rho: float,
        origin: Array,
        origin_gradient: Array,
        origin_error: float = 0.0,
    ) -> None:
        """Measure the scale. Collective.

        Args:
            problem: the dual problem (38.4).
            rho: step length.
            origin: (size,) the nearest point to zero in Lambda that satisfies the constraints.
            origin_gradient: (size,) gradient at the origin.
            origin_error: error of the gradient at the origin, in the norm sqrt(e'A^-1 e), if the
                solver cannot reduce this error further; residuals below the error count as zero.
        """
        self._problem, self._error, self._counted = problem, origin_error, 0.0
        self.origin, self.origin_gradient = origin, origin_gradient
        self.set_rho(rho)

    def set_rho(self, rho: float) -> None:
        """Change the step length with which residuals are measured. Collective."""
        self.rho = rho
        self.scale = max(
            self.at(self.origin, self.origin_gradient),
            # A x of the origin x, which equality constraints may move away from zero
            norm(self._problem, self.origin_gradient + self._problem.b),
        )
        # the constraints' multipliers c may cancel b: the terms of G c have rounding errors as well
        constraints = self._problem.constraints
        lam = self._problem.admissible.section(self.origin)
        c = constraints.multipliers(lam, self.origin, self.origin_gradient, rho)
        moved = constraints.matrix.absolute @ np.abs(c)
        size = norm(self._problem, self._problem.b) + norm(self._problem, moved)
        self.rounding = max(ROUNDING * size, self._error / float(np.sqrt(rho)))
        self.origin_is_solution = self.scale <= self.rounding
        self.scale = max(0.0 if self.origin_is_solution else self.scale, self._counted)

    def count(self, product: Array) -> None:
        """Increase the scale to the norm of a product A x (size,), if it is larger. Collective."""
        self._counted = norm(self._problem, product)
        self.scale = max(self.scale, self._counted)

    def origin_is_undecided(self, error: float) -> bool:
        """Return whether the gradient is too inaccurate to decide if the origin is the solution.

        Collective.

        Args:
            error: error of the gradient at the origin, in the norm sqrt(e'A^-1 e).
        """
        # |e| is at most sqrt(sigma_max) times the norm sqrt(e'A^-1 e)
        largest = error / float(np.sqrt(self.rho))
        return self.scale <= largest and self.at(self.origin, self.origin_gradient - largest) > 0.0

    def projection(self, x: Array, r: Array) -> Array:
        """Return the gradient projection P(x - rho r) (size,) with the bounds at x. Collective."""
        cones = self._problem.admissible.at(x, r, self.rho)
        return self._problem.constraints.gradient_step(cones.section(x), x, r, self.rho)[0]

    def at(self, x: Array, r: Array) -> float:
        """Return the natural residual, not divided by its scale. Collective.

        Args:
            x: (size,) multipliers.
            r: (size,) gradient at x.
        """
        return norm(self._problem, x - self.projection(x, r)) / self.rho

    def is_limited_by_rounding(self, residual: float) -> bool:
        """Return whether rounding may keep a residual from decreasing. Not collective.

        This is possible if the residual is small compared with its scale or with b. The size of b
        matters if the loads move the bodies much less than the width of a gap: then the scale
        follows from the loads, but rounding errors follow from the gap.
        """
        size = max(self.scale, self.rounding / ROUNDING)
        return residual <= EXHAUSTED * size

    def relative(self, residual: float) -> float:
        """Return a natural residual divided by its scale. Not collective."""
        return residual / self.scale if self.scale > 0.0 else residual
