"""Peak memory of a part of a run, and what its ranks send each other."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import resource
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

from mpi4py import MPI


def peak_memory(comm: MPI.Comm) -> float:
    """Return the peak resident memory [MB] of all ranks since `reset_peak_memory`. Collective."""
    status = Path("/proc/self/status")
    if status.exists():
        lines = status.read_text().splitlines()
        kilobytes = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    else:
        kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(comm.allreduce(kilobytes / 1024))


def reset_peak_memory() -> None:
    """Forget the peak so far, where Linux allows it; else the peak is that of the whole run."""
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)  # what was freed, but not yet given back
        Path("/proc/self/clear_refs").write_text("5")


def resident_memory(comm: MPI.Comm) -> float:
    """Return the memory [MB] that all ranks hold now: the peak of a moment. Collective."""
    reset_peak_memory()
    return peak_memory(comm)


def peak_bytes(work: Callable[[], object]) -> int:
    """Return the most bytes that Python and numpy hold on this rank while they do a work.

    What was there before does not count. Unlike resident memory this is the same in each run.
    """
    tracemalloc.start()
    result = work()
    del result
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


class Traffic(logging.Handler):
    """What this rank sends others in `exchange`.

    Attributes:
        bytes: of all rows.
        messages: one for each rank that a round of exchange goes to.
        rounds: each of them also tells all ranks how many rows they get, 4 bytes each.
    """

    def __init__(self) -> None:
        super().__init__()
        self.bytes = self.messages = self.rounds = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Count a round."""
        sent, ranks = cast(tuple[int, int], record.args)
        self.bytes += sent
        self.messages += ranks
        self.rounds += 1


@contextlib.contextmanager
def traffic() -> Iterator[Traffic]:
    """Count what is sent within a block."""
    logger, counted = logging.getLogger("dolfinx_tresca.exchange"), Traffic()
    logger.addHandler(counted)
    logger.setLevel(logging.DEBUG)
    try:
        yield counted
    finally:
        logger.removeHandler(counted)
        logger.setLevel(logging.NOTSET)
