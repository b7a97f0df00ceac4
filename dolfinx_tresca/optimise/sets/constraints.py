"""Linear equations that multipliers must satisfy besides Lambda, exactly or softly. Numpy only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, eye_array, issparse

from dolfinx_tresca._base.arrays import ROUNDING, Array, Matrix
from dolfinx_tresca.optimise.reductions import Reductions
from dolfinx_tresca.optimise.sets.balance import Balance, balancing_multipliers
from dolfinx_tresca.optimise.sets.block_eigenpairs import eigenpairs
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

    def __len__(self) -> int:
        return len(self.values)

    def softness_with(self, added: float) -> Matrix:
        """Return S + s I, (k, k), for a number s >= 0 that is added. Not collective."""
        unit = eye_array(len(self), format="csr")
        return self.softness + added * (unit if issparse(self.softness) else unit.toarray())

    def residual(self, x: Array, c: Array) -> Array:
        """Return e - G'x - S c, (k,)."""
        result: Array = self.values - self.matrix.along(x) - self.softness @ c
        return result

    def imbalance(self, x: Array, c: Array) -> float:
        """Return the largest residual of the equations, divided by the sizes of their terms."""
        if len(self) == 0:
            return 0.0
        terms = self.matrix.along_absolute(np.abs(x)) + abs(self.softness) @ np.abs(c) + self.sizes
        size = float(np.linalg.norm(terms))
        return float(np.linalg.norm(self.residual(x, c))) / size if size > 0.0 else 0.0

    def balance(self, feasible_set: FeasibleSet | FrictionCones, reserve: float = 0.0) -> Balance:
        """Search for multipliers in Lambda that satisfy the equations: they balance the loads.

        S is replaced by the projector onto its range: all soft equations are then equally soft, and
        the result does not depend on their softness. Exact equations stay exact.

        Args:
            feasible_set: Lambda.
            reserve: relative increase of e; a positive value asks for a margin.
        """
        sizes = np.maximum(self.sizes, np.abs(self.values))
        vectors = self._range[1]
        return balancing_multipliers(
            feasible_set,
            self.matrix,
            vectors @ vectors.T,
            (1.0 + reserve) * self.values,
            sizes,
            depth=0.5 * LARGEST_REACTION**2 * float(sizes @ sizes),
        )

    def violation(self, x: Array, c: Array) -> float:
        """Return sqrt(d'S d) for the change d of c with which the soft equations hold at x.

        For floating bodies, the result is the energy norm of the rigid displacements that are
        missing for equilibrium.
        """
        values, vectors = self._range
        missing = vectors.T @ self.residual(x, c)
        return float(np.sqrt(missing @ (missing / values)))

    @cached_property
    def _range(self) -> tuple[Array, Matrix]:
        """The eigenvalues of S that exceed rounding errors, and their eigenvectors (k, number)."""
        if not self.softness.nonzero()[0].size:
            shape = (len(self), 0)
            return np.empty(0), csr_array(shape) if issparse(self.softness) else np.empty(shape)
        agreed = self.matrix.reductions.from_first_rank
        if not issparse(self.softness):
            values, vectors = (agreed(one) for one in np.linalg.eigh(self.softness))
        else:
            values, vectors = eigenpairs(self.softness)
            values, vectors.data = agreed(values), agreed(vectors.data)
        kept = values > ROUNDING * values.max()
        return values[kept], vectors[:, kept]
