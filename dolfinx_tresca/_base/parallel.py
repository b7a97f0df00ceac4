"""Collective helpers: errors that are raised on all ranks, logging, reductions of small arrays."""

from __future__ import annotations

import logging
import pickle
import traceback
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, issparse, vstack

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.lines import fill

_logger = logging.getLogger("dolfinx_tresca")

#: The last warnings of this process, for reports; more of them would hide the result.
RECENT_WARNINGS: deque[str] = deque(maxlen=20)

#: Warnings (message, subject) logged so far in a block of `each_warning_once`; None outside of such
#: a block.
_logged_warnings: ContextVar[set[tuple[str, str]] | None] = ContextVar(
    "_logged_warnings", default=None
)


@contextmanager
def each_warning_once() -> Iterator[None]:
    """Log each warning of the enclosed block only once, whatever numbers the message contains.

    This context manager serves functions that solve one problem on many meshes. Not collective.
    """
    token = _logged_warnings.set(set())
    try:
        yield
    finally:
        _logged_warnings.reset(token)


def log(
    comm: MPI.Comm, message: str, *args: object, level: int = logging.INFO, about: str = ""
) -> None:
    """Log a message on the first rank, broken into lines. Not collective.

    Args:
        comm: the communicator; its other ranks do nothing.
        message: a format string with % placeholders.
        args: the values of the placeholders.
        level: the logging level.
        about: the subject of a warning, such as a pair; `each_warning_once` logs the same message
            once for each subject.
    """
    logged = _logged_warnings.get()
    if comm.rank == 0 and level >= logging.WARNING:
        RECENT_WARNINGS.append(message % args)
    if comm.rank > 0 or not _logger.isEnabledFor(level):
        return
    if logged is not None and (message, about) in logged:
        return
    if logged is not None and level == logging.WARNING:
        logged.add((message, about))
    _logger.log(level, "%s", fill(message % args))


@contextmanager
def errors_on_all_ranks(comm: MPI.Comm) -> Iterator[None]:
    """Raise on every rank an exception that the enclosed block raised on any rank.

    Without this, the remaining ranks would wait for ever in their next collective call. The block
    itself must not communicate, since a rank that has raised takes no part in communication.

    Collective: all ranks enter and leave together.

    Raises:
        BaseException: the rank's own exception, `KeyboardInterrupt` and `SystemExit` included; on a
            rank without an exception, the exception of the lowest rank that failed, or a
            RuntimeError with the message of this exception if it cannot be pickled.
    """
    error: BaseException | None = None
    try:
        yield
    except (Exception, KeyboardInterrupt, SystemExit) as caught:
        error = caught
    failed = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
    if failed == comm.size:
        return
    received = comm.bcast(picklable(error) if comm.rank == failed else None, root=failed)
    raise mark_raised_on_all_ranks(error if error is not None else received)


def mark_raised_on_all_ranks(error: BaseException) -> BaseException:
    """Mark an exception as one that all ranks raise together, and return it."""
    error.__dict__["_on_all_ranks"] = True
    return error


def raised_on_all_ranks(error: BaseException) -> bool:
    """Return whether `mark_raised_on_all_ranks` has marked an exception."""
    return bool(error.__dict__.get("_on_all_ranks", False))


def picklable(error: BaseException | None) -> BaseException | None:
    """Return an exception if it can be pickled, else a RuntimeError with its message.

    Pickle fails for local classes and for exceptions whose arguments are not their message.
    """
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError("".join(traceback.format_exception_only(error)).strip())
    return error


def gather_rows(comm: MPI.Comm, rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Gather the rows of all ranks, in rank order, on every rank. Collective; for few rows only."""
    return np.concatenate(comm.allgather(rows), axis=0)


def reduce_array(comm: MPI.Comm, values: npt.ArrayLike, op: MPI.Op = MPI.SUM) -> npt.NDArray[Any]:
    """Reduce an array elementwise over all ranks and return the result on every rank. Collective.

    The first rank reduces and broadcasts, so that all ranks get the same bits and decide alike:
    `Allreduce` may add in a different order on each rank.
    """
    array = np.asarray(values, order="C")
    result = np.empty_like(array)
    comm.Reduce(array, result, op=op, root=0)
    comm.Bcast(result, root=0)
    return result


def broadcast_array(comm: MPI.Comm, values: npt.ArrayLike) -> npt.NDArray[Any]:
    """Return the first rank's array on every rank; all ranks give the same shape. Collective."""
    array = np.array(values, dtype=np.float64, order="C")
    comm.Bcast(array, root=0)
    return array


@dataclass(frozen=True)
class RankReductions:
    """Reductions over the ranks for distributed vectors, with `size` entries on this rank.

    All methods are collective.
    """

    comm: MPI.Comm

    def total(self, x: Array) -> Array:
        """Return the sum of x over all ranks. Collective."""
        return reduce_array(self.comm, x)

    def inner(self, x: Array | csr_array, y: Array | csr_array) -> Array:
        """Return x'y, summed over all ranks, for x and y (size,) or (size, k). Collective.

        Both x and y may be sparse.
        """
        product: Any = x.T @ y
        return reduce_array(self.comm, product.toarray() if issparse(product) else product)

    def sparse_inner(self, x: csr_array, y: csr_array) -> csr_array:
        """Return x'y for sparse x and y (size, k), summed in the order of ranks. Collective."""
        product, *further_products = self.comm.allgather(csr_array(x.T @ y))
        return sum(further_products, start=product)

    def stacked(self, rows: csr_array) -> csr_array:
        """Return the rows of all ranks, sparse (size, k), in the order of ranks. Collective."""
        if self.comm.size == 1:
            return rows
        return csr_array(vstack(self.comm.allgather(rows)))

    def from_first_rank(self, x: Array) -> Array:
        """Return the first rank's x; on the other ranks, x may differ by rounding. Collective."""
        return broadcast_array(self.comm, x)

    def minimum_over_ranks(self, value: float) -> float:
        """Return the minimum of a value over all ranks. Collective."""
        return float(self.comm.allreduce(value, op=MPI.MIN))
