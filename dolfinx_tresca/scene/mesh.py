"""Reading of meshes and CAD files with Gmsh: mesh, tags, and the names of the tags."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx
from dolfinx.mesh import MeshTags

from dolfinx_tresca._base import compat
from dolfinx_tresca._base.agreement import collective
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log
from dolfinx_tresca.errors import InputError, MeshError, shown
from dolfinx_tresca.scene.cad import CELLS_PER_TURN, name_groups, set_sizes
from dolfinx_tresca.scene.geometry import GmshGeometry
from dolfinx_tresca.scene.gmsh_files import CAD_SUFFIXES, gmsh_session, open_file, shapes_of

#: Number of tags of a list that the name of merged tags has in full. A name of twice as many tags
#: is wider than a table.
MOST_NAMES = 3

MESHES = Path(__file__).parents[1] / "meshes"  #: the folder of the demos' `.geo` files


class NamedTags(MeshTags):  # type: ignore[misc]
    """`dolfinx.mesh.MeshTags` with the names of the tags, for messages and tables.

    Attributes:
        names: tag -> name in the mesh file, for all tags that have a name.
        cell_tags: for tags of facets, the tags of the cells, with the names of the bodies; else
            None.
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


class MergedTags(NamedTags):
    """The tags of facets, in which all tags of a list are replaced by the first one.

    Attributes:
        given: the tags of the facets before they were merged.
        merged: first tag of each list -> the tags in the list.
    """

    def __init__(self, given: MeshTags, lists: Sequence[Sequence[int]]) -> None:
        self.given, self.merged = given, {tags[0]: tuple(tags) for tags in lists}
        names = dict(given.names) if isinstance(given, NamedTags) else {}
        tags = given
        for lowest_tag, merged in self.merged.items():
            words = [names.get(tag, f"tag {tag}") for tag in merged[:MOST_NAMES]]
            if len(merged) > MOST_NAMES:
                words.append(f"{len(merged) - MOST_NAMES} more")
            if len(merged) > 1:
                names[lowest_tag] = ", ".join(words)
            tags = compat.with_one_tag(tags, np.isin(given.values, merged), lowest_tag)
        of_given = (getattr(given, name, None) for name in ("cell_tags", "geometry"))
        super().__init__(tags, names, *of_given)


@dataclass(frozen=True)
class TaggedMesh:
    """A mesh with cell and facet tags.

    Attributes:
        mesh: the distributed `dolfinx.mesh.Mesh`.
        cell_tags: `MeshTags` of the cells, with the names of the tags.
        facet_tags: `MeshTags` of the facets, with the names of the tags.
        tags: name of each physical group in the file -> tag. The name of an unnamed group is its
            number, as a string.
        geometry: the geometry from which Gmsh made the mesh, for projection onto curved surfaces;
            None if it is unknown.
    """

    mesh: Any
    cell_tags: Any
    facet_tags: NamedTags
    tags: dict[str, int]
    geometry: GmshGeometry | None = None

    @property
    def outside(self) -> list[int]:
        """The tags of all outer facets, as a list for either side of a `ContactPair`. Collective.

        Raises:
            MeshError: outer facets have no tag.
        """
        topology, tags = self.mesh.topology, self.facet_tags
        topology.create_connectivity(tags.dim, tags.dim + 1)
        outer = dolfinx.mesh.exterior_facet_indices(topology)
        with_tag = np.isin(tags.indices, outer)
        untagged = self.mesh.comm.allreduce(int((~np.isin(outer, tags.indices)).sum()))
        if untagged:
            raise MeshError(
                f"{untagged} facets on the outside have no tag: put all surfaces of the bodies "
                "into physical groups."
            )
        of_ranks = self.mesh.comm.allgather(np.unique(tags.values[with_tag]).tolist())
        return sorted(set().union(*of_ranks))

    def __repr__(self) -> str:
        topology = self.mesh.topology
        cells = f"{topology.index_map(topology.dim).size_global} cells ({topology.cell_name()})"
        tags = ", ".join(f"{name} {tag}" for name, tag in self.tags.items())
        return f"<TaggedMesh: {cells}, tags: {textwrap.shorten(tags, 120, placeholder=' ...')}>"


