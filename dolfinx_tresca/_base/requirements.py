"""Import of MPI, PETSc and DOLFINx, with an error message that tells how to install them."""

from __future__ import annotations

import logging
import sys

#: Versions of Python whose `functools.singledispatchmethod`, used by UFL, never frees its
#: arguments, so that every mesh stays in memory. tools/venvs.py reads these versions from the file.
LEAKING = ((3, 13, 0), (3, 13, 1))


try:
    # MPI comes first: DOLFINx from PyPI finds the MPI library only after mpi4py has loaded it.
    from mpi4py import MPI
    from petsc4py import PETSc  # noqa: F401

    import dolfinx  # noqa: F401
except ImportError as error:
    if "libmpi" in str(error):
        remedy = (
            "mpi4py and DOLFINx need different MPI libraries. With DOLFINx from PyPI use a new "
            "virtual environment, without system packages and with no other MPI than mpich"
        )
    else:
        remedy = (
            "Install DOLFINx 0.9 to 0.11 with petsc4py for real numbers: on Linux x86_64 with "
            "Python 3.12 or later by pip install 'dolfinx_tresca[fenicsx]', elsewhere by conda "
            "install -c conda-forge fenics-dolfinx, on Debian 13 by apt install python3-dolfinx "
            "python3-petsc4py, or take the container dolfinx/dolfinx:stable"
        )
    raise ImportError(f"dolfinx_tresca cannot import DOLFINx: {error}. {remedy}.") from error

if sys.version_info[:3] in LEAKING and MPI.COMM_WORLD.rank == 0:
    logging.getLogger("dolfinx_tresca").warning(
        "Python %d.%d.%d never frees a mesh whose form UFL has derived: memory grows, and under "
        "MPICH some 250 problems on new meshes end in a crash. Take another, such as 3.13.2.",
        *sys.version_info[:3],
    )
