"""Import of MPI, PETSc and DOLFINx, with an error message that tells how to install them."""

from __future__ import annotations

try:
    # MPI comes first: DOLFINx from PyPI finds the MPI library only after mpi4py has loaded it.
    from mpi4py import MPI  # noqa: F401
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
