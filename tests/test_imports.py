"""What importing the package costs, its errors without DOLFINx, and the types of its options."""

from __future__ import annotations

import dataclasses
import inspect
import os
import subprocess
import sys
from pathlib import Path
from typing import get_type_hints

import pytest

import dolfinx_tresca
from dolfinx_tresca import ContactProblem, SolverOptions

CHECKOUT = Path(__file__).parents[1]

HEAVY = ("pyvista", "matplotlib", "gmsh", "IPython", "vtk", "vtkmodules")


def test_importing_the_package_pulls_in_no_heavy_module():
    """Pictures, meshing and progress bars are imported when they are used."""
    code = f"import sys, dolfinx_tresca; print(*sys.modules.keys() & {set(HEAVY)!r})"
    environment = os.environ | {"PYTHONPATH": str(CHECKOUT)}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize(
    ("fault", "remedy"),
    [
        ("No module named 'dolfinx'", "pip install 'dolfinx_tresca[fenicsx]'"),
        ("libmpi.so.12: cannot open shared object file", "need different MPI libraries"),
    ],
)
def test_without_dolfinx_the_error_says_what_to_do(tmp_path, fault, remedy):
    (tmp_path / "petsc4py.py").write_text(f"raise ImportError({fault!r})")
    environment = os.environ | {"PYTHONPATH": f"{tmp_path}:{CHECKOUT}"}
    command = [sys.executable, "-c", "import dolfinx_tresca"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    last = done.stderr.splitlines()[-1]
    assert last.startswith("ImportError: dolfinx_tresca cannot import DOLFINx")
    assert fault in last and remedy in last


def test_the_versions_for_a_bug_report():
    environment = os.environ | {"PYTHONPATH": str(CHECKOUT)}
    command = [sys.executable, "-m", "dolfinx_tresca", "--check"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    rows = dict(line.split(None, 1) for line in done.stdout.splitlines() if line[:1].strip())
    assert rows["package"].startswith(f"dolfinx_tresca {dolfinx_tresca.__version__}")
    assert "float64 scalars" in rows["PETSc"]


def test_every_public_name_exists():
    for name in dolfinx_tresca.__all__:
        assert getattr(dolfinx_tresca, name).__doc__, name


def test_solve_takes_every_option_and_no_other():
    """Names, order and types are those of the fields of SolverOptions; None leaves one alone."""
    parameters = inspect.signature(ContactProblem.solve).parameters
    names = [name for name in parameters if name not in ("self", "observer")]
    assert names == [field.name for field in dataclasses.fields(SolverOptions)]
    assert all(parameters[name].default is None for name in names)
    fields, hints = get_type_hints(SolverOptions), get_type_hints(ContactProblem.solve)
    assert all(hints[name] == fields[name] | None for name in names)
