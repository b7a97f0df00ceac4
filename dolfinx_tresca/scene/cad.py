"""Bodies and faces of CAD models in Gmsh: their names and groups, and the sizes of cells."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, product
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array, real
from dolfinx_tresca.errors import InputError, MeshError, shown

#: Number of cells along the edge of a cube, in 2D a square, that is as large as the body.
CELLS_PER_EDGE = 6

#: Number of cells round a full turn of a curved surface.
CELLS_PER_TURN = 24

#: Size of cells near another body, relative to the size in the body, and distances from the other
#: body between which cells grow from the one to the other, relative to the size in the body.
NEAR_SIZE, NEAR_DISTANCE, FAR_DISTANCE = 0.5, 0.5, 3.0

#: What the kernel of Gmsh writes into STEP files in place of names.
NO_NAME = "Open CASCADE STEP translator"

#: Height of plane models over their plane, relative to their size (boxes of OpenCASCADE are loose).
PLANE_HEIGHT = 1e-5


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
    dim, size = model.getDimension(), _box(model, -1, -1)
    if dim < 2 or (dim == 2 and np.ptp(size[:, 2]) > PLANE_HEIGHT * np.ptp(size, axis=0).max()):
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
        number = real(value)
        if body not in groups:
            raise InputError(
                f"size: '{name}' has no body {shown(body)}; its bodies are {', '.join(groups)}."
            )
        if number is None or not 0.0 < number < np.inf:
            raise InputError(f"a size of cells must be a positive number, found {shown(value)}.")
    fields: list[int] = []

    def field(kind: str, lists: Mapping[str, Any], **numbers: float) -> int:
        tag = int(model.mesh.field.add(kind))
        for option, value in numbers.items():
            model.mesh.field.setNumber(tag, option, value)
        for option, value in lists.items():
            model.mesh.field.setNumbers(tag, option, value)
        return tag

    sizes: dict[int, float] = {}
    listed = {3: "VolumesList", 2: "SurfacesList"}[dim]
    for body, tag in groups.items():
        for entity in map(int, model.getEntitiesForPhysicalGroup(dim, tag)):
            content = model.occ.getMass(dim, entity)
            sizes[entity] = float(given.get(body, content ** (1.0 / dim) / CELLS_PER_EDGE))
            fields.append(field("Constant", {listed: [entity]}, VIn=sizes[entity]))
    for entity, near in _near_faces_of_others(model, dim, sizes).items():
        distance = field("Distance", {{3: "SurfacesList", 2: "CurvesList"}[dim]: near}, Sampling=20)
        cells = sizes[entity]
        limits = {"SizeMin": NEAR_SIZE * cells, "SizeMax": cells}
        limits |= {"DistMin": NEAR_DISTANCE * cells, "DistMax": FAR_DISTANCE * cells}
        growing = field("Threshold", {}, InField=distance, **limits)
        fields.append(field("Restrict", {listed: [entity]}, InField=growing))
    model.mesh.field.setAsBackgroundMesh(field("Min", {"FieldsList": fields}))


def _near_faces_of_others(model: Any, dim: int, sizes: Mapping[int, float]) -> dict[int, list[int]]:
    """Return body -> the faces of other bodies that are near it, of the kernel's numbers.

    They are near if their distance from a face of the body is at most the size of its cells.
    """
    faces = {
        body: [abs(face) for _, face in model.getBoundary([(dim, body)], oriented=False)]
        for body in sizes
    }
    boxes = {face: _box(model, dim - 1, face) for of_body in faces.values() for face in of_body}
    near: dict[int, set[int]] = {}
    for both in combinations(sizes, 2):
        reach = max(sizes[body] for body in both)
        for face, facing in product(faces[both[0]], faces[both[1]]):
            apart = np.maximum(boxes[face][0] - boxes[facing][1], boxes[facing][0] - boxes[face][1])
            if np.linalg.norm(np.maximum(apart, 0.0)) > reach:
                continue
            distance = model.occ.getDistance(dim - 1, face, dim - 1, facing)[0]
            for body, near_face in zip(both, (facing, face), strict=True):
                if distance <= sizes[body]:
                    near.setdefault(body, set()).add(near_face)
    return {body: sorted(of_body) for body, of_body in near.items()}


def _box(model: Any, dim: int, entity: int) -> Array:
    """Return the least and largest coordinates (2, 3) of an entity."""
    return np.reshape(model.getBoundingBox(dim, entity), (2, 3))
