"""The outer loop's bookkeeping: residuals, when to stop, what to report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.monitor import Iteration
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.solvers.problem import ContactStatus, DualProblem, DualSolution
from dolfinx_tresca.solvers.spectrum import largest_eigenvalue
from dolfinx_tresca.solvers.stopping import FINEST, UNPROVEN, Stopping

#: Told of each iteration; its answer, the same on all ranks, says whether to stop.
Observe = Callable[[Iteration], bool]

#: Error of the gradient at the end, over what is wanted.
FINAL = 0.1

#: Residual over |b| that is rounding.
ROUNDING = 64 * float(np.finfo(float).eps)

#: Iterations without any progress after which double precision counts as exhausted.
PATIENCE = 8


@dataclass
class History:
    """Judges the iterates of one solve.

    The natural residual |lambda - P(lambda - rho r)| / rho (the norm of the reduced gradient of the
    paper) is measured against its value at lambda = 0, so that it does not depend on units, on the
    size of the load, or on where the iteration starts. Where bodies float, and zero does not
    balance the loads, the least lambda that does takes its place, and A lambda is the scale if that
    is larger.

    Attributes:
        origin: (size,) the point of Lambda next to zero.
        origin_gradient: (size,) the gradient there.
        residuals: natural residuals over their scale, of each iterate.
        errors: the same, not divided.
        q: q(lambda) of each iterate, less its value at the origin.
        stopping: when it is enough.
    """

    problem: DualProblem
    options: SolverOptions
    observe: Observe
    rho: float
    origin: Array
    origin_gradient: Array
    residuals: list[float] = field(default_factory=list)
    q: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.set_rho(self.rho)
        self.stopping = Stopping(self.problem, self.options)
        self._resumed = 0

    def set_rho(self, rho: float) -> None:
        """Change the step length with which residuals are measured from now on. Collective."""
        self.rho = rho
        self.scale = max(
            self.natural_residual(self.origin, self.origin_gradient),
            # where loads must be balanced: of no effect at zero
            self.norm(self.origin_gradient + self.problem.b),
        )
        # nothing is loaded: bodies that float move as a whole at most
        self._rounding = ROUNDING * self.norm(self.problem.b)
        springs = self.problem.feasible_set.rigid_stiffness.any()
        if self.scale <= self._rounding and not springs:
            self.scale = 0.0

    def norm(self, v: Array) -> float:
        """Return the Euclidean norm of v over all ranks."""
        return float(np.sqrt(self.problem.inner(v, v)))

    def natural_residual(self, multipliers: Array, r: Array) -> float:
        """Return |lambda - P(lambda - rho r)| / rho, not divided by its scale. Collective."""
        moved = self.gradient_projection(multipliers, r)
        return self.norm(multipliers - moved) / self.rho

    def gradient_projection(self, multipliers: Array, r: Array) -> Array:
        """Return P(lambda - rho r). Collective."""
        feasible_set = self.problem.feasible_set
        still = np.zeros(feasible_set.rigid_jumps.shape[1])
        return feasible_set.project_balanced(multipliers - self.rho * r, still, self.rho)[0]

    def change_of_q(self, multipliers: Array, r: Array) -> float:
        """Return q less its value at the origin, which is zero where no body is loose."""
        way, feasible_set = multipliers - self.origin, self.problem.feasible_set
        change = 0.5 * float(self.problem.inner(way, r + self.origin_gradient))
        springs = feasible_set.rigid_work(self.origin, way)
        return change + springs + 0.5 * feasible_set.rigid_curvature(way)

    def better_start(self, multipliers: Array, r: Array) -> tuple[Array, Array]:
        """Return a start and its gradient, or the origin and its own where that is better.

        It is after the load has been taken away, say: where nothing presses, zero is the solution.
        Collective.
        """
        if self.natural_residual(multipliers, r) > self.scale:
            return self.origin, self.origin_gradient
        return multipliers, r

    @property
    def error(self) -> float:
        """The natural residual of the newest iterate, not divided by its scale."""
        return self.errors[-1]

    @property
    def first_error(self) -> float:
        """The natural residual at the start, not divided by its scale."""
        return self.errors[0]

    def energy_error(
        self, multipliers: Array, r: Array, rigid: Array, uncertainty: float = 0.0
    ) -> float:
        """Return a bound of the displacement's relative error in the energy norm. Collective.

        Args:
            multipliers: (size,) in Lambda.
            r: (size,) the gradient there.
            rigid: (k,) the motions that belong to them.
            uncertainty: error of r, in the norm sqrt(e'A^-1 e).
        """
        feasible_set = self.problem.feasible_set
        bound = self.problem.energy_bound(
            multipliers,
            r - feasible_set.rigid_jumps @ rigid,
            uncertainty + feasible_set.rigid_error(multipliers, rigid),
        )
        norm = self.energy_norm(multipliers, r, rigid)
        if bound == 0.0:
            return 0.0
        return bound / norm if norm > 0.0 else float("inf")

    def energy_norm(self, multipliers: Array, r: Array, rigid: Array) -> float:
        """Return |u|_K of the displacement that belongs to multipliers and motions. Collective."""
        stretched = float(rigid @ self.problem.feasible_set.rigid_stiffness @ rigid)
        return float(np.hypot(self.problem.energy_norm(multipliers, r), np.sqrt(stretched)))

    def rigid_motions(self, multipliers: Array, r: Array) -> Array:
        """Return the motions of loose bodies that belong to an iterate. Collective."""
        return self.problem.feasible_set.settled_motions(multipliers, r, self.rho)

    def reached(
        self, multipliers: Array, r: Array, uncertainty: float
    ) -> tuple[float, float, bool]:
        """Return what is reached, what is wanted, and whether that is all. Collective.

        Args:
            multipliers: (size,) in Lambda.
            r: (size,) the gradient there.
            uncertainty: error of r, in the norm sqrt(e'A^-1 e).
        """
        rigid = self.rigid_motions(multipliers, r)
        residual = self.natural_residual(multipliers, r)
        reached, wanted = np.inf, 1.0
        for reached, wanted in self.stopping.measures(
            multipliers,
            r - self.problem.feasible_set.rigid_jumps @ rigid,
            self.rho,
            self.relative(residual),
            lambda: self.energy_error(multipliers, r, rigid, uncertainty),
        ):
            if not reached <= wanted:
                return reached, wanted, residual == 0.0
        return reached, wanted, True

    def tolerable_error(self, multipliers: Array, r: Array) -> float:
        """Return the error that the last gradient may have, in the norm sqrt(e'A^-1 e). Collective.

        Small against the error of the multipliers, since what nodes want is judged by it.
        """
        rigid = self.rigid_motions(multipliers, r)
        norm = self.energy_norm(multipliers, r, rigid)
        if norm == 0.0:  # nothing to measure errors by
            return 0.0
        reached = self.energy_error(multipliers, r, rigid)
        error = max(min(self.stopping.accuracy, reached), FINEST) * norm
        if self.options.rtol is not None or not np.isfinite(error):
            error = min(error, self.residual_error)
        return FINAL * error

    @property
    def residual_error(self) -> float:
        """Error of a gradient, in that norm, that is the wanted residual."""
        rtol = UNPROVEN if self.options.rtol is None else self.options.rtol
        # the norm is at least |e| / sqrt(sigma_max)
        return rtol * self.scale * float(np.sqrt(self.rho / self.options.step_factor))

    def relative(self, residual: float) -> float:
        """Return a natural residual over its scale."""
        # a scale of zero: lambda = 0 is the solution
        return residual / self.scale if self.scale > 0.0 else residual

    def judge(
        self, multipliers: Array, gradient: Array, uncertainty: float | None = None
    ) -> ContactStatus | None:
        """Record an iterate and say whether the iteration ends with it. Collective.

        Args:
            multipliers: (size,) in Lambda.
            gradient: (size,) there.
            uncertainty: error of the gradient, in the norm sqrt(e'A^-1 e); None: that of a product.
        """
        problem = self.problem
        if uncertainty is None:
            energy = float(problem.inner(multipliers, gradient + problem.b))
            uncertainty = problem.product_error * float(np.sqrt(max(energy, 0.0)))
        error = self.natural_residual(multipliers, gradient)
        self.errors.append(error)
        self.residuals.append(self.relative(error))
        self.q.append(self.change_of_q(multipliers, gradient))
        reached, wanted, done = self.reached(multipliers, gradient, uncertainty)
        if self.scale == 0.0 and error <= self._rounding:
            reached, done = 0.0, True
        number = len(self.residuals) - 1
        stop = self.observe(
            Iteration(number, problem.products, self.residuals[-1], reached, wanted, self.q[-1])
        )
        if done:
            return ContactStatus.CONVERGED
        if stop:
            return ContactStatus.STOPPED
        if self._stagnates():
            return ContactStatus.STAGNATED
        if number >= self.options.max_iterations:
            return ContactStatus.MAX_ITERATIONS
        return None

    def resume(self) -> None:
        """Go on after the iteration stagnated: what follows is judged by itself."""
        self._resumed = len(self.q)

    def _stagnates(self) -> bool:
        """Whether the last iterations moved q by rounding only and brought no smaller residual."""
        if len(self.q) <= self._resumed + PATIENCE:
            return False
        recent = self.q[-PATIENCE - 1 :]
        flat = max(recent) - min(recent) <= 8 * np.finfo(float).eps * abs(recent[-1])
        return bool(flat) and min(self.residuals[-PATIENCE:]) >= min(self.residuals[:-PATIENCE])

    def judge_projection(
        self, multipliers: Array, r: Array
    ) -> tuple[ContactStatus | None, Array, Array]:
        """Judge P(multipliers); return it with its gradient: a product if it moved. Collective."""
        projected = self.problem.feasible_set.project(multipliers)
        # a slipping node may be an ulp outside its circle: that is no move
        rounding = 4 * np.finfo(float).eps * self.norm(multipliers)
        if self.norm(multipliers - projected) > rounding:
            r = gradient(self.problem, projected)
        return self.judge(projected, r), projected, r

    def solution(
        self, multipliers: Array, gradient: Array, status: ContactStatus, error: float | None = None
    ) -> DualSolution:
        """Return the outcome with the newest iterate as answer. Collective.

        Args:
            multipliers: (size,) in Lambda.
            gradient: (size,) there.
            status: how the iteration ended.
            error: of the gradient, in the norm sqrt(e'A^-1 e); None: that of a product.
        """
        feasible_set = self.problem.feasible_set
        rigid = self.rigid_motions(multipliers, gradient)
        accuracy = None
        if error is not None:
            accuracy = FINAL * self.tolerable_error(multipliers, gradient)
        return DualSolution(
            multipliers,
            rigid,
            gradient - feasible_set.rigid_jumps @ rigid,
            status,
            len(self.residuals) - 1,
            tuple(self.residuals),
            tuple(self.q),
            self.rho,
            self.stopping.accuracy,
            accuracy,
        )


def gradient(problem: DualProblem, multipliers: Array) -> Array:
    """Return r = A lambda - b; without a product where lambda is zero. Collective."""
    if float(problem.inner(multipliers, multipliers)) == 0.0:
        return -problem.b
    return problem.apply(multipliers) - problem.b


def begin(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> tuple[History, Array, Array]:
    """Return the history with rho from an estimate of sigma_max, a start, and its gradient.

    Collective.
    """
    rho = options.step_factor / largest_eigenvalue(problem)
    history = History(problem, options, observe, rho, np.zeros_like(start), -problem.b)
    multipliers = problem.feasible_set.project(start)
    return history, *history.better_start(multipliers, gradient(problem, multipliers))
