"""The algorithms of the paper, for Tresca's law: SSN, MSSN, IMSSN and GIMSSN.

They are here for comparisons with the default method (docs/theory/algorithms.md). Each algorithm is
a function of a new `Run`, the state that its steps change, and is collective.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.tolerances import PATIENCE, PROGRESS
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.solvers.constraints import norm
from dolfinx_tresca.solvers.convergence import History, NaturalResidual, Observe
from dolfinx_tresca.solvers.problem import DualProblem, DualSolution, Point
from dolfinx_tresca.solvers.products import PRODUCT_ROUNDING, ProductStore
from dolfinx_tresca.status import ContactStatus

#: Limit on the number of products with A in an inner iteration.
MOST_PRODUCTS = 1000


def ssn(run: Run) -> DualSolution:
    """Solve lambda = P(lambda - rho r(lambda)) by Newton steps with the whole derivative of P.

    The derivative of the projection onto circles makes the systems nonsymmetric. Table 38.1 of the
    paper compares its methods with this variant. Convergence is not guaranteed.
    """
    problem = run.problem

    def step(tolerance: float) -> tuple[Array, Array]:
        # Newton's equation (I - P' (I - rho A)) change = P(y) - x for y = x - rho r, the target
        rho, y = run.history.residual.rho, run.target
        derivative = run.feasible_set.projection_derivative(y)
        change = _bicgstab(
            problem,
            lambda v: v - derivative @ (v - rho * problem.compliance.apply(v)),
            run.feasible_set.project(y) - run.x,
            rho * tolerance,  # the natural residual is divided by rho
        )
        x = run.x + change
        return x, gradient(problem, x)

    return run.iterate(step, adaptive_precision(run.history, run.options))


def mssn(run: Run) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM MSSN (section 38.3.1), with accurate inner solves.

    The inner CG iterations end at 1e-12 times the residual at the start. MSSN converges fast if
    most nodes stick, but need not; if it converges, the limit is the solution (Lemma 38.1).
    """
    return run.iterate(run.symmetrized_step, lambda: 1e-12 * run.history.residual_norms[0])


def imssn(run: Run) -> DualSolution:
    """Minimise q by ALGORITHM IMSSN: MSSN with (Step 3.1). It may cycle if many nodes stick."""
    return run.iterate(run.symmetrized_step, adaptive_precision(run.history, run.options))


