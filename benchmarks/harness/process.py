"""Running a case of a benchmark in a process of its own, or in several processes with MPI."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO, TypeAlias

from mpi4py import MPI

from harness.record import Row

Comm: TypeAlias = MPI.Comm

#: Function that yields rows with the figures of a case. Collective.
Measure: TypeAlias = Callable[[Comm, Row], Iterator[Row]]

#: Interval at which the parent process looks for new rows [s].
POLL = 0.05

#: Exit codes of a process whose time is up: without mpirun, and with mpirun.
TIME_IS_UP = (-signal.SIGALRM, 128 + signal.SIGALRM)

#: Beginning of the last line of a traceback.
REASON = re.compile(r"[\w.]*Error\b")

_limit = 0.0


def restart_clock() -> None:
    """Start the time limit of the case anew, if there is a limit."""
    signal.setitimer(signal.ITIMER_REAL, _limit)


def free_memory() -> int:
    """Return the bytes of memory that are available now, or -1 if this is unknown."""
    info = Path("/proc/meminfo")
    lines = info.read_text().splitlines() if info.exists() else []
    sizes = (1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    return next(sizes, -1)


def work(measure: Measure, small: Row, task: Row) -> None:
    """Measure a case in a process that `in_new` has started. Collective.

    Args:
        measure: function that measures the case.
        small: entries that replace those of the case in a first run; see `Benchmark.small`.
        task: the task that `in_new` wrote into the command line: the case, the file for its rows,
            and the limits.
    """
    global _limit
    # beyond this limit allocations fail: the case ends with a message before memory runs out
    resource.setrlimit(resource.RLIMIT_AS, (task["memory"], task["memory"]))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # time is up: the process ends
    comm, case = MPI.COMM_WORLD, task["case"]
    if small:
        for _ in measure(comm, {**case, **small}):
            pass
    _limit = task["limit"]
    restart_clock()
    try:
        with Path(task["result"]).open("a") as result:
            for row in measure(comm, case):
                if comm.rank == 0:
                    print(json.dumps(row), file=result, flush=True)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)  # the traceback and the exit have no time limit


def in_new(script: str, case: Row, limit: float) -> Iterator[Row]:
    """Yield the rows of a case, measured in as many new processes as its entry `ranks` says.

    If the case fails, the last row has a `status` with the reason.

    Args:
        script: path of the script, which is started with `--work TASK`.
        case: the case, which can be written as JSON.
        limit: wall-clock limit for measuring the case [s], without start and first run; 0: no
            limit.
    """
    ranks, cores = case.get("ranks", 1), len(os.sched_getaffinity(0))
    memory = free_memory()
    environment = {**os.environ, "OMPI_MCA_rmaps_base_oversubscribe": "1"}
    environment.setdefault("OMP_NUM_THREADS", str(cores))
    if ranks > 1:
        environment["OMP_NUM_THREADS"] = str(max(1, int(environment["OMP_NUM_THREADS"]) // ranks))
        environment["OMPI_MCA_mca_base_env_list"] = "OMP_NUM_THREADS"
    if ranks > cores:  # ranks that wait leave their core to ranks that work
        environment["OMPI_MCA_mpi_yield_when_idle"] = "1"
    with tempfile.TemporaryDirectory() as folder:
        result, errors = Path(folder) / "rows", Path(folder) / "errors"
        task = {
            "case": case,
            "result": str(result),
            "limit": limit,
            "memory": memory // ranks if memory > 0 else -1,
        }
        command = [sys.executable, script, "--work", json.dumps(task)]
        if ranks > 1:  # mpi4py ends all ranks when one has failed
            command[1:1] = ["-m", "mpi4py"]
            command = ["mpirun", "-n", str(ranks), *command]
        result.touch()
        with (
            errors.open("w") as stderr,
            result.open() as rows,
            subprocess.Popen(
                command, env=environment, stdout=subprocess.DEVNULL, stderr=stderr
            ) as process,
        ):
            try:
                while process.poll() is None:
                    time.sleep(POLL)
                    yield from _new_rows(rows)
            finally:
                process.terminate()  # mpirun passes the signal on to the ranks
            yield from _new_rows(rows)
        if process.returncode in TIME_IS_UP:
            yield {"status": f"stopped after {limit:g} s"}
        elif process.returncode != 0:
            reasons = [line for line in errors.read_text().splitlines() if REASON.match(line)]
            yield {"status": (reasons or [f"ended with {process.returncode}"])[-1]}


def _new_rows(rows: TextIO) -> Iterator[Row]:
    """Yield the rows that were written since the last call, without an unfinished line."""
    start = rows.tell()
    while (line := rows.readline()).endswith("\n"):
        start = rows.tell()
        yield json.loads(line)
    rows.seek(start)
