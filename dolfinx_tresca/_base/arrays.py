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

#: Integer types of DOLFINx that number nodes, cells, facets or rows: locally on one rank, and
#: globally over all ranks or in the mesh file.
LocalNumbers: TypeAlias = npt.NDArray[np.int32]
GlobalNumbers: TypeAlias = npt.NDArray[np.int64]

#: Lower bound that is imposed on divisors and on arguments of logarithms: below any length,
#: stiffness, energy or barrier of a scene in any units, and its reciprocal does not overflow.
LEAST_DIVISOR = 1e-300

#: Largest difference of two numbers that counts as rounding, divided by the sum of the absolute
#: values of the terms from which the numbers are computed: the error of some hundred operations.
#: Doubling or halving it changes no status and no number of products (benchmarks/ablation.py).
ROUNDING = 64 * float(np.finfo(np.float64).eps)


def dense(matrix: Matrix) -> Array:
    """Return a matrix as a dense array."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