def gimssn(run: Run) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM GIMSSN (section 38.4).

    Each iteration takes a gradient projection step, which alone gives the R-linear rate of
    Theorem 38.1, then CG steps of pressed and sticking nodes before one leaves Lambda. The method
    converges from any start, but slowly if many nodes slip: CG does not change directions of slip.
    """
    problem, feasible_set = run.problem, run.feasible_set

    def step(tolerance: float) -> tuple[Array, Array]:
        # the gradient projection step, with rho < 2 / sigma_max
        residual = run.history.residual
        while True:
            move = feasible_set.project(run.target) - run.x
            product = problem.compliance.apply(move)
            curvature = float(problem.inner(product, move) / problem.inner(move, move))
            if curvature * residual.rho < 2.0:
                break
            # `largest_eigenvalue` missed an eigenvalue whose vector is almost orthogonal to b
            residual.set_rho(run.options.step_factor / curvature)
        projected = run.x + move

        def feasible(change: Array) -> bool:
            moved = projected + change
            outside = moved - feasible_set.project(moved)
            # rounding alone may move the traction of a slipping node off its circle
            square = problem.inner(outside, outside)
            return bool(square <= np.finfo(float).eps ** 2 * problem.inner(moved, moved))

        # CG steps of `active` multipliers (`Face`), while all others stay
        active, r = feasible_set.face(run.target).active, run.r + product
        change, image = conjugate_gradients(problem, active, r, tolerance, feasible=feasible)
        return feasible_set.project(projected + change), r + image

    return run.iterate(step, adaptive_precision(run.history, run.options))


#: Name of a method in `SolverOptions` -> its function.
ALGORITHMS = {"gimssn": gimssn, "imssn": imssn, "mssn": mssn, "ssn": ssn}


class Run:
    """The state of a solve by an algorithm of the paper.

    Attributes:
        history: the criteria and values of all iterates, with rho from an estimate of sigma_max.
        x: (size,) multipliers, maybe outside of Lambda.
        r: (size,) their gradient A x - b.
    """

    def __init__(
        self, problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
    ) -> None:
        """Begin at the projected start, or at zero if the residual is smaller there. Collective."""
        problem.refine_b()  # every gradient contains b
        residual = NaturalResidual(problem, options.step_factor / largest_eigenvalue(problem))
        self.problem, self.options = problem, options
        self.history = History(problem, options, observe, residual)
        self.feasible_set = problem.section_at(start, -problem.b)  # the same at any point
        self.x = self.feasible_set.project(start)
        self.r = gradient(problem, self.x)
        if residual.norm_at(Point(self.x, np.empty(0), self.r)) > residual.scale:
            self.x, self.r = np.zeros_like(start), -problem.b

    @property
    def target(self) -> Array:
        """The end x - rho r (size,) of a gradient step, whose face (38.12), (38.13) steps use."""
        return self.x - self.history.residual.rho * self.r

    def iterate(
        self, step: Callable[[float], tuple[Array, Array]], precision: Callable[[], float]
    ) -> DualSolution:
        """Take steps until a status ends the iteration, and return the solution. Collective.

        Convergence is checked at the projection of x onto Lambda, which costs a product if x is
        outside of Lambda. The function `step` takes the tolerance of its inner iteration, which
        `precision` returns, and returns the next multipliers and their gradient, (size,) each.
        """
        problem, history = self.problem, self.history
        while True:
            projected, r = self.feasible_set.project(self.x), self.r
            # a slipping node that is outside its circle by rounding counts as inside
            if norm(problem, self.x - projected) > PRODUCT_ROUNDING * norm(problem, self.x):
                r = gradient(problem, projected)
            point = Point(projected, np.empty(0), r)
            status = history.check_convergence(point, problem.b_error)
            if status is None and history.is_idle(2 * PATIENCE, PROGRESS):
                status = ContactStatus.STAGNATED
            if status is not None:
                return history.solution(point, status, None)
            self.x, self.r = step(precision())

    def symmetrized_step(self, tolerance: float) -> tuple[Array, Array]:
        """Return multipliers (size,) after Steps 2 and 3 of MSSN or IMSSN, and their gradient.

        Open multipliers become zero, and slipping ones go to their circles in the directions of
        the gradient step; CG then minimises q over the multipliers of pressed and sticking nodes.
        """
        problem, target = self.problem, self.target
        face = self.feasible_set.face(target)
        fixed = np.where(face.active, self.x, self.feasible_set.project(target))
        r = self.r + problem.compliance.apply(fixed - self.x)
        change, product = conjugate_gradients(problem, face.active, r, tolerance)
        return fixed + change, r + product


def gradient(problem: DualProblem, x: Array) -> Array:
    """Return r = A x - b, without a product if x is zero. Collective."""
    if float(problem.inner(x, x)) == 0.0:
        return -problem.b
    return problem.compliance.apply(x) - problem.b


def largest_eigenvalue(problem: DualProblem) -> float:
    """Return an estimate of sigma_max from products with b, A b, A A b, ... Collective.

    The largest Ritz value is a lower bound, and is far too small if the eigenvector of the largest
    eigenvalue is almost orthogonal to b; algorithms therefore check the curvature along their
    steps. The iteration ends after an increase of less than 2 %, or after 20 products.
    """
    x: Array = problem.b if norm(problem, problem.b) > 0.0 else np.ones_like(problem.b)
    store, value = ProductStore(problem.reductions, np.ones_like(x)), 0.0
    for _ in range(20):
        product = problem.compliance.apply(x)
        store.add(x, product)
        before, value = value, store.largest_eigenvalue_estimate
        if value <= 1.02 * before:
            break
        x = np.asarray(product / norm(problem, product))
    return value or 1.0


def adaptive_precision(history: History, options: SolverOptions) -> Callable[[], float]:
    """Return a function for the norm of the residual at which the next inner iteration ends.

    This is the precision control of (Step 3.1): tol^{k+1} = min(r_tol err^k / err^0, c_fact tol^k)
    with tol^0 = r_tol / c_fact. Here r_tol and c_fact are `SolverOptions`, and err^k is the
    residual of outer iteration k. The paper does not define the reference value of the inner
    residual. Here the reference is err^0: an inner iteration ends at the norm tol^{k+1} err^0,
    which is at most r_tol times the outer residual err^k.
    """
    tolerance = options.r_tol / options.c_fact

    def following() -> float:
        nonlocal tolerance
        relative = history.residual_norms[-1] / history.residual_norms[0]
        tolerance = min(options.r_tol * relative, options.c_fact * tolerance)
        return tolerance * history.residual_norms[0]

    return following


def conjugate_gradients(
    problem: DualProblem,
    active: Mask,
    gradient: Array,
    tolerance: float,
    *,
    feasible: Callable[[Array], bool] = lambda step: True,
) -> tuple[Array, Array]:
    """Minimise q over changes s of the active multipliers, (38.14). Collective.

    The `gradient` r is that at s = 0. The iteration ends when the norm of r + A s in active rows is
    at most the tolerance, before the first s for which `feasible` is False, equally on all ranks
    (CGM_feas), or after `MOST_PRODUCTS`; the result does not say which.

    Returns:
        s (size,), zero where multipliers are not active, and A s (size,) in all rows.
    """
    step, product, direction = (np.zeros_like(gradient) for _ in range(3))
    residual, before = np.where(active, -gradient, 0.0), np.inf
    for _ in range(MOST_PRODUCTS):
        squared = float(problem.inner(residual, residual))
        if np.sqrt(squared) <= tolerance:
            break
        direction, before = residual + (squared / before) * direction, squared
        image = problem.compliance.apply(direction)
        curvature = float(problem.inner(direction, image))
        # a curvature that is not positive is rounding: A is positive definite
        if curvature <= 0.0 or not feasible(step + squared / curvature * direction):
            break
        step += squared / curvature * direction
        product += squared / curvature * image
        residual -= squared / curvature * np.where(active, image, 0.0)
    return step, product


def _bicgstab(
    problem: DualProblem, image: Callable[[Array], Array], right: Array, tolerance: float
) -> Array:
    """Return x with |right - image(x)| <= tolerance, or the best x after `MOST_PRODUCTS`.

    The method is BiCGStab (van der Vorst 1992) for the linear function `image`. Collective.
    """
    inner, x = problem.inner, np.zeros_like(right)
    direction: Array = right
    residual = shadow = right
    best, least, before = x, norm(problem, right), inner(shadow, residual)
    for _ in range(MOST_PRODUCTS // 2):
        v = image(direction)
        if least <= tolerance or before == 0.0 or inner(shadow, v) == 0.0:
            break
        alpha = before / inner(shadow, v)
        half = residual - alpha * v
        t = image(half)
        omega = inner(t, half) / (inner(t, t) or 1.0)
        x, residual = x + alpha * direction + omega * half, half - omega * t
        size = norm(problem, residual)
        if size < least:
            best, least = x, size
        if omega == 0.0 or not np.isfinite(size):
            break
        after = inner(shadow, residual)
        direction = residual + (after / before) * (alpha / omega) * (direction - omega * v)
        before = after
    return best
