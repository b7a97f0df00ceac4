"""Collective helpers: agreement on errors, gathering of small arrays."""

from __future__ import annotations

import logging
import pickle
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.lines import fill

_logger = logging.getLogger("dolfinx_tresca")

#: Warnings, and what they were about, since `each_warning_once` began; None outside of it.
_given: ContextVar[set[tuple[str, str]] | None] = ContextVar("_given", default=None)


@contextmanager
def each_warning_once() -> Iterator[None]:
    """Log a warning of the enclosed block the first time only, whatever numbers it has then.

    For what solves one problem on many meshes. Also a decorator. Not collective.
    """
    token = _given.set(set())
    try:
        yield
    finally:
        _given.reset(token)


def log(
    comm: MPI.Comm, message: str, *args: object, level: int = logging.INFO, about: str = ""
) -> None:
    """Log on the first rank of a communicator, in lines of limited length. Not collective.

    Args:
        comm: the ranks.
        message: with places for the arguments.
        args: what goes there.
        level: of the logger.
        about: of a warning, what it is about where that may be several things: see
            `each_warning_once`.
    """
    given = _given.get()
    if comm.rank > 0 or (given is not None and (message, about) in given):
        return
    if given is not None and level == logging.WARNING:
        given.add((message, about))
    _logger.log(level, "%s", fill(message % args))


@contextmanager
def errors_on_all_ranks(comm: MPI.Comm) -> Iterator[None]:
    """Raise on every rank what the enclosed block raised on any of them.

    Without this a rank that fails leaves the others waiting in their next collective call. The
    block itself must not communicate: a rank that has left it answers nobody.

    Collective: all ranks enter and leave together.

    Raises:
        BaseException: the rank's own exception, `KeyboardInterrupt` and `SystemExit` included, or
            else that of the lowest rank that failed; a RuntimeError with its words where it cannot
            be sent.
    """
    error: BaseException | None = None
    try:
        yield
    except (Exception, KeyboardInterrupt, SystemExit) as caught:
        error = caught
    failed = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
    if failed == comm.size:
        return
    other = comm.bcast(sendable(error) if comm.rank == failed else None, root=failed)
    raise on_all_ranks(error if error is not None else other)


def on_all_ranks(error: BaseException) -> BaseException:
    """Return an error that all ranks are about to raise together, marked as such."""
    error.__dict__["_on_all_ranks"] = True
    return error


def raised_on_all_ranks(error: BaseException) -> bool:
    """Return whether an error was raised on all ranks together: see `on_all_ranks`."""
    return bool(error.__dict__.get("_on_all_ranks", False))


def sendable(error: BaseException | None) -> BaseException | None:
    """Return an error, or one with its words if others cannot have it: users' may be of any kind.

    Such as one of a class inside of a function, or one whose arguments are not its message.
    """
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError("".join(traceback.format_exception_only(error)).strip())
    return error


def gather_rows(comm: MPI.Comm, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the rows of all ranks, in rank order, on every rank. For few rows only.

    Collective.
    """
    return np.concatenate(comm.allgather(rows), axis=0)


def reduce_array(comm: MPI.Comm, values: npt.ArrayLike, op: MPI.Op = MPI.SUM) -> npt.NDArray[Any]:
    """Return an array combined elementwise over all ranks, on every rank. Collective.

    The first rank combines, so that the result is the same to the last bit everywhere: decisions
    rest on it, and `Allreduce` may add in another order on each rank.
    """
    array = np.asarray(values, order="C")
    result = np.empty_like(array)
    comm.Reduce(array, result, op=op, root=0)
    comm.Bcast(result, root=0)
    return result


def broadcast_array(comm: MPI.Comm, values: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return the first rank's array of numbers; others have one of this shape. Collective."""
    array = np.array(values, dtype=np.float64, order="C")
    comm.Bcast(array, root=0)
    return array


@dataclass(frozen=True)
class RankReductions:
    """Sums and agreements over the ranks of a communicator, for vectors that they share.

    All methods are collective.
    """

    comm: MPI.Comm

    def inner(self, x: Array, y: Array) -> Array:
        """Return x'y over all ranks; (size,) or (size, k) each."""
        return reduce_array(self.comm, x.T @ y)

    def agreed(self, x: Array) -> Array:
        """Return the first rank's x, which others have but for rounding."""
        return broadcast_array(self.comm, x)

    def least(self, value: float) -> float:
        """Return the least value of all ranks."""
        return float(self.comm.allreduce(value, op=MPI.MIN))
