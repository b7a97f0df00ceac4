"""The versions of all software that a solve depends on, for bug reports."""

from __future__ import annotations

import os
import platform
import sys
from importlib import import_module, metadata
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

import dolfinx

from dolfinx_tresca.stiffness.blas import BLAS, loaded_libraries, reference_blas
from dolfinx_tresca.table import Row, as_text

#: Packages of PETSc that factor or precondition K.
SOLVERS = ("mumps", "cholmod", "superlu_dist", "hypre")

#: Python packages whose versions are printed.
PACKAGES = (
    *("mpi4py", "fenics-ufl", "fenics-basix", "fenics-ffcx"),
    *("numpy", "scipy", "gmsh", "pyvista", "matplotlib"),
)


def environment() -> str:
    """Return a table of the versions of all software and of missing packages. Not collective."""
    versions = [(name, _version(name)) for name in PACKAGES]
    package = sys.modules["dolfinx_tresca"]
    folders = [str(Path(str(module.__file__)).parent) for module in (package, dolfinx)]
    rows: list[Row] = [
        ("package", f"dolfinx_tresca {package.__version__}, {folders[0]}"),
        ("Python", f"{sys.version.split()[0]}, {sys.executable}"),
        ("machine", f"{platform.platform()}, {os.cpu_count()} processors"),
        ("DOLFINx", f"{dolfinx.__version__}, {folders[1]}"),
        ("PETSc", _petsc()),
        ("MPI", MPI.Get_library_version().splitlines()[0].strip("\0 ")),
        ("BLAS", _blas()),
        ("VTK", _vtk()),
        *(("", f"{name} {version}") for name, version in versions if version),
        ("not installed", ", ".join(name for name, version in versions if not version) or "none"),
    ]
    return as_text(rows)


def _version(name: str) -> str | None:
    """Return the version of an installed Python package, or None."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _petsc() -> str:
    """Return the version of PETSc, its number types and its solvers."""
    version = ".".join(map(str, PETSc.Sys.getVersion()))
    scalars, indices = np.dtype(PETSc.ScalarType), np.dtype(PETSc.IntType)
    solvers = [name for name in SOLVERS if PETSc.Sys.hasExternalPackage(name)]
    return f"{version}, {scalars} scalars, {indices} indices, with {', '.join(solvers) or 'none'}"


def _vtk() -> str:
    """Return the version of VTK, which Debian installs without metadata."""
    try:
        core = import_module("vtkmodules.vtkCommonCore")
    except ImportError as error:
        return f"none: {error}"
    return str(core.vtkVersion.GetVTKVersion())


def _blas() -> str:
    """Return the BLAS libraries of this process and the environment variable OMP_NUM_THREADS."""
    libraries = loaded_libraries()
    names = {Path(path).name for path in filter(BLAS.search, libraries)}
    slow = ", the slow reference implementation" if reference_blas(libraries) else ""
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    return f"{', '.join(sorted(names)) or 'inside PETSc'}{slow}; OMP_NUM_THREADS {threads}"
