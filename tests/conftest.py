"""What all tests share: scenes, and an end to runs in which one rank fails alone."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "demos"))


@pytest.fixture
def comm() -> Iterator[MPI.Comm]:
    """A communicator of all ranks; afterwards all collect PETSc objects together."""
    yield MPI.COMM_WORLD
    gc.collect()
    MPI.COMM_WORLD.barrier()


@pytest.fixture
def folder(comm: MPI.Comm, tmp_path: Path) -> Path:
    """A folder for files that all ranks see: the first rank's."""
    return Path(comm.bcast(str(tmp_path)))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Abort a parallel run at the first failure: the other ranks may wait for this one."""
    outcome = yield
    report = outcome.get_result()  # type: ignore[attr-defined]
    if report.failed and MPI.COMM_WORLD.size > 1:
        print(
            f"\nrank {MPI.COMM_WORLD.rank}: {report.nodeid} failed\n{report.longreprtext}",
            flush=True,
        )
        MPI.COMM_WORLD.Abort(1)
