"""Gmsh sessions, and files that are opened in them."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dolfinx_tresca._base.number import real
from dolfinx_tresca.errors import InputError, MeshError, shown


@contextmanager
def gmsh_session() -> Iterator[Any]:
    """Yield an initialised gmsh module; leave a user's own session open."""
    try:
        import gmsh
    except ImportError as error:
        raise MeshError(
            f"reading a Gmsh file needs the Python package gmsh: {error}. Install it with "
            "pip install gmsh."
        ) from error
    except OSError as error:
        raise MeshError(
            f"the Python package gmsh cannot be loaded: {error}. It needs libraries of the system "
            "(Debian, Ubuntu: apt install libglu1-mesa libgl1 libxrender1 libxcursor1 libxft2 "
            "libxinerama1)."
        ) from error

    ours = not gmsh.isInitialized()
    if ours:
        gmsh.initialize(interruptible=False)
    verbosity = gmsh.option.getNumber("General.Terminal")
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        yield gmsh
    finally:
        gmsh.option.setNumber("General.Terminal", verbosity)
        if ours:
            gmsh.finalize()


def open_file(
    gmsh: Any, path: Path, parameters: Mapping[str, float], *, again: bool = False
) -> None:
    """Open a file in Gmsh.

    Args:
        gmsh: the module, in a session.
        path: `.geo` or `.msh`.
        parameters: values of names that a `.geo` declares with `DefineConstant`.
        again: whether it has been opened before, with these parameters: it has their names.

    Raises:
        InputError: a parameter is unknown or no number, or the file is a `.msh`.
        MeshError: there is no such file, or Gmsh cannot read it.
    """
    if path.suffix not in (".geo", ".msh"):
        raise InputError(f"read_gmsh reads .geo and .msh files, found '{path}'.")
    if not path.is_file():
        raise MeshError(f"there is no file '{path}' (looked for from '{Path.cwd()}').")
    if path.suffix == ".msh" and parameters:
        raise InputError(
            f"'{path}' is a finished mesh and takes no parameters, found "
            f"{', '.join(parameters)}. Read the .geo file that it was made from instead."
        )
    for name, value in parameters.items():
        number = real(value)
        if number is None or not math.isfinite(number):
            raise InputError(
                f"parameter {name} of '{path}' must be a finite number, found {shown(value)}."
            )
    try:
        if not (again and parameters):
            gmsh.open(str(path))
            _check_names(gmsh, path, parameters)
        if parameters:
            _open_with(gmsh, path, parameters)
    except (InputError, MeshError):
        raise
    except Exception as error:  # gmsh raises nothing more specific
        raise MeshError(f"Gmsh cannot use '{path}': {error}") from error


def _check_names(gmsh: Any, path: Path, parameters: Mapping[str, float]) -> None:
    """Check that the `.geo` file that is open has parameters of these names."""
    known = gmsh.parser.getNames() if parameters else []
    unknown = [name for name in parameters if name not in known]
    if unknown:
        raise InputError(
            f"'{path}' has no parameter {', '.join(unknown)}; its names are {', '.join(known)}."
        )


def _open_with(gmsh: Any, path: Path, parameters: Mapping[str, float]) -> None:
    """Open a `.geo` file with parameters set."""
    # DefineConstant leaves alone what is defined already, so a file that sets the values and then
    # includes the user's does what -setnumber does on Gmsh's command line.
    with tempfile.TemporaryDirectory() as folder:
        wrapper = Path(folder) / "with_parameters.geo"
        lines = [f"{name} = {float(value)!r};" for name, value in parameters.items()]
        file = str(path.resolve())
        quote = "'" if '"' in file else '"'  # Gmsh knows both, and no way to escape one
        wrapper.write_text("\n".join([*lines, f"Include {quote}{file}{quote};", ""]))
        # forget the values that the file gave its names when it was opened first
        gmsh.parser.clear()
        gmsh.onelab.clear()
        gmsh.open(str(wrapper))
    for name, value in parameters.items():
        found = gmsh.parser.getNumber(name)[0]
        if found != float(value):
            raise InputError(
                f"'{path}' sets {name} = {found:g} itself and ignores the value {float(value):g}. "
                f"Declare it there as DefineConstant[ {name} = {found:g} ]."
            )
