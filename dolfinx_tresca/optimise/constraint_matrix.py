"""The matrix G of equality constraints, with matrices derived from it. Numpy only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.reductions import Reductions


@dataclass(frozen=True)
class ConstraintMatrix:
    """The matrix G of the equations G'x + S c = e. A row has entries of two bodies only.

    Attributes:
        columns: (size, k) G, whose columns have length 1 or less.
        reductions: sums over the ranks.
    """

    columns: Array
    reductions: Reductions

    @cached_property
    def sparse(self) -> csr_array:
        """G as a sparse matrix."""
        return csr_array(self.columns)

    @cached_property
    def absolute(self) -> csr_array:
        """The absolute values of G as a sparse matrix."""
        return abs(self.sparse)

    @cached_property
    def gram(self) -> csr_array:
        """G'G (k, k), sparse, the same on all ranks. The first call is collective."""
        return self.reductions.sparse_inner(self.sparse, self.sparse)

    def along(self, x: Array) -> Array:
        """Return G'x (k,). Collective."""
        return self.reductions.inner(self.sparse, x) if self.columns.shape[1] else np.empty(0)
