"""The algorithms of the paper, for Tresca's law: SSN, MSSN, IMSSN and GIMSSN.

They are here for comparisons with the default method (docs/theory/algorithms.md). All have the same
signature, and all are collective.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh_tridiagonal

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.history import History, Observe, gradient
from dolfinx_tresca.optimise.record.residual import NaturalResidual
from dolfinx_tresca.optimise.reductions import norm
from dolfinx_tresca.options import SolverOptions

#: Inner residual of "exact" solves, divided by the outer residual at the start.
INNER_RESIDUAL = 1e-12


def ssn(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Solve lambda = P(lambda - rho r(lambda)) by Newton steps with the full slanting function.

    The full derivative of the projection onto the circle makes the systems non-symmetric. Table
    38.1 of the paper compares its methods with this variant. Convergence is not guaranteed.

    Collective.
    """
    feasible_set = problem.feasible_set
    history, multipliers, r = begin(problem, start, options, observe)
    precision = adaptive_precision(history, options)
    while True:
        status, projected, r_projected = history.check_convergence_of_projection(multipliers, r)
        if status is not None:
            return history.solution(projected, r_projected, status)
        y = multipliers - history.residual.rho * r
        derivative = feasible_set.projection_derivative(y)

        def image(v: Array, derivative: Callable[[Array], Array] = derivative) -> Array:
            return v - derivative(v - history.residual.rho * problem.operator.apply(v))

        step = _bicgstab(
            problem,
            image,
            feasible_set.project(y) - multipliers,
            history.residual.rho * precision(),
        )
        multipliers = multipliers + step
        r = gradient(problem, multipliers)


