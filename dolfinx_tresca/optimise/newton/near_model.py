"""The model of A that is based on the near field instead of a diagonal."""

from __future__ import annotations

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import FORCING
from dolfinx_tresca.optimise.models.products import ProductStore
from dolfinx_tresca.optimise.newton.semismooth_newton import NewtonPoint, solve_model
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.record.residual import NaturalResidual

#: Limit on products with the near field in one iteration.
MOST = 8


def solve(
    problem: DualProblem,
    multipliers: Array,
    gradient: Array,
    residual: NaturalResidual,
    tolerance: float,
) -> tuple[Array, NewtonPoint | None]:
    """Return an approximate solution of the dual problem with the model M in place of A.

    The result is that of `solve_model`.

    With known products Y = A W, M = Y Y' + (I - Y W') D (I - W Y') contains the near field D where
    the basic model has a diagonal. The error of M is then smaller by an order of magnitude, but
    there is no formula for the inverse of M on a face. Hence D is itself approximated by D~, a
    low-rank model made of known products with D. Each iteration solves the problem for M with D~ in
    place of D. It then computes a product with D, which gives the residual for M and improves D~. A
    product with D costs one solve with a small matrix, and no solve with K. Products with D are
    kept until the products with A are dropped. Collective.

    Args:
        problem: Lambda, D, and the known products with D and A.
        multipliers: (size,) point of Lambda.
        gradient: (size,) gradient at this point.
        residual: the natural residual, with its step length.
        tolerance: requested natural residual, with the model in place of A.
    """
    store, near = problem.known_products(), problem.near_products()
    store.fit_far(None if near is None else near.updated_model())
    if near is None or not isinstance(store, ProductStore):
        return solve_model(problem, store.model(), multipliers, gradient, residual.rho)

    def apply_near(new: Array) -> Array:
        product = problem.near_field(new)
        near.add(new, product)
        return product

    # a smaller tolerance costs no product with A, and saves some, since the model is accurate
    tolerance *= FORCING
    x, r, left = multipliers, gradient, residual.at(multipliers, gradient)
    best, least = None, float("inf")
    for _ in range(MOST):
        model = store.updated_model(near.updated_model())
        target, missed = solve_model(problem, model, x, r, residual.rho)
        step = target - x
        if float(problem.inner(step, step)) == 0.0:
            break
        at_target = r + store.apply(step, apply_near)
        rest = residual.at(target, at_target)
        if rest < least:
            best, least = (target, missed), rest
        if rest < left:
            x, r, left = target, at_target, rest
        if left <= tolerance:
            break
    if best is None:  # solve with the diagonal as base; a product with A then checks the step
        return solve_model(problem, store.model(), x, r, residual.rho)
    return best
