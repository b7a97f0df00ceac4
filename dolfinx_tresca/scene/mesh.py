"""Reading of meshes and CAD files with Gmsh: mesh, tags, and the names of the tags."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx.mesh import MeshTags

from dolfinx_tresca._base import compat
from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.arguments import check_type, checked_number
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log
from dolfinx_tresca.errors import InputError, MeshError, shown
from dolfinx_tresca.scene.geometry import (
    CAD_SUFFIXES,
    Geometry,
    GmshGeometry,
    curved_groups,
    gmsh_session,
    open_file,
    options,
)

MESHES = Path(__file__).parents[1] / "meshes"  #: the folder of the demos' `.geo` files

#: Least number of cells round a full turn of a curved surface of a CAD model.
CELLS_PER_TURN = 24


class NamedTags(MeshTags):  # type: ignore[misc]
    """`dolfinx.mesh.MeshTags` with the names of the tags, for messages and tables.

    Attributes:
        names: tag -> name in the mesh file, for all tags that have a name.
        cell_tags: for tags of facets, those of the cells, with the names of the bodies; else None.
        geometry: for tags of facets, the geometry from which Gmsh made the mesh, if it is known.
    """

    def __init__(
        self,
        tags: MeshTags,
        names: Mapping[int, str],
        cell_tags: NamedTags | None = None,
        geometry: GmshGeometry | None = None,
    ) -> None:
        super().__init__(tags._cpp_object)
        self.names = dict(names)
        self.cell_tags, self.geometry = cell_tags, geometry


def abridged_names(tags: Sequence[int], facet_tags: MeshTags) -> str:
    """Return the names of tags as a text: at most three names, then the number of the others."""
    names = facet_tags.names if isinstance(facet_tags, NamedTags) else {}
    words = [names.get(tag, f"tag {tag}") for tag in tags[:3]]
    if len(tags) > len(words):
        words.append(f"{len(tags) - len(words)} more")
    return ", ".join(words)


class MergedTags(NamedTags):
    """Facet tags of a `ContactPair` with lists of tags: each list is replaced by its first tag.

    The user's tags stay in `given`; `merged` is the first tag of each list -> the tags in the list.
    """

    def __init__(self, given: MeshTags, lists: Sequence[Sequence[int]]) -> None:
        self.given, self.merged = given, {tags[0]: tuple(tags) for tags in lists}
        names = dict(given.names) if isinstance(given, NamedTags) else {}
        values = given.values.copy()
        for kept, merged in self.merged.items():
            names[kept] = abridged_names(merged, given)
            values[np.isin(values, merged)] = kept
        cell_tags = getattr(given, "cell_tags", None)
        geometry = getattr(given, "geometry", None)
        super().__init__(compat.with_values(given, values), names, cell_tags, geometry)


@dataclass(frozen=True)
class TaggedMesh:
    """A mesh with cell and facet tags.

    Attributes:
        mesh: the distributed `dolfinx.mesh.Mesh`.
        cell_tags: `MeshTags` of the cells, with the names of the tags.
        facet_tags: `MeshTags` of the facets, with the names of the tags.
        tags: name of each physical group of cells or facets -> tag. The name of an unnamed group
            is its tag, as a string.
        geometry: the curved surfaces that facets approximate, on which `refine` puts new nodes: the
            geometry from which Gmsh made the mesh, or tag -> function, as in `ContactPair`; None if
            they are unknown, or there are none.
    """

    mesh: Any
    cell_tags: Any
    facet_tags: NamedTags
    tags: dict[str, int]
    geometry: Geometry | None = None

    def __repr__(self) -> str:
        topology = self.mesh.topology
        cells = f"{topology.index_map(topology.dim).size_global} cells ({topology.cell_name()})"
        tags = ", ".join(f"{name} {tag}" for name, tag in self.tags.items())
        return f"<TaggedMesh: {cells}, tags: {textwrap.shorten(tags, 120, placeholder=' ...')}>"


@collective(comm_of("comm"), ignored=("path",))
def read_gmsh(
    path: Any, comm: MPI.Comm, *, size: Any = None, unit: Any = "mm", **parameters: float
) -> TaggedMesh:
    """Mesh a CAD file or a `.geo` file, or load a mesh, with the names of bodies and faces.

    Collective. The first rank runs Gmsh, then the mesh is distributed.

    Args:
        path: file `.step`, `.stp`, `.brep`, `.xao`, `.iges`, `.igs`, `.geo` or `.msh`; `gmsh.model`
            of the first rank's session, which gets groups and a mesh if it has none; or the result
            of `dolfinx.io.gmsh.model_to_mesh`. Curved surfaces of `.geo` and CAD files, and of a
            `gmsh.model` made by OpenCASCADE, are known. In `.geo` and `.msh` files all cells, and
            all facets that need a tag, are in physical groups. In CAD files, and in a `gmsh.model`
            without groups, each body and each face has a tag, and its label in the file as name;
            without label `body 1`, and `body 1/2` for its second face.
        comm: communicator of the mesh.
        size: size of cells [length] of CAD files, and of a `gmsh.model` without mesh, or name of a
            body -> size of its cells; None: a sixth of the edge of a cube as large as the body
            (of a `gmsh.model`: its own sizes). Near faces of other bodies cells are half as large,
            and curved faces have at least 24 cells round a turn. For `.geo`: its parameter `size`.
        unit: unit of the mesh of a STEP or IGES file: "mm", "cm", "m", "um", "km", "in" or "ft".
        **parameters: values of names that a `.geo` file declares with `DefineConstant`.

    Returns:
        The mesh, its cell and facet tags, and the table name -> tag.

    Raises:
        InputError: the suffix, the unit or a body in `size` is unknown; a parameter is unknown, not
            finite, or overwritten by the file; parameters are given for a file that is not `.geo`;
            or an argument has a wrong type.
        MeshError: the file does not exist or has an error; it has no body, or faces of no body; two
            bodies share a face; groups of cells or of facets are missing; or a facet is in two.

    Example:
        >>> from mpi4py import MPI
        >>> from dolfinx_tresca import MESHES, read_gmsh
        >>> bricks = read_gmsh(MESHES / "two_bricks.geo", MPI.COMM_WORLD, N=2)
        >>> bricks.tags["upper_contact"]
        22
    """
    check_type("comm", comm, MPI.Comm, "an MPI communicator, such as MPI.COMM_WORLD")
    geometry: GmshGeometry | None = None
    if isinstance(path, tuple):  # from model_to_mesh
        mesh, cell_tags, facet_tags = path[:3]
        wanted = "MeshTags, from physical groups of all bodies and surfaces"
        check_type("the tags of cells", cell_tags, MeshTags, wanted)
        check_type("the tags of facets", facet_tags, MeshTags, wanted)
        named = getattr(path, "physical_groups", {})
        groups = [(dim, tag, name) for name, (dim, tag) in named.items()]
    else:
        # Gmsh keeps the model of the first rank until the mesh is distributed
        with ExitStack() as session:
            model, description = None, None
            with errors_on_all_ranks(comm):
                if comm.rank == 0:
                    gmsh = session.enter_context(gmsh_session())
                    description = _meshed(comm, gmsh, path, size, unit, parameters)
                    model = gmsh.model
            groups, geometry = comm.bcast(description, root=0)
            mesh, cell_tags, facet_tags = compat.model_to_mesh(model, comm, 0)
    if geometry is not None and not geometry.curved:
        geometry = None
    cell_dim, facet_dim = cell_tags.dim, facet_tags.dim
    cell_names = {tag: name for dim, tag, name in groups if dim == cell_dim and name}
    facet_names = {tag: name for dim, tag, name in groups if dim == facet_dim and name}
    cells = NamedTags(cell_tags, cell_names)
    facets = NamedTags(facet_tags, facet_names, cells, geometry)
    tags = {name or str(tag): tag for dim, tag, name in groups if dim in (cell_dim, facet_dim)}
    return TaggedMesh(mesh, cells, facets, tags, geometry)


def _meshed(
    comm: MPI.Comm, gmsh: Any, path: Any, size: Any, unit: str, parameters: dict[str, float]
) -> tuple[list[tuple[int, int, str]], GmshGeometry | None]:
    """Make the user's file or model Gmsh's current model, with a mesh.

    Returns:
        dimension, tag and name of each group of cells or facets; and the geometry from which the
        mesh was made, None for a `.msh` file and for a model without shapes of OpenCASCADE.
    """
    is_file = isinstance(path, str | PathLike)
    if not is_file and not hasattr(path, "getPhysicalGroups"):
        raise InputError(
            "path must be the path of a file, gmsh.model, or the result of model_to_mesh, "
            f"found {shown(path)}."
        )
    source = Path(path) if is_file else Path("gmsh.model")
    suffix = source.suffix.lower()
    if suffix in (".geo", ".msh") and size is not None:  # refused below if the file has none
        parameters["size"] = size
    if is_file:
        open_file(gmsh, source, {}, unit=unit)
    if parameters:
        if suffix != ".geo":
            raise InputError(
                f"'{source}' takes no parameters, found {', '.join(parameters)}. Read the .geo "
                "file that it was made from instead."
            )
        # the open file tells which names it declares
        names = gmsh.parser.getNames()
        unknown = [name for name in parameters if name not in names]
        if unknown:  # Gmsh's list does not tell parameters from the file's own variables
            text = source.read_text(errors="replace")
            texts = " ".join(re.findall(r"DefineConstant\s*\[.*?\]\s*;", text, flags=re.S))
            declared = [name for name in names if re.search(rf"\b{re.escape(name)}\b", texts)]
            raise InputError(
                f"'{source}' has no parameter {', '.join(unknown)}; its parameters are "
                f"{', '.join(declared) or 'none: declare them with DefineConstant'}."
            )
        open_file(gmsh, source, parameters)
    if suffix in CAD_SUFFIXES:
        box = " x ".join(f"{length:.4g}" for length in np.ptp(_box(gmsh.model, -1, -1), axis=0))
        log(comm, "%s: the box of all bodies is %s %s", source.name, box, unit)
    _mesh(gmsh, source, size)
    groups = _physical_groups(gmsh.model, source)
    _check_facets(gmsh.model, source)
    # DOLFINx requires that the nodes of cells with tags are the first ones, without gaps
    cells = gmsh.model.getPhysicalGroups(gmsh.model.getDimension())
    of_groups = [gmsh.model.mesh.getNodesForPhysicalGroup(*group)[0] for group in cells]
    first_nodes = np.unique(np.concatenate(of_groups))
    nodes = np.concatenate([first_nodes, np.setdiff1d(gmsh.model.mesh.getNodes()[0], first_nodes)])
    gmsh.model.mesh.renumberNodes(nodes, np.arange(1, len(nodes) + 1))
    if suffix in (".geo", *CAD_SUFFIXES):
        return groups, GmshGeometry(source.resolve(), parameters, curved_groups(gmsh.model), unit)
    return groups, None if is_file else GmshGeometry.from_shapes(gmsh)


def _mesh(gmsh: Any, path: Path, size: Any) -> None:
    """Name the bodies and faces of a CAD model without groups, and mesh a model without mesh.

    A `.geo` file is meshed in any case. A MeshError is raised if Gmsh fails, or mixes cells.
    """
    model, suffix = gmsh.model, path.suffix.lower()
    is_cad = suffix in CAD_SUFFIXES
    dim = model.getDimension()
    if (is_cad or suffix == ".model") and not model.getPhysicalGroups():
        name_groups(model, str(path))
    sizes: dict[str, float] = {}  # options of Gmsh whose names begin with Mesh.MeshSize
    if suffix == ".geo" or not len(model.mesh.getElementTypes(dim)):
        if is_cad or (suffix == ".model" and size is not None):
            set_sizes(model, {} if size is None else size, str(path))
            sizes = {"FromCurvature": CELLS_PER_TURN, "FromPoints": 0, "ExtendFromBoundary": 0}
        try:
            with options(gmsh, {f"Mesh.MeshSize{name}": value for name, value in sizes.items()}):
                model.mesh.generate(dim)
        except Exception as error:  # gmsh raises nothing more specific
            raise MeshError(
                f"Gmsh cannot mesh '{path}': {error}. Faces of a body that overlap or cross each "
                "other, and gaps between faces, must be repaired in the program that made them."
            ) from error
    kinds = model.mesh.getElementTypes(dim)
    if len(kinds) > 1:
        names = [model.mesh.getElementProperties(kind)[0] for kind in kinds]
        raise MeshError(f"'{path}' mixes cells: {', '.join(names)}. Mesh it with one type of cell.")


def name_groups(model: Any, name: str) -> None:
    """Put each body, and each face of a body, of a model without groups into a group of its own.

    Names are the labels in the file; without labels, bodies are `body 1`, `body 2`, and faces of
    `pin` are `pin/1`, `pin/2`. In 2D bodies are surfaces. A MeshError, with the `name` of the
    model, is raised if faces belong to no body or to two.
    """
    dim, extent = model.getDimension(), np.ptp(_box(model, -1, -1), axis=0)
    if dim < 2 or (dim == 2 and extent[2] > 1e-5 * extent.max()):  # boxes of OpenCASCADE are loose
        raise MeshError(
            f"'{name}' has {len(model.getEntities(2))} faces and no solid: the faces do not close "
            "a body (an open shell). Close and sew them in the CAD program, and export solids."
        )
    names: set[str] = set()

    def add(entity: tuple[int, int], default: str) -> str:
        """Make a group of an entity, and return its name: the label made unique, or the default."""
        label = model.getEntityName(*entity).rpartition("/")[2]
        # STEP files of OpenCASCADE have this label for shapes without a name
        if not label or label.startswith("Open CASCADE STEP translator"):
            label = default
        same = sum(word == label or word.startswith(f"{label} (") for word in names)
        unique = f"{label} ({same + 1})" if same else label
        names.add(unique)
        model.addPhysicalGroup(entity[0], [entity[1]], entity[1], name=unique)
        return unique

    entities = [body for _, body in model.getEntities(dim)]
    bodies = {body: add((dim, body), f"body {k}") for k, body in enumerate(entities, start=1)}
    for body, body_name in bodies.items():
        faces = sorted(abs(face) for _, face in model.getBoundary([(dim, body)], oriented=False))
        for i, face in enumerate(faces, start=1):
            sharing = [bodies[number] for number in model.getAdjacencies(dim - 1, face)[0]]
            if len(sharing) > 1:
                raise MeshError(
                    f"bodies {' and '.join(sharing)} in '{name}' share a face, which makes them "
                    "one body: export them without merging them (in Gmsh without fragment)."
                )
            add((dim - 1, face), f"{body_name}/{i}")
    count = len(model.getEntities(dim - 1))
    free = count - len(model.getPhysicalGroups(dim - 1))
    if free:
        raise MeshError(
            f"{free} of the {count} faces in '{name}' belong to no body: they are an open shell. "
            "Close it in the CAD program, or remove the faces."
        )


def set_sizes(model: Any, size: float | Mapping[str, float], name: str) -> None:
    """Give each body its size of cells [length], and half of it near faces of other bodies.

    Bodies whose size is not given get a sixth of the root of their volume or area. The current
    model of Gmsh, with a name for error messages, has a group for each body.
    """
    dim = model.getDimension()
    bodies = {
        entity: model.getPhysicalName(dim, tag) or str(tag)
        for tag, entity in _grouped_entities(model, dim)
    }
    names = list(dict.fromkeys(bodies.values()))
    given = size if isinstance(size, Mapping) else dict.fromkeys(names, size)
    for body, value in given.items():
        if body not in names:
            raise InputError(
                f"size: '{name}' has no body {shown(body)}; its bodies are {', '.join(names)}."
            )
        checked_number("a size of cells", value)
    fields: list[int] = []

    def field(kind: str, **settings: float | list[int]) -> int:
        """Add a field, a size of cells or a distance at each point, and return its number."""
        tag, new = int(model.mesh.field.add(kind)), model.mesh.field
        for option, value in settings.items():
            set_value = new.setNumbers if isinstance(value, list) else new.setNumber
            set_value(tag, option, value)
        return tag

    # the options of fields that list bodies or faces, by their dimension
    list_of_dim = {3: "VolumesList", 2: "SurfacesList", 1: "CurvesList"}
    # number, body and box of each face
    faces = [
        (abs(face), entity, *_box(model, dim - 1, abs(face)))
        for entity in bodies
        for _, face in model.getBoundary([(dim, entity)], oriented=False)
    ]
    for entity, body in bodies.items():
        h = float(given.get(body, model.occ.getMass(dim, entity) ** (1.0 / dim) / 6.0))
        fields.append(field("Constant", VIn=h, **{list_of_dim[dim]: [entity]}))
        # faces of other bodies whose boxes are less than h away from the box of this body
        low, high = _box(model, dim, entity)
        near = [
            face
            for face, owner, least, largest in faces
            if owner != entity and (least <= high + h).all() and (largest >= low - h).all()
        ]
        if near:
            distance = field("Distance", Sampling=20, **{list_of_dim[dim - 1]: sorted(near)})
            limits = {"SizeMin": 0.5 * h, "SizeMax": h, "DistMin": 0.5 * h, "DistMax": 3.0 * h}
            growing = field("Threshold", InField=distance, **limits)
            fields.append(field("Restrict", InField=growing, **{list_of_dim[dim]: [entity]}))
    model.mesh.field.setAsBackgroundMesh(field("Min", FieldsList=fields))


def _box(model: Any, dim: int, entity: int) -> Array:
    """Return the least and the largest coordinates (2, 3) of an entity; -1, -1: of the model."""
    return np.reshape(model.getBoundingBox(dim, entity), (2, 3))


def _physical_groups(model: Any, path: Path) -> list[tuple[int, int, str]]:
    """Return dimension, tag and name, "" if it has none, of each group of facets or cells.

    A MeshError is raised without groups of facets or of cells, or if a name has two tags.
    """
    dim = model.getDimension()
    for group_dim, entities in ((dim, "cells"), (dim - 1, "facets")):
        if dim < 2 or not model.getPhysicalGroups(group_dim):
            raise MeshError(
                f"'{path}' has no physical group of {entities}: name all bodies and surfaces with "
                'Physical Volume("...") and Physical Surface("...") (in 2D Surface and Curve).'
            )
    groups = model.getPhysicalGroups(dim - 1) + model.getPhysicalGroups(dim)
    result = [(*group, model.getPhysicalName(*group)) for group in groups]
    tags: dict[str, int] = {}
    for _, tag, given in result:
        name = given or str(tag)
        if tags.setdefault(name, tag) != tag:
            raise MeshError(
                f"'{path}' uses the name {name} for two groups: {tags[name]} and {tag}."
            )
    return result


def _grouped_entities(model: Any, dim: int) -> list[tuple[int, int]]:
    """Return (tag of a group, number of an entity) for all entities in groups of dimension dim."""
    return [
        (tag, int(entity))
        for _, tag in model.getPhysicalGroups(dim)
        for entity in model.getEntitiesForPhysicalGroup(dim, tag)
    ]


def _check_facets(model: Any, path: Path) -> None:
    """Check that facets with tags are faces of cells with tags, and have one tag each.

    Without this check, DOLFINx would abort all ranks if a facet had nodes of no cell, such as a
    facet of a body that is in no physical group, and ignore other facets that are no cell's faces.
    """
    mesh, dim = model.mesh, model.getDimension()
    (cell,) = mesh.getElementTypes(dim)
    groups = _grouped_entities(model, dim - 1)
    bodies = _grouped_entities(model, dim)
    for kind in mesh.getElementTypes(dim - 1):
        # corner nodes (n, corners) and tags (n,) of facets, each with `count` nodes
        _, _, _, count, _, corners = mesh.getElementProperties(kind)
        elements = [mesh.getElementsByType(kind, entity)[1] for _, entity in groups]
        tags = np.repeat([tag for tag, _ in groups], [len(nodes) // count for nodes in elements])
        facets = np.concatenate(elements).reshape(-1, count)[:, :corners]
        # corner nodes (m, corners) of the faces of cells; those that may be facets are kept
        nodes_of_sides = partial(mesh.getElementFaceNodes, faceType=corners)
        nodes_of_faces = mesh.getElementEdgeNodes if dim == 2 else nodes_of_sides
        faces_of_bodies = [nodes_of_faces(cell, tag=body, primary=True) for _, body in bodies]
        faces = np.concatenate(faces_of_bodies).reshape(-1, corners)
        faces = faces[np.isin(faces, facets).all(axis=1)]
        # faces (m,) and facets (n,) have the same number if they have the same nodes in any order
        sets = np.sort(np.concatenate([faces, facets]), axis=1)
        number = np.unique(sets, axis=0, return_inverse=True)[1].ravel()
        face, facet = number[: len(faces)], number[len(faces) :]
        wrong = tags[~np.isin(facet, face)]
        if len(wrong):
            raise MeshError(
                f"{(wrong == wrong[0]).sum()} of the {(tags == wrong[0]).sum()} facets of group "
                f"{model.getPhysicalName(dim - 1, wrong[0]) or wrong[0]} in '{path}' are not faces "
                "of a cell: the volume is in no physical group, or its mesh is another one."
            )
        # rows are sorted by facet, so those of a facet with two tags follow each other
        table = np.unique(np.column_stack([facet, tags]), axis=0)
        twice = np.flatnonzero(table[1:, 0] == table[:-1, 0])
        if len(twice):
            both = table[twice[0] : twice[0] + 2, 1]
            names = [model.getPhysicalName(dim - 1, tag) or str(tag) for tag in both]
            raise MeshError(
                f"{len(twice)} facets in '{path}' are in two groups, {names[0]} and {names[1]}: "
                "a facet has one tag. If they lie between two bodies that share their nodes there, "
                "mesh the bodies without merging them (in Gmsh without fragment, Coherence and "
                "removeDuplicateNodes); else put the surface into one group."
            )
