"""A primal-dual interior-point method for the model of A: slow but sure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array, FeasibleSet
from dolfinx_tresca.solvers.problem import DualProblem
from dolfinx_tresca.solvers.recycling import RecycledModel

#: Part of the way to the boundary of Lambda that a step may take.
TO_BOUNDARY = 0.99

#: Part of its radius inside which a disc's multiplier begins.
INSIDE = 0.9

#: Factors of the barrier after steps that were cut short, and after nearly whole ones; and the part
#: of a step from which on it is nearly whole.
SLOW, FAST, WHOLE = 0.5, 0.1, 0.8

#: Barrier at the start, over the energy that each node's own compliance suggests.
FIRST = 0.1

#: Below any number that means something.
TINY = 1e-300


@dataclass(frozen=True)
class InteriorPoint:
    """A point inside Lambda, near the one that minimises the model with a barrier.

    Attributes:
        multipliers: (size,) strictly inside.
        rigid: (k,) rigid motions of loose bodies.
        gradient: (size,) of the model there, without the barrier.
    """

    multipliers: Array
    rigid: Array
    gradient: Array


def central_path(
    problem: DualProblem, model: RecycledModel, multipliers: Array, gradient: Array
) -> Iterator[InteriorPoint]:
    """Yield points inside Lambda that approach the minimiser of r'd + 1/2 d'M d.

    With pressures lambda, their forces z = mu / lambda, discs c = (g^2 - |lambda|^2) / 2 >= 0 and
    their curvatures kappa = mu / c, Newton's method for

        r - z + kappa lambda - G c_rigid = 0,   G'lambda + S c_rigid = e

    and the products lambda z = mu, c kappa = mu, with mu going to zero (Wright 1997, Primal-dual
    interior-point methods). Each step costs one solve with M and a diagonal; there are no sets that
    could alternate, and the number of steps hardly depends on condition, size, or start. It ends
    where rounding leaves no inside.

    Collective. Needs no product with A.

    Args:
        problem: Lambda and the inner product.
        model: M.
        multipliers: (size,) the origin of d.
        gradient: (size,) r there.
    """
    lam = problem.feasible_set
    path = _CentralPath(problem, model, multipliers, gradient)
    while path.is_inside():
        path.step()
        yield InteriorPoint(path.x, path.rigid, path.r - lam.rigid_jumps @ path.rigid)


class _CentralPath:
    """The state of the iteration: multipliers x, z of the normals, kappa of the discs, barrier."""

    def __init__(self, problem: DualProblem, model: RecycledModel, x: Array, r: Array) -> None:
        self.problem, self.model = problem, model
        lam: FeasibleSet = problem.feasible_set
        self.lam = lam
        #: discs with an inside and a circle
        self.round = (lam.radius > 0.0) & np.isfinite(lam.radius)
        self.fixed = np.zeros(lam.size, dtype=np.bool_)
        self.fixed[lam.tangential] = (lam.radius == 0.0)[lam.node]
        size = lam.mean_over_discs(model.size)
        self.count = self._sum(len(lam.normal) + self.round.sum())
        scale = np.maximum(np.abs(x), np.abs(r) / size)
        energy = float(problem.inner(scale, size * scale))
        self.barrier = max(FIRST * energy / max(self._sum((scale > 0.0).sum()), 1.0), TINY)
        # the minimiser where M is replaced by its diagonal
        own = x - r / size
        start = np.where(self.fixed, 0.0, own)
        n, d = lam.normal, size[lam.normal]
        half = 0.5 * own[n]
        root = np.sqrt(half**2 + self.barrier / d)
        # a form of each root without cancellation
        start[n] = np.where(
            half > 0.0, half + root, self.barrier / d / np.maximum(root - half, TINY)
        )
        self.z: Array = self.barrier / start[n]
        norms = lam.norms(start)
        shrink = np.ones_like(lam.radius)
        outside = self.round & (norms > INSIDE * lam.radius)
        np.divide(INSIDE * lam.radius, norms, out=shrink, where=outside)
        start[lam.tangential] *= shrink[lam.node]
        self.origin, self.first = x, r
        self.place(start)
        self.kappa: Array = np.where(
            self.round, self.barrier / np.where(self.round, self.inside, 1.0), 0.0
        )
        self.rigid: Array = np.zeros(lam.rigid_jumps.shape[1])

    def place(self, x: Array) -> None:
        """Go to a point."""
        self.x = x
        self.r = self.first + self.model.apply(x - self.origin)
        norms = self.lam.norms(x)
        with np.errstate(invalid="ignore"):
            self.inside = 0.5 * (self.lam.radius - norms) * (self.lam.radius + norms)

    def is_inside(self) -> bool:
        """Whether rounding leaves the point inside Lambda, and the barrier a number."""
        least = min(
            self.x[self.lam.normal].min(initial=np.inf), self.inside[self.round].min(initial=np.inf)
        )
        return self.barrier > TINY and self.problem.least(float(least)) > 0.0

    def step(self) -> None:
        """Take a Newton step, and lower the barrier."""
        lam, x, z, kappa = self.lam, self.x, self.z, self.kappa
        n, t, disc = lam.normal, lam.tangential, lam.node
        inside = np.where(self.round, self.inside, 1.0)
        curvature = np.where(self.round, kappa / inside, 0.0)
        diagonal = self.model.diagonal.copy()
        diagonal[n] += z / x[n]
        diagonal[t] += kappa[disc]
        weight = np.where(self.fixed, 0.0, 1.0 / diagonal)
        circle = x[t] * weight[t]
        bend = np.bincount(disc, x[t] * circle, minlength=len(kappa))
        factor = curvature / (1.0 + curvature * bend)

        def inverse(v: Array) -> Array:
            """Apply the inverse of the diagonal part: a rank-one change of each disc's."""
            result = (weight * v.T).T
            along: Any = np.zeros((len(kappa), *v.shape[1:]))
            np.add.at(along, disc, (x[t] * result[t].T).T)
            result[t] -= (circle * (factor[disc] * along[disc].T)).T
            return result

        right = -(self.r - lam.rigid_jumps @ self.rigid)
        right[n] += self.barrier / x[n]
        right[t] -= (np.where(self.round, self.barrier / inside, 0.0))[disc] * x[t]
        step, rigid = self.model.solve(
            inverse,
            right,
            lam.rigid_jumps,
            lam.rigid_stiffness,
            lam.imbalance(x, self.rigid),
        )
        dz = (self.barrier - z * step[n]) / x[n] - z
        along = np.bincount(disc, x[t] * step[t], minlength=len(kappa))
        dkappa = np.where(self.round, (self.barrier + kappa * along) / inside - kappa, 0.0)
        whole = self.problem.least(
            min(
                self._reach(step),
                _reach(z, dz),
                _reach(kappa[self.round], dkappa[self.round]),
            )
        )
        part = min(1.0, TO_BOUNDARY * whole)
        self.z, self.kappa = z + part * dz, kappa + part * dkappa
        self.rigid = self.rigid + part * rigid
        self.place(x + part * step)
        self._lower(part)

    def _reach(self, step: Array) -> float:
        """Return how often a step can be made until it meets the boundary of Lambda."""
        lam = self.lam
        least = _reach(self.x[lam.normal], step[lam.normal])
        a = lam.norms(step)[self.round]
        along = np.bincount(
            lam.node, self.x[lam.tangential] * step[lam.tangential], minlength=len(lam.radius)
        )[self.round]
        rest = 2.0 * self.inside[self.round]
        denominator = along + np.sqrt(along**2 + a**2 * rest)
        moves = denominator > 0.0
        return float((rest[moves] / denominator[moves]).min(initial=least))

    def _lower(self, part: float) -> None:
        """Set the barrier from what the products of the pairs are now."""
        if self.count == 0:
            return
        products = float(self.x[self.lam.normal] @ self.z)
        products += float((self.inside * self.kappa)[self.round].sum())
        mean = self._sum(products) / self.count
        self.barrier = max((FAST if part > WHOLE else SLOW) * mean, TINY)

    def _sum(self, value: float) -> float:
        """Return the sum over all ranks."""
        return float(self.problem.inner(np.array([value], dtype=np.float64), np.ones(1))[()])


def _reach(values: Array, steps: Array) -> float:
    """Return how often steps can be made until the first of some positive values is zero."""
    falling = steps < 0.0
    return float((values[falling] / -steps[falling]).min(initial=np.inf))
