"""Benchmarks run as their first lines say, on meshes of a few cells; their tables are up to date.

Parts of convergence.py are in other tests.
"""

from __future__ import annotations

import importlib
import json
import re
import shlex
import sys
from pathlib import Path

import pytest

from scenes.two_bricks import on_bricks

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"

#: The mesh error is estimated anew of what is returned, and differs a little.
SLACK = 1.1

#: Arguments for a quick run, and a figure that each row with a result has.
RUNS = {
    "seed_table": ("--sizes 4 --methods projected_newton ssn", "products"),
    "growth": ("--kinds pairs --most 1", "products"),
    "cost": ("--sizes 4 --scenes free_end_1 --backends multigrid --repeats 1", "contact_rss_mb"),
    "peers": (
        "--sizes 4 --scenes free_end_1 --error 0.1 --peers cholesky monolithic penalty",
        "stress_error",
    ),
    "pairing": ("--facets 100", "seconds"),
    "assemblies": ("--bricks 2", "weight_products"),
    "reports": ("--small --scenes strips piles roller taper", "seconds"),
    "fixed_points": ("--number 3 --coefficients 3 --ways all", "found"),
    "adaptive": ("--scenes hertz_line --degrees 1 --dofs 700", "error"),
    "guaranteed": ("--scenes slips --sizes 4", "bound"),
    "finite_sliding": ("--scenes ironing --ironing 20 --cells 2 --way 0.1 --cases", "newton_steps"),
    "gradients": ("--sizes 3 --scenes free_end_2 --backends cholesky", "values"),
    "published": ("--cases shrink_fit incline one_node --meshes 1", "size"),
    "ablation": ("--scenes floating --parts solvers.products.SHIFT", "total"),
    "convergence": ("--cells triangle --degrees 1 --sizes 1 2", "energy"),
}

#: Cases of the yardstick whose rows `reports.py` measures.
REPORTS = {
    "curved_beams": ("curved beams", "F = 0: largest force [N/mm]"),
    "hopping_block": ("hopping block", "F = 0.1: largest T / N"),
    "gears": ("gears", "linear"),
}

#: Cases of the yardstick that `dolfinx_tresca_cases.py` solves: name -> coarsest size.
STATICS = {"belt": 30, "dovetail": 1.6, "taper": 2.0}


@pytest.fixture(autouse=True)
def benchmarks(monkeypatch):
    # the second for cases that are imported when they are needed, after the path was put back
    for folder in (BENCHMARKS, BENCHMARKS / "published_cases"):
        monkeypatch.syspath_prepend(str(folder))


def run(monkeypatch, name, *arguments) -> None:
    """Run a benchmark with a command line."""
    monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
    importlib.import_module(name).BENCHMARK.main()


def kept(path) -> list[dict]:
    """Return the rows of a file, each with its run."""
    return importlib.import_module("harness.record").read(path)


@pytest.mark.parametrize("name", RUNS)
def test_benchmark(tmp_path, monkeypatch, capsys, name):
    arguments, figure = RUNS[name]
    result = tmp_path / "rows.json"
    run(monkeypatch, name, *arguments.split(), "--here", "--changed", "--json", result)
    rows = kept(result)
    assert rows
    for row in rows:
        assert row[figure] > 0.0, row
        assert row["run"]["commit"]
    printed = capsys.readouterr().out
    for table in importlib.import_module(name).BENCHMARK.tables:
        if table.lines(rows):
            assert table.markdown(rows) in printed


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:Polyfit")  # fits need more nodes than coarse meshes have
@pytest.mark.parametrize("row", ["reports --small scene SCENES", "published --meshes=1 case NAMES"])
def test_all_cases_are_solved(tmp_path, monkeypatch, row):
    name, option, column, cases = row.split()
    result = tmp_path / "rows.json"
    run(monkeypatch, name, option, "--here", "--changed", "--json", result)
    assert {row[column] for row in kept(result)} == set(vars(importlib.import_module(name))[cases])


