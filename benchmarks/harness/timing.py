"""Seconds of repeated runs."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import TypeVar

from mpi4py import MPI

T = TypeVar("T")


def timed(comm: MPI.Comm, work: Callable[[], T]) -> tuple[float, T]:
    """Return how long the slowest rank takes, and the result. Collective."""
    gc.collect()
    comm.barrier()
    start = time.perf_counter()
    result = work()
    return float(comm.allreduce(time.perf_counter() - start, op=MPI.MAX)), result


def spread(seconds: Sequence[float]) -> float:
    """Return (slowest - fastest) / median."""
    return (max(seconds) - min(seconds)) / median(seconds)
