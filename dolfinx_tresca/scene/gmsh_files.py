"""Gmsh sessions and opening of files in them."""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dolfinx_tresca._base.arrays import real
from dolfinx_tresca.errors import InputError, MeshError, shown

#: Endings of the names of CAD files, and of all files that Gmsh reads here.
CAD_SUFFIXES = (".step", ".stp", ".brep", ".iges", ".igs")
SUFFIXES = (".geo", ".msh", *CAD_SUFFIXES)

#: Units of length of coordinates from STEP and IGES files -> the kernel's name.
UNITS = {"mm": "MM", "cm": "CM", "m": "M", "um": "UM", "km": "KM", "in": "INCH", "ft": "FT"}


@contextmanager
def gmsh_session() -> Iterator[Any]:
    """Yield the initialised gmsh module; a session that the user has opened keeps its models.

    Raises:
        MeshError: the Python package gmsh cannot be imported.
    """
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
    current, models = gmsh.model.getCurrent(), len(gmsh.model.list())
    try:
        with options(gmsh, {"General.Terminal": 0}):
            yield gmsh
    finally:
        if ours:
            gmsh.finalize()
        else:
            while len(gmsh.model.list()) > models:  # the newest model is current
                gmsh.model.remove()
            gmsh.model.setCurrent(current)


@contextmanager
def options(gmsh: Any, values: Mapping[str, float]) -> Iterator[None]:
    """Set options of Gmsh in a block."""
    before = {name: gmsh.option.getNumber(name) for name in values}
    try:
        for name, value in values.items():
            gmsh.option.setNumber(name, value)
        yield
    finally:
        for name, value in before.items():
            gmsh.option.setNumber(name, value)


def shapes_of(gmsh: Any) -> bytes | None:
    """Return the current model's shapes of OpenCASCADE, if any, as text of a `.brep` file."""
    if not gmsh.model.occ.getEntities():
        return None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shapes.brep"
        gmsh.write(str(path))
        return path.read_bytes()


def open_file(
    gmsh: Any,
    path: Path,
    parameters: Mapping[str, float],
    *,
    unit: str = "mm",
    reopened: bool = False,
) -> None:
    """Open a file in Gmsh.

    Args:
        gmsh: the module, in a session.
        path: path of the file, with one of `SUFFIXES`.
        parameters: values of names that a `.geo` file declares with `DefineConstant`.
        unit: unit of length of the coordinates, for STEP and IGES files.
        reopened: whether the file was opened with these parameters before; their names are not
            checked again.

    Raises:
        InputError: the suffix is none of `SUFFIXES`, or the unit none of `UNITS`; a parameter is
            unknown, is not a finite number, or is overwritten by the file; or a file that is not
            `.geo` has parameters.
        MeshError: the file does not exist, or Gmsh cannot read it.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"read_gmsh reads {', '.join(SUFFIXES)} files, found '{path}'.")
    if unit not in UNITS:
        raise InputError(f"unit must be one of {', '.join(UNITS)}, found {shown(unit)}.")
    if not path.is_file():
        raise MeshError(f"there is no file '{path}' (looked for from '{Path.cwd()}').")
    if suffix != ".geo" and parameters:
        what = "a finished mesh" if suffix == ".msh" else "a CAD file"
        raise InputError(
            f"'{path}' is {what} and takes no parameters, found {', '.join(parameters)}. Read the "
            ".geo file that it was made from instead."
        )
    for name, value in parameters.items():
        number = real(value)
        if number is None or not math.isfinite(number):
            raise InputError(
                f"parameter {name} of '{path}' must be a finite number, found {shown(value)}."
            )
    try:
        if suffix in CAD_SUFFIXES:
            gmsh.option.setString("Geometry.OCCTargetUnit", UNITS[unit])
            for option in ("OCCSewFaces", "OCCMakeSolids"):  # IGES files have faces without order
                gmsh.option.setNumber(f"Geometry.{option}", suffix in (".iges", ".igs"))
        if not (reopened and parameters):
            _parse(gmsh, path)
            _check_names(gmsh, path, parameters)
        if parameters:
            _open_with_parameters(gmsh, path, parameters)
    except (InputError, MeshError):
        raise
    except Exception as error:  # gmsh raises nothing more specific
        raise MeshError(f"Gmsh cannot use '{path}': {error}") from error


def _parse(gmsh: Any, path: Path) -> None:
    """Let Gmsh read a file to its end, and then raise the first error that Gmsh has logged.

    If Gmsh's parser raised the error itself, the next call would continue with the rest of the
    file, even after `gmsh.finalize()`.

    Raises:
        MeshError: Gmsh found an error in the file.
    """
    with options(gmsh, {"General.AbortOnError": 0}):
        gmsh.logger.start()
        try:
            gmsh.model.add("")  # gmsh.open deletes the current model if it looks empty
            gmsh.open(str(path))
            errors = [line for line in gmsh.logger.get() if line.startswith("Error")]
        finally:
            gmsh.logger.stop()
    if errors:
        raise MeshError(f"Gmsh cannot use '{path}': {errors[0].partition(': ')[2]}")


def _check_names(gmsh: Any, path: Path, parameters: Mapping[str, float]) -> None:
    """Check that the open `.geo` file declares the names of all parameters.

    Raises:
        InputError: the file does not declare one of the names.
    """
    names = gmsh.parser.getNames() if parameters else []
    unknown = [name for name in parameters if name not in names]
    if unknown:  # Gmsh's list does not tell parameters from the file's own variables
        text = path.read_text(errors="replace")
        texts = " ".join(re.findall(r"DefineConstant\s*\[.*?\]\s*;", text, flags=re.S))
        declared = [name for name in names if re.search(rf"\b{re.escape(name)}\b", texts)]
        raise InputError(
            f"'{path}' has no parameter {', '.join(unknown)}; its parameters are "
            f"{', '.join(declared) or 'none: declare them with DefineConstant'}."
        )


def _open_with_parameters(gmsh: Any, path: Path, parameters: Mapping[str, float]) -> None:
    """Open a `.geo` file with given values of its parameters.

    Raises:
        InputError: the file overwrites the value of a parameter.
    """
    # DefineConstant does not change a name that is already defined: a wrapper file that sets the
    # values and then includes the user's file has the effect of Gmsh's option -setnumber
    with tempfile.TemporaryDirectory() as folder:
        wrapper = Path(folder) / "with_parameters.geo"
        lines = [f"{name} = {float(value)!r};" for name, value in parameters.items()]
        file = str(path.resolve())
        quote = "'" if '"' in file else '"'  # Gmsh has no escape sequence for quotes
        wrapper.write_text("\n".join([*lines, f"Include {quote}{file}{quote};", ""]))
        # forget the default values, which the first opening of the file has set
        gmsh.parser.clear()
        gmsh.onelab.clear()
        _parse(gmsh, wrapper)
    for name, value in parameters.items():
        actual = gmsh.parser.getNumber(name)[0]
        if actual != float(value):
            raise InputError(
                f"'{path}' sets {name} = {actual:g} itself and ignores the value {float(value):g}. "
                f"Declare it there as DefineConstant[ {name} = {actual:g} ]."
            )
