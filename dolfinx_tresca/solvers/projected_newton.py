"""Projected Newton on a model of A that every product improves: the default."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.solvers import face_newton
from dolfinx_tresca.solvers.history import History, Observe
from dolfinx_tresca.solvers.problem import ContactStatus, DualProblem, DualSolution
from dolfinx_tresca.solvers.recycling import RecycledProducts

#: Error of a gradient over the natural residual that it is to show.
ACCURACY = 0.1

#: By how much errors shrink when they hide what a step brings.
SHARPER = 0.3

#: Change of q, over the norms of lambda and r, that rounding hides.
ROUNDING = 4 * float(np.finfo(float).eps)


def solve(
    problem: DualProblem,
    start: Array,
    options: SolverOptions,
    observe: Observe,
    recycled: RecycledProducts,
) -> DualSolution:
    """Minimise q over Lambda by Newton steps in which a model stands in for A.

    The model M (`RecycledModel`) equals A on all vectors whose products are known. Newton's method
    on the faces of Lambda (`face_newton`) minimises q with M in place of A, sets and slip
    directions included, at the cost of small dense algebra; then one product tells A on the step d,
    the best point on the way is taken, and the pair (d, A d) goes into the model. On a settled face
    this is conjugate gradients, preconditioned by everything known; and sets settle without
    products.

    A step is accepted when q falls at least by as much as the gradient projection step
    p = P_Lambda(lambda - rho r) - lambda promises, q + r'p + |p|^2 / (2 rho), which is all that the
    proof of Theorem 38.1 uses; otherwise that step is taken first. So (i) holds with
    eta = 1 - rho sigma_min for the rho of the result.

    Collective.

    Args:
        problem: A, b, Lambda.
        start: (size,) first multipliers; projected onto Lambda.
        options: tolerances.
        observe: called before each iteration.
        recycled: the products known so far; those of this solve are added.
    """
    return _ProjectedNewton(problem, start, options, observe, recycled).run()


class _ProjectedNewton:
    """The state of one solve: multipliers, gradient r, history."""

    def __init__(
        self,
        problem: DualProblem,
        start: Array,
        options: SolverOptions,
        observe: Observe,
        recycled: RecycledProducts,
    ) -> None:
        self.problem = problem
        self.options = options
        self.recycled = recycled
        if len(recycled) == 0:
            recycled.add(problem.b, problem.apply(problem.b))
        self.history = History(problem, options, observe, self.proposed_rho())
        self.multipliers = problem.feasible_set.project(start)
        self.r = -problem.b
        self.share = ACCURACY
        self.accuracy = self.share * self.history.scale
        if float(problem.inner(start, start)) > 0.0:
            self.r = problem.gradient(self.multipliers, self.accuracy)
            self.multipliers, self.r = self.history.better_start(self.multipliers, self.r)

    def proposed_rho(self) -> float:
        """Return rho from the lower bound of sigma_max; any number where nothing is loaded."""
        return self.options.step_factor / (self.recycled.largest_ritz_value() or 1.0)

    def product(self, step: Array) -> Array:
        """Return A times a step from here, and keep the pair; nothing is computed for no step."""
        if float(self.problem.inner(step, step)) == 0.0:
            return np.zeros_like(step)
        product = self.problem.change_of_gradient(
            self.multipliers, self.r, step, self.wanted_accuracy()
        )
        error = 0.0 if self.problem.exact else 2.0 * self.accuracy
        if not self.recycled.add(step, product, error):
            self.share *= SHARPER
        return product

    def wanted_accuracy(self) -> float:
        """Return how accurate the next gradient must be: a part of what its residual will be."""
        self.accuracy = self.share * max(0.5 * self.history.error, self.target)
        return self.accuracy

    @property
    def target(self) -> float:
        """The natural residual that is wanted."""
        return self.options.rtol * self.history.scale

    def judge(self) -> ContactStatus | None:
        """Judge the present point, with a gradient that is accurate enough to end there."""
        if (
            not self.problem.exact
            and self.accuracy > ACCURACY * self.target
            and (self.history.natural_residual(self.multipliers, self.r) <= self.target)
        ):
            self.accuracy = ACCURACY * self.target
            self.r = self.problem.gradient(self.multipliers, self.accuracy)
        return self.history.judge(self.multipliers, self.r)

    def run(self) -> DualSolution:
        """Iterate to the end."""
        while (status := self.judge()) is None:
            target = face_newton.minimise(
                self.problem,
                self.recycled.model(),
                self.multipliers,
                self.r,
                self.history.rho,
                self.options.r_tol * self.history.error,
            )
            newton = target - self.multipliers
            step, product = self.accepted(newton, self.product(newton))
            self.multipliers = self.multipliers + step
            self.r = self.r + product
        return self.history.solution(self.multipliers, self.r, status)

    def accepted(self, newton: Array, newton_product: Array) -> tuple[Array, Array]:
        """Return the step to take, given the whole Newton step, and its product."""
        inner = self.problem.inner
        move = self.projected_move()
        promised = float(inner(move, self.r + 0.5 / self.history.rho * move))
        size = self.history.norm(self.multipliers) * self.history.norm(self.r)
        if -promised <= ROUNDING * size:
            # q is flat to rounding here, the gradient is not yet: let the residual decide
            point = self.multipliers + newton
            residual = self.history.natural_residual(point, self.r + newton_product)
            better = residual < self.history.error
            return (newton, newton_product) if better else (0.0 * newton, 0.0 * newton)
        step, product = self.shorten(newton, newton_product, self.r)
        if float(inner(step, self.r + 0.5 * product)) > promised:
            self.share *= SHARPER
            step, product = self.safeguard(newton, newton_product)
        return step, product

    def shorten(self, step: Array, product: Array, r: Array) -> tuple[Array, Array]:
        """Return the part of a step, at most all of it, after which q is least, and its product."""
        slope = float(self.problem.inner(step, r))
        curvature = float(self.problem.inner(step, product))
        part = min(max(-slope / curvature, 0.0), 1.0) if curvature > 0.0 else 0.0
        return part * step, part * product

    def projected_move(self) -> Array:
        """Return the gradient projection step P_Lambda(lambda - rho r) - lambda."""
        target = self.multipliers - self.history.rho * self.r
        return self.problem.feasible_set.project(target) - self.multipliers

    def safeguard(self, newton: Array, newton_product: Array) -> tuple[Array, Array]:
        """Return a step at least as good as the gradient projection step, and its product.

        It goes from the end of that step towards the end of the Newton step, as far as q falls.
        Where q turns out to be more curved than 1 / rho, rho is reduced first.
        """
        inner = self.problem.inner
        while True:
            move = self.projected_move()
            product = self.product(move)
            curvature, length = float(inner(move, product)), float(inner(move, move))
            if curvature * self.history.rho <= length * (1.0 + 1e-10):
                break
            self.history.set_rho(0.95 * min(self.proposed_rho(), length / curvature))
        rest, rest_product = self.shorten(newton - move, newton_product - product, self.r + product)
        return move + rest, product + rest_product
