"""Sparse matrices of maps that couple only multipliers of the same node. Numpy only."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Indices


class NodalPattern:
    """The sparsity of a matrix that couples only multipliers of the same node."""

    def __init__(self, nodes: Indices) -> None:
        """Group multipliers.

        Args:
            nodes: (size,) the node of each multiplier.
        """
        size = len(nodes)
        index = np.unique(nodes, return_inverse=True)[1]
        member = csr_array((np.ones(size), (np.arange(size), index)), shape=(size, size))
        self._pattern = csr_array(member @ member.T)
        self._pattern.sort_indices()  # as operations with a matrix that shares its indices may do
        # multipliers of one node have different colours
        order = np.argsort(index, kind="stable")
        numbers = np.bincount(index)
        colour = np.empty(size, dtype=np.intp)
        colour[order] = np.arange(size) - (np.cumsum(numbers) - numbers)[index[order]]
        self._units = (colour[:, None] == np.arange(colour.max(initial=0) + 1)).astype(np.float64)
        row = np.repeat(np.arange(size), np.diff(self._pattern.indptr))
        self._entries = row, colour[self._pattern.indices]

    def matrix(self, nodal: Callable[[Array], Array]) -> csr_array:
        """Return the matrix (size, size) of a linear map of arrays (size, columns)."""
        pattern, values = self._pattern, nodal(self._units)[self._entries]
        return csr_array((values, pattern.indices, pattern.indptr), shape=pattern.shape)
