"""The model of A that is based on the near field instead of a diagonal."""

from __future__ import annotations

from dataclasses import replace

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import FORCING
from dolfinx_tresca.solvers.problem import DualProblem, Point
from dolfinx_tresca.solvers.products import ProductStore
from dolfinx_tresca.solvers.residual import NaturalResidual
from dolfinx_tresca.solvers.semismooth_newton import ModelSolution, solve_model

#: Limit on products with the near field in one iteration.
MOST = 8


def solve(
    problem: DualProblem, start: Point, residual: NaturalResidual, tolerance: float
) -> ModelSolution:
    """Return an approximate solution of the dual problem with the model M in place of A.

    With known products Y = A W, M = Y Y' + (I - Y W') D (I - W Y') contains the near field D where
    the basic model has a diagonal. The error of M is then smaller by an order of magnitude, but
    there is no formula for the inverse of M on a face. Hence D is itself approximated by D~, a
    low-rank model made of known products with D. Each iteration solves the problem for M with D~ in
    place of D. It then computes a product with D, which gives the residual for M and improves D~. A
    product with D costs one solve with a small matrix, and no solve with K. Products with D are
    kept until the products with A are dropped. Collective.

    Args:
        problem: the cones, D, and the known products with D and A.
        start: point in the cones.
        residual: the natural residual, with its step length.
        tolerance: requested natural residual, with the model in place of A.
    """
    store = problem.known_products()
    if not isinstance(store, ProductStore) or store.near is None:
        return solve_model(problem, store.model(), start)

    near, apply = store.near, store.apply_near

    def apply_near(new: Array) -> Array:
        product = apply(new)
        near.add(new, product)
        return product

    # a smaller tolerance costs no product with A, and saves some, since the model is accurate
    tolerance *= FORCING
    G, point, best = problem.constraints.columns, start, None
    left, least = residual.at(start), float("inf")
    for _ in range(MOST):
        model = store.updated_model(near.updated_model())
        target = solve_model(problem, model, point)
        step = target.x - point.x
        if float(problem.inner(step, step)) == 0.0:
            break
        r = point.r + store.apply(step, apply_near) - G @ (target.c - point.c)
        target = replace(target, r=r)
        rest = residual.at(target)
        if rest < least:
            best, least = target, rest
        if rest < left:
            point, left = target, rest
        if left <= tolerance:
            break
    if best is None:  # solve with the diagonal as base; a product with A then checks the step
        return solve_model(problem, store.model(), point)
    return best
