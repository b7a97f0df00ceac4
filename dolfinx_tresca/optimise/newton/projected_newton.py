"""The default method: projected Newton on a model of A that every product improves."""

from __future__ import annotations

import dataclasses

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import FORCING, ROUGH
from dolfinx_tresca._base.patience import PROGRESS
from dolfinx_tresca.optimise.models.known_products import KnownProducts
from dolfinx_tresca.optimise.models.products import PRODUCT_ROUNDING, ProductStore
from dolfinx_tresca.optimise.newton import near_model
from dolfinx_tresca.optimise.newton.iterate import Iterate, Step
from dolfinx_tresca.optimise.newton.semismooth_newton import NewtonPoint
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.energy import best_part
from dolfinx_tresca.optimise.record.history import History, Observe
from dolfinx_tresca.optimise.record.residual import NaturalResidual
from dolfinx_tresca.optimise.reductions import norm
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.status import ContactStatus

#: Number of products of the near field D with b, D b, ... before the iteration. With two products,
#: the largest Ritz value is near sigma_max, the largest eigenvalue of A.
NEAR_POWERS = 2

#: Limit on reductions of rho in one iteration, each of which takes a product with A.
MOST_REDUCTIONS = 20

#: If the residual is not halved in this number of iterations, the rest of A is computed, unless A
#: is too large (`ContactCompliance.complete_products`).
SLOW = 8

#: Statuses with which an iteration ends only if A is known whole, or is too large.
FAILED = ContactStatus.NO_FIXED_POINT, ContactStatus.STAGNATED


def solve(
    problem: DualProblem,
    start: Array,
    options: SolverOptions,
    observe: Observe,
) -> DualSolution:
    """Minimise q over Lambda by Newton steps on a model of A.

    The model M (`near_model`) equals A on all vectors with known products. The semismooth Newton
    method (`semismooth_newton`) minimises q with M in place of A by small dense algebra, and finds
    active sets and slip directions at the same time. Let d be the step to this minimiser. The
    product A d is computed, the iteration goes to the minimiser of q along d, and M is updated with
    the pair (d, A d). While the face does not change, the method is the conjugate gradient method
    with M as the preconditioner; changes of the face need no products.

    A step is accepted if q decreases at least to q + r'p + |p|^2 / (2 rho), which is an upper bound
    of q after the gradient projection step p = P_Lambda(lambda - rho r) - lambda; otherwise the
    gradient projection step is taken first. This is sufficient for the proof of Theorem 38.1; part
    (i) of the theorem holds with eta = 1 - rho sigma_min, where rho is the step length at the end.

    Collective.

    Args:
        problem: A, b, Lambda; the products of this solve are added to its store.
        start: (size,) first multipliers; projected onto Lambda.
        options: tolerances.
        observe: function that is called with each iterate, the first one included.
    """
    return ProjectedNewton(problem, options, observe).run(start)


