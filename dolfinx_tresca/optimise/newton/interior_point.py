"""A primal-dual interior-point method for the model of A, used if Newton's method cycles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array
from dolfinx_tresca.optimise.models.model import Model, NodalMaps
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet

#: Largest length of a step, divided by the length with which the step would reach the boundary of
#: Lambda or of its dual (the customary 0.99).
TO_BOUNDARY = 0.99

#: Largest norm of a friction disc's multiplier at the start, divided by the radius of the disc.
INITIAL_RADIUS = 0.9

#: Barrier mu after a shortened step, and after a nearly whole step, divided by the mean product of
#: multipliers and duals. A step is nearly whole if more than the part `WHOLE_STEP` of it is taken.
#: These numbers determine the number of steps, but not the point to which the steps converge.
BARRIER_AFTER_CUT, BARRIER_AFTER_WHOLE, WHOLE_STEP = 0.5, 0.1, 0.8

#: Barrier mu at the start, divided by the mean of D s^2 over the multipliers with s > 0. Here D is
#: the diagonal of the model, and s is the larger one of |x| and |r| / D for a multiplier x with the
#: gradient r. The number |r| / D is the distance of x from its minimiser with all other multipliers
#: fixed.
INITIAL_BARRIER = 1.0


@dataclass(frozen=True)
class InteriorPoint:
    """A point inside Lambda, near the minimiser of the model with a barrier.

    Attributes:
        multipliers: (size,) multipliers strictly inside Lambda.
        c: (k,) multipliers of the equality constraints.
        gradient: (size,) gradient of the model at the multipliers, without the barrier.
    """

    multipliers: Array
    c: Array
    gradient: Array


def central_path(
    problem: DualProblem, model: Model, multipliers: Array, gradient: Array
) -> Iterator[InteriorPoint]:
    """Yield points inside Lambda that approach the minimiser of r'd + 1/2 d'M d.

    A pressure lambda has a dual z >= 0. A friction disc |lambda| <= g is the section at g of the
    second-order cone (g, lambda), g >= |lambda|, with a dual (t, s), t >= |s|. Newton's method is
    applied to

        r - z - G c = 0 (normal), r - s - G c = 0 (tangential),   G'lambda + S c = e

    with lambda z = mu and the Jordan product (g, lambda) o (t, s) = (mu, 0), where mu goes to zero,
    in the scaling of Nesterov and Todd (Vandenberghe 2010, The CVXOPT linear and quadratic cone
    program solvers). Each step costs one solve with M and a diagonal. There are no active sets that
    could cycle, and the number of steps hardly depends on the condition of M, on the number of
    multipliers, or on the start. The iteration ends when, by rounding, the point or its dual is no
    longer strictly inside its cone.

    Collective. Needs no product with A.

    Args:
        problem: Lambda and the inner product.
        model: model M of A.
        multipliers: (size,) the point from which the steps d are counted.
        gradient: (size,) r at this point.
    """
    G = problem.constraints.columns
    path = _CentralPath(problem, model, multipliers, gradient)
    while path.is_inside():
        path.step()
        yield InteriorPoint(path.x, path.c, path.r - G @ path.c)


class _CentralPath:
    """The state of the iteration in `central_path`.

    Attributes:
        x: (size,) multipliers.
        r: (size,) gradient of the model at x.
        c: (k,) multipliers of the equality constraints.
        dual: (size,) z for normal multipliers, s for tangential multipliers, zero elsewhere.
        t: (n_discs,) first components of the duals of friction discs.
        barrier: mu.
    """

    def __init__(self, problem: DualProblem, model: Model, x: Array, r: Array) -> None:
        """Start near the minimiser with the diagonal of M in place of M."""
        self.problem, self.model = problem, model
        feasible_set: FeasibleSet = problem.feasible_set
        self.set = feasible_set
        #: friction discs with a positive and finite radius
        self.round = (feasible_set.radius > 0.0) & np.isfinite(feasible_set.radius)
        #: radii of these discs; 1 for the other discs
        self.g: Array = np.where(self.round, feasible_set.radius, 1.0)
        self.fixed = np.zeros(feasible_set.size, dtype=np.bool_)
        self.fixed[feasible_set.tangential] = (feasible_set.radius == 0.0)[feasible_set.node]
        size = feasible_set.mean_over_discs(model.size)
        self.count = self._sum(len(feasible_set.normal) + int(self.round.sum()))
        scale = np.maximum(np.abs(x), np.abs(r) / size)
        energy = float(problem.inner(scale, size * scale))
        number = max(self._sum(int((scale > 0.0).sum())), 1.0)
        self.barrier = max(INITIAL_BARRIER * energy / number, LEAST_DIVISOR)
        own = x - r / size
        start = np.where(self.fixed, 0.0, own)
        n, d = feasible_set.normal, size[feasible_set.normal]
        half = 0.5 * own[n]
        root = np.sqrt(half**2 + self.barrier / d)
        # the positive root of a quadratic equation, in a form without cancellation
        start[n] = np.where(
            half > 0.0, half + root, self.barrier / d / np.maximum(root - half, LEAST_DIVISOR)
        )
        norms = feasible_set.norms(start)
        shrink = np.ones_like(feasible_set.radius)
        outside = self.round & (norms > INITIAL_RADIUS * feasible_set.radius)
        np.divide(INITIAL_RADIUS * feasible_set.radius, norms, out=shrink, where=outside)
        start[feasible_set.tangential] *= shrink[feasible_set.node]
        self.origin, self.first = x, r
        self.c: Array = np.zeros(len(problem.constraints))
        self.move_to(start)
        self.dual, self.t = self.on_path()

    def move_to(self, x: Array) -> None:
        """Go to multipliers x, and update the gradient there."""
        self.x = x
        self.r = self.first + self.model.apply(x - self.origin)
        self.square = self.in_cone(self.g, x)

    def in_cone(self, first: Array, v: Array) -> Array:
        """Return first^2 - |v|^2 for discs in `round`, positive inside the cone; 1 for others."""
        norms = self.set.norms(v)
        return np.where(self.round, (first - norms) * (first + norms), 1.0)

    def on_path(self) -> tuple[Array, Array]:
        """Return the duals of x at the barrier mu: mu times the inverse of x (Jordan product)."""
        n, t = self.set.normal, self.set.tangential
        dual = np.zeros_like(self.x)
        dual[n] = self.barrier / self.x[n]
        curvature = np.where(self.round, self.barrier / self.square, 0.0)
        dual[t] = -curvature[self.set.node] * self.x[t]
        return dual, np.where(self.round, curvature * self.g, 1.0)

    def is_inside(self) -> bool:
        """Return whether x and its dual are strictly inside their cones. Collective.

        The result is False also if the barrier mu has fallen to its lower limit.
        """
        n = self.set.normal
        least = min(
            float(values.min(initial=np.inf))
            for values in (self.x[n], self.dual[n], self.square, self.in_cone(self.t, self.dual))
        )
        inside = self.problem.reductions.minimum_over_ranks(least) > 0.0
        return self.barrier > LEAST_DIVISOR and inside

    def step(self) -> None:
        """Take a Newton step, and lower the barrier."""
        feasible_set, x, dual = self.set, self.x, self.dual
        n, t, disc = feasible_set.normal, feasible_set.tangential, feasible_set.node
        # the scaling W of discs: W^-2 = stiffness (2 (J w)(J w)' - J), where w = (w_0, along) and J
        # is the diagonal matrix with 1, -1, ..., -1
        x_size, dual_size = np.sqrt(self.square), np.sqrt(self.in_cone(self.t, dual))
        both = self.t * self.g + self.dot(dual, x)
        double = np.sqrt(2.0 * (1.0 + both / (x_size * dual_size)))
        stiffness = np.where(self.round, dual_size / x_size, 0.0)
        w_0 = (self.g / x_size + self.t / dual_size) / double
        along = np.zeros_like(x)
        along[t] = (x[t] / x_size[disc] - dual[t] / dual_size[disc]) / double[disc]
        along[t] *= self.round[disc]

        diagonal = self.model.diagonal.copy()
        diagonal[n] += dual[n] / x[n]
        diagonal[t] += stiffness[disc]
        weight = np.where(self.fixed, 0.0, 1.0 / diagonal)
        weighted = weight * along
        factor = 2.0 * stiffness / (1.0 + 2.0 * stiffness * self.dot(along, weighted))

        def inverse(v: Array) -> Array:
            """Apply the inverse of the diagonal plus a rank-one matrix for each disc."""
            result = (weight * v.T).T
            part: Any = np.zeros((len(factor), *v.shape[1:]))
            np.add.at(part, disc, (along[t] * result[t].T).T)
            result[t] -= (weighted[t] * (factor[disc] * part[disc].T)).T
            return result

        added = diagonal - self.model.diagonal

        def add_stiffness(v: Array) -> Array:
            """Apply the diagonal and the rank-one matrices, without the diagonal of M."""
            result = (added * v.T).T
            part = feasible_set.sums((along * v.T).T)
            result[t] += (along[t] * (2.0 * stiffness * part.T).T[disc].T).T
            return result

        def movable(v: Array) -> Array:
            return np.asarray(np.where(self.fixed, 0.0, v.T).T)

        maps = NodalMaps(movable, movable, add_stiffness, movable, inverse)
        wanted, wanted_t = self.on_path()
        constraints = self.problem.constraints
        step, step_c = self.model.solve_between(
            maps,
            wanted - (self.r - constraints.columns @ self.c),
            constraints.columns,
            constraints.softness,
            constraints.residual(x, self.c),
        )
        rank_one = 2.0 * stiffness * self.dot(along, step)
        change = wanted - dual
        change[n] -= dual[n] / x[n] * step[n]
        change[t] -= stiffness[disc] * step[t] + rank_one[disc] * along[t]
        change_t = np.where(self.round, wanted_t - self.t + w_0 * rank_one, 0.0)
        whole = self.problem.reductions.minimum_over_ranks(
            min(
                _reach(x[n], step[n]),
                _reach(dual[n], change[n]),
                self._reach_in_cone(self.g, x, x_size, np.zeros_like(self.t), step),
                self._reach_in_cone(self.t, dual, dual_size, change_t, change),
            )
        )
        part = min(1.0, TO_BOUNDARY * whole)
        self.dual, self.t = dual + part * change, self.t + part * change_t
        self.c = self.c + part * step_c
        self.move_to(x + part * step)
        self._lower(part)

    def dot(self, a: Array, b: Array) -> Array:
        """Return the inner products (n_discs,) of the tangential parts of a and b (size,)."""
        t = self.set.tangential
        sums = np.bincount(self.set.node, a[t] * b[t], minlength=len(self.g))
        return sums.astype(np.float64, copy=False)  # bincount of nothing is an array of integers

    def _reach_in_cone(
        self, first: Array, v: Array, size: Array, first_step: Array, step: Array
    ) -> float:
        """Return the largest t with (first, v) + t (first_step, step) in all friction cones.

        `size` is the root of `in_cone(first, v)`.
        """
        turned = (first * first_step - self.dot(v, step)) / size
        factor = (turned + first_step) / (first + size)
        across = np.zeros_like(v)
        t, disc = self.set.tangential, self.set.node
        across[t] = step[t] - factor[disc] * v[t]
        inverse = (self.set.norms(across) - turned) / size
        return float(1.0 / inverse[self.round].max(initial=LEAST_DIVISOR))

    def _lower(self, part: float) -> None:
        """Reduce the barrier below the present mean of the products of multipliers and duals.

        Args:
            part: the part of the Newton step that was taken; nearly whole steps reduce the barrier
                more.
        """
        if self.count == 0:
            return
        n = self.set.normal
        products = float(self.x[n] @ self.dual[n])
        products += float((self.g * self.t + self.dot(self.x, self.dual))[self.round].sum())
        mean = self._sum(products) / self.count
        factor = BARRIER_AFTER_WHOLE if part > WHOLE_STEP else BARRIER_AFTER_CUT
        self.barrier = max(factor * mean, LEAST_DIVISOR)

    def _sum(self, value: float) -> float:
        """Return the sum of a value over all ranks. Collective."""
        return float(self.problem.inner(np.array([value], dtype=np.float64), np.ones(1))[()])


def _reach(values: Array, steps: Array) -> float:
    """Return the largest factor with which steps keep positive values positive."""
    falling = steps < 0.0
    return float((values[falling] / -steps[falling]).min(initial=np.inf))
