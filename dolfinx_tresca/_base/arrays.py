"""Types of arrays and matrices, rounding, plain numbers, and random integers."""

from __future__ import annotations

import numbers
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.intp]
Mask: TypeAlias = npt.NDArray[np.bool_]

Matrix: TypeAlias = Array | csr_array

#: Integer types with which DOLFINx numbers nodes, cells, facets or rows. Local numbers are those on
#: one rank; global numbers are those over all ranks, or in the mesh file.
LocalNumbers: TypeAlias = npt.NDArray[np.int32]
GlobalNumbers: TypeAlias = npt.NDArray[np.int64]

#: Lower bound imposed on divisors and on arguments of logarithms, smaller than any quantity of a
#: scene in any units; its reciprocal does not overflow.
LEAST_DIVISOR = 1e-300

#: The difference of two numbers counts as rounding up to this multiple of the sum of the absolute
#: values of their terms: the rounding of some hundred operations. Doubling or halving it changes no
#: status and no number of products (benchmarks/ablation.py).
ROUNDING = 64 * float(np.finfo(np.float64).eps)


def scaled_rows(matrix: csr_array, factors: Array) -> csr_array:
    """Return a matrix (n, m) whose rows are multiplied by factors (n,)."""
    values = matrix.data * np.repeat(factors, np.diff(matrix.indptr))
    return csr_array((values, matrix.indices, matrix.indptr), matrix.shape)


def cross(a: Array, b: Array) -> Array:
    """Return the cross products (..., 3) of vectors; np.cross takes three times as long for few."""
    result = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(a[..., j] * b[..., k], a[..., k] * b[..., j], out=result[..., i])
    return result


def dots(a: Array, b: Array) -> Array:
    """Return the scalar products (...) of vectors (..., k)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def unit(vectors: Array) -> Array:
    """Return unit vectors (..., k) along vectors (..., k)."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def in_space(vectors: Array) -> Array:
    """Return vectors (..., 2) or (..., 3) as vectors (..., 3), whose third component is 0 in 2D."""
    added = [(0, 0)] * (vectors.ndim - 1) + [(0, 3 - vectors.shape[-1])]
    return np.pad(vectors, added)


def dense(matrix: Matrix) -> Array:
    """Return a matrix, dense or sparse, as a dense array (n, m)."""
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def real(value: Any) -> float | None:
    """Convert a real number of any type to float; return None for other values.

    Zero-dimensional arrays, such as the value of a `fem.Constant`, are numbers; bools are not.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    return float(value)


def integer(value: Any) -> int | None:
    """Convert an integer of any type to int; return None for other values, such as 2.0 or True."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        return None
    return int(value)


def splitmix64(x: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    """Return random integers (n,) for numbers (n,), by SplitMix64 (Steele, Lea and Flood 2014)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> np.uint64(31)))
