"""What type checkers find in users' scripts."""

from __future__ import annotations

import dataclasses
import inspect
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import get_type_hints

import pytest

from dolfinx_tresca import ContactProblem, SolverOptions

PACKAGE = Path(__file__).parents[1] / "dolfinx_tresca"

SCRIPT = """
from dolfinx_tresca.problem.linear import ContactProblem

def script(problem: ContactProblem) -> None:
    problem.solve(accuracy=1e-3, rtol=1e-8, method="gimssn")
    problem.solve(acuracy=1e-3)
    problem.solve(method="newton")
    problem.solve(max_iterations="many")
"""


def test_mypy_finds_options_that_do_not_exist(tmp_path):
    if find_spec("mypy") is None:
        pytest.skip("mypy is not installed: what it finds in scripts is not checked")
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    # what the signature does not need takes seconds
    arguments = (
        *("--follow-imports=skip", "--no-site-packages", "--ignore-missing-imports"),
        *("--no-incremental", "--config-file="),
    )
    files = (
        script,
        *(
            PACKAGE / name
            for name in (
                "problem/linear.py",
                "problem/process.py",
                "options.py",
                "_base/agreement.py",
            )
        ),
    )
    # a process of its own: what mypy imports would slow down the tests that follow
    command = [sys.executable, "-m", "mypy", *arguments, *map(str, files)]
    found = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    errors = [line for line in found.splitlines() if ": error: " in line]
    assert [line.split(":")[1] for line in errors] == ["6", "7", "8"]
    assert 'Unexpected keyword argument "acuracy"' in errors[0]


def test_solve_takes_every_option_and_no_other():
    """Names, order and types are those of the fields of SolverOptions; None leaves one alone."""
    parameters = inspect.signature(ContactProblem.solve).parameters
    names = [name for name in parameters if name not in ("self", "observer")]
    assert names == [field.name for field in dataclasses.fields(SolverOptions)]
    assert all(parameters[name].default is None for name in names)
    fields, hints = get_type_hints(SolverOptions), get_type_hints(ContactProblem.solve)
    assert all(hints[name] == fields[name] | None for name in names)
