"""Gmsh: sessions, opening of files, and the names and sizes of bodies and faces of CAD models."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx_tresca._base.arguments import check_word, checked_number
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import InputError, MeshError, shown

#: Endings of the names of CAD files, and of all files that Gmsh reads here.
CAD_SUFFIXES = (".step", ".stp", ".brep", ".iges", ".igs", ".xao")
SUFFIXES = (".geo", ".msh", *CAD_SUFFIXES)

#: Units of length of coordinates from STEP and IGES files -> the kernel's name.
UNITS = {"mm": "MM", "cm": "CM", "m": "M", "um": "UM", "km": "KM", "in": "INCH", "ft": "FT"}

#: Number of cells round a full turn of a curved surface.
CELLS_PER_TURN = 24

#: What the kernel of Gmsh writes into STEP files in place of names.
NO_NAME = "Open CASCADE STEP translator"


@contextmanager
def gmsh_session() -> Iterator[Any]:
    """Yield the initialised gmsh module; a session that the user has opened keeps its models.

    Raises:
        MeshError: the Python package gmsh cannot be imported.
    """
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise MeshError(
            f"reading a Gmsh file needs the Python package gmsh: {error}. Install it with pip "
            "install gmsh, and the libraries of the system that it needs (Debian, Ubuntu: apt "
            "install libglu1-mesa libgl1 libxrender1 libxcursor1 libxft2 libxinerama1)."
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


def open_file(gmsh: Any, path: Path, parameters: Mapping[str, float], *, unit: str = "mm") -> None:
    """Open a file in Gmsh.

    Args:
        gmsh: the module, in a session.
        path: path of the file, with one of `SUFFIXES`.
        parameters: values of names that a `.geo` file declares with `DefineConstant`.
        unit: unit of length of the coordinates, for STEP and IGES files.

    Raises:
        InputError: the suffix is none of `SUFFIXES`, or the unit none of `UNITS`; or a parameter is
            not a finite number, or is overwritten by the file.
        MeshError: the file does not exist, or Gmsh cannot read it.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"read_gmsh reads {', '.join(SUFFIXES)} files, found '{path}'.")
    check_word("unit", unit, tuple(UNITS))
    if not path.is_file():
        raise MeshError(f"there is no file '{path}' (looked for from '{Path.cwd()}').")
    for name, value in parameters.items():
        checked_number(f"parameter {name} of '{path}'", value, "(-inf, inf)")
    if suffix in CAD_SUFFIXES:
        gmsh.option.setString("Geometry.OCCTargetUnit", UNITS[unit])
        for option in ("OCCSewFaces", "OCCMakeSolids"):  # IGES files have faces without order
            gmsh.option.setNumber(f"Geometry.{option}", suffix in (".iges", ".igs"))
    gmsh.model.add("")  # gmsh.open deletes the current model if it looks empty
    gmsh.parser.clear()
    gmsh.onelab.clear()
    # if Gmsh's parser raised an error itself, the next call would continue with the rest of the
    # file, even after gmsh.finalize()
    with options(gmsh, {"General.AbortOnError": 0}), tempfile.TemporaryDirectory() as folder:
        opened = path
        if parameters:
            # DefineConstant does not change a name that is already defined: a file that sets the
            # values and then includes the user's has the effect of Gmsh's option -setnumber
            opened = Path(folder) / "with_parameters.geo"
            lines = [f"{name} = {float(value)!r};" for name, value in parameters.items()]
            quote = "'" if '"' in str(path.resolve()) else '"'  # Gmsh has no escape sequence
            lines.append(f"Include {quote}{path.resolve()}{quote};\n")
            opened.write_text("\n".join(lines))
        gmsh.logger.start()
        try:
            gmsh.open(str(opened))
            errors = [line for line in gmsh.logger.get() if line.startswith("Error")]
        except Exception as error:  # gmsh raises nothing more specific
            errors = [f"Error: {error}"]
        finally:
            gmsh.logger.stop()
    if errors:
        raise MeshError(f"Gmsh cannot use '{path}': {errors[0].partition(': ')[2]}")
    for name, value in parameters.items():
        actual = gmsh.parser.getNumber(name)[0]
        if actual != float(value):
            raise InputError(
                f"'{path}' sets {name} = {actual:g} itself and ignores the value {float(value):g}. "
                f"Declare it there as DefineConstant[ {name} = {actual:g} ]."
            )


def check_parameters(gmsh: Any, path: Path, parameters: Mapping[str, float]) -> None:
    """Check that a file, which is open without parameters, declares the names of parameters.

    Raises:
        InputError: the file does not declare one of the names, or is no `.geo` file.
    """
    if path.suffix.lower() != ".geo":
        raise InputError(
            f"'{path}' takes no parameters, found {', '.join(parameters)}. Read the .geo file that "
            "it was made from instead."
        )
    names = gmsh.parser.getNames()
    unknown = [name for name in parameters if name not in names]
    if unknown:  # Gmsh's list does not tell parameters from the file's own variables
        text = path.read_text(errors="replace")
        texts = " ".join(re.findall(r"DefineConstant\s*\[.*?\]\s*;", text, flags=re.S))
        declared = [name for name in names if re.search(rf"\b{re.escape(name)}\b", texts)]
        raise InputError(
            f"'{path}' has no parameter {', '.join(unknown)}; its parameters are "
            f"{', '.join(declared) or 'none: declare them with DefineConstant'}."
        )


