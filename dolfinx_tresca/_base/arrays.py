"""Types of arrays and matrices, the smallest divisor, and rounding."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.intp]
Mask: TypeAlias = npt.NDArray[np.bool_]

#: A matrix, dense or sparse.
Matrix: TypeAlias = Array | csr_array

#: Integer types with which DOLFINx numbers nodes, cells, facets or rows. Local numbers are those on
#: one rank; global numbers are those over all ranks, or in the mesh file.
LocalNumbers: TypeAlias = npt.NDArray[np.int32]
GlobalNumbers: TypeAlias = npt.NDArray[np.int64]

#: Lower bound that is imposed on divisors and on arguments of logarithms. It is smaller than any
#: length, stiffness, energy or barrier of a scene in any units, and its reciprocal does not
#: overflow.
LEAST_DIVISOR = 1e-300

#: The difference of two numbers counts as rounding up to this multiple of the sum of the absolute
#: values of the terms from which the numbers are computed. This multiple is the rounding error of
#: some hundred operations. Doubling or halving it changes no status and no number of products
#: (benchmarks/ablation.py).
ROUNDING = 64 * float(np.finfo(np.float64).eps)


def scaled_rows(matrix: csr_array, factors: Array) -> csr_array:
    """Return a matrix (n, m) whose rows are multiplied by factors (n,)."""
    values = matrix.data * np.repeat(factors, np.diff(matrix.indptr))
    return csr_array((values, matrix.indices, matrix.indptr), matrix.shape)


def cross(a: Array, b: Array) -> Array:
    """Return the cross products (..., 3); for few vectors, np.cross takes three times as long."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(a[..., j] * b[..., k], a[..., k] * b[..., j], out=result[..., i])
    return result


def dense(matrix: Matrix) -> Array:
    """Return a matrix as a dense array."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
