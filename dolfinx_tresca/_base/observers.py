"""Observers: functions of the user that are called with the progress and may stop a solve."""

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

    Calls of the returned observer are collective. It returns True if the observer of any rank
    returns True.

    Args:
        comm: the communicator.
        observer: the observer of this rank, or None.
        argument: the type of the observer's argument, for the error message.

    Raises:
        InputError: the observer of a rank is not callable.
    """
    with errors_on_all_ranks(comm):
        if observer is not None and not callable(observer):
            raise InputError(f"observer must be a function of {argument}, found {shown(observer)}.")
    if not comm.allreduce(observer is not None, op=MPI.LOR):
        return lambda progress: False

    def any_rank_stops(progress: _T) -> bool:
        stop = False
        with errors_on_all_ranks(comm):
            stop = observer is not None and bool(observer(progress))
        return bool(comm.allreduce(stop, op=MPI.LOR))

    return any_rank_stops
