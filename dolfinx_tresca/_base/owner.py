"""Owners of PETSc objects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_tresca.errors import ContactError

_T = TypeVar("_T", bound="PetscOwner")


class PetscOwner(ABC):
    """Base class of PETSc owners: `destroy()`, or the end of a `with` block, frees the objects.

    A `ContactError` is raised on all ranks together, so the objects are freed after it, too. After
    any other exception on several ranks, the objects are left to petsc4py. Freeing them is
    collective: it would wait for ranks that may not have raised the exception, and the exception
    would never be shown.

    Attributes:
        comm: the communicator of the objects.
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


def free_unused(comm: MPI.Comm) -> None:
    """Free those PETSc objects on a communicator that no rank uses any more. Collective.

    On one rank, petsc4py frees an object as soon as Python drops it. On several ranks, freeing is
    collective, but the ranks drop objects at different times: petsc4py keeps them until this call.

    Args:
        comm: the communicator of the objects; for objects on a mesh `mesh.comm`, which is not the
            communicator that the mesh was made with, but a duplicate.
    """
    if comm.size > 1:
        PETSc.garbage_cleanup(comm)


@contextmanager
def destroyed_on_error(owner: PetscOwner) -> Iterator[None]:
    """Destroy an owner if the enclosed block raises; the block must raise on all ranks together."""
    try:
        yield
    except BaseException:
        owner.destroy()
        raise
