"""What all tests share: fixtures, what runs on several ranks, and how a run on these ends."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

import hypothesis
import pytest

import dolfinx.jit

# The same examples in each run, and no clock.
hypothesis.settings.register_profile("tests", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("tests")

# Two processes may want the same form at once: one compiles it, the other waits, by default no more
# than 10 seconds, which is too short on a busy machine.
dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS["timeout"] = (300, "seconds")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave the marker `parallel(name=[value, ...])` to tests with such parameters."""
    for item in items:
        for mark in [mark for mark in item.own_markers if mark.name == "parallel"]:
            given = item.callspec.params if mark.kwargs else {}  # type: ignore[attr-defined]
            if any(given[name] not in wanted for name, wanted in mark.kwargs.items()):
                item.own_markers.remove(mark)


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Take what was imported out of the garbage collector's sight.

    A collection after each test looks at what tests have made then, which takes no time; with all
    modules it takes a tenth of a second.
    """
    gc.collect()
    gc.freeze()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """A selection that has no test for several ranks is no error."""
    if MPI.COMM_WORLD.size > 1 and exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
        session.exitstatus = pytest.ExitCode.OK


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
