"""Functions of the user's that are told of progress, and may stop it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from mpi4py import MPI

from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError, shown

_T = TypeVar("_T")


def agreed_observer(
    comm: MPI.Comm, observer: Callable[[_T], bool | None] | None, argument: str
) -> Callable[[_T], bool]:
    """Return an observer whose answer, or exception, is the same on all ranks. Collective.

    It is collective, too, and answers True where that of any rank does.

    Args:
        comm: the ranks.
        observer: this rank's; None on ranks that have none.
        argument: what it is a function of, for the message.

    Raises:
        InputError: it is no function.
    """
    with errors_on_all_ranks(comm):
        if observer is not None and not callable(observer):
            raise InputError(f"observer must be a function of {argument}, found {shown(observer)}.")
    if not comm.allreduce(observer is not None, op=MPI.LOR):
        return lambda about: False

    def ask(about: _T) -> bool:
        answer = False
        with errors_on_all_ranks(comm):
            answer = observer is not None and bool(observer(about))
        return bool(comm.allreduce(answer, op=MPI.LOR))

    return ask