def _comm_argument(given: Mapping[str, Any]) -> MPI.Comm | None:
    """Return the argument `comm` if it is a communicator, else None. Not collective."""
    comm = given.get("comm")
    return comm if isinstance(comm, MPI.Comm) and comm != MPI.COMM_NULL else None


@collective(_comm_argument, ignored=("path",))
def read_gmsh(
    path: Any,
    comm: MPI.Comm,
    *,
    size: Any = None,
    unit: Any = "mm",
    geometry: Any = None,
    **parameters: float,
) -> TaggedMesh:
    """Mesh a CAD file or a `.geo` file, or load a mesh, with the names of bodies and faces.

    Collective. The first rank runs Gmsh, then the mesh is distributed.

    Args:
        path: a file `.step`, `.stp`, `.brep`, `.iges`, `.igs`, `.geo` or `.msh`; or `gmsh.model` of
            the first rank's session; or the result of `dolfinx.io.gmsh.model_to_mesh`. Of `.geo`
            and `.msh` files all cells, and all facets with tags, are in physical groups. Of CAD
            files, and of a `gmsh.model` without groups, each body and each face has a tag, and its
            label in the file as name; without label `body 1`, and `body 1/2` for its second face.
        comm: communicator of the mesh.
        size: size of cells [length] of CAD files, and of a `gmsh.model` without mesh, or name of a
            body -> size of its cells; None: a sixth of the edge of a cube as large as the body
            (of a `gmsh.model`: its own sizes). At faces near another body cells are half as large,
            and curved faces have at least 24 cells round a turn. A `.geo` file has it as parameter.
        unit: unit of length of the mesh of a STEP or IGES file, which names its own unit: "mm",
            "m", "in" ...
        geometry: CAD file from which a mesh without geometry was made. `.geo` and CAD files, and
            the model of the present session of Gmsh, have it already.
        **parameters: values of names that a `.geo` file declares with `DefineConstant`.

    Returns:
        The mesh, its cell and facet tags, and the table name -> tag.

    Raises:
        InputError: the suffix or the unit is unknown; a parameter is unknown, is not a finite
            number, or is overwritten by the file; a file that is not `.geo` has parameters; facets
            do not lie on the faces of `geometry`; or an argument has a wrong type.
        MeshError: the file does not exist or has an error; it has no body, or faces of no body; two
            bodies share a face; or a file with groups has none of cells or none of facets.

    Example:
        >>> from mpi4py import MPI
        >>> from dolfinx_tresca import MESHES, read_gmsh
        >>> bricks = read_gmsh(MESHES / "two_bricks.geo", MPI.COMM_WORLD, N=2)
        >>> bricks.tags["upper_contact"]
        22
    """
    if not isinstance(comm, MPI.Comm) or comm == MPI.COMM_NULL:
        raise InputError(
            f"comm must be an MPI communicator, such as MPI.COMM_WORLD, found {shown(comm)}."
        )
    root = 0
    is_model = hasattr(path, "getPhysicalGroups")
    if isinstance(path, tuple) or (hasattr(path, "mesh") and not is_model):
        return _of_mesh_data(path, comm, geometry, unit)
    tags: dict[str, int] = {}
    names: dict[int, str] = {}
    cell_names: dict[int, str] = {}
    in_file: dict[int, int] = {}
    cad_geometry: GmshGeometry | None = None
    model: Any = None
    with ExitStack() as session:
        with errors_on_all_ranks(comm):
            is_file = isinstance(path, str | PathLike)
            if not is_file and not is_model and comm.rank == root:
                raise InputError(
                    "path must be the path of a file, gmsh.model, or the result of model_to_mesh, "
                    f"found {shown(path)}."
                )
            if comm.rank == root:
                gmsh = session.enter_context(gmsh_session())
                model = gmsh.model
                source = Path(path) if is_file else Path("gmsh.model")
                if source.suffix in (".geo", ".msh"):  # the latter takes none, which is said
                    parameters |= {} if size is None else {"size": size}
                if is_file:
                    open_file(gmsh, source, parameters, unit=unit)
                if source.suffix.lower() in CAD_SUFFIXES:
                    low, high = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
                    box = " x ".join(f"{length:.4g}" for length in high - low)
                    log(comm, "%s: the box of all bodies is %s %s", source.name, box, unit)
                _mesh(gmsh, source, size)
                tags, names, cell_names = _physical_groups(gmsh, source)
                _check_one_group_per_facet(gmsh, source, names)
                cell_nodes = _renumber_cell_nodes_first(gmsh)
                in_file, not_of_cells = _facet_counts(gmsh, cell_nodes)
                for tag, wrong in not_of_cells.items():
                    _check_facets_of_cells(source, names, tag, wrong, in_file[tag])
                if source.suffix.lower() in (".geo", *CAD_SUFFIXES):
                    cad_geometry = GmshGeometry.from_open_file(gmsh, source, parameters, unit)
                elif source.suffix == ".model" and (content := shapes_of(gmsh)):
                    cad_geometry = GmshGeometry(source, {}, {}, content=content)
        tags, names, cell_names, in_file, cad_geometry = comm.bcast(
            (tags, names, cell_names, in_file, cad_geometry), root=root
        )
        mesh, cell_tags, facet_tags = compat.model_to_mesh(model, comm, root)
    owned = mesh.topology.index_map(facet_tags.dim).size_local
    for tag, count in in_file.items():
        read_count = comm.allreduce(int((facet_tags.find(tag) < owned).sum()))
        _check_facets_of_cells(path, names, tag, count - read_count, count)
    cad_geometry = _geometry_of(mesh, facet_tags, names, geometry, cad_geometry, unit)
    cell_tags = NamedTags(cell_tags, cell_names)
    facet_tags = NamedTags(facet_tags, names, cell_tags, cad_geometry)
    return TaggedMesh(mesh, cell_tags, facet_tags, tags, cad_geometry)


