"""What importing the package costs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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
        environment["PYTHONPATH"] = str(Path(__file__).parents[1])
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
