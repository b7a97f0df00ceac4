"""Lambda where bodies are loose: multipliers, and rigid motions, that balance the loads."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfinx_tresca.dual.feasible_set import Array, FeasibleSet
from dolfinx_tresca.errors import InputError

#: Newton steps of a projection; ten are many.
MOST = 100

#: Of the largest derivative, what stands in for it where nothing presses.
REGULARISATION = 1e-8

#: Resultant, over the sum of its terms' sizes, that is rounding, and above which nothing balances
#: the loads.
ROUNDING, UNBALANCED = 64 * float(np.finfo(float).eps), 1e-8

#: Part by which loads could be larger and be balanced still: at a limit of friction bodies slide
#: as far as they like.
RESERVE = 1e-6

#: Square of a motion's jump, over that of others, below which contact does not resist it.
UNRESISTED = 1e-6


@dataclass(frozen=True)
class BalancedSet(FeasibleSet):
    """The multipliers of Lambda, with rigid motions c, that have G'lambda + S c = e.

    Loose bodies are ones whose rigid motions K resists with a small stiffness S, or none. Let K_p
    be K with some stiff springs added, and U c the displacements that K_p needs the forces of these
    springs for. Then K u = f - B'lambda holds for u = K_p^-1 (f - B'lambda) + U c if and only if

        G'lambda + S c = e,    G = B U,  e = U'f:

    what contact and soft springs do together balances the loads. So the gradient is A lambda - b
    less G c, with A and b from K_p, and c is part of the solution. Where S = 0 multipliers must
    balance the loads by themselves.

    All methods that this class adds or changes are collective.

    Attributes:
        jumps: (size, k) G, columns of length 1 in the rows that carry something; short ones where
            S resists more than contact.
        softness: (k, k) S, symmetric and positive semidefinite.
        resultants: (k,) e.
        inner: x'y over all ranks.
        agreed: the first rank's numbers.
        describe: the motion c in words.
    """

    jumps: Array
    softness: Array
    resultants: Array
    inner: Callable[[Array, Array], Array]
    agreed: Callable[[Array], Array]
    describe: Callable[[Array], str]

    @property
    def rigid_jumps(self) -> Array:
        """G, (size, k)."""
        return self.jumps

    @property
    def rigid_stiffness(self) -> Array:
        """S, (k, k)."""
        return self.softness

    def imbalance(self, x: Array, rigid: Array) -> Array:
        """Return e - G'x - S c, (k,)."""
        result: Array = self.resultants - self.inner(self.jumps, x) - self.softness @ rigid
        return result

    def project_balanced(self, y: Array, rigid: Array, rho: float) -> tuple[Array, Array]:
        """Return the multipliers next to y that balance the loads, and how c changes for that.

        They minimise |lambda - y|^2 / 2 + rho dc'S dc / 2 with G'lambda + S (c + dc) = e: so
        lambda = P_Lambda(y + rho G dc). With y = lambda - rho r it is a gradient projection step.

        Args:
            y: (size,).
            rigid: (k,) c.
            rho: a step length.

        Raises:
            InputError: nothing in Lambda balances the loads; names body and motion.
        """
        lift = self._lift(y, self.resultants - self.softness @ rigid, 1.0 / rho * self.softness)
        return self.project(y + self.jumps @ lift), 1.0 / rho * lift

    def _lift(self, y: Array, target: Array, compliance: Array) -> Array:
        """Return z with G'P_Lambda(y + G z) + C z = target.

        It minimises the convex function 1/2 |x|^2 - 1/2 |x - P(x)|^2 + 1/2 z'C z - z'target of
        x = y + G z: Newton's method with a line search.
        """
        G, inner = self.jumps, self.inner

        def at(z: Array) -> tuple[float, Array, Array, Array]:
            x = y + G @ z
            p = self.project(x)
            value = float(0.5 * inner(p, 2.0 * x - p) + z @ (0.5 * compliance @ z - target))
            terms = inner(sizes, np.abs(p)) + np.abs(self.resultants)
            return value, inner(G, p) + compliance @ z - target, x, terms

        sizes = np.abs(G)
        before = inner(sizes, np.abs(y))
        slack = REGULARISATION * np.diag(np.diag(self._gram))
        z = self._solution(self._gram + slack + compliance, target - inner(G, y))
        value, excess, x, terms = at(z)
        for _ in range(MOST):
            if (np.abs(excess) <= ROUNDING * (terms + before)).all():
                return z
            H = inner(G, self.projection_derivative(x)(G)) + compliance
            step = -self._solution(H + slack, excess)
            part = 1.0
            trial = at(z + step)
            while (
                trial[0] > value + 1e-4 * part * float(excess @ step)
                and np.linalg.norm(trial[1]) > 0.5 * np.linalg.norm(excess)
                and part > ROUNDING
            ):
                part *= 0.25
                trial = at(z + part * step)
            if part <= ROUNDING:
                break
            z = z + part * step
            value, excess, x, terms = trial
        if (np.abs(excess) <= UNBALANCED * terms).all():
            return z
        raise InputError(
            f"no contact forces balance the loads on {self.describe(z / np.linalg.norm(z))}. The "
            "loads pull it off what it touches, tip it over, or overcome friction there: look at "
            "their directions and at the slip bounds, or hold the body by Dirichlet conditions or "
            "springs."
        )

    @cached_property
    def _gram(self) -> Array:
        """G'G, (k, k)."""
        return self.inner(self.jumps, self.jumps)

    def _solution(self, matrix: Array, right: Array) -> Array:
        """Return the solution of a small system, the same on all ranks."""
        return self.agreed(np.asarray(np.linalg.solve(matrix, right), dtype=np.float64))

    def settled_motions(self, x: Array, r: Array, rho: float) -> Array:
        """Return the motions c (k,) that belong to x and its gradient: of the next projection step.

        S^-1 (e - G'x) would balance the loads exactly, but magnify errors of x where S is small.

        Args:
            x: (size,) in this set.
            r: (size,) A x - b.
            rho: a step length.
        """
        return self.project_balanced(x - rho * r, np.zeros(len(self.resultants)), rho)[1]

    def rigid_error(self, x: Array, rigid: Array) -> float:
        """Return a bound of the energy norm of the motion that x and c lack for balance."""
        missing = self.imbalance(x, rigid)
        return float(np.sqrt(missing @ self._inverse @ missing))

    def rigid_motions(self, x: Array) -> Array:
        """Return the motions (k,) that soft springs allow until they balance x and the loads."""
        result: Array = self._inverse @ (self.resultants - self.inner(self.jumps, x))
        return result

    def rigid_work(self, x: Array, way: Array) -> float:
        """Return the derivative along a way of |e - G'x|^2 / 2, measured by S^-1."""
        return -float(self.rigid_motions(x) @ self.inner(self.jumps, way))

    def rigid_curvature(self, way: Array) -> float:
        """Return the square of G'way, measured by S^-1."""
        change = self.inner(self.jumps, way)
        return float(change @ self._inverse @ change)

    @cached_property
    def _inverse(self) -> Array:
        """S^-1 on the motions that S resists; along others multipliers keep the balance."""
        if not self.softness.any():
            return np.zeros_like(self.softness)
        values, vectors = (self.agreed(one) for one in np.linalg.eigh(self.softness))
        resisted = values > ROUNDING * values[-1]
        result: Array = (vectors[:, resisted] / values[resisted]) @ vectors[:, resisted].T
        return result