def _of_mesh_data(data: Any, comm: MPI.Comm, geometry: str | Path | None, unit: str) -> TaggedMesh:
    """Return the result of `dolfinx.io.gmsh.model_to_mesh` with names and geometry. Collective.

    Raises:
        InputError: the data have no tags of cells or of facets, or see `_geometry_of`.
    """
    mesh, cell_tags, facet_tags = (
        data[:3] if isinstance(data, tuple) else (data.mesh, data.cell_tags, data.facet_tags)
    )
    if not isinstance(cell_tags, MeshTags) or not isinstance(facet_tags, MeshTags):
        raise InputError(
            "the result of model_to_mesh must have tags of cells and of facets: put the bodies and "
            "their surfaces into physical groups."
        )
    names: dict[int, dict[int, str]] = {0: {}, 1: {}}
    tags: dict[str, int] = {}
    for name, group in (getattr(data, "physical_groups", None) or {}).items():
        dim, tag = (int(group.dim), int(group.tag)) if hasattr(group, "dim") else map(int, group)
        below = mesh.topology.dim - dim
        if below in names:
            names[below][tag], tags[name] = name, tag
    with errors_on_all_ranks(comm):
        gmsh = sys.modules.get("gmsh")
        content = shapes_of(gmsh) if gmsh is not None and gmsh.isInitialized() else None
    content = comm.bcast(content, root=0)
    cad_geometry = GmshGeometry(Path("gmsh.model"), {}, {}, content=content) if content else None
    cad_geometry = _geometry_of(mesh, facet_tags, names[1], geometry, cad_geometry, unit)
    cells = NamedTags(cell_tags, names[0])
    facets = NamedTags(facet_tags, names[1], cells, cad_geometry)
    return TaggedMesh(mesh, cells, facets, tags, cad_geometry)


def _geometry_of(
    mesh: Any,
    facet_tags: MeshTags,
    names: Mapping[int, str],
    file: str | Path | None,
    cad_geometry: GmshGeometry | None,
    unit: str,
) -> GmshGeometry | None:
    """Return the geometry of the mesh: from the user's CAD file, or as far as known. Collective.

    Raises:
        InputError: facets do not lie on the faces of the user's file.
        MeshError: there is no such file, or Gmsh cannot read it.
    """
    if file is not None:
        cad_geometry = GmshGeometry(Path(file).resolve(), {}, {}, unit)
    if cad_geometry is None:
        log(mesh.comm, "the mesh has no geometry: for exact curved surfaces give geometry=")
    if cad_geometry is None or (file is None and cad_geometry.content is None):
        return cad_geometry
    cad_geometry, off = cad_geometry.matched(mesh, facet_tags)
    if off and file is not None:
        tag, distance = max(off.items(), key=lambda item: item[1])
        raise InputError(
            f"facets of {len(off)} surfaces do not lie on faces of '{file}'; those of "
            f"{_group_name(names, tag)} are up to {distance:.3g} away from them. Give the CAD file "
            f"from which the mesh was made, and its unit of length in the mesh (unit is {unit})."
        )
    return cad_geometry