def test_pairing_takes_as_much_memory_as_the_page_says(tmp_path, monkeypatch):
    """3.9 kB at the peak for each secondary facet; 5.0 if the search for pairs is kept longer."""
    result = tmp_path / "rows.json"
    counted = "--facets 10000 --count-bytes --here --changed --json"
    run(monkeypatch, "pairing", *counted.split(), result)
    (row,) = kept(result)
    assert sum(row["bytes"]) <= 4000 * row["facets"]


def test_peers_find_the_same_stresses(tmp_path, monkeypatch):
    """All peers reach the stresses, with their own assembly and after load steps with history."""
    result = tmp_path / "rows.json"
    peers = "cholesky multigrid monolithic monolithic_classical penalty augmented scikit_fem"
    peers = peers.split()
    arguments = ["--sizes", 4, "--scenes", "free_end_1", "press_fit_steps", "--error", 0.01]
    arguments += ["--peers", *peers, "--here", "--changed", "--json", result]
    run(monkeypatch, "peers", *arguments)
    rows = kept(result)
    assert len(rows) == 2 * len(peers) - 1  # scikit_fem has the bricks alone
    for row in rows:
        assert row["status"] == "reached", row


def test_tables_of_the_page_are_up_to_date():
    """`tools/fenicsx python3 benchmarks/readme.py` makes them of what is kept."""
    readme = importlib.import_module("readme")
    page = readme.README.read_text()
    assert page == readme.filled(page)
    marked = [name for _, name in readme.MARKED.findall(page)]
    assert sorted(marked) == sorted(table.name for table, _ in readme.tables())


def test_commands_of_the_page_are_understood():
    """Each script takes the options that the page gives it."""
    page = (BENCHMARKS / "README.md").read_text().replace("\\\n", " ")
    found = re.findall(r"(?m)^ {4,}.*tools/fenicsx python3 benchmarks/(\w+)\.py(.*)$", page)
    assert 20 < len(importlib.import_module("measure").commands(page)) <= len(found)
    for name, arguments in found:
        parser = importlib.import_module(name).BENCHMARK.parser()
        parser.parse_args(shlex.split(arguments, comments=True))


@pytest.mark.parametrize("data", sorted((BENCHMARKS / "data").glob("*.json")), ids=lambda p: p.stem)
def test_kept_measurements_can_be_had_again(data):
    runs = json.loads(data.read_text())["runs"]
    assert all(re.fullmatch("[0-9a-f]{7,}", run["commit"]) and run["date"] for run in runs)


@pytest.mark.parametrize("name", ["convergence", "peers", "published", "tradeoff"])
def test_pictures_of_kept_measurements(tmp_path, monkeypatch, name):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "picture.png"
    run(monkeypatch, name, "--from", BENCHMARKS / "data" / f"{name}.json", "--picture", picture)
    assert picture.stat().st_size > 10_000


