"""The record of a solve, and the check of convergence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import FORCING
from dolfinx_tresca._base.patience import IDLE_STEPS
from dolfinx_tresca.monitor import Iteration
from dolfinx_tresca.optimise.models.products import PRODUCT_ROUNDING
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.energy import change_of_q
from dolfinx_tresca.optimise.record.residual import NaturalResidual
from dolfinx_tresca.optimise.record.stopping import Stopping
from dolfinx_tresca.optimise.reductions import norm
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
        q: q(lambda) of each iterate, minus its value at the origin of `NaturalResidual`.
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
        self._errors: list[float] = []

    @property
    def error(self) -> float:
        """The natural residual of the newest iterate, not divided by its scale."""
        return self._errors[-1]

    @property
    def first_error(self) -> float:
        """The natural residual at the start, not divided by its scale."""
        return self._errors[0]

    def check_convergence(
        self, x: Array, r: Array, error: float | None = None
    ) -> ContactStatus | None:
        """Record an iterate; return the status if the iteration ends here, else None. Collective.

        Args:
            x: (size,) multipliers in Lambda.
            r: (size,) gradient at x.
            error: error of the gradient in the norm sqrt(e'A^-1 e); None: see `error_of_product`.
        """
        problem, residual = self._problem, self.residual
        if error is None:
            error = error_of_product(problem, x, r)
        value = residual.at(x, r)
        self._errors.append(value)
        self.residuals.append(residual.relative(value))
        self.q.append(change_of_q(problem, x, r, residual.origin, residual.origin_gradient))
        reached, wanted, done = self.stopping.reached(x, r, error)
        if residual.origin_is_solution and value <= residual.rounding:
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
        if self._stagnates():
            return ContactStatus.STAGNATED
        if number >= self._options.max_iterations:
            return ContactStatus.MAX_ITERATIONS
        return None

    def _stagnates(self) -> bool:
        """Whether the last iterations changed q by rounding only and reduced no residual."""
        if len(self.q) <= IDLE_STEPS:
            return False
        recent = self.q[-IDLE_STEPS - 1 :]
        flat = max(recent) - min(recent) <= 8 * np.finfo(float).eps * abs(recent[-1])
        return bool(flat) and min(self.residuals[-IDLE_STEPS:]) >= min(self.residuals[:-IDLE_STEPS])

    def check_convergence_of_projection(
        self, x: Array, r: Array
    ) -> tuple[ContactStatus | None, Array, Array]:
        """Check the convergence of the projection P(x) of an iterate onto Lambda. Collective.

        Returns:
            the status, or None if the iteration goes on; P(x); and the gradient at P(x), which
            costs a product if P(x) differs from x.
        """
        problem = self._problem
        projected = problem.feasible_set.project(x)
        # a slipping node that is outside its circle by rounding counts as inside
        rounding = PRODUCT_ROUNDING * norm(problem, x)
        if norm(problem, x - projected) > rounding:
            r = gradient(problem, projected)
        return self.check_convergence(projected, r), projected, r

    def solution(
        self, x: Array, r: Array, status: ContactStatus, error: float | None = None
    ) -> DualSolution:
        """Return the result with the last iterate as the solution. Collective.

        Args:
            x: (size,) multipliers in Lambda.
            r: (size,) gradient at x.
            status: reason for the end of the iteration.
            error: error of the gradient in the norm sqrt(e'A^-1 e); None: see `error_of_product`.
        """
        problem, rho = self._problem, self.residual.rho
        lam = problem.admissible.at(x, r, rho).section(x)
        c = problem.constraints.multipliers(lam, x, r, rho)
        return DualSolution(
            multipliers=x,
            c=c,
            gradient=r - problem.constraints.columns @ c,
            status=status,
            iterations=len(self.residuals) - 1,
            residuals=tuple(self.residuals),
            q=tuple(self.q),
            rho=rho,
            wanted=self.stopping.accuracy,
            # the displacement is computed after the last check of convergence: with an error as
            # large as the tolerable error, its error bound could exceed the bound that was checked
            accuracy=None
            if error is None
            else max(error, FORCING * self.stopping.tolerable_error(x, r)),
        )


def error_of_product(problem: DualProblem, x: Array, r: Array) -> float:
    """Return an estimate of the error of r = A x - b if `apply` has computed A x. Collective.

    The error is measured in the norm sqrt(e'A^-1 e) and includes the error of b.
    """
    energy = float(problem.inner(x, r + problem.b))
    return (
        problem.operator.product_error * float(np.sqrt(max(energy, 0.0))) + problem.response.b_error
    )


def gradient(problem: DualProblem, x: Array) -> Array:
    """Return r = A x - b, without a product if x is zero. Collective."""
    if float(problem.inner(x, x)) == 0.0:
        return -problem.b
    return problem.operator.apply(x) - problem.b