def _mesh(gmsh: Any, path: Path, size: Any) -> None:
    """Name the bodies and faces of a CAD model without groups; mesh a model without mesh.

    Raises:
        InputError: see `set_sizes`.
        MeshError: Gmsh cannot mesh the model, or cells are of several types; see `name_groups`.
    """
    model, suffix = gmsh.model, path.suffix.lower()
    is_cad = suffix in CAD_SUFFIXES
    dim = model.getDimension()
    if (is_cad or suffix == ".model") and not model.getPhysicalGroups():
        name_groups(model, str(path))
    options = {
        "MeshSizeFromCurvature": CELLS_PER_TURN,
        "MeshSizeFromPoints": 0,
        "MeshSizeExtendFromBoundary": 0,
    }
    before = {name: gmsh.option.getNumber(f"Mesh.{name}") for name in options}
    try:
        if suffix == ".geo" or not len(model.mesh.getElementTypes(dim)):
            if is_cad or (suffix == ".model" and size is not None):
                set_sizes(model, size, str(path))
                for name, value in options.items():
                    gmsh.option.setNumber(f"Mesh.{name}", value)
            model.mesh.generate(dim)
        kinds = model.mesh.getElementTypes(dim)
    except (InputError, MeshError):
        raise
    except Exception as error:  # gmsh raises nothing more specific
        hint = ""
        if is_cad:
            hint = (
                ". Faces of a body that overlap or cross each other, and gaps between faces, "
                "cannot be meshed: repair them in the CAD program."
            )
        raise MeshError(f"Gmsh cannot use '{path}': {error}{hint}") from error
    finally:
        for name, value in before.items():
            gmsh.option.setNumber(f"Mesh.{name}", value)
    if len(kinds) > 1:
        names = [model.mesh.getElementProperties(kind)[0] for kind in kinds]
        raise MeshError(f"'{path}' mixes cells: {', '.join(names)}. Mesh it with one type of cell.")


def _physical_groups(
    gmsh: Any, path: Path
) -> tuple[dict[str, int], dict[int, str], dict[int, str]]:
    """Return name -> tag of all groups, and tag -> name of named groups of facets and of cells.

    Raises:
        MeshError: the model has no group of cells or of facets, or two groups have the same name.
    """
    dim = gmsh.model.getDimension()
    groups = [group for group in gmsh.model.getPhysicalGroups() if group[0] >= dim - 1]
    for group_dim, entities in ((dim, "cells"), (dim - 1, "facets")):
        if dim < 2 or not any(group[0] == group_dim for group in groups):
            raise MeshError(
                f"'{path}' has no physical group of {entities}: name all bodies and surfaces with "
                'Physical Volume("...") and Physical Surface("...") (in 2D Surface and Curve).'
            )
    tags: dict[str, int] = {}
    names: dict[int, dict[int, str]] = {dim - 1: {}, dim: {}}
    for group_dim, tag in groups:
        given = gmsh.model.getPhysicalName(group_dim, tag)
        if given:
            names[group_dim][tag] = given
        name = given or str(tag)
        if tags.setdefault(name, tag) != tag:
            raise MeshError(
                f"'{path}' uses the name {name} for two groups: {tags[name]} and {tag}."
            )
    return tags, names[dim - 1], names[dim]


def _elements(gmsh: Any, dim: int, group: int) -> Iterator[tuple[int, npt.NDArray[np.uint64]]]:
    """Yield the number of elements, and their nodes in a flat array, of each entity of a group."""
    for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group):
        for numbers, nodes in zip(*gmsh.model.mesh.getElements(dim, entity)[1:], strict=True):
            yield len(numbers), nodes


