"""Wall-clock times of the phases of a solve."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI

from dolfinx import common

from dolfinx_tresca._base.parallel import reduce_array


@contextmanager
def timed(name: str, timings: dict[str, float]) -> Iterator[None]:
    """Add the wall-clock time of a block [s] to `timings` and to `dolfinx.common.list_timings`."""
    start = time.perf_counter()
    with common.Timer(f"~dolfinx_tresca: {name}"):
        yield
    timings[name] = timings.get(name, 0.0) + time.perf_counter() - start


def largest_over_ranks(comm: MPI.Comm, timings: dict[str, float]) -> dict[str, float]:
    """Return the largest time of each phase over all ranks [s]. Collective."""
    values = reduce_array(comm, list(timings.values()), MPI.MAX)
    return dict(zip(timings, values.tolist(), strict=True))
