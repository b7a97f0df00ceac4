"""Benchmarks run as their first lines say, on meshes of a few cells.

What convergence.py and extremes.py run are tests of their own, and tradeoff.py takes minutes.
"""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from dolfinx_tresca import ContactStatus

#: The mesh error is estimated anew of what is returned, and differs a little.
SLACK = 1.1

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


def test_the_tradeoff_turns_knobs_that_exist(monkeypatch):
    """It sets factors that users cannot choose, by their names in the package."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    tradeoff = importlib.import_module("tradeoff")
    case = importlib.import_module("tradeoff_scenes").two_bricks(4, "tetrahedra", 1)
    settings = (tradeoff.Setting(stiffness="multigrid", part=part) for part in (0.1, 0.01))
    loose, fine = (tradeoff.contact(case, setting, 60.0)[0] for setting in settings)
    assert loose.status is fine.status is ContactStatus.CONVERGED
    # a part of the mesh's error, without what the default asks of nodes
    assert fine.energy_error_bound <= 0.01 * SLACK * fine.discretisation_error
    assert loose.energy_error_bound <= 0.1 * SLACK * loose.discretisation_error
    tight = tradeoff.Setting(stiffness="multigrid", krylov=1e-4)
    assert tradeoff.contact(case, tight, 60.0)[0].krylov_iterations > loose.krylov_iterations
