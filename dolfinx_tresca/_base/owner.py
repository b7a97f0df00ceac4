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
    """Frees its PETSc objects in `destroy()`, or at the end of a `with` block.

    Where an exception ends the block on several ranks, other than this package's, which all ranks
    raise together, the objects are left to petsc4py: freeing them would wait for ranks that may
    have met no exception, and hide it.
    """

    @property
    @abstractmethod
    def comm(self) -> Any:
        """The ranks that own the objects together."""

    @abstractmethod
    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""

    def __enter__(self: _T) -> _T:
        return self

    def __exit__(self, kind: type[BaseException] | None, *error: object) -> None:
        if kind is None or issubclass(kind, ContactError) or self.comm.size == 1:
            self.destroy()


def free_unused(comm: MPI.Comm) -> None:
    """Free PETSc objects on a communicator that no rank refers to any more. Collective.

    On one rank petsc4py frees what Python drops at once. On several it cannot: to free is
    collective, and ranks drop objects at different times. It keeps them until all ranks come here.

    Args:
        comm: that of the mesh, which is another one than the mesh was made with.
    """
    if comm.size > 1:
        PETSc.garbage_cleanup(comm)


@contextmanager
def destroyed_on_error(owner: PetscOwner) -> Iterator[None]:
    """Destroy an owner where the enclosed block fails, which it must do on all ranks."""
    try:
        yield
    except BaseException:
        owner.destroy()
        raise
