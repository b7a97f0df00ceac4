"""Refinement of meshes in the cells with the largest errors, and on curved surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

import dolfinx
import dolfinx.io
import ufl
from dolfinx import fem

from dolfinx_tresca._base import compat
from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.arguments import check_type, checked_number
from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, LocalNumbers, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array, summed_at_nodes, warn
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.geometry import (
    ExactSurface,
    check_geometry,
    open_geometry,
    project_points,
)
from dolfinx_tresca.scene.mesh import NamedTags, TaggedMesh

#: Least squared error that a marked cell may have, divided by the least that Doerfler's marking
#: needs. The limit is in the widest gap between errors of this range, so that rounding, and what
#: iterative solvers leave, hardly change the marked cells: symmetric scenes get symmetric meshes,
#: which do not depend on the number of ranks. A smaller number widens the gap and marks more cells.
NEARLY = 0.8


@collective(comm_of("tagged_mesh", "cell_errors"), ignored=("cell_errors",))
def refine(
    tagged_mesh: TaggedMesh, cell_errors: fem.Function | Array, fraction: float = 0.5
) -> TaggedMesh:
    """Return a mesh with smaller cells where errors are large, and the same tags. Collective.

    In the cells with the largest errors all edges are bisected, and further edges as needed to
    leave no hanging nodes. (With the longest edges of tetrahedra alone, two bricks of degree 2 take
    1.4 to 1.9 times as long, and with degree 1 two thirds of the time.) New cells and facets have
    the tags of those that contain them. The new mesh is partitioned anew, with ghost cells if the
    old mesh has some; the old mesh stays as it is. Only numberings depend on the number of ranks.

    Nodes of facets whose tag is in `tagged_mesh.geometry` move to the nearest points of its curved
    surface; with `read_gmsh`, Gmsh opens its file again on each rank, and finds these points. New
    nodes on other facets stay on the old flat facets. To give other curved surfaces::

        surfaces = {tagged_mesh.tags["ball"]: on_ball}  # function from points (3, n) to (3, n)
        tagged_mesh = dataclasses.replace(tagged_mesh, geometry=surfaces)

    Args:
        tagged_mesh: mesh of triangles or tetrahedra with straight edges; `cell_tags` may be None.
        cell_errors: error of each cell [energy^(1/2), or any other unit]: the function
            `ContactSolution.cell_errors`, better after `refinement_indicators`; or the values (n,)
            of the cells that this rank owns.
        fraction: part of the sum of squared errors, in (0, 1]: the fewest cells that have this part
            together are refined, with 1 all cells whose error is not zero or rounding.

    Raises:
        InputError: an argument is wrong, the mesh has cells that cannot be bisected, or the
            geometry does not fit the mesh.
        MeshError: the file of the geometry does not exist any more, or Gmsh cannot read it.
    """
    check_tagged_mesh(tagged_mesh)
    fraction = checked_number("fraction", fraction, "(0, 1]")
    mesh, comm = tagged_mesh.mesh, tagged_mesh.mesh.comm
    with errors_on_all_ranks(comm):
        errors = checked_cell_errors(mesh, cell_errors)
    largest = float(reduce_array(comm, errors.max(initial=0.0), MPI.MAX))
    if largest == 0.0:
        raise InputError("cell_errors are all zero: there is nothing to refine.")
    # new cells on the ranks of the old ones, and their nodes on curved surfaces
    marked = cells_to_refine(comm, np.square(errors / largest), fraction)
    bisection = bisected(mesh, marked)
    facets, facet_values = bisection.inherited(tagged_mesh.facet_tags)
    with ExitStack() as session:
        with errors_on_all_ranks(comm):
            surfaces = session.enter_context(open_geometry(tagged_mesh.geometry or {}))
        points = snapped(bisection, facets, facet_values, surfaces)

    # the same cells and tags, distributed over the ranks anew
    dim, index_map = mesh.topology.dim, bisection.mesh.geometry.index_map()
    numbers = np.asarray(index_map.local_to_global(np.arange(len(points), dtype=np.int32)))
    fine = compat.create_mesh(
        comm,
        numbers[bisection.nodes],
        points[: index_map.size_local, :dim],
        ufl.Mesh(mesh.ufl_domain().ufl_coordinate_element()),
        ghosts=comm.allreduce(mesh.topology.index_map(dim).num_ghosts, op=MPI.MAX) > 0,
    )
    cell_tags = tagged_mesh.cell_tags
    if cell_tags is not None:
        cells, cell_values = bisection.inherited(cell_tags)
        cell_tags = _distributed_tags(fine, cell_tags, numbers[cells], cell_values)
    facet_tags = _distributed_tags(fine, tagged_mesh.facet_tags, numbers[facets], facet_values)
    if isinstance(facet_tags, NamedTags) and isinstance(cell_tags, NamedTags):
        facet_tags.cell_tags = cell_tags
    return TaggedMesh(fine, cell_tags, facet_tags, dict(tagged_mesh.tags), tagged_mesh.geometry)


class Bisection(NamedTuple):
    """The n new cells on this rank, into which bisection cuts its cells; they carry tags over.

    Cells have the dimension d. Facet i of a cell is opposite to its corner i.

    Attributes:
        mesh: the mesh of the new cells.
        nodes: (n, d + 1) nodes of `mesh` at the corners of each new cell.
        parent: (n, 1) the cell of the old mesh that contains each new cell.
        parent_facets: (n, d + 1) the facet of the old mesh in which each facet of the new cell
            lies; -1: the facet is inside of an old cell.
    """

    mesh: Any
    nodes: Indices
    parent: LocalNumbers
    parent_facets: LocalNumbers

    def inherited(self, tags: Any) -> tuple[Indices, LocalNumbers]:
        """Return corners (m, k) and tags (m,) of all new cells, or facets, in tagged old ones.

        `tags` are MeshTags of the old mesh. A facet between two cells occurs twice.
        """
        # (sides, d + 1): a cell itself has all corners, its facet i has all but corner i
        corners: Mask
        if tags.dim == self.mesh.topology.dim:
            entities, corners = self.parent, np.ones((1, self.nodes.shape[1]), dtype=np.bool_)
        else:
            entities, corners = self.parent_facets, ~np.eye(self.nodes.shape[1], dtype=np.bool_)
        index_map = tags.topology.index_map(tags.dim)
        row = np.full(index_map.size_local + index_map.num_ghosts + 1, -1)  # the last one: no facet
        row[tags.indices] = np.arange(len(tags.indices))
        cell, side = np.nonzero(row[entities] >= 0)
        values = tags.values[row[entities[cell, side]]]
        return self.nodes[cell][corners[side]].reshape(-1, corners[0].sum()), values


def bisected(mesh: Any, marked: Mask) -> Bisection:
    """Bisect all edges of marked cells (owned cells,), and further edges as needed. Collective.

    DOLFINx uses the method of Plaza and Carey (2000, Local refinement of simplicial grids based on
    the skeleton): angles stay away from zero after any number of bisections. Among longest edges of
    equal length, it cuts the first in the numbering of a rank, which depends on the partition. So
    the mesh is stretched a little while it is cut, which makes lengths differ on any partition.
    """
    dim = mesh.topology.dim
    mesh.topology.create_entities(1)
    mesh.topology.create_connectivity(dim, 1)
    mesh.topology.create_connectivity(1, dim)
    mesh.topology.create_connectivity(dim, dim - 1)
    cells = np.flatnonzero(marked).astype(np.int32)
    option = dolfinx.mesh.RefinementOption.parent_cell_and_facet
    # close to the identity; afterwards only parallel edges of a cell are equally long
    stretch = np.eye(3) + 1e-6 * np.triu(np.exp(np.arange(9.0).reshape(3, 3) / np.pi))
    x, stretch = mesh.geometry.x, stretch[:dim, :dim]
    before = x.copy()
    try:
        x[:, :dim] = x[:, :dim] @ stretch
        edges = dolfinx.mesh.compute_incident_entities(mesh.topology, cells, dim, 1)
        fine, parent, parent_facet = dolfinx.mesh.refine(mesh, edges, None, option)
    finally:
        x[:] = before
    fine.geometry.x[:, :dim] = np.linalg.solve(stretch.T, fine.geometry.x[:, :dim].T).T
    # `parent` and `parent_facet` have the order of new cells before DOLFINx renumbered them
    count = len(parent)
    order = np.asarray(fine.topology.original_cell_index)[:count]
    order = order - sum(mesh.comm.allgather(count)[: mesh.comm.rank])
    parent, sides = parent[order, None], np.reshape(parent_facet, (count, dim + 1))[order]
    facets = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)
    parent_facets = np.where(sides >= 0, facets[parent, sides], -1)
    nodes = compat.geometry_dofmap(fine)[:count].astype(np.intp)
    return Bisection(fine, nodes, parent, parent_facets)


def snapped(
    bisection: Bisection, facets: Indices, tags: LocalNumbers, surfaces: Mapping[int, ExactSurface]
) -> Array:
    """Return points (nodes, 3) of the new mesh, on curved surfaces as far as possible. Collective.

    Nodes of `facets` (m, d) move to the surface in `surfaces` of their tag in `tags` (m,), those of
    several surfaces to each in turn. Nodes of cells that would become flat or inverted do not move;
    a warning has their number, and the next refinement, with smaller cells, tries again.
    """
    mesh, cells, start = bisection.mesh, bisection.nodes, bisection.mesh.geometry.x
    projected = start.copy()
    comm, dim, index_map = mesh.comm, mesh.topology.dim, mesh.geometry.index_map()
    for tag, exact in surfaces.items():
        nodes = np.unique(facets[tags == tag])
        if reduce_array(comm, len(nodes)) == 0:
            raise InputError(f"the geometry has facets that there are not: none has the tag {tag}.")
        with errors_on_all_ranks(comm):
            target = project_points(projected[nodes], f"geometry[{tag}]", exact.project, dim)
        # a mean, since another rank may know of a node, but of none of its facets
        sums = summed_at_nodes(index_map, nodes, np.column_stack([target, np.ones(len(nodes))]))
        ranks = sums[:, 3:]  # (nodes, 1) the number of ranks that give the point of the node
        projected = np.where(ranks > 0.0, sums[:, :3] / np.maximum(ranks, 1.0), projected)

    def volumes(points: Array) -> Array:
        sides = points[cells[:, 1:]] - points[cells[:, :1]]
        return np.asarray(np.linalg.det(sides[:, :, :dim]))

    # hold corners of cells that lose 0.9 of their volume, which may flatten others, until none does
    held: Mask = np.zeros(len(start), dtype=np.bool_)
    points, before = projected, volumes(start)
    while True:
        is_flat = np.sign(before) * volumes(points) < 0.1 * np.abs(before)
        flat = cells[is_flat]
        corners = summed_at_nodes(index_map, flat, np.ones((*flat.shape, 1)))[:, 0] > 0.0
        if reduce_array(comm, (corners & ~held).sum()) == 0:
            break
        held |= corners
        points = np.where(held[:, None], start, projected)
    not_moved = held & (projected != start).any(axis=1)
    count = int(reduce_array(comm, not_moved[: index_map.size_local].sum()))
    if count:
        warn(
            comm,
            "%d nodes were not moved to their curved surface, where cells would have become flat "
            "or turned inside out; a finer mesh to begin with helps there",
            count,
        )
    return np.asarray(points)


def cells_to_refine(comm: MPI.Comm, squares: Array, fraction: float) -> Mask:
    """Mark the fewest cells whose squared errors sum up to the part `fraction` of all. Collective.

    This is the marking of Doerfler (1996, A convergent adaptive algorithm for Poisson's equation),
    but cells whose errors nearly equal the least marked error are marked, too (`NEARLY`). `squares`
    and the result (n,) are of the rank's own cells. Every rank gathers all, 8 bytes for each cell.
    """
    above = 1.0 + 1e-9  # factor that takes a squared error or sum beyond its rounding
    descending = np.sort(np.concatenate(comm.allgather(squares)))[::-1]
    sums = np.cumsum(descending)
    least = descending[np.argmax(sums * above >= fraction * sums[-1])]
    # the cut is in the widest gap between errors that nearly equal the least marked one
    near = descending[(descending >= NEARLY * least) & (descending <= least * above)][::-1]
    below = np.append(NEARLY * least, near[:-1])
    gap = np.argmax(near / below)
    return np.asarray(squares > np.sqrt(below[gap]) * np.sqrt(near[gap]))  # the gap's middle


def check_tagged_mesh(tagged_mesh: Any) -> None:
    """Check that cells can be bisected, that tags belong to cells and facets, and the geometry."""
    example = "read_gmsh(...) or TaggedMesh(mesh, cell_tags, facet_tags, names)"
    check_type("tagged_mesh", tagged_mesh, TaggedMesh, f"a TaggedMesh, such as {example}")
    mesh = tagged_mesh.mesh
    dim, kind = mesh.topology.dim, mesh.topology.cell_name()
    if kind not in ("triangle", "tetrahedron") or mesh.geometry.dim != dim:
        raise InputError(
            f"only meshes of triangles in the plane and of tetrahedra in space can be refined "
            f"locally, found cells of type {kind} in {mesh.geometry.dim}D: in Gmsh, leave out "
            "Recombine."
        )
    nodes = compat.geometry_dofmap(mesh).shape[1]
    if nodes != dim + 1:
        raise InputError(
            f"cells must have straight edges, found {nodes} nodes in each. Mesh with elements of "
            "order 1, and give the curved surfaces as TaggedMesh.geometry={tag: function}."
        )
    check_geometry(tagged_mesh.geometry)
    for name, wanted in (("cell_tags", dim), ("facet_tags", dim - 1)):
        tags = getattr(tagged_mesh, name)
        if tags is None and name == "cell_tags":
            continue
        if not isinstance(tags, dolfinx.mesh.MeshTags) or tags.dim != wanted:
            given = f"those of dimension {tags.dim}" if hasattr(tags, "dim") else shown(tags)
            raise InputError(f"{name} must be MeshTags of dimension {wanted}, found {given}.")


def checked_cell_errors(mesh: Any, cell_errors: Any) -> Array:
    """Check `cell_errors`, and return the errors (n,) of this rank's own cells."""
    count = mesh.topology.index_map(mesh.topology.dim).size_local
    if isinstance(cell_errors, fem.Function):
        V = cell_errors.function_space
        if not compat.same_topology(V.mesh, mesh):
            raise InputError("cell_errors belong to another mesh than the one to refine.")
        if V.element.basix_element.degree != 0 or V.dofmap.bs != 1:
            raise InputError(f"cell_errors must have one value in each cell, found {shown(V)}.")
        values: Array = cell_errors.x.array[V.dofmap.list[:count, 0]]
    else:
        values = np.asarray(cell_errors)
    if values.shape != (count,) or values.dtype.kind not in "fiu":
        raise InputError(
            "cell_errors must be a function of degree 0, which solutions have after solve() with "
            f'accuracy="balanced", the default; or real numbers of shape ({count},), one for each '
            f"cell that this rank owns; found {values.dtype} of shape {values.shape}."
        )
    wrong = ~(np.isfinite(values) & (values >= 0.0))
    if wrong.any():
        raise InputError(
            f"cell_errors must be finite and not negative, found {values[wrong][0]} in "
            f"{wrong.sum()} of {count} cells."
        )
    return values.astype(np.float64)


def _distributed_tags(mesh: Any, old: Any, entities: GlobalNumbers, values: LocalNumbers) -> Any:
    """Return tags of a refined mesh, on the ranks that have the entities. Collective.

    Names are those of the `old` tags. Each rank gives n tagged entities, whoever owns them, by the
    numbers of their nodes (n, k) with which `create_mesh` got the cells, and their values (n,).
    """
    mesh.topology.create_connectivity(old.dim, 0)
    mesh.topology.create_connectivity(old.dim, mesh.topology.dim)
    local, own_values = dolfinx.io.distribute_entity_data(mesh, old.dim, entities, values)
    tags = dolfinx.mesh.meshtags_from_entities(
        mesh, old.dim, dolfinx.graph.adjacencylist(local), own_values
    )
    if isinstance(old, NamedTags):
        tags = NamedTags(tags, old.names, geometry=old.geometry)
    tags.name = old.name
    return tags
