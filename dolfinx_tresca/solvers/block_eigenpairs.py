"""Eigenpairs of sparse symmetric matrices that consist of many small blocks. Numpy only."""

from __future__ import annotations

import numpy as np
from scipy.sparse import block_diag, csr_array
from scipy.sparse.csgraph import connected_components

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
