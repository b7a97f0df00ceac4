"""What importing the package costs, and which rooms beside it know each other."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[1]

HEAVY = ("pyvista", "matplotlib", "gmsh", "IPython", "vtk", "vtkmodules")


def test_importing_the_package_pulls_in_no_heavy_module(comm):
    """Pictures, meshing and progress bars are imported when they are used."""
    loaded = "nothing was run"
    if comm.rank == 0:
        # a process of its own, outside of this MPI run
        environment = {
            key: value
            for key, value in os.environ.items()
            if not key.startswith(("OMPI_", "PMIX_", "PMI_", "PRTE_"))
        }
        environment["PYTHONPATH"] = str(CHECKOUT)
        code = (
            "import sys, dolfinx_tresca; "
            f"print(*[name for name in {HEAVY!r} if name in sys.modules])"
        )
        loaded = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env=environment,
        ).stdout.strip()
    assert comm.bcast(loaded) == ""


def test_every_public_name_exists():
    import dolfinx_tresca

    for name in dolfinx_tresca.__all__:
        assert getattr(dolfinx_tresca, name).__doc__, name


def imported(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield each file of a folder, and the first part of each name that it imports."""
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            else:
                continue
            yield from ((str(path.relative_to(CHECKOUT)), name.split(".")[0]) for name in names)


def stems(room: str) -> set[str]:
    """Return the names by which the files of a folder are imported."""
    return {path.stem for path in (CHECKOUT / room).rglob("*.py")}


@pytest.mark.parametrize(
    ("room", "others"),
    [
        ("demos", ("scenes", "tests", "benchmarks")),  # readers copy them
        ("scenes", ("tests", "benchmarks", "demos")),
        ("tests", ("benchmarks", "demos")),
        ("benchmarks", ("tests", "demos")),
    ],
)
def test_what_is_shared_is_in_scenes(room, others):
    foreign = {name for other in others for name in (other, *stems(other))} - stems(room)
    assert [found for found in imported(CHECKOUT / room) if found[1] in foreign] == []
