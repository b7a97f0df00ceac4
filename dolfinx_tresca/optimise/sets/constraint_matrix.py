"""The matrix G of equality constraints, with matrices derived from it. Numpy only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csc_array, csr_array, eye_array, issparse

from dolfinx_tresca._base.arrays import Array, Indices, Matrix
from dolfinx_tresca.optimise.reductions import Reductions

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
    def gram(self) -> Array | csc_array:
        """G'G (k, k), the same on all ranks. The first call is collective."""
        return self.hessian(lambda v: v)

    def hessian(self, derivative: Callable[[Array], Array]) -> Array | csc_array:
        """Return G'D G, (k, k), the same on all ranks. Collective.

        This is the Hessian of phi in `constrained_projection` if all equations are exact.

        Args:
            derivative: function that applies D to an array (size, columns); D is symmetric and
                couples only multipliers of the same node.
        """
        if not issparse(self.columns):
            return self.reductions.inner(self.columns, derivative(self.columns))
        narrow, position, pattern = self._narrow
        terms = narrow[:, :, None] * derivative(narrow)[:, None, :]
        sums = np.bincount(position, terms.ravel(), minlength=len(pattern.data))
        values = self.reductions.total(sums.astype(np.float64))
        return csc_array((values, pattern.indices, pattern.indptr), shape=pattern.shape)

    @cached_property
    def _narrow(self) -> tuple[Array, Indices, csc_array]:
        """The rows of G without columns that are zero at their node, for G'D G. Collective.

        D couples only multipliers of the same node, see `hessian`.

        Returns:
            the entries of G (size, width): each row has only the columns in which any row of its
            node has an entry, in ascending order, and zeros up to the largest number of columns;
            for any two entries of a row, the position of their product in the values of `pattern`
            (size * width^2,); and `pattern` (k, k), a matrix with the sparsity of G'D G and a full
            diagonal.
        """
        entries = csr_array(self.columns).tocoo()
        (size, k), row, column = entries.shape, entries.row, entries.col
        pairs, index = np.unique(self.nodes[row] * k + column, return_inverse=True)
        node, of_node = pairs // k, pairs % k
        first = np.searchsorted(node, np.arange(size))
        place = np.arange(len(pairs)) - first[node]
        width = int(place.max(initial=0)) + 1
        narrow = np.zeros((size, width))
        narrow[row, place[index]] = entries.data
        of_nodes = np.zeros((size, width), dtype=np.int64)  # 0 where a node has fewer columns
        of_nodes[node, place] = of_node
        columns = of_nodes[self.nodes]

        structure = csr_array((np.ones(len(pairs)), (node, of_node)), shape=entries.shape)
        structure = csc_array(self.reductions.sparse_inner(structure, structure))
        pattern = csc_array(structure + eye_array(k))
        pattern.sort_indices()
        known = np.repeat(np.arange(k), np.diff(pattern.indptr)) * k + pattern.indices
        wanted = (columns[:, :, None] * k + columns[:, None, :]).ravel()
        return narrow, np.searchsorted(known, wanted) % len(known), pattern
