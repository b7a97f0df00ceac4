"""Processor seconds of repeated runs."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import TypeVar

from mpi4py import MPI

T = TypeVar("T")


def timed(comm: MPI.Comm, work: Callable[[], T]) -> tuple[float, T]:
    """Return the processor seconds of the slowest rank, and the result of `work`. Collective.

    The seconds are those of all threads of the rank, and include the time in which it waits for
    other ranks, but not the work of other programs.
    """
    gc.collect()
    comm.barrier()
    start = time.process_time()
    result = work()
    return float(comm.allreduce(time.process_time() - start, op=MPI.MAX)), result


def spread(seconds: Sequence[float]) -> float:
    """Return (slowest - fastest) / median."""
    return (max(seconds) - min(seconds)) / median(seconds)