def name_groups(model: Any, name: str) -> None:
    """Put each body, and each face of a body, of a model without groups into a group of its own.

    Names are the labels of the file. Without label bodies are `body 1`, `body 2`, and the faces of
    `pin` are `pin/1`, `pin/2`. In 2D bodies are surfaces, and their faces are curves. Not
    collective.

    Args:
        model: the current model of Gmsh.
        name: name of the model, for error messages.

    Raises:
        MeshError: there is no body, a face is in no body, or two bodies share a face.
    """
    dim, size = model.getDimension(), np.ptp(_box(model, -1, -1), axis=0)
    if dim < 2 or (dim == 2 and size[2] > 1e-5 * size.max()):  # boxes of OpenCASCADE are loose
        raise MeshError(
            f"'{name}' has {len(model.getEntities(2))} faces and no solid: the faces do not close "
            "a body (an open shell). Close and sew them in the CAD program, and export solids."
        )
    names: set[str] = set()

    def add(entity: tuple[int, int], otherwise: str) -> str:
        label = model.getEntityName(*entity).rpartition("/")[2]
        label = otherwise if not label or label.startswith(NO_NAME) else label
        same = sum(word == label or word.startswith(f"{label} (") for word in names)
        names.add(word := f"{label} ({same + 1})" if same else label)
        model.addPhysicalGroup(entity[0], [entity[1]], entity[1], name=word)
        return word

    for k, body in enumerate(model.getEntities(dim), start=1):
        of_body = add(body, f"body {k}")
        faces = sorted(abs(face) for _, face in model.getBoundary([body], oriented=False))
        for i, face in enumerate(faces, start=1):
            bodies = model.getAdjacencies(dim - 1, face)[0]
            if len(bodies) == 1:
                add((dim - 1, face), f"{of_body}/{i}")
                continue
            both = [model.getPhysicalName(dim, int(body)) or f"body {body}" for body in bodies]
            raise MeshError(
                f"bodies {' and '.join(both)} in '{name}' share a face, which makes them one body. "
                "Contact needs two surfaces with nodes of their own: export the bodies without "
                "merging them (in Gmsh without fragment and removeAllDuplicates)."
            )
    faces = [face for _, face in model.getEntities(dim - 1)]
    free = [face for face in faces if not len(model.getAdjacencies(dim - 1, face)[0])]
    if free:
        raise MeshError(
            f"{len(free)} of the {len(faces)} faces in '{name}' belong to no "
            "body: they are an open shell. Close it in the CAD program, or remove the faces."
        )


def set_sizes(model: Any, size: float | Mapping[str, float] | None, name: str) -> None:
    """Give each body its size of cells, and half of it at faces that are near another body.

    Curved faces have `CELLS_PER_TURN` cells round a turn, if these are smaller. Not collective.

    Args:
        model: the current model of Gmsh, with a group for each body.
        size: size of cells [length], or name of a body -> size of its cells; None: from the size of
            each body, as for bodies that the mapping leaves out.
        name: name of the model, for error messages.

    Raises:
        InputError: a size is not a positive number, or no body has a name.
    """
    dim = model.getDimension()
    tags = [tag for _, tag in model.getPhysicalGroups(dim)]
    groups = {model.getPhysicalName(dim, tag) or str(tag): tag for tag in tags}
    same = {} if size is None else dict.fromkeys(groups, size)
    given = size if isinstance(size, Mapping) else same
    for body, value in given.items():
        if body not in groups:
            raise InputError(
                f"size: '{name}' has no body {shown(body)}; its bodies are {', '.join(groups)}."
            )
        checked_number("a size of cells", value)
    fields: list[int] = []

    def field(kind: str, **settings: float | list[int]) -> int:
        tag, new = int(model.mesh.field.add(kind)), model.mesh.field
        for option, value in settings.items():
            (new.setNumbers if isinstance(value, list) else new.setNumber)(tag, option, value)
        return tag

    sizes: dict[int, float] = {}
    faces: dict[int, list[int]] = {}
    listed, listed_faces = ("VolumesList", "SurfacesList", "CurvesList")[3 - dim :][:2]
    for body, tag in groups.items():
        for entity in map(int, model.getEntitiesForPhysicalGroup(dim, tag)):
            content = model.occ.getMass(dim, entity)
            sizes[entity] = float(given.get(body, content ** (1.0 / dim) / 6.0))
            fields.append(field("Constant", VIn=sizes[entity], **{listed: [entity]}))
            boundary = model.getBoundary([(dim, entity)], oriented=False)
            faces[entity] = [abs(face) for _, face in boundary]
    boxes = {face: _box(model, dim - 1, face) for of_body in faces.values() for face in of_body}
    for entity, cells in sizes.items():
        low, high = _box(model, dim, entity)
        near = [
            face
            for other_body in sizes.keys() - {entity}
            for face in faces[other_body]
            if (boxes[face][0] <= high + cells).all() and (boxes[face][1] >= low - cells).all()
        ]
        if near:
            distance = field("Distance", Sampling=20, **{listed_faces: sorted(near)})
            limits = {"SizeMin": 0.5 * cells, "SizeMax": cells}
            limits |= {"DistMin": 0.5 * cells, "DistMax": 3.0 * cells}
            growing = field("Threshold", InField=distance, **limits)
            fields.append(field("Restrict", InField=growing, **{listed: [entity]}))
    model.mesh.field.setAsBackgroundMesh(field("Min", FieldsList=fields))


def _box(model: Any, dim: int, entity: int) -> Array:
    """Return the least and largest coordinates (2, 3) of an entity."""
    return np.reshape(model.getBoundingBox(dim, entity), (2, 3))