def balance(
    feasible_set: FeasibleSet,
    jumps: Array,
    stiffness: Array,
    resultants: Array,
    bodies: Sequence[str],
    inner: Callable[[Array, Array], Array],
    agreed: Callable[[Array], Array],
    describe: Callable[[Array], str],
) -> tuple[BalancedSet, Array]:
    """Return Lambda with the balance of loads on loose bodies. Collective.

    Args:
        feasible_set: Lambda.
        jumps: (size, k) B U, the jumps of k rigid motions.
        stiffness: (k, k) what K resists them with; rows of zeros where it does not.
        resultants: (k,) U'f.
        bodies: (k,) which body moves.
        inner: x'y over all ranks.
        agreed: the first rank's numbers.
        describe: motions with components (k,) or (k, columns) in words.

    Returns:
        the set, and the factors (k,) with which its columns are those motions.

    Raises:
        InputError: neither K nor contact resists a motion, or nothing balances the loads.
    """
    carries = np.ones(feasible_set.size, dtype=np.bool_)
    carries[feasible_set.tangential] = feasible_set.radius[feasible_set.node] > 0.0
    carrying = jumps * carries[:, None]
    gram = inner(carrying, carrying)
    length = np.sqrt(np.diag(gram))
    # of each body: their jumps depend on its size and mesh
    largest = np.array([length[[o == body for o in bodies]].max() for body in bodies])
    length[length <= np.sqrt(UNRESISTED) * largest] = 0.0
    floats = np.flatnonzero(np.diag(stiffness) == 0.0)
    size = np.where(length > 0.0, length, np.where(largest > 0.0, largest, 1.0))
    scaled = (gram / np.outer(size, size))[np.ix_(floats, floats)]
    values, vectors = (agreed(one) for one in np.linalg.eigh(scaled))
    if (values <= UNRESISTED).any():
        loose = np.zeros((len(size), int((values <= UNRESISTED).sum())))
        loose[floats] = vectors[:, values <= UNRESISTED] / size[floats, None]
        raise InputError(
            f"nothing holds {describe(loose)}, and no contact resists that. Fix "
            "part of the body's boundary with a Dirichlet condition, add a soft spring to a, or "
            "give it friction."
        )
    # what contact does not feel is measured by the spring that holds it
    factors = 1.0 / np.where(length > 0.0, length, np.sqrt(np.diag(stiffness)))
    result = BalancedSet(
        **vars(feasible_set),
        jumps=jumps * factors,
        softness=stiffness * np.outer(factors, factors),
        resultants=factors * resultants,
        inner=inner,
        agreed=agreed,
        describe=lambda components: describe(factors * components),
    )
    larger = dataclasses.replace(result, resultants=(1.0 + RESERVE) * result.resultants)
    larger.project_balanced(np.zeros(feasible_set.size), np.zeros(len(factors)), 1.0)
    return result, factors
