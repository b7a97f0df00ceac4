"""Examples in docstrings give what they say."""

from __future__ import annotations

import doctest
from pathlib import Path
from typing import Any

import pytest

import dolfinx_tresca

#: The main classes, and the function that begins most scripts.
WITH_EXAMPLE = (
    "ContactPair",
    "ContactProblem",
    "ContactSolution",
    "SolverOptions",
    "Tresca",
    "read_gmsh",
)


def examples(name: str) -> list[doctest.DocTest]:
    """Return the examples of a public name and of its methods."""
    found = doctest.DocTestFinder().find(getattr(dolfinx_tresca, name), name)
    return [test for test in found if test.examples]


def run(name: str, names: dict[str, Any]) -> None:
    """Run examples; `names` are what they know, and get what they define."""
    for test in examples(name):
        test.globs = names
        report: list[str] = []
        failed, _ = doctest.DocTestRunner().run(test, out=report.append, clear_globs=False)
        assert failed == 0, "".join(report)


@pytest.fixture(scope="module")
def cube() -> dict[str, Any]:
    """The names that the example of ContactProblem defines; others refer to them."""
    names: dict[str, Any] = {}
    run("ContactProblem", names)
    return names


@pytest.mark.parametrize("name", [name for name in dolfinx_tresca.__all__ if examples(name)])
def test_examples_give_what_they_say(comm, cube, monkeypatch, name):
    monkeypatch.chdir(Path(__file__).parents[1])
    run(name, dict(cube))


@pytest.mark.parametrize("name", WITH_EXAMPLE)
def test_what_scripts_begin_with_has_an_example(name):
    assert examples(name)
