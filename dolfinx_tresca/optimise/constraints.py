"""Linear equations that multipliers must satisfy besides Lambda, exactly or softly. Numpy only."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.constrained_projection import (
    EXCESS_ROUNDING,
    ConstrainedProjection,
    constrained_projection,
)
from dolfinx_tresca.optimise.constraint_matrix import ConstraintMatrix
from dolfinx_tresca.optimise.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.friction_cones import FrictionCones
from dolfinx_tresca.optimise.reductions import Reductions

#: Norm of the multipliers, over that of e's sizes, beyond which multipliers that satisfy the
#: equations are not looked for: there are none then.
LARGEST_REACTION = 1e4


@dataclass(frozen=True)
class EqualityConstraints:
    """G'x + S c = e: k equations for multipliers x of Lambda, with multipliers c of their own.

    Where S = 0 the equations are exact, and c are their Lagrange multipliers. Where S is positive
    they are soft: q gains (e - G'x)'S^-1 (e - G'x) / 2, and c = S^-1 (e - G'x). Either way the
    gradient in x is A x - b - G c. There may be none, k = 0: then nothing here communicates.

    The floating bodies of contact give these equations (`floating/equilibrium.py`); nothing here
    knows that.

    Methods are collective.

    Attributes:
        matrix: G (size, k), of columns of length 1 or less.
        softness: (k, k) S, symmetric and positive semidefinite.
        values: (k,) e.
        sizes: (k,) of what e is the sum of, for rounding.
    """

    matrix: ConstraintMatrix
    softness: Array
    values: Array
    sizes: Array
    _last: list[Any] = field(default_factory=list, init=False, repr=False, compare=False)

    @classmethod
    def none(cls, size: int, reductions: Reductions) -> EqualityConstraints:
        """Return no equations for vectors (size,)."""
        nothing = np.empty(0)
        matrix = ConstraintMatrix(np.empty((size, 0)), reductions)
        return cls(matrix, np.empty((0, 0)), nothing, nothing)

    @property
    def columns(self) -> Array:
        """G (size, k). Not collective."""
        return self.matrix.columns

    @property
    def reductions(self) -> Reductions:
        """Over the ranks."""
        return self.matrix.reductions

    def __len__(self) -> int:
        return len(self.values)

    def softened(self, softness: float, c: Array) -> EqualityConstraints:
        """Return the equations with more on the diagonal of S, which changes nothing at c.

        Not collective.

        Args:
            softness: what is added.
            c: (k,) multipliers of the constraints.
        """
        softer, values = self.softness + softness * np.eye(len(self)), self.values + softness * c
        return dataclasses.replace(self, softness=softer, values=values)

    def with_less(self, values: Array) -> EqualityConstraints:
        """Return the equations with e less (k,) values. Not collective."""
        return dataclasses.replace(self, values=self.values - values)

    @property
    def are_soft(self) -> bool:
        """Whether any of the equations is soft. Not collective."""
        return bool(self.softness.any())

    def residual(self, x: Array, c: Array) -> Array:
        """Return e - G'x - S c, (k,)."""
        result: Array = self.values - self.matrix.along(x) - self.softness @ c
        return result

    def project(
        self, feasible_set: FeasibleSet | FrictionCones, y: Array, c: Array, rho: float
    ) -> tuple[Array, Array]:
        """Return the point of Lambda next to y that satisfies the equations, and the change of c.

        It minimises |x - y|^2 / 2 + rho dc'S dc / 2 with G'x + S (c + dc) = e: so
        x = P_Lambda(y + rho G dc). With y = x - rho r it is a gradient projection step.

        Args:
            feasible_set: Lambda.
            y: (size,).
            c: (k,).
            rho: a step length.
        """
        if len(self) == 0:
            return feasible_set.project(y), np.empty(0)
        if self._is_last(feasible_set, y, c, rho):
            known: tuple[Array, Array] = self._last[-1]
            return known
        shift = constrained_projection(
            feasible_set,
            self.matrix,
            1.0 / rho * self.softness,
            y,
            self.values - self.softness @ c,
            self.sizes + np.abs(self.softness) @ np.abs(c),
        ).shift
        result = feasible_set.project(y + self.matrix.sparse @ shift), 1.0 / rho * shift
        for part in result:
            part.flags.writeable = False  # it may be returned again
        self._last[:] = feasible_set, y, c, rho, result
        return result

    def _is_last(
        self, feasible_set: FeasibleSet | FrictionCones, y: Array, c: Array, rho: float
    ) -> bool:
        """Return whether the last projection was that of the same point. Collective.

        Residual, multipliers and errors of an iterate need the same projection: of 330 in two load
        steps of a wall of 52 bricks 236 are such repetitions.
        """
        same = False
        if self._last:
            last_set, last_y, last_c, last_rho, _ = self._last
            same = rho == last_rho and np.array_equal(y, last_y) and np.array_equal(c, last_c)
            same = same and (
                feasible_set is last_set
                or (
                    isinstance(feasible_set, FeasibleSet)
                    and isinstance(last_set, FeasibleSet)
                    and np.array_equal(feasible_set.radius, last_set.radius)
                )
            )
        return self.reductions.minimum_over_ranks(float(same)) > 0.0

    def balance(
        self, feasible_set: FeasibleSet | FrictionCones, reserve: float = 0.0
    ) -> ConstrainedProjection:
        """Look for multipliers of Lambda that satisfy the equations, about.

        How stiff soft equations are does not matter for that: here all are alike.

        Args:
            feasible_set: Lambda.
            reserve: part by which e could be larger.
        """
        sizes = np.maximum(self.sizes, np.abs(self.values))
        return constrained_projection(
            feasible_set,
            self.matrix,
            self.soft_directions,
            np.zeros(len(self.columns)),
            (1.0 + reserve) * self.values,
            sizes,
            depth=0.5 * LARGEST_REACTION**2 * float(sizes @ sizes),
        )

    def multipliers(
        self, feasible_set: FeasibleSet | FrictionCones, x: Array, r: Array, rho: float
    ) -> Array:
        """Return the c (k,) of the next gradient projection step from x: those that belong to it.

        S^-1 (e - G'x) would satisfy the equations exactly, but magnify errors of x where S is
        small.

        Args:
            feasible_set: Lambda.
            x: (size,) in Lambda, about a solution of the equations.
            r: (size,) A x - b.
            rho: a step length.
        """
        return self.project(feasible_set, x - rho * r, np.zeros(len(self)), rho)[1]

    def violation(self, x: Array, c: Array) -> float:
        """Return sqrt(d'S d) for the d that c lacks to satisfy the soft equations."""
        missing = self.residual(x, c)
        return float(np.sqrt(missing @ self._inverse @ missing))

    def soft_multipliers(self, x: Array) -> Array:
        """Return S^-1 (e - G'x), (k,), of soft equations; zero for exact ones."""
        missing = self.values - self.matrix.along(x)
        rough = self._inverse @ missing
        # refined, for equations that are much softer than others would keep the rounding of those
        result: Array = rough + self._inverse @ (missing - self.softness @ rough)
        return result

    def slope(self, x: Array, direction: Array) -> float:
        """Return the derivative of (e - G'x)'S^-1 (e - G'x) / 2 along a direction."""
        return -float(self.soft_multipliers(x) @ self.matrix.along(direction))

    def curvature(self, direction: Array) -> float:
        """Return the second derivative of the same."""
        change = self.matrix.along(direction)
        return float(change @ self._inverse @ change)

    @cached_property
    def soft_directions(self) -> Array:
        """The orthogonal projector (k, k) onto the range of S."""
        _, vectors = self._range
        result: Array = vectors @ vectors.T
        return result

    @cached_property
    def _inverse(self) -> Array:
        """S^-1 on its range, zero on its kernel, (k, k)."""
        values, vectors = self._range
        result: Array = (vectors / values) @ vectors.T
        return result

    @cached_property
    def _range(self) -> tuple[Array, Array]:
        """The eigenvalues of S that are not rounding, and their vectors (k, number)."""
        if not self.are_soft:
            return np.empty(0), np.empty((len(self), 0))
        values, vectors = (
            self.reductions.from_first_rank(one) for one in np.linalg.eigh(self.softness)
        )
        kept = values > EXCESS_ROUNDING * values[-1]
        return values[kept], vectors[:, kept]
