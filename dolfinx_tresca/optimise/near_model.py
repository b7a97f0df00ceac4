"""The model of A on a better base than a diagonal: one that knows what is near the contact."""

from __future__ import annotations

from collections.abc import Callable

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.residual import NaturalResidual

#: Products with the near field in one iteration, at the most.
MOST = 8

#: Part of the tolerance to which the problem is solved with the near field: that costs no product,
#: and pays since the model is good.
AHEAD = 0.2

#: Finds a solution where a model of low rank stands in for A: `face_newton.minimise`, say, and its
#: arguments.
SolveModel = Callable[[DualProblem, BlockBFGSModel, Array, Array, float, float], Array]


def solve(
    problem: DualProblem,
    solve_model: SolveModel,
    multipliers: Array,
    gradient: Array,
    residual: NaturalResidual,
    tolerance: float,
) -> Array:
    """Return a point of Lambda that nearly is a solution for M in place of A. Collective.

    M = Y Y' + (I - Y W') D (I - W Y') with the near field D in place of a diagonal. The error of M
    is smaller by an order of magnitude, but its inverse on a face has no formula. D is therefore
    approximated by a low-rank model D~ of its known products, the problem is solved for M with D~
    in place of D, and a true product with D checks each step. Such a product costs a solve with a
    small matrix and none with K; it is kept as long as the products with A. After a change of K, D
    is computed anew, plus the far field that follows from earlier products.

    Args:
        problem: Lambda, D, and what is known of D and A.
        solve_model: finds a solution for a model of M.
        multipliers: (size,) in Lambda.
        gradient: (size,) there.
        residual: how residuals are measured.
        tolerance: natural residual that is wanted of the model of A.
    """
    store, near = problem.store, problem.near_store
    store.fit_far(None if near is None else near.model())
    if near is None:
        return solve_model(problem, store.model(), multipliers, gradient, residual.rho, tolerance)

    def apply_near(new: Array) -> Array:
        product = problem.near_field(new)
        near.add(new, product)
        return product

    tolerance *= AHEAD
    x, r, left = multipliers, gradient, residual.at(multipliers, gradient)
    best, least = None, float("inf")
    for _ in range(MOST):
        model = store.model(near.model())
        target = solve_model(problem, model, x, r, residual.rho, tolerance)
        step = target - x
        if float(problem.inner(step, step)) == 0.0:
            break
        at_target = r + store.apply(step, apply_near)
        rest = residual.at(target, at_target)
        if rest < least:
            best, least = target, rest
        if rest < left:
            x, r, left = target, at_target, rest
        if left <= tolerance:
            break
    if best is None:  # there is another model, and products with A tell what it is worth
        return solve_model(problem, store.model(), x, r, residual.rho, tolerance)
    return best
