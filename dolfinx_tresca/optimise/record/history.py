"""The record of a solve, and the check of convergence."""

from __future__ import annotations

from collections.abc import Callable

from dolfinx_tresca._base.forcing import FORCING
from dolfinx_tresca.monitor import Iteration
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution, Point
from dolfinx_tresca.optimise.record.energy import dual_energy
from dolfinx_tresca.optimise.record.residual import NaturalResidual
from dolfinx_tresca.optimise.record.stopping import Stopping
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus

#: Function that is called with each iterate, the first one included. It returns whether to stop,
#: with the same result on all ranks.
Observe = Callable[[Iteration], bool]


class History:
    """Checks the convergence of each iterate of a solve, and records residuals and energies.

    Attributes:
        residual: natural residual and its scale.
        stopping: criterion of convergence.
        residuals: relative natural residual of each iterate.
        q: q(lambda) of each iterate, with the energy of soft constraints.
        errors: natural residual of each iterate, not divided by its scale.
    """

    def __init__(
        self,
        problem: DualProblem,
        options: SolverOptions,
        observe: Observe,
        residual: NaturalResidual,
    ) -> None:
        """Begin a solve. Not collective."""
        self._problem, self._options, self._observe = problem, options, observe
        self.residual = residual
        self.stopping = Stopping(problem, options, residual)
        self.residuals: list[float] = []
        self.q: list[float] = []
        self.errors: list[float] = []

    @property
    def error(self) -> float:
        """The natural residual of the newest iterate, not divided by its scale."""
        return self.errors[-1]

    def check_convergence(self, point: Point, error: float) -> ContactStatus | None:
        """Record an iterate; return the status if the iteration ends here, else None. Collective.

        Args:
            point: multipliers in Lambda, with their gradient.
            error: error of the gradient in the norm sqrt(e'A^-1 e).
        """
        problem, residual = self._problem, self.residual
        value = residual.at(point)
        self.errors.append(value)
        self.residuals.append(residual.relative(value))
        self.q.append(dual_energy(problem, point))
        reached, wanted, done = self.stopping.reached(point, error)
        if residual.zero_is_solution and value <= residual.rounding:
            reached, done = 0.0, True
        number = len(self.residuals) - 1
        stop = self._observe(
            Iteration(
                number, problem.operator.products, self.residuals[-1], reached, wanted, self.q[-1]
            )
        )
        if done:
            return ContactStatus.CONVERGED
        if stop:
            return ContactStatus.STOPPED
        if number >= self._options.max_iterations:
            return ContactStatus.MAX_ITERATIONS
        return None

    def is_idle(self, number: int, progress: float, since: int = 0) -> bool:
        """Return whether residuals have not decreased in the last iterations. Not collective.

        Args:
            number: number of iterations.
            progress: ratio of two residuals that counts as a decrease.
            since: number of the first iterate that counts.
        """
        residuals = self.residuals[since:]
        return len(residuals) > number and (
            min(residuals[-number:]) > progress * min(residuals[:-number])
        )

    def solution(self, point: Point, status: ContactStatus, error: float | None) -> DualSolution:
        """Return the result with the last iterate as the solution. Collective.

        Args:
            point: multipliers in Lambda, with their gradient.
            status: reason for the end of the iteration.
            error: error of the gradient in the norm sqrt(e'A^-1 e); None: unknown.
        """
        return DualSolution(
            multipliers=point.x,
            c=point.c,
            gradient=point.r,
            status=status,
            iterations=len(self.residuals) - 1,
            residuals=tuple(self.residuals),
            q=tuple(self.q),
            rho=self.residual.rho,
            wanted=self.stopping.accuracy,
            # the displacement is computed after the last check of convergence: with an error as
            # large as the tolerable error, its error bound could exceed the bound that was checked
            accuracy=None
            if error is None
            else max(error, FORCING * self.stopping.tolerable_error(point)),
        )
