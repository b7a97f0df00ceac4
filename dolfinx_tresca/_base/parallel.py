"""Helpers for MPI: errors on all ranks, logging, sums, exchange of rows, observers, times."""

from __future__ import annotations

import logging
import pickle
import textwrap
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, csr_array, issparse, vstack

import dolfinx.la
from dolfinx import common

from dolfinx_tresca._base.arrays import Array, Indices, LocalNumbers
from dolfinx_tresca.errors import InputError, shown

#: A space at which `fill` breaks no line, as between the components of a vector.
UNBROKEN = "\N{NO-BREAK SPACE}"


def fill(text: str, start: str = "", further: str = "  ") -> str:
    """Wrap a text at 100 characters; `start` precedes the first line, `further` each other one."""
    lines = textwrap.fill(
        text,
        100,
        initial_indent=start,
        subsequent_indent=further,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return lines.replace(UNBROKEN, " ")


_logger = logging.getLogger("dolfinx_tresca")

#: The last warnings of this process, for `ContactSolution.report`; more would hide the result.
RECENT_WARNINGS: deque[str] = deque(maxlen=20)

#: Warnings (message, subject) logged so far in each of the nested blocks of `each_warning_once`.
_logged_warnings: list[set[tuple[str, str]]] = []


@contextmanager
def each_warning_once() -> Iterator[None]:
    """Log a warning of the block once, even if it recurs with other numbers. Not collective."""
    _logged_warnings.append(set())
    try:
        yield
    finally:
        _logged_warnings.pop()


def log(
    comm: MPI.Comm, message: str, *args: object, level: int = logging.INFO, about: str = ""
) -> None:
    """Log a message, with `args` for its % placeholders, on the first rank. Not collective.

    In a block of `each_warning_once`, a message is logged once for each `about`, such as a pair.
    """
    if comm.rank > 0:
        return
    if _logged_warnings and level == logging.WARNING:
        if (message, about) in _logged_warnings[-1]:
            return
        _logged_warnings[-1].add((message, about))
    if level >= logging.WARNING:
        RECENT_WARNINGS.append(message % args)
    if _logger.isEnabledFor(level):
        _logger.log(level, "%s", fill(message % args))


def warn(comm: MPI.Comm, message: str, *args: object, about: str = "") -> None:
    """Log a warning on the first rank; see `log`. Not collective."""
    log(comm, message, *args, level=logging.WARNING, about=about)


@contextmanager
def errors_on_all_ranks(comm: MPI.Comm) -> Iterator[None]:
    """Raise on every rank an exception that the enclosed block raised on any rank. Collective.

    Without this, the other ranks would wait for ever in their next collective call. The block
    itself must not communicate. It may call collective functions of this package: their exceptions
    are raised on all ranks already, and pass. `KeyboardInterrupt` and `SystemExit` count, too. A
    rank without an exception gets that of the lowest rank that failed, see `picklable`.
    """
    error: BaseException | None = None
    try:
        yield
    except (Exception, KeyboardInterrupt, SystemExit) as caught:
        if comm.size == 1 or getattr(caught, "on_all_ranks", False):
            raise
        error = caught
    failed = comm.allreduce(comm.rank if error is not None else comm.size, op=MPI.MIN)
    if failed == comm.size:
        return
    received = comm.bcast(picklable(error) if comm.rank == failed else None, root=failed)
    raise mark_raised_on_all_ranks(error if error is not None else received)


def mark_raised_on_all_ranks(error: BaseException) -> BaseException:
    """Mark an exception as one that all ranks raise together, and return it."""
    error.__dict__["on_all_ranks"] = True
    return error


def picklable(error: BaseException | None) -> BaseException | None:
    """Return an exception; if it cannot be pickled, a RuntimeError with its type and message."""
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

    All ranks get the same bits and decide alike: `Allreduce` may add in another order on each rank.
    """
    array = np.asarray(values, order="C")
    result = np.empty_like(array)
    comm.Reduce(array, result, op=op, root=0)
    comm.Bcast(result, root=0)
    return result


def largest_abs(comm: MPI.Comm, *arrays: npt.ArrayLike) -> list[float]:
    """Return the largest absolute value in each array over all ranks, 0 if empty. Collective."""
    on_rank = [float(np.abs(array).max(initial=0.0)) for array in arrays]
    return [float(value) for value in reduce_array(comm, on_rank, MPI.MAX)]


@dataclass(frozen=True)
class RankReductions:
    """Sums and maxima over ranks, of vectors with `size` entries on this rank, for `solvers`."""

    comm: MPI.Comm

    def total(self, x: Array) -> Array:
        """Return the sum of x over all ranks, of equal shape on all, entry by entry. Collective."""
        return reduce_array(self.comm, x)

    def inner(self, x: Array | csr_array, y: Array | csr_array) -> Array:
        """Return x'y, summed over ranks, of dense or sparse (size,) or (size, k). Collective."""
        product: Any = x.T @ y
        return reduce_array(self.comm, product.toarray() if issparse(product) else product)

    def largest(self, value: float) -> float:
        """Return the largest value of all ranks. Collective."""
        return float(reduce_array(self.comm, value, MPI.MAX))

    def sparse_inner(self, x: csr_array, y: csr_array) -> csr_array:
        """Return x'y for sparse x and y (size, k), summed in the order of ranks. Collective."""
        product, *further_products = self.comm.allgather(csr_array(x.T @ y))
        return sum(further_products, start=product)

    def stacked(self, rows: csr_array) -> csr_array:
        """Return the sparse rows (size, k) of all ranks, stacked in their order. Collective."""
        if self.comm.size == 1:
            return rows
        return csr_array(vstack(self.comm.allgather(rows)))

    def from_first_rank(self, x: Array) -> Array:
        """Return the first rank's x; on the other ranks, x may differ by rounding. Collective."""
        return np.array(self.comm.bcast(x), dtype=np.float64)


_exchange_logger = logging.getLogger("dolfinx_tresca.exchange")


def exchange(
    comm: MPI.Comm, rows: npt.NDArray[Any], ranks: Indices
) -> tuple[npt.NDArray[Any], Indices]:
    """Send each row to a rank; return the rows received, and the rank of each. Collective.

    This rank sends rows (n, ...) to `ranks` (n,). The received rows (m, ...) are sorted by sender,
    and then as they were there. The number of bytes sent is logged at level DEBUG.
    """
    if comm.size == 1:
        return rows, np.asarray(ranks, dtype=np.intp)
    counts = np.bincount(ranks, minlength=comm.size)
    _exchange_logger.debug("%d bytes to %d ranks", rows.nbytes, np.count_nonzero(counts))
    sent = np.split(rows[np.argsort(ranks, kind="stable")], np.cumsum(counts)[:-1])
    received = comm.alltoall(sent)
    return np.concatenate(received), np.repeat(np.arange(comm.size), list(map(len, received)))


def summed_at_nodes(index_map: Any, nodes: Indices | LocalNumbers, values: Array) -> Array:
    """Return the sum (nodes, k) of all ranks' values at each node of this rank, with ghosts.

    This rank contributes values (..., k) at local nodes (...), which may repeat. Collective.
    """
    vector = dolfinx.la.vector(index_map, values.shape[-1])
    rows = values.reshape(-1, values.shape[-1])
    # a matrix with a single entry 1 in each column, at the row of the node
    entries = np.ones(len(rows)), nodes.ravel(), np.arange(len(rows) + 1)
    shape = (len(vector.array) // rows.shape[1], len(rows))
    vector.array[:] = (csc_array(entries, shape=shape) @ rows).ravel()
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    vector.scatter_forward()
    return np.array(vector.array).reshape(-1, values.shape[-1])


def row_of_least(comm: MPI.Comm, keys: npt.NDArray[Any], rows: npt.NDArray[Any]) -> Any:
    """Return the row (...) with the least key (n,) of all ranks; None without rows. Collective."""
    mine = (keys.min(), rows[keys.argmin()]) if len(keys) else None
    candidates = [candidate for candidate in comm.allgather(mine) if candidate is not None]
    return min(candidates, key=lambda candidate: candidate[0])[1] if candidates else None


_T = TypeVar("_T")


def agreed_observer(
    comm: MPI.Comm, observer: Callable[[_T], bool | None] | None, argument: str
) -> Callable[[_T], bool]:
    """Return a function that calls the user's observer on each rank. Collective.

    Its calls are collective, and return True on all ranks if any observer does; exceptions reach
    all ranks. The `argument` of the observer is named in the error for an observer of wrong type.
    """
    with errors_on_all_ranks(comm):
        if observer is not None and not callable(observer):
            raise InputError(f"observer must be a function of {argument}, found {shown(observer)}.")
    if not comm.allreduce(observer is not None, op=MPI.LOR):
        return lambda progress: False

    def any_rank_stops(progress: _T) -> bool:
        with errors_on_all_ranks(comm):
            stop = observer is not None and bool(observer(progress))
        return bool(comm.allreduce(stop, op=MPI.LOR))

    return any_rank_stops


@contextmanager
def timed(name: str, timings: dict[str, float]) -> Iterator[None]:
    """Add the wall-clock time of a block [s] to `timings` and to `dolfinx.common.list_timings`."""
    start = time.perf_counter()
    with common.Timer(f"~dolfinx_tresca: {name}"):
        yield
    timings[name] = timings.get(name, 0.0) + time.perf_counter() - start