class ProjectedNewton:
    """The state of one solve: a point with its gradient, and the history.

    Attributes:
        problem: A, b, Lambda.
        options: tolerances.
        observe: function that is called with each iterate, the first one included.
        largest: lower bound of sigma_max, kept when known products are dropped.
        store: known products with A.
        residual: natural residual and its scale.
        history: residuals and energies of the iterates, and the criterion of convergence.
        at: the present point.
        missed: the last point of Newton's method with the model, if it did not converge.
    """

    store: KnownProducts
    residual: NaturalResidual
    history: History
    at: Iterate
    missed: NewtonPoint | None = None

    def __init__(self, problem: DualProblem, options: SolverOptions, observe: Observe) -> None:
        """Keep the arguments; `run` solves. Not collective."""
        self.problem, self.options, self.observe = problem, options, observe
        self.largest = 0.0

    def run(self, start: Array) -> DualSolution:
        """Iterate until a status ends the iteration. Collective."""
        self.compute_first_products()
        self.begin_at(start)
        while (status := self.check_convergence()) is None or (
            status in FAILED and self.complete_products()
        ):
            if self.is_slow():
                self.complete_products()
            newton = self.target() - self.at.multipliers
            if self.at.refine_for_step(newton):
                newton = self.target() - self.at.multipliers
            self.at.move(self.accepted(newton))
            enough = PROGRESS * self.history.error
            if not self.at.resolved and self.residual_here() > enough:
                self.at.increase_accuracy()
        at = self.at
        return self.in_equilibrium(self.history.solution(at.multipliers, at.r, status, at.error))

    def is_slow(self) -> bool:
        """Return whether the last products have not halved the residual, above rounding."""
        residuals = self.history.residuals
        slow = len(residuals) > SLOW and min(residuals[-SLOW:]) > 0.5 * min(residuals[:-SLOW])
        return slow and not self.residual.is_limited_by_rounding(self.history.error)

    def complete_products(self) -> bool:
        """Compute the rest of A, unless it is known or too large; return whether it was computed.

        Collective.
        """
        if not isinstance(self.store, ProductStore) or not self.problem.complete_products():
            return False
        self.store = self.at.store = self.problem.known_products()
        return True

    def compute_first_products(self) -> None:
        """Compute first products to bound sigma_max, unless some are known. Collective.

        For a new A, `known_products` computes a product with random signs, or all columns of A if A
        is sparse. If no product is known after this call, b is multiplied by the near field if
        there is one, and otherwise by A.
        """
        self.store = store = self.problem.known_products()
        store.drop_inaccurate_pairs()
        if store.largest_ritz_value() != 0.0:
            return
        problem, near, x = self.problem, self.problem.near_products(), self.problem.b
        if near is None:
            product = problem.operator.apply(x)
            length = float(np.sqrt(max(float(problem.inner(x, product)), 0.0)))
            store.add(x, product, problem.operator.product_error * length)
            return
        for _ in range(NEAR_POWERS):
            product = problem.near_field(x)
            near.add(x, product)
            x = product

    def begin_at(self, start: Array) -> None:
        """Begin at the start, or at the origin if the residual is larger at the start.

        The gradients at both points are computed. Collective.
        """
        problem, rho = self.problem, self.proposed_rho()
        self.at = at = Iterate.of(problem, self.store)
        origin = self.feasible(np.zeros_like(start), rho)
        at.move_to(origin, *at.initial_gradient(origin, FORCING))
        self.residual = NaturalResidual(problem, rho, origin, at.r)
        if self.residual.origin_is_undecided(at.error) and at.refine_fully():
            self.residual = NaturalResidual(problem, rho, origin, at.r, at.error)
        self.history = History(problem, self.options, self.observe, self.residual)
        if self.options.rtol:
            at.finest = FORCING * self.history.stopping.residual_error
        start = self.feasible(start, rho)
        if norm(problem, start - origin) > 0.0:
            r, error = at.initial_gradient(start, ROUGH)
            if self.is_useful_start(start, r):
                at.move_to(start, r, error)

    def is_useful_start(self, start: Array, r: Array) -> bool:
        """Return whether the residual at a start is at most the residual at the origin."""
        return self.residual.at(start, r) <= self.residual.scale

    def feasible(self, multipliers: Array, rho: float) -> Array:
        """Return the projection of multipliers onto Lambda and the constraints.

        If all constraints are soft, they hold with some c at all points of Lambda. Otherwise c is
        changed from zero: from the c with which the multipliers satisfy the soft constraints, a
        projection that satisfies the exact constraints may be far away if springs are soft.
        """
        constraints = self.problem.constraints
        c: Array = np.zeros(len(constraints))
        if constraints.are_all_soft:
            c = constraints.soft_multipliers(multipliers)
        return constraints.project(self.problem.admissible, multipliers, c, rho)[0]

    def proposed_rho(self) -> float:
        """Return the step length rho from the bound of sigma_max; any number without loads."""
        stores = [self.store, self.problem.near_products()]
        known = [store.largest_ritz_value() for store in stores if store is not None]
        self.largest = max(self.largest, *known)
        return self.options.step_factor / (self.largest or 1.0)

    def target(self) -> Array:
        """Return an approximate solution of the problem with the model in place of A."""
        at, tolerance = self.at, self.options.r_tol * self.history.error
        target, self.missed = near_model.solve(
            self.problem, at.multipliers, at.r, self.residual, tolerance
        )
        return target

    def in_equilibrium(self, found: DualSolution) -> DualSolution:
        """Return the solution, changed such that it satisfies soft constraints to rounding.

        The multipliers c of an iterate belong to the end of the next projection step, and satisfy
        the constraints only at this end. One Newton step on the model, which needs no product,
        corrects x and c with the least increase of the energy.
        """
        constraints = self.problem.constraints
        if not constraints.are_soft:
            return found
        x, r, model = found.multipliers, found.gradient, self.store.model()
        cones = self.problem.admissible.at(x, r, found.rho)
        lam = cones.section(x)
        face = lam.face(x - found.rho * r)
        G, missing = constraints.columns, constraints.residual(x, found.c)
        curvature = lam.circle_stiffness(r, face)
        with_change = lam.with_bound_change(x, face, model.diagonal)
        softness, zero = constraints.softness, np.zeros_like(r)
        step, step_c = model.solve_on(face, curvature, zero, G, softness, missing, with_change)
        c = found.c + step_c
        moved, last = constraints.project(cones, x + step, c, found.rho)
        c = c + last
        r = r + model.apply(moved - x) - G @ (c - found.c)
        return dataclasses.replace(found, multipliers=moved, c=c, gradient=r)

    def check_convergence(self) -> ContactStatus | None:
        """Check convergence with a sufficiently accurate gradient."""
        at, history = self.at, self.history
        stopping = history.stopping
        if at.error > 0.0 and stopping.reached(at.multipliers, at.r, 0.0)[2]:
            at.refine(stopping.tolerable_error(at.multipliers, at.r))
        return history.check_convergence(at.multipliers, at.r, at.error)

    def residual_here(self) -> float:
        """Return the natural residual of the present point, not divided by its scale."""
        return self.residual.at(self.at.multipliers, self.at.r)

    def accepted(self, newton: Array) -> Step:
        """Return the step to take, given the whole Newton step."""
        whole = self.at.step(newton)
        if (rho := self.proposed_rho()) < self.residual.rho:
            self.residual.set_rho(rho)  # no step achieves the decrease that a large rho predicts
        at = self.at
        nothing = at.zero_step()
        move = self.projected_move()
        promised = self.slope(move) + 0.5 * self.curvature(move, 1.0 / self.residual.rho * move)
        size = norm(self.problem, at.multipliers) * norm(self.problem, at.r)
        if -promised <= PRODUCT_ROUNDING * size:
            # changes of q are rounding, changes of the gradient are not: the residual decides
            residual = self.residual.at(at.multipliers + newton, at.r + whole.product)
            if residual < self.history.error:
                return whole
            return at.zero_step() if at.increase_accuracy() else nothing
        step = self.minimiser_between(nothing, whole)
        if (
            self.slope(step.direction) + 0.5 * self.curvature(step.direction, step.product)
            <= promised
        ):
            return step
        before = at.r
        if at.increase_accuracy():
            whole = Step(whole.direction, whole.product + before - at.r, whole.error)
        return self.safeguard(whole)

    def slope(self, direction: Array) -> float:
        """Return the derivative of q along a direction from the present point."""
        x, r = self.at.multipliers, self.at.r
        soft = self.problem.constraints.slope(x, direction)
        return float(self.problem.inner(direction, r)) + soft

    def curvature(self, direction: Array, product: Array) -> float:
        """Return the second derivative of q along a direction, soft constraints included.

        The product is A times the direction, or an approximation of it.
        """
        soft = self.problem.constraints.curvature(direction)
        return float(self.problem.inner(direction, product)) + soft

    def minimiser_between(self, first: Step, last: Step) -> Step:
        """Return the step to the minimiser of q between the ends of two steps."""
        direction, product = last.direction - first.direction, last.product - first.product
        x, r = self.at.multipliers + first.direction, self.at.r + first.product
        part = best_part(self.problem, x, r, direction, product)
        return Step(
            first.direction + part * direction,
            first.product + part * product,
            (1.0 - part) * first.error + part * last.error,
        )

    def projected_move(self) -> Array:
        """Return the gradient projection step P_Lambda(lambda - rho r) - lambda."""
        at = self.at
        return self.residual.projection(at.multipliers, at.r) - at.multipliers

    def safeguard(self, newton: Step) -> Step:
        """Return a step at least as good as the gradient projection step.

        The step ends at the minimiser of q between the ends of the gradient projection step and of
        the Newton step. If the curvature of q exceeds 1 / rho, rho is reduced first, for all later
        iterations.
        """
        inner = self.problem.inner
        for _ in range(MOST_REDUCTIONS):
            move = self.at.step(self.projected_move())
            curvature = float(inner(move.direction, move.product))
            length = float(inner(move.direction, move.direction))
            # the error of an inexact product does not count as curvature
            noise = (move.error + self.at.error) * float(np.sqrt(max(curvature, 0.0)))
            if (curvature - noise) * self.residual.rho <= length * (1.0 + 1e-10):
                break
            self.residual.set_rho(0.95 * min(self.proposed_rho(), length / curvature))
        return self.minimiser_between(move, newton)