def test_yardstick(tmp_path, monkeypatch, capsys):
    """The checker finds the distances of our own table, and refuses what no case has."""
    monkeypatch.syspath_prepend(str(BENCHMARKS.with_name("yardstick")))
    check, published = importlib.import_module("check"), importlib.import_module("published")
    files = {path.stem for path in check.CASES.glob("*.json")}
    assert files == {*published.NAMES, *REPORTS, *STATICS}
    ours = BENCHMARKS / "data" / "published.json"
    measured = {(row["case"], row["quantity"]): row for row in check.measured(ours)}
    for row in published.quantities(kept(ours)):
        assert measured[row["case"], row["quantity"]]["off"] == pytest.approx(row["off"], abs=1e-6)
    paper = " ".join((BENCHMARKS.parent / "paper" / "paper.md").read_text().split())
    near = sum(abs(row["off"]) <= 0.01 for row in measured.values())
    assert f"{len(measured)} quantities, from" in paper and f"mesh {near} quantities" in paper
    reports = {(row["scene"], row["case"]): row for row in kept(ours.with_name("reports.json"))}
    for name, key in REPORTS.items():
        (value,) = json.loads((check.CASES / f"{name}.json").read_text())["published"].values()
        low, high = check.published_range(value)
        assert abs(check.distance(reports[key]["value"], low, high)) < 0.011, name
    answers = check.CASES.with_name("answers")
    monkeypatch.setattr(sys, "argv", ["check.py", *map(str, sorted(answers.glob("*.json")))])
    check.main()
    printed = capsys.readouterr().out
    assert "GetFEM 5.4.2: ironing: horizontal force at t = 1.5 [N]" in printed
    assert "scikit-fem 12.0.2: shrink_fit: mean pressure [MPa]" in printed
    for row, message in (
        ({"case": "iron", "quantity": "a", "value": 1.0}, "no case iron"),
        ({"case": "punch", "quantity": "a", "value": 1.0}, "no quantity 'a', but: pressure in"),
        ({"case": "punch", "quantity": "a", "value": float("nan")}, "punch: a: nan"),
    ):
        wrong = tmp_path / "wrong.json"
        wrong.write_text(json.dumps({"rows": [row | {"size": 1.0}]}))
        with pytest.raises(ValueError, match=message):
            check.measured(wrong)
    for text, message in (
        ('{"rows": [{"size": 1, "quantity": "a", "value": 1}]}', "a row has no case"),
        ('{"values": []}', "answers have the form"),
        ("{", "wrong.json cannot be read"),
    ):
        wrong.write_text(text)
        with pytest.raises(ValueError, match=message):
            check.measured(wrong)


@pytest.mark.parametrize(
    ("script", "sizes"),
    [("scikit_fem", {"shrink_fit": 16, "pushed_block": 32}), ("dolfinx_tresca", STATICS)],
)
def test_scripts_of_the_yardstick(monkeypatch, script, sizes):
    """The kept answers are those of the scripts, on the coarsest meshes, and near the published."""
    if script == "scikit_fem":
        pytest.importorskip("skfem")
    monkeypatch.syspath_prepend(str(BENCHMARKS.with_name("yardstick")))
    cases, check = importlib.import_module(f"{script}_cases"), importlib.import_module("check")
    answers = check.CASES.with_name("answers") / f"{script}.json"
    rows = json.loads(answers.read_text())["rows"]
    assert {row["case"] for row in rows} == set(sizes)
    for name, size in sizes.items():
        kept_rows = [row for row in rows if (row["case"], row["size"]) == (name, size)]
        values = {row["quantity"]: row["value"] for row in kept_rows}
        assert getattr(cases, name)(size) == pytest.approx(values, rel=1e-7)
    assert all(abs(row["off"]) < 0.004 for row in check.measured(answers))


def test_tradeoff(tmp_path, monkeypatch):
    """Meshes of all kinds, and parts of the mesh's error, on a few cells."""
    tradeoff = importlib.import_module("tradeoff")
    (mesh,) = tradeoff.family("tetrahedra", 1, 3)
    adaptive, *finer = tradeoff.adaptive(1, 2, 0.5, 0.35, 0.45)
    scene = tradeoff.Study(
        "two bricks", tradeoff.two_bricks, on_bricks, [mesh, adaptive], (mesh,), finer
    )
    monkeypatch.setitem(tradeoff.SCENES, "two_bricks", scene)
    monkeypatch.setattr(tradeoff, "PARTS", (0.1, 0.01))
    result = tmp_path / "rows.json"
    run(monkeypatch, "tradeoff", "--scenes", "two_bricks", "--here", "--changed", "--json", result)
    rows = kept(result)
    assert {row["axis"] for row in rows} == {"reference", "mesh", "part"}
    estimate = next(row["discretisation_error"] for row in rows if row["axis"] == "mesh")
    for row in rows:
        assert row["status"] == "CONVERGED", row
        if row["axis"] == "part":
            assert row["energy_error_bound"] <= row["part"] * SLACK * estimate
    for table in tradeoff.BENCHMARK.tables:
        assert table.lines(rows)
