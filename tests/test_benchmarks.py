"""Benchmarks run as their first lines say, on meshes of a few cells.

Parts of convergence.py are in other tests, extremes.py runs the cases of tests/extremes, and
tradeoff.py takes minutes.
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"

#: Script, arguments for a quick run, and a figure that each row with a result has.
RUNS = {
    "seed_table": (["--sizes", "4", "--methods", "projected_newton", "ssn"], "products"),
    "cost": (
        ["--sizes", "4", "--scenes", "free_end_1", "--backends", "multigrid", "--repeats", "1",
         "--no-memory"],
        "ratio",
    ),
    "peers": (
        ["--sizes", "4", "--scenes", "free_end_1", "--peers", "cholesky", "monolithic", "fista"],
        "residual",
    ),
    "pairing": (["--facets", "100"], "seconds"),
    "readings": (["--scenes", "free_end_2_4", "--backends", "cholesky"], "products"),
    "required": (["--size", "4", "--scenes", "bonded", "the same in 2D"], "multipliers"),
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_benchmark(tmp_path, name):
    """On one rank: they start processes, some of them mpirun, which cannot be nested."""
    arguments, figure = RUNS[name]
    result = tmp_path / "rows.json"
    command = [sys.executable, str(BENCHMARKS / f"{name}.py"), *arguments, "--json", str(result)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    rows = json.loads(result.read_text())
    if isinstance(rows, dict):  # kept for a picture
        assert rows["commit"]
        rows = rows["rows"]
    assert rows
    for row in rows:
        assert row[figure] > 0.0, row


@pytest.mark.parametrize("data", sorted((BENCHMARKS / "data").glob("*.json")), ids=lambda p: p.stem)
def test_kept_measurements(tmp_path, monkeypatch, data):
    """Pictures are drawn of what is kept, which says of which code it is."""
    pytest.importorskip("matplotlib")
    assert json.loads(data.read_text())["commit"]
    picture = tmp_path / "picture.png"
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    monkeypatch.setattr(sys, "argv", ["", "--from", str(data), "--picture", str(picture)])
    importlib.import_module(data.stem).main()
    assert picture.stat().st_size > 10_000
