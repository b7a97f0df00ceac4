"""What all tests share: fixtures, what runs on several ranks, and how a run on these ends."""

from __future__ import annotations

import contextlib
import gc
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI

import hypothesis
import pytest

import dolfinx.jit
import ffcx.codegeneration.jit

# The same examples in each run, and no clock.
hypothesis.settings.register_profile("tests", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("tests")

# Two processes may want the same form at once: one compiles it, the other waits, by default no more
# than 10 seconds, which is too short on a busy machine.
dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS["timeout"] = (300, "seconds")

# A process that is killed while it compiles a form leaves the source without the library, for which
# all later processes would wait in vain. Nobody waits longer than the timeout.
for _source in Path(dolfinx.jit.get_options()["cache_dir"]).expanduser().glob("*.c"):
    with contextlib.suppress(FileNotFoundError):  # another process may remove it as well
        if not _source.with_suffix(".c.cached").exists():
            if time.time() - _source.stat().st_mtime > 2 * 300:
                _source.unlink()

# Meshes are small: forms are compiled in less time than -O2 gains (194 forms of some tests from an
# empty cache: 48 seconds of processor time in place of 54).
dolfinx.jit.DOLFINX_DEFAULT_JIT_OPTIONS["cffi_extra_compile_args"] = (["-O1", "-g0"], "")


# FFCx lists the folder of all compiled forms each time it loads one, also one that it has loaded
# before: 6 % of the time of all tests.
_loaded: dict[str, Any] = {}
_load = ffcx.codegeneration.jit.get_cached_module


def _load_once(module_name: str, *args: Any) -> Any:
    if module_name not in _loaded:
        loaded = _load(module_name, *args)
        if loaded[0] is None:  # it is not compiled yet
            return loaded
        _loaded[module_name] = loaded
    return _loaded[module_name]


ffcx.codegeneration.jit.get_cached_module = _load_once


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the marker `parallel(name=[value, ...])` to tests with such parameters."""
    for item in items:
        for mark in [mark for mark in item.own_markers if mark.name == "parallel"]:
            given = item.callspec.params if mark.kwargs else {}  # type: ignore[attr-defined]
            if any(given[name] not in wanted for name, wanted in mark.kwargs.items()):
                item.own_markers.remove(mark)
    part = config.getoption("sample")
    if part:
        items[:] = sample(items, part)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that leaves out a part of the tests."""
    parser.addoption(
        "--sample",
        choices=["first", "second"],
        help="a part of the tests: first for all days, second for another DOLFINx",
    )


def sample(items: list[pytest.Item], part: str) -> list[pytest.Item]:
    """Return a part of the tests, selected by a hash of their names.

    "first" is for all days, "second" for another DOLFINx: each has half of the tests on one rank, a
    quarter of the parallel ones on 2 ranks and a sixteenth on 3 (three processes on two cores take
    longest: half a second a test). Tests that one sample has on several ranks are those that the
    other has on one rank.
    """
    ranks, second = MPI.COMM_WORLD.size, part == "second"

    def is_selected(item: pytest.Item) -> bool:
        number = zlib.crc32(item.nodeid.encode())
        if ranks == 1:
            return number % 2 == second
        return number % 4 == 1 - second if ranks == 2 else number % 16 == 3 - second

    return list(filter(is_selected, items))


_imported = 0


def collect_garbage() -> None:
    """Collect garbage, and exclude imported modules from following collections.

    Each test is followed by a collection. It takes 50 ms with the objects of all modules, 1 ms
    without them. Some modules are imported by the tests only.
    """
    global _imported
    gc.collect()
    if len(sys.modules) > _imported:
        _imported = len(sys.modules)
        gc.freeze()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """A selection that has no test for several ranks is no error."""
    if MPI.COMM_WORLD.size > 1 and exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
        session.exitstatus = pytest.ExitCode.OK


@pytest.fixture
def comm() -> Iterator[MPI.Comm]:
    """A communicator of all ranks; afterwards all collect PETSc objects together."""
    yield MPI.COMM_WORLD
    collect_garbage()
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
