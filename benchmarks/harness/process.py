"""A case of a benchmark in a process, or a group of MPI ranks, of its own."""

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

#: Yields the figures of a case, some at a time. Collective.
Measure: TypeAlias = Callable[[Comm, Row], Iterator[Row]]

#: How often the parent looks whether there are new rows [s].
POLL = 0.05

#: How a process ends when its time is up; mpirun tells it by the second number.
TIME_IS_UP = (-signal.SIGALRM, 128 + signal.SIGALRM)

#: How the last line of a traceback begins.
REASON = re.compile(r"[\w.]*Error\b")

_limit = 0.0


def restart_clock() -> None:
    """Give the case its whole time again, if it has a limit."""
    signal.setitimer(signal.ITIMER_REAL, _limit)


def free_memory() -> int:
    """Return the bytes that are free now, or -1 where nothing tells."""
    info = Path("/proc/meminfo")
    lines = info.read_text().splitlines() if info.exists() else []
    sizes = (1024 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    return next(sizes, -1)


def work(measure: Measure, small: Row, task: Row) -> None:
    """Do what `in_new` asks of a new process. Collective.

    Args:
        measure: what to do.
        small: what to change of the case for a first run, which loads what there is to load.
        task: from the command line.
    """
    global _limit
    # beyond this allocations fail, and the case with a message, before the machine runs dry
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
        signal.setitimer(signal.ITIMER_REAL, 0.0)  # neither traceback nor exit are of the case


def in_new(script: str, case: Row, limit: float) -> Iterator[Row]:
    """Yield what a case finds in new processes, as many as `ranks` in it says.

    Args:
        script: that is started, with `--work TASK`.
        case: of JSON.
        limit: seconds that it may take, without what comes before it; 0: any.

    What goes wrong is a last row with a `status`.
    """
    ranks, cores = case.get("ranks", 1), len(os.sched_getaffinity(0))
    memory = free_memory()
    environment = {**os.environ, "OMPI_MCA_rmaps_base_oversubscribe": "1"}
    environment.setdefault("OMP_NUM_THREADS", str(cores))
    if ranks > 1:
        environment["OMP_NUM_THREADS"] = str(max(1, int(environment["OMP_NUM_THREADS"]) // ranks))
        environment["OMPI_MCA_mca_base_env_list"] = "OMP_NUM_THREADS"
    if ranks > cores:  # those that wait give way to those that work
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
                process.terminate()  # which mpirun passes on
            yield from _new_rows(rows)
        if process.returncode in TIME_IS_UP:
            yield {"status": f"stopped after {limit:g} s"}
        elif process.returncode != 0:
            reasons = [line for line in errors.read_text().splitlines() if REASON.match(line)]
            yield {"status": (reasons or [f"ended with {process.returncode}"])[-1]}


def _new_rows(rows: TextIO) -> Iterator[Row]:
    """Yield the rows that were written since: whole lines."""
    start = rows.tell()
    while (line := rows.readline()).endswith("\n"):
        start = rows.tell()
        yield json.loads(line)
    rows.seek(start)
