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

#: Told of each iteration; its answer, the same on all ranks, says whether to stop.
Observe = Callable[[Iteration], bool]

#: Error of the iteration with which that of the mesh can be estimated, and the largest residual
#: that may be left; and the part of the mesh's error that the iteration's is at the end: where they
#: add up like orthogonal ones, it makes the whole larger by half a percent.
ROUGH, BALANCED = 0.1, 0.1

#: Relative error in the energy norm below which nothing is to gain, whatever the mesh.
FINEST = 1e-8

#: Residual that is wanted where no bound can be had and none was asked for.
UNPROVEN = 1e-6

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
        accuracy: relative error in the energy norm that is wanted now, unless residuals decide.
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
        accuracy = self.options.accuracy
        self._mesh_unknown = self.options.balanced
        self.accuracy = ROUGH if isinstance(accuracy, str) else accuracy

    def _balance(self, multipliers: Array) -> None:
        """Want the accuracy that suits the mesh from now on. Collective."""
        part = BALANCED * self.problem.discretisation_error(multipliers, self.rho)
        self.accuracy = min(max(part, FINEST), ROUGH)
        self._mesh_unknown = False

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

    def energy_error(self, multipliers: Array, r: Array, uncertainty: float = 0.0) -> float:
        """Return a bound of the displacement's relative error in the energy norm. Collective.

        Args:
            multipliers: (size,) in Lambda.
            r: (size,) the gradient there.
            uncertainty: error of r, in the norm sqrt(e'A^-1 e).
        """
        feasible_set = self.problem.feasible_set
        rigid = feasible_set.settled_motions(multipliers, r, self.rho)
        bound = self.problem.energy_bound(
            multipliers,
            r - feasible_set.rigid_jumps @ rigid,
            uncertainty + feasible_set.rigid_error(multipliers, rigid),
        )
        stretched = float(rigid @ feasible_set.rigid_stiffness @ rigid)
        norm = float(np.hypot(self.problem.energy_norm(multipliers, r), np.sqrt(stretched)))
        if bound == 0.0:
            return 0.0
        return bound / norm if norm > 0.0 else float("inf")

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
        # a scale of zero: lambda = 0 is the solution, and `better_start` begins there
        self.residuals.append(error / self.scale if self.scale > 0.0 else error)
        self.q.append(self.change_of_q(multipliers, gradient))
        reached, wanted = self.residuals[-1], self.options.rtol or UNPROVEN
        if self.options.rtol is None:
            bound = self.energy_error(multipliers, gradient, uncertainty)
            if self._mesh_unknown and bound <= ROUGH:
                self._balance(multipliers)
            if np.isfinite(bound) or not self.options.balanced:
                reached, wanted = bound, self.accuracy
            if self.options.balanced and bound <= self.accuracy and self.residuals[-1] > ROUGH:
                # most of the energy is elsewhere, and hides what happens in the contact
                reached, wanted = self.residuals[-1], ROUGH
        number = len(self.residuals) - 1
        if self.scale == 0.0 and error <= self._rounding:
            reached = 0.0
        stop = self.observe(
            Iteration(number, problem.products, self.residuals[-1], reached, wanted, self.q[-1])
        )
        if reached <= wanted:
            return ContactStatus.CONVERGED
        if stop:
            return ContactStatus.STOPPED
        if self._stagnates():
            return ContactStatus.STAGNATED
        if number >= self.options.max_iterations:
            return ContactStatus.MAX_ITERATIONS
        return None

    def _stagnates(self) -> bool:
        """Whether the last iterations moved q by rounding only and brought no smaller residual."""
        if len(self.q) <= PATIENCE:
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

    def solution(self, multipliers: Array, gradient: Array, status: ContactStatus) -> DualSolution:
        """Return the outcome with the newest iterate as answer. Collective."""
        feasible_set = self.problem.feasible_set
        rigid = feasible_set.settled_motions(multipliers, gradient, self.rho)
        return DualSolution(
            multipliers,
            rigid,
            gradient - feasible_set.rigid_jumps @ rigid,
            status,
            len(self.residuals) - 1,
            tuple(self.residuals),
            tuple(self.q),
            self.rho,
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
