"""Owners of PETSc objects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

_T = TypeVar("_T", bound="PetscOwner")


class PetscOwner(ABC):
    """Frees its PETSc objects in `destroy()`, or at the end of a `with` block."""

    @abstractmethod
    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""

    def __enter__(self: _T) -> _T:
        return self

    def __exit__(self, *error: object) -> None:
        self.destroy()


@contextmanager
def destroyed_on_error(owner: PetscOwner) -> Iterator[None]:
    """Destroy an owner where the enclosed block fails, which it must do on all ranks."""
    try:
        yield
    except BaseException:
        owner.destroy()
        raise
