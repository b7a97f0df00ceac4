"""Reading of meshes and CAD files with Gmsh: mesh, tags, and the names of the tags."""

from __future__ import annotations

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

from dolfinx.mesh import MeshTags

from dolfinx_tresca._base import compat
from dolfinx_tresca._base.agreement import collective
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log
from dolfinx_tresca.errors import InputError, MeshError, shown
from dolfinx_tresca.scene.geometry import Geometry, GmshGeometry
from dolfinx_tresca.scene.gmsh_files import (
    CAD_SUFFIXES,
    CELLS_PER_TURN,
    gmsh_session,
    name_groups,
    open_file,
    options,
    set_sizes,
)

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


def abridged_names(tags: Sequence[int], facet_tags: MeshTags) -> str:
    """Return the names of a list of tags; of a long list the first names. Not collective."""
    names = facet_tags.names if isinstance(facet_tags, NamedTags) else {}
    words = [names.get(tag, f"tag {tag}") for tag in tags[:3]]
    if len(tags) > len(words):
        words.append(f"{len(tags) - len(words)} more")
    return ", ".join(words)


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
            if len(merged) > 1:
                names[lowest_tag] = abridged_names(merged, given)
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
    **parameters: float,
) -> TaggedMesh:
    """Mesh a CAD file or a `.geo` file, or load a mesh, with the names of bodies and faces.

    Collective. The first rank runs Gmsh, then the mesh is distributed.

    Args:
        path: a file `.step`, `.stp`, `.brep`, `.iges`, `.igs`, `.geo` or `.msh`; or `gmsh.model` of
            the first rank's session, whose curved surfaces are then known, as those of `.geo` and
            CAD files; or the result of `dolfinx.io.gmsh.model_to_mesh`. Of `.geo`
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
        **parameters: values of names that a `.geo` file declares with `DefineConstant`.

    Returns:
        The mesh, its cell and facet tags, and the table name -> tag.

    Raises:
        InputError: the suffix or the unit is unknown; a parameter is unknown, is not a finite
            number, or is overwritten by the file; a file that is not `.geo` has parameters; or an
            argument has a wrong type.
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
    if isinstance(path, tuple):
        return _of_mesh_data(path)
    with ExitStack() as session:
        model, content = None, None
        with errors_on_all_ranks(comm):
            if comm.rank == 0:
                gmsh = session.enter_context(gmsh_session())
                model, content = gmsh.model, _meshed(comm, gmsh, path, size, unit, parameters)
        tags, names, cell_names, in_file, geometry = comm.bcast(content, root=0)
        mesh, cell_tags, facet_tags = compat.model_to_mesh(model, comm, 0)
    owned = mesh.topology.index_map(facet_tags.dim).size_local
    for tag, count in in_file.items():
        read_count = comm.allreduce(int((facet_tags.find(tag) < owned).sum()))
        _check_facets_of_cells(path, names, tag, count - read_count, count)
    if geometry is None:
        log(comm, "curved surfaces are not known: gaps follow from the nodes and their normals")
    elif not geometry.curved:
        geometry = None
    cells = NamedTags(cell_tags, cell_names)
    return TaggedMesh(mesh, cells, NamedTags(facet_tags, names, cells, geometry), tags, geometry)


def _meshed(
    comm: MPI.Comm, gmsh: Any, path: Any, size: Any, unit: str, parameters: dict[str, float]
) -> tuple[dict[str, int], dict[int, str], dict[int, str], dict[int, int], Any]:
    """Open and mesh the user's file or model in Gmsh; see `read_gmsh`. Not collective.

    Returns:
        name -> tag; tag -> name of facets, and of cells; tag -> number of facets; the geometry.
    """
    is_file = isinstance(path, str | PathLike)
    if not is_file and not hasattr(path, "getPhysicalGroups"):
        raise InputError(
            "path must be the path of a file, gmsh.model, or the result of model_to_mesh, "
            f"found {shown(path)}."
        )
    source = Path(path) if is_file else Path("gmsh.model")
    suffix = source.suffix.lower()
    if suffix in (".geo", ".msh") and size is not None:  # the latter takes none, which is said
        parameters["size"] = size
    if is_file:
        open_file(gmsh, source, parameters, unit=unit)
    if suffix in CAD_SUFFIXES:
        low, high = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
        box = " x ".join(f"{length:.4g}" for length in high - low)
        log(comm, "%s: the box of all bodies is %s %s", source.name, box, unit)
    _mesh(gmsh, source, size)
    tags, names, cell_names = _physical_groups(gmsh, source)
    in_file = _checked_facets(gmsh, source, names)
    geometry: GmshGeometry | None = None
    if suffix in (".geo", *CAD_SUFFIXES):
        geometry = GmshGeometry.from_open_file(gmsh, source, parameters, unit)
    elif not is_file:
        geometry = GmshGeometry.from_shapes(gmsh)
    return tags, names, cell_names, in_file, geometry


def _of_mesh_data(data: Any) -> TaggedMesh:
    """Return the result of `dolfinx.io.gmsh.model_to_mesh` with the names of its tags.

    Raises:
        InputError: the data have no tags of cells or of facets.
    """
    mesh, cell_tags, facet_tags = data[:3]
    if not isinstance(cell_tags, MeshTags) or not isinstance(facet_tags, MeshTags):
        raise InputError(
            "the result of model_to_mesh must have tags of cells and of facets: put the bodies and "
            "their surfaces into physical groups."
        )
    tags: dict[str, int] = {}
    names: dict[int, dict[int, str]] = {cell_tags.dim: {}, facet_tags.dim: {}}
    for name, (dim, tag) in getattr(data, "physical_groups", {}).items():
        if dim in names:
            names[dim][tag], tags[name] = name, tag
    cells = NamedTags(cell_tags, names[cell_tags.dim])
    return TaggedMesh(mesh, cells, NamedTags(facet_tags, names[facet_tags.dim], cells), tags)


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
    sizes = {"FromCurvature": CELLS_PER_TURN, "FromPoints": 0, "ExtendFromBoundary": 0}
    set_here = is_cad or (suffix == ".model" and size is not None)
    try:
        if suffix == ".geo" or not len(model.mesh.getElementTypes(dim)):
            if set_here:
                set_sizes(model, size, str(path))
            with options(gmsh, {f"Mesh.MeshSize{k}": sizes[k] for k in sizes if set_here}):
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


def _elements(gmsh: Any, dim: int) -> Iterator[tuple[int, npt.NDArray[np.uint64]]]:
    """Yield the tag of each group, and the nodes (n, k) of elements of one type in it."""
    for _, group in gmsh.model.getPhysicalGroups(dim):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group):
            for numbers, nodes in zip(*gmsh.model.mesh.getElements(dim, entity)[1:], strict=True):
                yield group, nodes.reshape(len(numbers), -1)


def _checked_facets(gmsh: Any, path: Path, names: Mapping[int, str]) -> dict[int, int]:
    """Check facets, number the nodes of cells first, and return tag -> number of its facets.

    DOLFINx requires numbers without gaps, and aborts all ranks if the number of a node of a tagged
    facet exceeds the number of nodes of cells. Tagged facets of a body that is in no physical group
    have such nodes.

    Raises:
        MeshError: facets have nodes that no cell in a group has, or are in two groups, for example
            because two bodies share their nodes.
    """
    mesh, dim = gmsh.model.mesh, gmsh.model.getDimension()
    facets = list(_elements(gmsh, dim - 1))
    cell_nodes = np.unique(np.concatenate([nodes.ravel() for _, nodes in _elements(gmsh, dim)]))
    counts: dict[int, int] = {}
    wrong: dict[int, int] = {}
    for tag, nodes in facets:
        counts[tag] = counts.get(tag, 0) + len(nodes)
        wrong[tag] = wrong.get(tag, 0) + int((~np.isin(nodes, cell_nodes)).any(axis=1).sum())
    for tag, count in counts.items():
        _check_facets_of_cells(path, names, tag, wrong[tag], count)
    for columns in {nodes.shape[1] for _, nodes in facets}:
        alike = [(tag, nodes) for tag, nodes in facets if nodes.shape[1] == columns]
        rows = [np.insert(np.sort(nodes, axis=1), 0, tag, axis=1) for tag, nodes in alike]
        table = np.unique(np.vstack(rows), axis=0)
        table = table[np.lexsort(table[:, ::-1].T[:-1])]  # sorted by nodes, then by tag
        twice = np.flatnonzero((table[1:, 1:] == table[:-1, 1:]).all(axis=1))
        if len(twice):
            groups = [names.get(int(tag), str(tag)) for tag in table[twice[0] : twice[0] + 2, 0]]
            raise MeshError(
                f"{len(twice)} facets in '{path}' are in two groups, {groups[0]} and {groups[1]}: "
                "a facet has one tag. Put each surface into one group. If they lie between two "
                "bodies that share their nodes there, these are one body. Contact needs two "
                "surfaces with nodes of their own: mesh the bodies without merging them (in Gmsh "
                "without fragment, Coherence and removeDuplicateNodes where they touch), and put "
                "the face of each body into a group of its own."
            )
    before = np.concatenate([cell_nodes, np.setdiff1d(mesh.getNodes()[0], cell_nodes)])
    wanted = np.arange(1, len(before) + 1)
    if not np.array_equal(before, wanted):
        mesh.renumberNodes(before, wanted)
    return counts


def _check_facets_of_cells(
    path: str | Path, names: Mapping[int, str], tag: int, wrong: int, count: int
) -> None:
    """Check that all facets of a group are faces of cells.

    Raises:
        MeshError: `wrong` of the `count` facets of the group are not faces of a cell.
    """
    if wrong > 0:
        raise MeshError(
            f"{wrong} of the {count} facets of group {names.get(tag, tag)} in '{path}' are not "
            "faces of a cell: the meshes of the surface and of the volume do not fit together, or "
            "no volume of that body is in a physical group."
        )
