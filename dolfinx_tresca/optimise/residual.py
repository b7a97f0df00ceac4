"""The natural residual: how far multipliers are from a solution of (38.4)."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.reductions import norm

#: Residual over |b| that is rounding.
RESIDUAL_ROUNDING = 64 * float(np.finfo(float).eps)

#: Residual over its scale, or over |b|, above which it is not double precision that ends progress.
EXHAUSTED = float(np.sqrt(np.finfo(float).eps))


class NaturalResidual:
    """|lambda - P(lambda - rho r)| / rho, the norm of the paper's reduced gradient.

    It is measured against its value at lambda = 0, so that it does not depend on units, on the size
    of the load, or on where the iteration starts. Where zero does not satisfy the equality
    constraints, the least lambda that does takes its place, and A lambda is the scale if that is
    larger. So it is for the lambda that a process goes on from, where the origin is nearer to a
    solution: friction may hold what no load presses.

    Attributes:
        rho: step length.
        scale: the value at the origin; zero where that is the solution.
        origin_solves: whether it is, but for rounding.
        rounding: values that are rounding.
        origin: (size,) the point of Lambda next to zero.
        origin_gradient: (size,) the gradient there.
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
            problem: (38.4).
            rho: step length.
            origin: see the class.
            origin_gradient: see the class.
            origin_error: error of the gradient at the origin, in the norm sqrt(e'A^-1 e), if the
                solver cannot reduce it further: residuals below it count as zero.
        """
        self._problem, self._error, self._counted = problem, origin_error, 0.0
        self.origin, self.origin_gradient = origin, origin_gradient
        self.set_rho(rho)

    def set_rho(self, rho: float) -> None:
        """Change the step length with which residuals are measured from now on. Collective."""
        self.rho = rho
        self.scale = max(
            self.at(self.origin, self.origin_gradient),
            # A x of the origin x, which is not zero where equality constraints move it
            norm(self._problem, self.origin_gradient + self._problem.b),
        )
        # where the constraints' multipliers c cancel b, the terms of G c are rounded as well
        constraints = self._problem.constraints
        lam = self._problem.admissible.section(self.origin)
        c = constraints.multipliers(lam, self.origin, self.origin_gradient, rho)
        moved = constraints.matrix.absolute @ np.abs(c)
        size = norm(self._problem, self._problem.b) + norm(self._problem, moved)
        self.rounding = max(RESIDUAL_ROUNDING * size, self._error / float(np.sqrt(rho)))
        self.origin_is_solution = self.scale <= self.rounding
        self.scale = max(0.0 if self.origin_is_solution else self.scale, self._counted)

    def count(self, product: Array) -> None:
        """Measure against a product A x (size,) as well, if that is larger. Collective."""
        self._counted = norm(self._problem, product)
        self.scale = max(self.scale, self._counted)

    def is_doubtful(self, error: float) -> bool:
        """Whether the origin may be the solution, or not, for all that is known. Collective.

        Args:
            error: of the gradient there, in the norm sqrt(e'A^-1 e).
        """
        # |e| is at most sqrt(sigma_max) times that norm
        largest = error / float(np.sqrt(self.rho))
        return self.scale <= largest and self.at(self.origin, self.origin_gradient - largest) > 0.0

    def projection(self, x: Array, r: Array) -> Array:
        """Return P(x - rho r), (size,), with the bounds at x: a gradient projection step.

        Collective.
        """
        constraints, lam = self._problem.constraints, self._problem.admissible.section(x)
        return constraints.project(lam, x - self.rho * r, np.zeros(len(constraints)), self.rho)[0]

    def at(self, x: Array, r: Array) -> float:
        """Return the natural residual, not divided by its scale. Collective.

        Args:
            x: (size,) multipliers.
            r: (size,) the gradient there.
        """
        return norm(self._problem, x - self.projection(x, r)) / self.rho

    def is_limited_by_rounding(self, residual: float) -> bool:
        """Whether double precision may be why a natural residual is no smaller. Not collective.

        It is small against its scale, or against b: with loads that are tiny before a gap the scale
        is theirs, and rounding that of the gap.
        """
        size = max(self.scale, self.rounding / RESIDUAL_ROUNDING)
        return residual <= EXHAUSTED * size

    def relative(self, residual: float) -> float:
        """Return a natural residual over its scale. Not collective."""
        return residual / self.scale if self.scale > 0.0 else residual
