"""Sums and minima over ranks, for algorithms on distributed vectors."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array


class InnerProduct(Protocol):
    """The inner product of distributed vectors."""

    def inner(self, x: Array | csr_array, y: Array | csr_array) -> Array:
        """Return x'y over all ranks; x and y of shape (size,) or (size, k). Collective."""


class Reductions(InnerProduct, Protocol):
    """Sums over all ranks, and values on which all ranks agree. All methods are collective."""

    def total(self, x: Array) -> Array:
        """Return the sum of x over all ranks."""

    def sparse_inner(self, x: csr_array, y: csr_array) -> csr_array:
        """Return x'y over all ranks, equal on all ranks, for sparse x and y of shape (size, k)."""

    def stacked(self, rows: csr_array) -> csr_array:
        """Return the rows (size, k) of all ranks in the order of ranks, (n, k)."""

    def from_first_rank(self, x: Array) -> Array:
        """Return the first rank's x; on the other ranks, x may differ by rounding."""

    def minimum_over_ranks(self, value: float) -> float:
        """Return the minimum of a value over all ranks."""


def norm(space: InnerProduct, v: Array) -> float:
    """Return the Euclidean norm of v (size,) over all ranks. Collective."""
    return float(np.sqrt(space.inner(v, v)))
