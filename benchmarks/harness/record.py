"""Measured rows, stored as JSON with their runs: code, date, machine and versions.

A file is `{"runs": [...], "rows": [...]}`; the entry `run` of a row is the index, in the first
list, of the run that measured the row.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Row = dict[str, Any]

ROOT = Path(__file__).parents[2]

#: Paths, for git, of the code on which measurements depend, without stored rows and Markdown pages.
CODE = ("dolfinx_tresca", "scenes", "demos", "tests", "benchmarks", ":!benchmarks/data", ":!*.md")


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)
    except OSError:
        return ""
    return done.stdout.strip()


def commit() -> str:
    """Return the commit of this checkout, followed by "+" if its code has changed since then."""
    found = _git("rev-parse", "--short=7", "HEAD") or "unknown"
    return found + "+" * bool(_git("status", "--porcelain", "--", *CODE))


def is_known(commit: str) -> bool:
    """Return whether a commit identifies the code that measured."""
    return commit != "unknown" and not commit.endswith("+")


def cpu_name() -> str:
    """Return the name of the processor."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def this_run() -> Row:
    """Return the commit, date, machine and versions of the present measurements."""
    # imported here, since reading rows does not need them
    from petsc4py import PETSc

    import dolfinx

    cores = len(os.sched_getaffinity(0))
    return {
        "commit": commit(),
        "date": datetime.date.today().isoformat(),
        "cpu": cpu_name(),
        "cores": cores,
        "threads": int(os.environ.get("OMP_NUM_THREADS") or cores),
        "dolfinx": dolfinx.__version__,
        "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
    }


class Record:
    """Rows in the order in which they were first measured, each with its run.

    Attributes:
        rows: the rows; the entry `run` of each is the dict of its run.
    """

    def __init__(self, path: Path | None, key: Sequence[str]) -> None:
        """Begin with the rows of the file, if it exists.

        Args:
            path: the file; None: rows are kept in memory only.
            key: fields that identify a row.
        """
        self._path, self._key = path, tuple(key)
        self.rows = read(path) if path is not None and path.exists() else []

    def add(self, row: Row, run: Row) -> Row:
        """Store a row and return it.

        If the same run has already stored a row with the same key, both rows are merged. Rows of
        other runs with this key are dropped.
        """
        key = self._key_of(row)
        same = [place for place, old in enumerate(self.rows) if self._key_of(old) == key]
        ours = [place for place in same if self.rows[place]["run"] is run]
        merged = {**(self.rows[ours[0]] if ours else {}), **row, "run": run}
        if same:
            self.rows[same[0]] = merged
            for place in reversed(same[1:]):
                del self.rows[place]
        else:
            self.rows.append(merged)
        return merged

    def _key_of(self, row: Row) -> tuple[Any, ...]:
        return tuple(row.get(field) for field in self._key)

    def write(self) -> None:
        """Write the file; it is complete or unchanged if writing fails."""
        if self._path is None:
            return
        runs: list[Row] = []
        for row in self.rows:
            if row["run"] not in runs:
                runs.append(row["run"])
        rows = [{**row, "run": runs.index(row["run"])} for row in self.rows]
        self._path.parent.mkdir(parents=True, exist_ok=True)
        unfinished = self._path.with_suffix(".unfinished")
        unfinished.write_text(json.dumps({"runs": runs, "rows": rows}, indent=1) + "\n")
        unfinished.replace(self._path)


def read(path: Path) -> list[Row]:
    """Return the rows of a file, each with its run."""
    kept = json.loads(path.read_text())
    return [{**row, "run": kept["runs"][row["run"]]} for row in kept["rows"]]
