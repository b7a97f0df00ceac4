"""Projected Newton with the curvature of the slip circle: the default."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array, Face
from dolfinx_tresca.options import SolverOptions
from dolfinx_tresca.solvers.cg import conjugate_gradients
from dolfinx_tresca.solvers.history import History, Observe, gradient
from dolfinx_tresca.solvers.problem import DualProblem, DualSolution
from dolfinx_tresca.solvers.recycling import RecycledProducts


def solve(
    problem: DualProblem,
    start: Array,
    options: SolverOptions,
    observe: Observe,
    recycled: RecycledProducts,
) -> DualSolution:
    """Minimise q over Lambda by Newton steps on its faces (NUMERICS section 3).

    At a slipping node r + kappa lambda = 0 with kappa = |r| / g. On the circle the only unknown is the
    move along the tangent, and

        (P A P + diag(kappa)) s = -P r

    is symmetric positive definite and the exact Newton system of the face: CG applies and the
    convergence is quadratic once the sets settle. A step is accepted when q falls below the model
    q + r'd + |d|^2 / (2 rho) of the gradient projection step d = P_Lambda(lambda - rho r) - lambda, which is
    all that the proof of Theorem 38.1 uses; otherwise that step itself is taken.

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
        self.set = problem.feasible_set
        self.multipliers = self.set.project(start)
        self.r = -problem.b + self.apply(self.multipliers)
        if len(recycled) == 0:
            self.apply(problem.b)
        self.history = History(
            problem, options, observe, options.rho_sigma / self.largest_ritz_value()
        )

    def largest_ritz_value(self) -> float:
        """Return a lower bound of sigma_max; any positive number where b and the start are zero."""
        return self.recycled.largest_ritz_value() or 1.0

    def apply(self, x: Array) -> Array:
        """Return A x, and keep the pair; nothing is computed for x = 0."""
        if float(self.problem.inner(x, x)) == 0.0:
            return np.zeros_like(x)
        product = self.problem.apply(x)
        self.recycled.add(x, product)
        return product

    def change(self, step: Array, product: Array) -> float:
        """Return q(lambda + step) - q(lambda), given A step."""
        return float(self.problem.inner(step, self.r + 0.5 * product))

    def run(self) -> DualSolution:
        """Iterate to the end."""
        while (status := self.history.judge(self.multipliers, self.r)) is None:
            rho = self.history.rho
            move = self.projected_move()
            model = float(self.problem.inner(move, self.r + 0.5 / rho * move))
            y = self.multipliers - rho * self.r
            step, product = self.newton_step(self.set.face(y, self.multipliers))
            if self.change(step, product) > model:
                step, product = self.safeguard(step, product)
            self.multipliers = self.multipliers + step
            self.r = self.r + product
        return self.history.solution(self.multipliers, self.r, status)

    def newton_step(self, face: Face) -> tuple[Array, Array]:
        """Return the step d to a feasible point that a Newton step on the face leads to, and A d."""
        problem = self.problem
        base = self.set.settle(self.multipliers, face)
        entry = base - self.multipliers
        product = self.apply(entry)
        r = self.r + product
        stiffness = self.set.circle_stiffness(r, face)
        inner = conjugate_gradients(
            problem,
            face.project,
            r,
            self.tolerance(),
            stiffness=stiffness,
            precondition=self.recycled.preconditioner(face, stiffness),
            record=self.recycled.add,
        )
        feasible = self.set.retract(base + inner.step, face)
        rest = feasible - base - inner.step
        return feasible - self.multipliers, product + inner.product + self.apply(rest)

    def tolerance(self) -> float:
        """Return the inner tolerance: superlinear, but no tighter than the outer one needs."""
        history = self.history
        before = history.residuals[-2] if len(history.residuals) > 1 else np.inf
        forcing = self.options.r_tol * min(1.0, history.residuals[-1] / before)
        return max(forcing * history.error, 0.3 * history.target)

    def projected_move(self) -> Array:
        """Return the gradient projection step P_Lambda(lambda - rho r) - lambda."""
        return self.set.project(self.multipliers - self.history.rho * self.r) - self.multipliers

    def safeguard(self, step: Array, product: Array) -> tuple[Array, Array]:
        """Return a step that is at least as good as the gradient projection step, and its product.

        It goes from the end of that step towards the end of the Newton step, as far as q falls. Where
        q turns out to be more curved than 1 / rho says, rho is reduced first.
        """
        inner = self.problem.inner
        while True:
            move = self.projected_move()
            moved = self.apply(move)
            curvature, length = float(inner(move, moved)), float(inner(move, move))
            if curvature * self.history.rho <= length * (1.0 + 1e-10):
                break
            bound = min(self.options.rho_sigma / self.largest_ritz_value(), length / curvature)
            self.history.set_rho(0.95 * bound)
        towards, towards_product = step - move, product - moved
        slope = float(inner(towards, self.r + moved))
        bend = float(inner(towards, towards_product))
        part = min(max(-slope / bend, 0.0), 1.0) if bend > 0.0 else 0.0
        return move + part * towards, moved + part * towards_product
