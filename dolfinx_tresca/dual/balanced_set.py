"""Lambda where bodies are loose: multipliers, and rigid motions, that balance the loads."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse.csgraph import connected_components

from dolfinx_tresca.dual.feasible_set import Array, FeasibleSet
from dolfinx_tresca.dual.lift import ROUNDING, find_lift
from dolfinx_tresca.errors import InputError

#: Multipliers over the loads' sizes that would have to be larger for nothing to balance the loads.
HUGE = 1e4

#: Part of the loads' sizes that is rounding where it decides whether they can be balanced.
UNBALANCED = 1e-8

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
        sizes: (k,) of what e is the sum of.
        inner: x'y over all ranks.
        agreed: the first rank's numbers.
    """

    jumps: Array
    softness: Array
    resultants: Array
    sizes: Array
    inner: Callable[[Array, Array], Array]
    agreed: Callable[[Array], Array]

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
        """
        lift = find_lift(
            self,
            self.jumps,
            1.0 / rho * self.softness,
            y,
            self.resultants - self.softness @ rigid,
            self.sizes + np.abs(self.softness) @ np.abs(rigid),
            self.inner,
            self.agreed,
        ).motion
        return self.project(y + self.jumps @ lift), 1.0 / rho * lift

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
        values, vectors = self._resisted
        result: Array = (vectors / values) @ vectors.T
        return result

    @cached_property
    def springs(self) -> Array:
        """The orthogonal projector (k, k) onto the motions that S resists."""
        _, vectors = self._resisted
        result: Array = vectors @ vectors.T
        return result

    @cached_property
    def _resisted(self) -> tuple[Array, Array]:
        """The eigenvalues of S that are not rounding, and their vectors (k, number)."""
        values, vectors = (self.agreed(one) for one in np.linalg.eigh(self.softness))
        resisted = values > ROUNDING * values[-1]
        return values[resisted], vectors[:, resisted]


def balance(
    feasible_set: FeasibleSet,
    jumps: Array,
    stiffness: Array,
    resultants: Array,
    sizes: Array,
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
        sizes: (k,) of what these are the sums of.
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
    gram = agreed(inner(carrying, carrying))
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
        sizes=_shared(gram, bodies, np.where(length > 0.0, factors * sizes, 0.0)),
        inner=inner,
        agreed=agreed,
    )
    return _checked(result, lambda motion: describe(factors * motion)), factors


def _shared(gram: Array, bodies: Sequence[str], sizes: Array) -> Array:
    """Return for each motion the largest size (k,) among bodies that contact holds together."""
    _, body = np.unique(np.asarray(bodies), return_inverse=True)
    _, group = connected_components((gram != 0.0) | (body[:, None] == body), directed=False)
    largest = np.zeros(len(sizes))
    np.maximum.at(largest, group, sizes)
    result: Array = largest[group]
    return result


def _checked(balanced: BalancedSet, describe: Callable[[Array], str]) -> BalancedSet:
    """Return the set, with loads that can be balanced; rounding of theirs is taken away.

    How stiff springs are does not matter for that: here all are alike.

    Raises:
        InputError: nothing balances the loads.
    """
    reserve = 1.0 + RESERVE
    sizes = np.maximum(balanced.sizes, np.abs(balanced.resultants))
    lift = find_lift(
        balanced,
        balanced.jumps,
        balanced.springs,
        np.zeros(balanced.size),
        reserve * balanced.resultants,
        sizes,
        balanced.inner,
        balanced.agreed,
        depth=0.5 * HUGE**2 * float(sizes @ sizes),
    )
    if lift.balanced:
        return balanced
    if lift.unbounded or (np.abs(lift.excess) > UNBALANCED * sizes).any():
        motion = lift.motion / np.linalg.norm(lift.motion)
        raise InputError(
            f"no contact forces balance the loads on {describe(motion)}. The loads pull it off "
            "what it touches, tip it over, or overcome friction there: look at their directions "
            "and at the slip bounds, or hold the body by Dirichlet conditions or springs."
        )
    return dataclasses.replace(balanced, resultants=balanced.resultants + lift.excess / reserve)
