"""Eigenpairs and triangular factors of sparse symmetric matrices. Numpy only."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import block_diag, csc_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from dolfinx_tresca._base.arrays import Array


def eigenpairs(matrix: csr_array) -> tuple[Array, csr_array]:
    """Return eigenvalues (k,) and eigenvectors (k, k) of a symmetric matrix.

    Rows that nonzero entries connect, directly or through other rows, are treated as one dense
    block: the cost grows with the sum of the cubes of the blocks' sizes. Eigenpair number j belongs
    to the block of row j; the eigenvalues of a block ascend.

    Args:
        matrix: (k, k) symmetric, k > 0.
    """
    label = connected_components(matrix, directed=False)[1]
    order = np.argsort(label, kind="stable")
    blocks = np.split(order, np.cumsum(np.bincount(label))[:-1])
    rows = csr_array(matrix)
    pairs = [np.linalg.eigh(rows[block][:, block].toarray()) for block in blocks]
    vectors = csr_array(block_diag([csr_array(vectors) for _, vectors in pairs]))
    place = np.argsort(order)
    return np.concatenate([values for values, _ in pairs])[place], vectors[place][:, place]


def factored(matrix: csr_array) -> Any | None:
    """Return SciPy's triangular factors of a symmetric matrix; None if there is a zero pivot.

    The matrix is factored as L U without pivoting, which for positive definite matrices is as
    stable as Cholesky's method.
    """
    try:
        return splu(csc_array(matrix), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return None


def is_positive_definite(matrix: csr_array) -> bool:
    """Return whether all pivots of a sparse symmetric matrix are positive (Sylvester)."""
    factors = factored(matrix)
    return factors is not None and bool((factors.U.diagonal() > 0.0).all())
