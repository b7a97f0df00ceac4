"""PETSc matrices from the rows of each rank, and products with sparse matrices."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array


def sparse_matrix(rows: csr_array, columns: tuple[int, int], comm: Any) -> PETSc.Mat:
    """Return a sparse PETSc matrix, which the caller owns. Collective.

    Args:
        rows: (rows of this rank, all columns), with global column numbers.
        columns: number of columns of this rank, and of all ranks.
        comm: the communicator.
    """
    pattern = (array.astype(PETSc.IntType) for array in (rows.indptr, rows.indices))
    sizes = ((rows.shape[0], None), columns)
    matrix = PETSc.Mat().createAIJ(sizes, csr=(*pattern, rows.data), comm=comm)
    matrix.assemble()
    return matrix


def dense_matrix(rows: Array, comm: Any) -> PETSc.Mat:
    """Return a dense PETSc matrix from rows (n, k) of each rank; the caller owns it. Collective."""
    matrix = PETSc.Mat().createDense(((len(rows), None), (None, rows.shape[1])), comm=comm)
    matrix.setUp()
    matrix.getDenseArray()[:] = rows
    matrix.assemble()
    return matrix


def product(matrix: PETSc.Mat, columns: csr_array) -> csr_array:
    """Return this rank's rows of the product of a PETSc matrix and sparse columns. Collective.

    Args:
        matrix: (rows of this rank, n).
        columns: (rows of this rank, k) all columns of the second matrix.
    """
    comm, k = matrix.comm, columns.shape[1]
    right = sparse_matrix(columns, (k if comm.rank == 0 else 0, k), comm)
    result = matrix.matMult(right)
    values = csr_array(result.getValuesCSR()[::-1], shape=(result.getLocalSize()[0], k))
    right.destroy()
    result.destroy()
    return values
