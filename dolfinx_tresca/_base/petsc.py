"""Owners of PETSc objects, and matrices from the rows of each rank."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from mpi4py import MPI
from petsc4py import PETSc

from scipy.sparse import csr_array, vstack

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import ContactError

_T = TypeVar("_T", bound="PetscOwner")


class PetscOwner(ABC):
    """Base class of PETSc owners: `destroy()`, or the end of a `with` block, frees the objects.

    A `ContactError` is raised on all ranks together, so the objects are freed after it, too. After
    any other exception on several ranks, the objects are left to petsc4py: freeing them would wait
    for ranks that may not have raised the exception, which would never be shown.
    """

    comm: Any

    @abstractmethod
    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""

    def __enter__(self: _T) -> _T:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None or issubclass(kind, ContactError) or self.comm.size == 1:
            self.destroy()


#: References of communicators that were freed since the last `free_unused` (`_REFERENCE`).
_unused_references: list[Any] = []


def free_unused(comm: MPI.Comm) -> None:
    """Free those PETSc objects on a communicator that no rank uses any more. Collective.

    On several ranks petsc4py keeps objects that Python has dropped until this call. Then PETSc's
    duplicates of freed communicators, which these objects needed, go as well. For objects on a mesh
    the communicator is `mesh.comm`.
    """
    if comm.size > 1:
        PETSc.garbage_cleanup(comm)
        _unused_references.clear()


#: Attribute of a communicator: a reference to PETSc's duplicate of it, kept while it exists.
_REFERENCE = MPI.Comm.Create_keyval(
    delete_fn=lambda comm, key, reference: _unused_references.append(reference)
)


def keep_inner_communicator(comm: MPI.Comm) -> None:
    """Keep PETSc's duplicate of an index map's communicator as long as the latter. Collective.

    PETSc frees the duplicate with its last object, and each rank frees vectors on its own: if an
    exception keeps them on one rank, the others would make a new duplicate, and wait forever.
    """
    if comm.size > 1 and comm.Get_attr(_REFERENCE) is None:
        # a copy of the handle, since DOLFINx keeps the index map as long as its own object exists
        comm.Set_attr(_REFERENCE, PETSc.Comm(MPI.Comm(comm)).duplicate())


@contextmanager
def destroyed_on_error(owner: PetscOwner) -> Iterator[None]:
    """Destroy an owner if the enclosed block raises, in the cases in which `PetscOwner` does."""
    try:
        yield
    except BaseException as error:
        owner.__exit__(type(error), error)
        raise


def sparse_matrix(rows: csr_array, columns: tuple[int, int], comm: Any) -> PETSc.Mat:
    """Return the sparse PETSc matrix with given rows on this rank; the caller owns it. Collective.

    The rows have global column numbers; `columns` counts this rank's columns, and all columns.
    """
    pattern = (array.astype(PETSc.IntType) for array in (rows.indptr, rows.indices))
    sizes = ((rows.shape[0], None), columns)
    matrix = PETSc.Mat().createAIJ(sizes, csr=(*pattern, rows.data), comm=comm)
    matrix.assemble()
    return matrix


def as_petsc(index_map: Any, block_size: int, blocks: Sequence[Any], comm: Any) -> PETSc.Mat:
    """Return the PETSc matrix with blocks, one below the other, as this rank's rows. Collective.

    The sparse blocks have global column numbers. The columns are distributed over the ranks like
    the index map, with `block_size` columns for each index.
    """
    columns = block_size * index_map.size_local, block_size * index_map.size_global
    return sparse_matrix(vstack(blocks, format="csr"), columns, comm)


def dense_matrix(rows: Array, comm: Any) -> PETSc.Mat:
    """Return a dense PETSc matrix from rows (n, k) of each rank; the caller owns it. Collective."""
    matrix = PETSc.Mat().createDense(((len(rows), None), (None, rows.shape[1])), comm=comm)
    matrix.setUp()
    matrix.getDenseArray()[:] = rows
    matrix.assemble()
    return matrix


def product(matrix: PETSc.Mat, columns: csr_array) -> csr_array:
    """Return this rank's rows of a PETSc matrix (m, n) times sparse columns (n, k). Collective.

    `columns` has a row for each of this rank's columns of the matrix; k is equal on all ranks.
    """
    comm, k = matrix.comm, columns.shape[1]
    result = matrix.matMult(sparse_matrix(columns, (k if comm.rank == 0 else 0, k), comm))
    return csr_array(result.getValuesCSR()[::-1], shape=(result.getLocalSize()[0], k))
