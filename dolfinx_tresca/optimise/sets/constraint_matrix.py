"""The matrix G of equality constraints, with matrices derived from it. Numpy only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, issparse

from dolfinx_tresca._base.arrays import Array, Indices, Matrix
from dolfinx_tresca.optimise.reductions import Reductions
from dolfinx_tresca.optimise.sets.nodal_matrix import NodalPattern

#: Number of equations at and above which sparse matrices are faster than dense matrices.
MANY = 100


def stored(matrix: csr_array) -> Matrix:
    """Return a matrix as it is if it has at least `MANY` columns, else as a dense array."""
    return matrix if matrix.shape[1] >= MANY else matrix.toarray()


@dataclass(frozen=True)
class ConstraintMatrix:
    """The matrix G of `EqualityConstraints`, G'x + S c = e.

    Each row of G has entries for few bodies only.

    Attributes:
        columns: (size, k) G, sparse or dense, whose columns have length 1 or less.
        reductions: sums over the ranks.
        nodes: (size,) the node of each multiplier, see `FeasibleSet.nodes`.
    """

    columns: Matrix
    reductions: Reductions
    nodes: Indices

    @cached_property
    def absolute(self) -> Matrix:
        """The absolute values of G, sparse or dense."""
        return abs(self.columns)

    @cached_property
    def _transposed(self) -> tuple[Matrix, Matrix]:
        """G' and its absolute values; their rows are contiguous in memory."""
        contiguous = csr_array if issparse(self.columns) else np.ascontiguousarray
        return contiguous(self.columns.T), contiguous(self.absolute.T)

    def along(self, x: Array) -> Array:
        """Return G'x (k,). Collective."""
        if self.columns.shape[1] == 0:
            return np.empty(0)
        return self.reductions.total(self._transposed[0] @ x)

    def along_absolute(self, x: Array) -> Array:
        """Return |G|'x, (k,) or (k, columns), with the absolute values of G. Collective."""
        return self.reductions.total(self._transposed[1] @ x)

    @cached_property
    def gram(self) -> Array | csr_array:
        """G'G (k, k), the same on all ranks. The first call is collective."""
        return self.hessian(lambda v: v)

    def hessian(self, derivative: Callable[[Array], Array]) -> Array | csr_array:
        """Return G'D G, (k, k), the same on all ranks. Collective.

        Args:
            derivative: function that applies D to an array (size, columns); D is symmetric and
                couples only multipliers of the same node.
        """
        if not issparse(self.columns):
            return self.reductions.inner(self.columns, derivative(self.columns))
        D = self._pattern.matrix(derivative)
        return self.reductions.sparse_inner(self.columns, csr_array(D @ self.columns))

    @cached_property
    def _pattern(self) -> NodalPattern:
        """The pattern of matrices that couple only multipliers of the same node."""
        return NodalPattern(self.nodes)