def _renumber_cell_nodes_first(gmsh: Any) -> int:
    """Number the nodes of cells in physical groups first; return the number of these nodes.

    DOLFINx requires numbers without gaps, and aborts all ranks if the number of a node of a tagged
    facet exceeds the number of nodes of cells. Tagged facets of a body that is in no physical group
    have such nodes.
    """
    mesh, dim = gmsh.model.mesh, gmsh.model.getDimension()
    groups = gmsh.model.getPhysicalGroups(dim)
    nodes = [nodes for group in groups for _, nodes in _elements(gmsh, *group)]
    cell_nodes = np.unique(np.concatenate([np.zeros(0, dtype=np.uint64), *nodes]))
    further_nodes = np.setdiff1d(mesh.getNodes()[0], cell_nodes)
    before = np.concatenate([cell_nodes, further_nodes])
    wanted = np.arange(1, len(before) + 1)
    if not np.array_equal(before, wanted):
        mesh.renumberNodes(before, wanted)
    return len(cell_nodes)


def _facet_counts(gmsh: Any, cell_nodes: int) -> tuple[dict[int, int], dict[int, int]]:
    """Count the facets of each physical group, and the facets in it that belong to no cell.

    Args:
        gmsh: the module, in a session.
        cell_nodes: result of `_renumber_cell_nodes_first`: nodes with larger numbers belong to no
            cell.

    Returns:
        tag -> number of facets, and tag -> number of facets with a node that no cell has.
    """
    dim = gmsh.model.getDimension() - 1
    counts: dict[int, int] = {}
    not_of_cells: dict[int, int] = {}
    for _, tag in gmsh.model.getPhysicalGroups(dim):
        counts[tag] = not_of_cells[tag] = 0
        for count, nodes in _elements(gmsh, dim, tag):
            counts[tag] += count
            not_of_cells[tag] += int((nodes.reshape(count, -1) > cell_nodes).any(axis=1).sum())
    return counts, not_of_cells


def _check_one_group_per_facet(gmsh: Any, path: Path, names: Mapping[int, str]) -> None:
    """Check that each facet is in one physical group only.

    Raises:
        MeshError: facets are in two groups, for example because two bodies share their nodes.
    """
    dim = gmsh.model.getDimension() - 1
    rows = [
        np.insert(np.sort(nodes.reshape(count, -1), axis=1), 0, tag, axis=1)
        for _, tag in gmsh.model.getPhysicalGroups(dim)
        for count, nodes in _elements(gmsh, dim, tag)
    ]
    for columns in {facets.shape[1] for facets in rows}:
        facets = np.unique(np.vstack([row for row in rows if row.shape[1] == columns]), axis=0)
        facets = facets[np.lexsort(facets[:, ::-1].T[:-1])]  # sorted by nodes, then by tag
        twice = np.flatnonzero((facets[1:, 1:] == facets[:-1, 1:]).all(axis=1))
        if not len(twice):
            continue
        groups = [_group_name(names, int(facets[twice[0] + i, 0])) for i in (0, 1)]
        start = f"{len(twice)} facets in '{path}' are in two groups, {groups[0]} and {groups[1]}: "
        cells = [
            nodes.reshape(count, -1)
            for _, group in gmsh.model.getPhysicalGroups(dim + 1)
            for count, nodes in _elements(gmsh, dim + 1, group)
        ]
        corners = facets[twice[0], 1:]
        if sum((np.isin(nodes, corners).sum(axis=1) == len(corners)).sum() for nodes in cells) > 1:
            raise MeshError(
                start + "they lie between two bodies that share their nodes there, which makes "
                "them one body. Contact needs two surfaces with nodes of their own: mesh the "
                "bodies without merging them (in Gmsh without fragment, Coherence and "
                "removeDuplicateNodes where they touch), and put the face of each body into a "
                "group of its own."
            )
        raise MeshError(start + "a facet has one tag. Put each surface into one group.")


def _group_name(names: Mapping[int, str], tag: int) -> str:
    """Return the name of a group of facets, or its tag if it has no name."""
    return names.get(tag, str(tag))


def _check_facets_of_cells(
    path: str | Path, names: Mapping[int, str], tag: int, wrong: int, count: int
) -> None:
    """Check that all facets of a group are faces of cells.

    Raises:
        MeshError: `wrong` of the `count` facets of the group are not faces of a cell.
    """
    if wrong > 0:
        raise MeshError(
            f"{wrong} of the {count} facets of group {_group_name(names, tag)} in '{path}' are not "
            "faces of a cell: the meshes of the surface and of the volume do not fit together, or "
            "no volume of that body is in a physical group."
        )
