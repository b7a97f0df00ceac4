"""Eigenvalues and eigenvectors of sparse matrices of small blocks, against a dense matrix."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca.solvers.linear_algebra import eigenpairs
from scenes.scene import EPS

#: Number of the block of each row: blocks of 1, 2 and 3 rows that are not next to each other.
BLOCK = np.array([3, 0, 1, 0, 2, 4, 1, 2, 3, 3, 4])


def test_blocks_of_several_sizes():
    """The blocks 1 and 3 have rank 1; the block 4 is diagonal, the row without entries is zero."""
    rng = np.random.default_rng(0)
    dense = np.zeros((len(BLOCK), len(BLOCK)))
    for block in range(5):
        some = np.flatnonzero(BLOCK == block)
        root = rng.standard_normal((len(some), 1 if block in (1, 3) else len(some)))
        dense[np.ix_(some, some)] = root @ root.T
    first, second = np.flatnonzero(BLOCK == 4)
    dense[first, second] = dense[second, first] = dense[second, second] = 0.0
    values, vectors = eigenpairs(csr_array(dense))
    V, rounding = vectors.toarray(), 16 * EPS * np.linalg.norm(dense)
    assert np.abs(V.T @ V - np.eye(len(V))).max() <= 64 * EPS
    assert np.abs(V * values @ V.T - dense).max() <= rounding
    assert np.abs(np.sort(values) - np.linalg.eigvalsh(dense)).max() <= rounding
    assert vectors.nnz <= sum(np.bincount(BLOCK) ** 2)
