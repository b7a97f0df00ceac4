"""Eigenpairs of sparse symmetric matrices that consist of many small blocks. Numpy only."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from dolfinx_tresca._base.arrays import Array, Indices


def eigenpairs(matrix: csr_array) -> tuple[Array, csr_array]:
    """Return eigenvalues (k,) and eigenvectors (k, k) of a symmetric matrix.

    Rows that nonzero entries connect, directly or through other rows, are treated as one dense
    block: the cost grows with the sum of the cubes of the blocks' sizes. Eigenpair number j belongs
    to the block of row j; the eigenvalues of a block ascend.

    Args:
        matrix: (k, k) symmetric, k > 0.
    """
    entries = matrix.tocoo()
    _, label = connected_components(matrix, directed=False)
    order: Indices = np.argsort(label, kind="stable")
    sizes = np.bincount(label)
    first = np.cumsum(sizes) - sizes
    place = np.empty(len(order), dtype=np.intp)
    place[order] = np.arange(len(order)) - first[label[order]]
    values = np.empty(len(order))
    rows, columns, vectors = [], [], []
    for size in np.unique(sizes):
        blocks = np.flatnonzero(sizes == size)
        number = np.empty(len(sizes), dtype=np.intp)
        number[blocks] = np.arange(len(blocks))
        some = sizes[label[entries.row]] == size
        row, column = entries.row[some], entries.col[some]
        dense = np.zeros((len(blocks), size, size))
        np.add.at(dense, (number[label[row]], place[row], place[column]), entries.data[some])
        members = order[first[blocks, None] + np.arange(size)]
        values[members], found = np.linalg.eigh(dense)
        rows.append(np.broadcast_to(members[:, :, None], found.shape).ravel())
        columns.append(np.broadcast_to(members[:, None], found.shape).ravel())
        vectors.append(found.ravel())
    row, column, data = (np.concatenate(one) for one in (rows, columns, vectors))
    return values, csr_array((data, (row, column)), shape=matrix.shape)
