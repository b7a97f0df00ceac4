"""Peak memory during a part of a run, and the data that ranks send each other."""

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
    """Reset the peak, if Linux allows it; otherwise the peak is the peak of the whole run."""
    with contextlib.suppress(AttributeError, OSError):
        ctypes.CDLL(None).malloc_trim(0)  # give freed memory back to the system
        Path("/proc/self/clear_refs").write_text("5")


def resident_memory(comm: MPI.Comm) -> float:
    """Return the resident memory [MB] of all ranks at present. Collective."""
    reset_peak_memory()
    return peak_memory(comm)


def peak_bytes(work: Callable[[], object]) -> int:
    """Return the largest number of bytes that Python and numpy allocate on this rank during `work`.

    Memory allocated before does not count. Unlike resident memory the result is the same in each
    run.
    """
    tracemalloc.start()
    result = work()
    del result
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


class Traffic(logging.Handler):
    """Counts the data that this rank sends to other ranks in `exchange`.

    Attributes:
        bytes: number of bytes in all rows that are sent.
        messages: number of messages; a round of exchange sends one to each rank that gets rows.
        rounds: number of rounds of exchange. In each round, 4 further bytes tell each rank how many
            rows it gets.
    """

    def __init__(self) -> None:
        super().__init__()
        self.bytes = self.messages = self.rounds = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Count a round."""
        sent, ranks = cast(tuple[int, int], record.args)
        self.bytes += int(sent)  # numpy's integers are not written to JSON
        self.messages += int(ranks)
        self.rounds += 1


@contextlib.contextmanager
def traffic() -> Iterator[Traffic]:
    """Count the data that this rank sends within a `with` block."""
    logger, counted = logging.getLogger("dolfinx_tresca.exchange"), Traffic()
    logger.addHandler(counted)
    logger.setLevel(logging.DEBUG)
    try:
        yield counted
    finally:
        logger.removeHandler(counted)
        logger.setLevel(logging.NOTSET)