def mssn(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM MSSN (section 38.3.1), with accurate inner solves.

    The inner CG iterations end at 1e-12 times the residual at the start. The method converges fast
    if most nodes stick. Convergence is not guaranteed: Lemma 38.1 only states that the limit, if
    there is one, is the solution. Collective.
    """
    return _iterate(
        problem,
        start,
        options,
        observe,
        lambda history: lambda: INNER_RESIDUAL * history.first_error,
    )


def imssn(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM IMSSN: MSSN with the precision control of (Step 3.1).

    The method is fast if it converges, but may cycle if many nodes stick. Collective.
    """
    return _iterate(
        problem, start, options, observe, lambda history: adaptive_precision(history, options)
    )


def _iterate(
    problem: DualProblem,
    start: Array,
    options: SolverOptions,
    observe: Observe,
    precision: Callable[[History], Callable[[], float]],
) -> DualSolution:
    """Run Steps 1 to 4 of the paper's algorithm. Collective.

    `precision(history)` is a function that returns the tolerance of the next inner iteration each
    time it is called.
    """
    feasible_set = problem.feasible_set
    history, multipliers, r = begin(problem, start, options, observe)
    tolerance = precision(history)
    while True:
        status, projected, r_projected = history.check_convergence_of_projection(multipliers, r)
        if status is not None:
            return history.solution(projected, r_projected, status)
        target = multipliers - history.residual.rho * r
        face = feasible_set.face(target)
        fixed = np.where(face.active, multipliers, feasible_set.project(target))
        r = r + problem.operator.apply(fixed - multipliers)
        step, product = conjugate_gradients(problem, face.active, r, tolerance())
        multipliers, r = fixed + step, r + product


def gimssn(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM GIMSSN (section 38.4).

    Each iteration takes a gradient projection step, which alone gives the R-linear rate of
    Theorem 38.1, then CG steps on the free multipliers until one leaves Lambda. The method
    converges from any start, but slowly if many nodes slip: CG does not change directions of slip.

    Collective.
    """
    feasible_set = problem.feasible_set
    history, multipliers, r = begin(problem, start, options, observe)
    precision = adaptive_precision(history, options)
    while (status := history.check_convergence(multipliers, r)) is None:
        target = multipliers - history.residual.rho * r
        projected = feasible_set.project(target)
        move = projected - multipliers
        product = problem.operator.apply(move)
        curvature = float(problem.inner(product, move) / problem.inner(move, move))
        # the Lanczos iteration missed an eigenvalue whose eigenvector is almost orthogonal to b
        if curvature * history.residual.rho >= 2.0:
            history.residual.set_rho(options.step_factor / curvature)
            continue
        active = feasible_set.face(target).active
        r = r + product

        def feasible(step: Array, base: Array = projected) -> bool:
            moved = base + step
            outside = moved - feasible_set.project(moved)
            # rounding alone may move the traction of a slipping node off its circle
            return bool(
                problem.inner(outside, outside)
                <= np.finfo(float).eps ** 2 * problem.inner(moved, moved)
            )

        step, product = conjugate_gradients(problem, active, r, precision(), feasible=feasible)
        multipliers, r = feasible_set.project(projected + step), r + product
    return history.solution(multipliers, r, status)


def begin(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> tuple[History, Array, Array]:
    """Begin a solve by an algorithm of the paper. Collective.

    Returns:
        the history, with rho from an estimate of sigma_max; the first multipliers (size,); and the
        gradient at them. The first multipliers are the projected start, or zero if the residual at
        zero is smaller, for example after the load was removed.
    """
    problem.response.refine_b()  # every gradient contains b
    rho = options.step_factor / largest_eigenvalue(problem)
    zero, at_zero = np.zeros_like(start), -problem.b
    residual = NaturalResidual(problem, rho, zero, at_zero)
    history = History(problem, options, observe, residual)
    x = problem.feasible_set.project(start)
    r = gradient(problem, x)
    if residual.at(x, r) > residual.scale:
        x, r = zero, at_zero
    return history, x, r


def largest_eigenvalue(problem: DualProblem, rtol: float = 0.02, most: int = 20) -> float:
    """Return an estimate of sigma_max by the Lanczos iteration started at b.

    The largest Ritz value is a lower bound; the norm of its residual is added. The sum is an upper
    bound if the Ritz value approximates the largest eigenvalue. This fails if the eigenvector of
    the largest eigenvalue is almost orthogonal to b; algorithms therefore check the curvature along
    their steps.

    Collective. The products are counted.

    Args:
        problem: the dual problem (38.4), for A and b.
        rtol: residual of the Ritz vector, divided by the Ritz value, at which the iteration ends.
        most: limit on the number of products.
    """
    v, agreed = problem.b, problem.reductions.from_first_rank
    beta = norm(problem, v)
    if beta == 0.0:
        v = np.ones_like(v)
        beta = norm(problem, v)
    if beta == 0.0:
        return 1.0
    basis = np.asarray((v / beta)[:, None], dtype=np.float64)
    alphas: list[float] = []
    betas: list[float] = []
    while True:
        w = problem.operator.apply(basis[:, -1])
        alphas.append(float(problem.inner(basis[:, -1], w)))
        for _ in range(2):  # full orthogonalisation, twice: cheap for so few vectors
            w = w - basis @ problem.inner(basis, w)
        beta = norm(problem, w)
        values, vectors = (agreed(one) for one in eigh_tridiagonal(alphas, betas))
        error = beta * abs(float(vectors[-1, -1]))
        if error <= rtol * values[-1] or len(alphas) == most:
            return float(values[-1]) + error
        betas.append(beta)
        basis = np.column_stack([basis, w / beta])


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
        relative = history.error / history.first_error
        tolerance = min(options.r_tol * relative, options.c_fact * tolerance)
        return tolerance * history.first_error

    return following


def conjugate_gradients(
    problem: DualProblem,
    free: Mask,
    gradient: Array,
    tolerance: float,
    *,
    feasible: Callable[[Array], bool] | None = None,
    most: int = 1000,
) -> tuple[Array, Array]:
    """Minimise q over steps s of the free multipliers, (38.14).

    Collective. The result does not say which of the limits ended the iteration: the caller judges
    the step.

    Args:
        problem: the dual problem (38.4), for A and the inner product.
        free: (size,) True for multipliers that may change.
        gradient: (size,) r at s = 0.
        tolerance: norm of r + A s in the free rows at which the iteration ends.
        feasible: function that returns whether the multipliers after a step s lie in Lambda, with
            the same result on all ranks. The iteration ends before the first step that leaves
            Lambda (CGM_feas).
        most: limit on the number of products.

    Returns:
        s (size,), zero where multipliers are not free, and A s (size,) in all rows, from the
        recurrence.
    """
    step = np.zeros_like(gradient)
    product = np.zeros_like(gradient)
    residual = np.where(free, -gradient, 0.0)
    direction = np.zeros_like(gradient)
    squared = float(problem.inner(residual, residual))
    before = np.inf
    for _ in range(most):
        if np.sqrt(squared) <= tolerance:
            break
        direction = residual + (squared / before) * direction
        image = problem.operator.apply(direction)
        curvature = float(problem.inner(direction, image))
        if curvature <= 0.0:  # rounding only: A is positive definite
            break
        alpha = squared / curvature
        if feasible is not None and not feasible(step + alpha * direction):
            break
        step += alpha * direction
        product += alpha * image
        residual -= alpha * np.where(free, image, 0.0)
        before, squared = squared, float(problem.inner(residual, residual))
    return step, product


def _bicgstab(
    problem: DualProblem,
    image: Callable[[Array], Array],
    right: Array,
    tolerance: float,
    most: int = 500,
) -> Array:
    """Return x with |right - image(x)| <= tolerance, or the best x of `most` steps."""
    x = np.zeros_like(right)
    residual = right.copy()
    shadow = right
    direction = residual
    shadow_residual = float(problem.inner(shadow, residual))
    best, best_norm = x, float(np.sqrt(problem.inner(right, right)))
    for _ in range(most):
        if best_norm <= tolerance or shadow_residual == 0.0:
            break
        v = image(direction)
        denominator = float(problem.inner(shadow, v))
        if denominator == 0.0:
            break
        alpha = shadow_residual / denominator
        half = residual - alpha * v
        t = image(half)
        tt = float(problem.inner(t, t))
        omega = float(problem.inner(t, half)) / tt if tt > 0.0 else 0.0
        x = x + alpha * direction + omega * half
        residual = half - omega * t
        norm = float(np.sqrt(problem.inner(residual, residual)))
        if not np.isfinite(norm):
            break
        if norm < best_norm:
            best, best_norm = x, norm
        if omega == 0.0:
            break
        before, shadow_residual = shadow_residual, float(problem.inner(shadow, residual))
        direction = residual + (shadow_residual / before) * (alpha / omega) * (
            direction - omega * v
        )
    return best
