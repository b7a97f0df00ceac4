"""When an iteration has converged: the natural residual, the criteria, and all iterates' values."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.tolerances import FORCING
from dolfinx_tresca.monitor import Iteration
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.solvers.constraints import norm
from dolfinx_tresca.solvers.problem import DualProblem, DualSolution, Point
from dolfinx_tresca.status import ContactStatus

#: Largest residual, relative to the larger of its scale and `terms`, that may stall by rounding.
EXHAUSTED = float(np.sqrt(np.finfo(float).eps))


class NaturalResidual:
    """The residual |lambda - P(lambda - rho r)| / rho, the norm of the paper's reduced gradient.

    With equality constraints, |e - G'lambda - S c| / rho is the other component of the residual.
    The relative residual is this residual divided by its scale. The scale is the residual at
    lambda = 0, so that the relative residual does not depend on units, on the size of the load, or
    on the initial guess. In a load step with Coulomb's law the residual of the initial multipliers
    x may be larger, as in a wedge without load; the scale is then at least |A x|.

    Attributes:
        rho: length of the gradient step in the residual, `step_factor` / sigma_max of A.
        scale: the divisor of relative residuals, see above.
        least_scale: lower bound of the scale; 0 unless a load step sets it to |A x|.
        zero: the point lambda = 0, with the constraints' present multipliers.
        zero_is_solution: whether the residual at lambda = 0 is rounding.
        rounding: largest residual that counts as rounding.
        terms: norm of the terms of b before they cancel. It is much larger than the scale if the
            loads move bodies much less than the width of a gap.
    """

    def __init__(self, problem: DualProblem, rho: float, error: float = 0.0) -> None:
        """Measure the scale. Collective.

        The `error` is that of b in the norm sqrt(e'A^-1 e), if the solver for K cannot reduce it:
        residuals below it count as zero. By default, only rounding counts as zero.
        """
        self._problem, self._error = problem, error
        self.rho, self.least_scale = rho, 0.0
        self.set_constraint_multipliers(np.zeros(len(problem.constraints)))

    def set_constraint_multipliers(self, c: Array) -> None:
        """Measure the scale with multipliers c (k,): the gradient at 0 is -b - G c. Collective."""
        b = self._problem.b
        self.zero = Point(np.zeros_like(b), c, -b - self._problem.constraints.columns @ c)
        self.set_rho(self.rho)

    def set_rho(self, rho: float) -> None:
        """Change the step length of residuals, and their scale and rounding errors. Collective."""
        self.rho = rho
        at_zero = self.norm_at(self.zero)
        # the constraints' multipliers c may cancel b: the terms of G c have rounding errors as well
        constraint_terms = self._problem.constraints.absolute @ np.abs(self.zero.c)
        self.terms = norm(self._problem, self._problem.b_terms)
        all_terms = self.terms + norm(self._problem, constraint_terms)
        # the gradient's error e has |e| <= sqrt(sigma_max) sqrt(e'A^-1 e), rho ~ 1 / sigma_max
        self.rounding = max(ROUNDING * all_terms, self._error / float(np.sqrt(rho)))
        self.zero_is_solution = at_zero <= self.rounding
        scale = 0.0 if self.zero_is_solution else at_zero
        self.scale = max(scale, self.least_scale)

    def zero_is_undecided(self, error: float) -> bool:
        """Return whether the gradient is too inaccurate to decide if zero is the solution.

        The `error` e is given in the norm sqrt(e'A^-1 e). Zero is undecided if its residual is at
        most |e|, and gradients that are lower by |e| in each row cause a pressure. Collective.
        """
        bound = error / float(np.sqrt(self.rho))  # of |e|, as in `set_rho`
        lowered = Point(self.zero.x, self.zero.c, self.zero.r - bound)
        return self.scale <= bound and self.norm_at(lowered) > 0.0

    def norm_at(self, point: Point) -> float:
        """Return the natural residual, not divided by its scale. Collective."""
        problem, x, r = self._problem, point.x, point.r
        projected = problem.section_at(x, r).project(x - self.rho * r)
        change = norm(problem, x - projected)
        unbalanced = np.linalg.norm(problem.constraints.residual(x, point.c))
        return float(np.hypot(change, unbalanced)) / self.rho

    def relative(self, residual: float) -> float:
        """Return a natural residual divided by its scale. Not collective."""
        return residual / self.scale if self.scale > 0.0 else residual


def energy_norm(problem: DualProblem, point: Point, error: float = 0.0) -> float:
    """Return the root of |u|_K^2 + c'S c [energy^(1/2)] for the displacement u. Collective.

    If the `error` of u may hide |u|_K (`DualProblem.energy_norm`), |u|_K counts as 0.
    """
    constraints, c = problem.constraints, point.c
    soft = float(c @ constraints.softness @ c)
    elastic = problem.energy_norm(point.x, point.r + constraints.columns @ c, error)
    return float(np.hypot(elastic, np.sqrt(max(soft, 0.0))))


def energy_error(problem: DualProblem, point: Point, error: float = 0.0) -> float:
    """Return a bound of the relative energy error; `error` is the gradient's. Collective."""
    missing = problem.constraints.soft_violation(point.x, point.c)
    bound = problem.energy_bound(point.x, point.r, error + missing)
    return relative_error(problem, bound, energy_norm(problem, point, error))


def relative_error(problem: DualProblem, bound: float, displacement_norm: float) -> float:
    """Return an error bound divided by the norm of the displacement; 0 if both are rounding.

    If the contact carries all loads and no body deforms, the displacement and its error are both
    only rounding errors of displacements that cancel, and their ratio has no meaning. Collective.
    """
    if bound == 0.0 or max(bound, displacement_norm) <= problem.energy_resolution():
        return 0.0
    return bound / displacement_norm if displacement_norm > 0.0 else float("inf")


#: `SMALLEST_TOLERANCE` is the least relative energy error that is requested if the mesh's error
#: determines the request. With `rtol`, the mesh's error is not estimated if the relative energy
#: error is below `BELOW_ANY_MESH`, since every mesh has a larger error.
SMALLEST_TOLERANCE, BELOW_ANY_MESH = 1e-8, 1e-4

#: Largest accepted residual of the equality constraints, relative to their terms.
BALANCED = 1e-10

#: Requested residual if there is no bound of the energy error and the user set no `rtol`.
UNPROVEN = 1e-6

#: Function that is called with each iterate. It returns whether to stop, equally on all ranks.
Observe = Callable[[Iteration], bool]


class History:
    """Checks the convergence of each iterate of a solve, and records residuals and energies.

    Floating bodies must be in equilibrium. With `accuracy=`, only the bound of the energy error is
    checked besides. By default, the requested energy error is a part of the discretisation error,
    and the traction of every node must be near its local minimiser (`DualProblem.local_error`),
    since energies say little about peaks and states. With `rtol=`, the residual is checked in
    addition: of slender bodies, the energy error may be large although the residual is small.

    Attributes:
        accuracy: relative error in the energy norm that is requested; inf: not yet known.
        residuals: relative natural residual of each iterate.
        q: q(lambda) of each iterate, with the energy of soft constraints.
        residual_norms: natural residual of each iterate, not divided by its scale.
    """

    def __init__(
        self,
        problem: DualProblem,
        options: SolverOptions,
        observe: Observe,
        residual: NaturalResidual,
    ) -> None:
        """Begin without iterates; `accuracy` is inf if the mesh is to decide. Not collective."""
        self._problem, self._options, self._observe = problem, options, observe
        self.residual = residual
        given, rtol = options.accuracy, options.rtol
        self.accuracy = np.inf if isinstance(given, str) or rtol else given
        self._mesh_decides = self.accuracy == np.inf
        self.residuals: list[float] = []
        self.q: list[float] = []
        self.residual_norms: list[float] = []

    def check_convergence(self, point: Point, error: float) -> ContactStatus | None:
        """Record an iterate; return the status if the iteration ends, else None. Collective."""
        problem, constraints, c = self._problem, self._problem.constraints, point.c
        residual_norm = self.residual.norm_at(point)
        relative = self.residual.relative(residual_norm)
        # q = x'A x / 2 - b'x, plus the energy c'S c / 2 of soft constraints
        image = point.r + constraints.columns @ c - problem.b  # A x - 2 b, since r = A x - b - G c
        q = 0.5 * (float(problem.inner(point.x, image)) + float(c @ constraints.softness @ c))
        self.residual_norms.append(residual_norm)
        self.residuals.append(relative)
        self.q.append(q)
        reached, wanted, done = self.reached(point, error, residual_norm)
        number = len(self.residuals) - 1
        products = problem.compliance.products
        stop = self._observe(Iteration(number, products, relative, reached, wanted, q))
        if done:
            return ContactStatus.CONVERGED
        if stop:
            return ContactStatus.STOPPED
        if number >= self._options.max_iterations:
            return ContactStatus.MAX_ITERATIONS
        return None

    def is_idle(self, iterations: int, progress: float, since: int = 0) -> bool:
        """Return whether residuals have hardly decreased in the last `iterations`. Not collective.

        This is so if the least residual of these iterations exceeds `progress` times the least
        residual before them. Iterates before the one with the index `since` do not count.
        """
        residuals = self.residuals[since:]
        if len(residuals) <= iterations:
            return False
        return min(residuals[-iterations:]) > progress * min(residuals[:-iterations])

    def solution(self, point: Point, status: ContactStatus, error: float | None) -> DualSolution:
        """Return the result with the last iterate as the solution. Collective.

        The `error` is that of the gradient in the norm sqrt(e'A^-1 e); None: unknown.
        """
        # the displacement is computed after the last check of convergence: with an error as large
        # as the tolerable error, its error bound could exceed the bound that was checked; the
        # displacement of the last gradient, with its `error`, may always stay
        tolerance = None if error is None else max(error, FORCING * self.tolerable_error(point))
        return DualSolution(
            multipliers=point.x,
            c=point.c,
            gradient=point.r,
            status=status,
            iterations=len(self.residuals) - 1,
            residuals=tuple(self.residuals),
            q=tuple(self.q),
            rho=self.residual.rho,
            wanted=self.accuracy,
            displacement_tolerance=tolerance,
        )

    def reached(self, point: Point, error: float, residual: float) -> tuple[float, float, bool]:
        """Return the reached and the requested accuracy, and whether the iterate is good enough.

        The two numbers belong to the first criterion that is not met; if all criteria are met, they
        belong to the last criterion. Unless the user set `accuracy=`, the first call that meets the
        energy error `FORCING` sets `accuracy` from the mesh's error. An iterate whose residual is
        exactly zero is always good enough, since no step would change it. Collective.

        The `error` is that of the gradient; the `residual` is not divided by its scale.
        """
        reached, wanted = 0.0, 1.0  # the result if there is no criterion
        for reached, wanted in self.measures(point, error, residual):
            if not reached <= wanted:
                return reached, wanted, residual == 0.0
        return reached, wanted, True

    def measures(
        self, point: Point, error: float, residual: float
    ) -> Iterator[tuple[float, float]]:
        """Yield the reached and the requested value of each criterion in turn. Collective.

        A criterion is computed only if the caller asks for it, after the earlier criteria are met.
        If the residual is rounding, equilibrium is not checked; nor is anything if, besides, zero
        is the solution, or the user gave neither a number for `accuracy=` nor `rtol=`.
        """
        problem, rtol, x, r = self._problem, self._options.rtol, point.x, point.r
        user_asks = rtol is not None or not self._mesh_decides
        is_rounding = residual <= self.residual.rounding
        if is_rounding and (self.residual.zero_is_solution or not user_asks):
            return
        if not is_rounding:
            yield problem.constraints.imbalance(x, point.c), BALANCED
        if rtol is not None:
            yield self.residual.relative(residual), rtol
        bound = energy_error(problem, point, error)
        if not self._mesh_decides:
            yield bound, self.accuracy
            return
        yield problem.local_error(x, r), self._options.local_accuracy
        # the relative bound is infinite if there is no bound, or while |u|_K is below its error
        if np.isfinite(bound) or np.isfinite(problem.energy_bound(x, r, error)):
            if self.accuracy == np.inf:
                yield bound, FORCING  # before the error of the mesh is estimated
                if rtol is None or bound > BELOW_ANY_MESH:
                    mesh = problem.discretisation_error(x, point.c)
                    wanted = max(self._options.mesh_part * mesh, SMALLEST_TOLERANCE)
                    self.accuracy = min(wanted, FORCING)
            if self.accuracy < np.inf:
                yield bound, self.accuracy
        elif rtol is None:
            yield self.residual.relative(residual), UNPROVEN

    def tolerable_error(self, point: Point) -> float:
        """Return the tolerable error of the last gradient, in the norm sqrt(e'A^-1 e). Collective.

        It is small compared with the error of the displacement, or with the residual that `rtol`
        requests, since the criteria of convergence are computed from the gradient.
        """
        displacement_norm = energy_norm(self._problem, point)
        if displacement_norm == 0.0:  # no relative error
            return 0.0
        relative = min(self.accuracy, energy_error(self._problem, point))
        error = max(relative, SMALLEST_TOLERANCE) * displacement_norm
        if self._options.rtol is not None or not np.isfinite(error):
            error = min(error, self.residual_error)
        return FORCING * error

    @property
    def residual_error(self) -> float:
        """The largest tolerable norm sqrt(e'A^-1 e) of an error e of the gradient.

        The Euclidean norm |e| <= sqrt(sigma_max) sqrt(e'A^-1 e) is then at most the requested
        residual, since rho is `step_factor` / sigma_max.
        """
        rtol = UNPROVEN if self._options.rtol is None else self._options.rtol
        rho = self.residual.rho
        return rtol * self.residual.scale * float(np.sqrt(rho / self._options.step_factor))
