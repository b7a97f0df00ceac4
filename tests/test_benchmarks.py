"""Benchmarks run as their first lines say, on meshes of a few cells.

Parts of convergence.py are in other tests, extremes.py runs the cases of tests/extremes, and
tradeoff.py takes minutes.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"

#: Script, arguments for a quick run, and a figure that each row with a result has.
RUNS = {
    "seed_table": (["--sizes", "4", "--methods", "projected_newton", "ssn"], "products"),
    "cost": (["--sizes", "4", "--repeats", "1", "--no-memory"], "ratio"),
    "peers": (["--sizes", "4", "--peers", "cholesky", "monolithic", "fista"], "residual"),
    "pairing": (["--facets", "100"], "seconds"),
    "readings": (["--scenes", "free_end_2_4", "--backends", "cholesky"], "products"),
    "required": (["--size", "4"], "multipliers"),
}


@pytest.mark.parametrize("name", RUNS)
def test_benchmark(comm, folder, name):
    if comm.size > 1:
        pytest.skip("these scripts start processes, some of them mpirun, which cannot be nested")
    arguments, figure = RUNS[name]
    result = folder / "rows.json"
    command = [sys.executable, str(BENCHMARKS / f"{name}.py"), *arguments, "--json", str(result)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    rows = json.loads(result.read_text())
    assert rows
    for row in rows:
        assert row[figure] > 0.0, row
