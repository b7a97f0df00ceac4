"""The model of A on a better base than a diagonal: one that knows what is near the contact."""

from __future__ import annotations

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise import face_newton
from dolfinx_tresca.optimise.energy import best_part
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.products import ProductStore
from dolfinx_tresca.optimise.residual import NaturalResidual

#: Products with the model, at the most.
MOST = 8


def minimise(
    problem: DualProblem,
    store: ProductStore,
    multipliers: Array,
    gradient: Array,
    residual: NaturalResidual,
    tolerance: float,
) -> Array:
    """Return a point of Lambda that nearly minimises gradient'd + 1/2 d'M d. Collective.

    M = Y Y' + (I - Y W') D (I - W Y') with the near field D in place of a diagonal. What M lacks of
    A is less by an order of magnitude, but there is no formula for its inverse on a face. So the
    method for A (`projected_newton`) is used here for M: `face_newton` on a model of M, which has
    the pairs (W, Y) of A, since M W = Y, and those of the products with M that are made here. They
    cost a solve with a small matrix each, and none with K.

    Args:
        problem: Lambda, and D.
        store: the pairs (W, Y).
        multipliers: (size,) in Lambda.
        gradient: (size,) there.
        residual: how residuals are measured.
        tolerance: wanted natural residual.
    """
    inner = store.with_room(MOST)
    x, r, left = multipliers, gradient, residual.at(multipliers, gradient)
    for _ in range(MOST):
        target = face_newton.minimise(problem, inner.model(), x, r, residual.rho, tolerance)
        direction = target - x
        if float(problem.inner(direction, direction)) == 0.0:
            break
        # M of what is A-orthogonal to W
        new, known = inner.split(direction)
        product = problem.near_field(new)
        product = product - store.Y @ problem.inner(store.W, product)
        inner.add(new, product)
        product = known + product
        part, rest = 1.0, residual.at(target, r + product)
        if rest > left:
            part = best_part(problem, x, r, direction, product)
            rest = residual.at(x + part * direction, r + part * product)
        x, r, left = x + part * direction, r + part * product, rest
        if left <= tolerance:
            break
    return x
