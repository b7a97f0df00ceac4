"""Linear equations that multipliers must satisfy besides Lambda, exactly or softly. Numpy only."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_array, eye_array, issparse

from dolfinx_tresca._base.arrays import ROUNDING, Array, Matrix
from dolfinx_tresca.optimise.reductions import Reductions
from dolfinx_tresca.optimise.sets.block_eigenpairs import eigenpairs
from dolfinx_tresca.optimise.sets.constrained_projection import (
    ConstrainedProjection,
    constrained_projection,
)
from dolfinx_tresca.optimise.sets.constraint_matrix import ConstraintMatrix
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.optimise.sets.friction_cones import FrictionCones

#: `balance` ends its search without a solution if all multipliers that satisfy the equations have a
#: norm above this multiple of the norm of `sizes`.
LARGEST_REACTION = 1e4


@dataclass(frozen=True)
class EqualityConstraints:
    """The k equations G'x + S c = e for multipliers x in Lambda and multipliers c of the equations.

    Equations with S = 0 are exact, and c are their Lagrange multipliers. Equations with S > 0 are
    soft: the term (e - G'x)'S^-1 (e - G'x) / 2 is added to q, and c = S^-1 (e - G'x). In both
    cases, the gradient in x is A x - b - G c. With k = 0, there are no equations, and no method
    communicates.

    The equations express the equilibrium of floating bodies (`floating/equilibrium.py`); this
    module does not depend on that meaning.

    Methods are collective.

    Attributes:
        matrix: G (size, k), with columns of length 1 or less.
        softness: (k, k) S, symmetric and positive semidefinite, sparse if `matrix` is.
        values: (k,) e.
        sizes: (k,) sums of the absolute values of the terms of e, from which rounding errors are
            estimated.
    """

    matrix: ConstraintMatrix
    softness: Matrix
    values: Array
    sizes: Array
    _last: list[Any] = field(default_factory=list, init=False, repr=False, compare=False)
    _guess: list[Array] = field(default_factory=list, init=False, repr=False, compare=False)

    @classmethod
    def none(cls, size: int, reductions: Reductions) -> EqualityConstraints:
        """Return an empty set of equations for vectors (size,)."""
        nothing = np.empty(0)
        matrix = ConstraintMatrix(np.empty((size, 0)), reductions, np.arange(size))
        return cls(matrix, np.empty((0, 0)), nothing, nothing)

    @property
    def columns(self) -> Matrix:
        """G (size, k). Not collective."""
        return self.matrix.columns

    @property
    def reductions(self) -> Reductions:
        """The sums over the ranks."""
        return self.matrix.reductions

    def __len__(self) -> int:
        return len(self.values)

    def softness_with(self, added: float) -> Matrix:
        """Return S + s I, (k, k), for a number s >= 0 that is added. Not collective."""
        unit = eye_array(len(self), format="csr")
        return self.softness + added * (unit if issparse(self.softness) else unit.toarray())

    @property
    def are_soft(self) -> bool:
        """Whether any of the equations is soft. Not collective."""
        return bool(self.softness.nonzero()[0].size)

    @property
    def are_all_soft(self) -> bool:
        """Whether none of the equations is exact. Not collective after the first access."""
        return len(self._range[0]) == len(self)

    def residual(self, x: Array, c: Array) -> Array:
        """Return e - G'x - S c, (k,)."""
        result: Array = self.values - self.matrix.along(x) - self.softness @ c
        return result

    def project(
        self,
        feasible_set: FeasibleSet | FrictionCones,
        y: Array,
        c: Array,
        rho: float,
        guess: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return the point x of Lambda nearest to y that satisfies the equations, and a change dc.

        The multipliers of the equations become c + dc. The point and dc minimise
        |x - y|^2 / 2 + rho dc'S dc / 2 under the condition G'x + S (c + dc) = e, so that x is
        P_Lambda(y + rho G dc). For y = z - rho r with the gradient r at z, this is the gradient
        projection step from z.

        Args:
            feasible_set: Lambda.
            y: (size,) point to project.
            c: (k,) multipliers of the equations.
            rho: step length.
            guess: (k,) first guess of dc; None: zero.
        """
        if len(self) == 0:
            return feasible_set.project(y), np.empty(0)
        if self._is_last(feasible_set, y, c, rho, guess is not None):
            known: tuple[Array, Array] = self._last[-1]
            return known
        shift = constrained_projection(
            feasible_set,
            self.matrix,
            1.0 / rho * self.softness,
            y,
            self.values - self.softness @ c,
            self.sizes + abs(self.softness) @ np.abs(c),
            guess=None if guess is None else rho * guess,
        ).shift
        result = feasible_set.project(y + self.columns @ shift), 1.0 / rho * shift
        for part in result:
            part.flags.writeable = False  # later calls may return this array again
        self._last[:] = feasible_set, y, c, rho, guess is not None, result
        return result

    def _is_last(
        self,
        feasible_set: FeasibleSet | FrictionCones,
        y: Array,
        c: Array,
        rho: float,
        guessed: bool,
    ) -> bool:
        """Return whether the last projection had the same arguments. Collective.

        Residual, multipliers and errors of an iterate need the same projection; most projections
        are repetitions. If a projection should start from zero, a projection that started from a
        guess does not count as the same.
        """
        same = False
        if self._last:
            last_set, last_y, last_c, last_rho, last_guessed, _ = self._last
            same = rho == last_rho and guessed >= last_guessed
            same = same and np.array_equal(y, last_y) and np.array_equal(c, last_c)
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
        """Search for multipliers in Lambda that satisfy the equations: they balance the loads.

        S is replaced by the projector onto its range: all soft equations are then equally soft, and
        the result does not depend on their softness. Exact equations stay exact.

        Args:
            feasible_set: Lambda.
            reserve: relative increase of e; a positive value asks for a margin.
        """
        sizes = np.maximum(self.sizes, np.abs(self.values))
        return constrained_projection(
            feasible_set,
            self.matrix,
            self.soft_directions,
            np.zeros(self.columns.shape[0]),
            (1.0 + reserve) * self.values,
            sizes,
            depth=0.5 * LARGEST_REACTION**2 * float(sizes @ sizes),
        )

    def gradient_step(
        self, feasible_set: FeasibleSet | FrictionCones, x: Array, r: Array, rho: float
    ) -> tuple[Array, Array]:
        """Return P_Lambda(x - rho (r - G c)), which satisfies the equations, and this c (k,).

        The search for c begins at the c of the last call. For the equations of a body that nothing
        presses, c is not unique and depends on this start, unlike the c of `multipliers`.

        Args:
            feasible_set: Lambda.
            x: (size,) point of Lambda.
            r: (size,) A x - b.
            rho: step length.
        """
        guess = self._guess[0] if self._guess else None
        result = self.project(feasible_set, x - rho * r, np.zeros(len(self)), rho, guess)
        self._guess[:] = result[1:]
        return result

    def multipliers(
        self, feasible_set: FeasibleSet | FrictionCones, x: Array, r: Array, rho: float
    ) -> Array:
        """Return the c (k,) of the gradient projection step from x, by a search from zero.

        The values S^-1 (e - G'x) would satisfy the equations exactly, but magnify errors of x if S
        is small.

        Args:
            feasible_set: Lambda.
            x: (size,) point of Lambda, approximately a solution of the equations.
            r: (size,) A x - b.
            rho: step length.
        """
        return self.project(feasible_set, x - rho * r, np.zeros(len(self)), rho)[1]

    def violation(self, x: Array, c: Array) -> float:
        """Return sqrt(d'S d) for the change d of c with which the soft equations hold at x.

        For floating bodies, the result is the energy norm of the rigid displacements that are
        missing for equilibrium.
        """
        missing = self.residual(x, c)
        return float(np.sqrt(missing @ self._inverse @ missing))

    def soft_multipliers(self, x: Array) -> Array:
        """Return S^-1 (e - G'x), (k,), for soft equations, and zero for exact equations."""
        missing = self.values - self.matrix.along(x)
        first = self._inverse @ missing
        # one step of iterative refinement: rounding of stiff equations would spoil softer equations
        result: Array = first + self._inverse @ (missing - self.softness @ first)
        return result

    def slope(self, x: Array, direction: Array) -> float:
        """Return the derivative of (e - G'x)'S^-1 (e - G'x) / 2 along a direction."""
        return -float(self.soft_multipliers(x) @ self.matrix.along(direction))

    def curvature(self, direction: Array) -> float:
        """Return the second derivative of (e - G'x)'S^-1 (e - G'x) / 2 along a direction."""
        change = self.matrix.along(direction)
        return float(change @ self._inverse @ change)

    @cached_property
    def soft_directions(self) -> Matrix:
        """The orthogonal projector (k, k) onto the range of S."""
        _, vectors = self._range
        return vectors @ vectors.T

    @cached_property
    def _inverse(self) -> Matrix:
        """S^-1 on the range of S, zero on the kernel of S, (k, k)."""
        values, vectors = self._range
        return (vectors * (1.0 / values)) @ vectors.T

    @cached_property
    def _range(self) -> tuple[Array, Matrix]:
        """The eigenvalues of S that exceed rounding errors, and their eigenvectors (k, number)."""
        if not self.are_soft:
            shape = (len(self), 0)
            return np.empty(0), csr_array(shape) if issparse(self.softness) else np.empty(shape)
        agreed = self.reductions.from_first_rank
        if not issparse(self.softness):
            values, vectors = (agreed(one) for one in np.linalg.eigh(self.softness))
        else:
            values, vectors = eigenpairs(self.softness)
            values, vectors.data = agreed(values), agreed(vectors.data)
        kept = values > ROUNDING * values.max()
        return values[kept], vectors[:, kept]
