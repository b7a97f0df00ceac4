"""The cells into which bisection cuts cells of a mesh, and motion of their nodes to surfaces."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array, summed_at_nodes
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.scene.geometry import ExactSurface, project_points


@dataclass(frozen=True)
class BisectedCells:
    """The cells into which bisection cuts this rank's cells of a mesh.

    Cells have the dimension d.

    Attributes:
        mesh: the mesh of the new cells, which are on the ranks of their parents.
        parent: (n,) the cell of the old mesh that contains each new cell of this rank.
        parent_facet: (n, d + 1) the facet of the parent, by its number there, in which each facet
            of the cell lies; -1: the facet is inside of the parent.
        nodes: (n, d + 1) nodes of `mesh` at the corners of each cell. The facets of a cell are in
            the order of the opposite corners.
    """

    mesh: Any
    parent: npt.NDArray[np.int32]
    parent_facet: npt.NDArray[np.int8]
    nodes: Indices

    @classmethod
    def from_marked(cls, mesh: Any, marked: Mask) -> BisectedCells:
        """Bisect all edges of marked cells, and further edges as needed. Collective.

        DOLFINx uses the method of Plaza and Carey (2000, Local refinement of simplicial grids based
        on the skeleton): angles stay away from zero after any number of bisections. Among edges of
        equal length, DOLFINx cuts the first one in the numbering of a rank, which depends on the
        partition: the mesh is stretched meanwhile, in the same way for any partition.

        Args:
            mesh: mesh of simplices.
            marked: (owned cells,) whether each cell is marked.
        """
        dim = mesh.topology.dim
        mesh.topology.create_entities(1)
        mesh.topology.create_connectivity(dim, 1)
        mesh.topology.create_connectivity(1, dim)
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
        # both have the order of the cells before DOLFINx renumbered them
        count = len(parent)
        order = np.asarray(fine.topology.original_cell_index)[:count]
        order = order - sum(mesh.comm.allgather(count)[: mesh.comm.rank])
        parent_facet = np.reshape(parent_facet, (count, dim + 1))[order]
        nodes = geometry_dofmap(fine)[:count].astype(np.intp)
        return cls(fine, parent[order], parent_facet, nodes)

    @property
    def numbers(self) -> npt.NDArray[np.int64]:
        """(nodes,) the numbers of this rank's nodes over all ranks. Not collective."""
        count = np.arange(len(self.mesh.geometry.x), dtype=np.int32)
        return np.asarray(self.mesh.geometry.index_map().local_to_global(count))

    def volumes(self, points: Array) -> Array:
        """Return the signed volumes (n,), times d!, for nodes at given points (nodes, 3)."""
        sides = points[self.nodes[:, 1:]] - points[self.nodes[:, :1]]
        return np.asarray(np.linalg.det(sides[:, :, : self.mesh.topology.dim]))

    def inherited_facets(self, mesh: Any, tags: Any) -> tuple[Indices, npt.NDArray[np.int32]]:
        """Return the nodes (m, d) and tags (m,) of the facets of the cells that inherit a tag.

        A facet inside a tagged facet of the old `mesh` gets this tag. A facet between two cells
        occurs twice. Not collective.
        """
        dim = mesh.topology.dim
        mesh.topology.create_connectivity(dim, dim - 1)
        facets_of_cells = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)
        value, tagged = _of_entities(facets_of_cells.max(initial=-1) + 1, tags)
        inside = self.parent_facet < 0
        number = np.where(inside, 0, self.parent_facet)
        facets = np.take_along_axis(facets_of_cells[self.parent], number, axis=1)
        cell, side = np.nonzero(~inside & tagged[facets])
        corners = np.arange(dim + 1) != side[:, None]
        return self.nodes[cell][corners].reshape(-1, dim), value[facets[cell, side]]

    def inherited_cells(self, tags: Any) -> tuple[Indices, npt.NDArray[np.int32]]:
        """Return nodes (m, d + 1) and tags (m,) of cells with tagged parents. Not collective."""
        value, tagged = _of_entities(int(self.parent.max(initial=-1)) + 1, tags)
        kept = tagged[self.parent]
        return self.nodes[kept], value[self.parent[kept]]


def _of_entities(count: int, tags: Any) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.bool_]]:
    """Return the tag (n,) of each entity, 0 if untagged, and whether it is tagged (n,).

    The number n is at least `count`, and large enough for all tagged entities.
    """
    count = max(count, int(tags.indices.max(initial=-1)) + 1)
    value, tagged = np.zeros(count, dtype=np.int32), np.zeros(count, dtype=np.bool_)
    value[tags.indices], tagged[tags.indices] = tags.values, True
    return value, tagged


def snapped(
    cells: BisectedCells,
    facets: Indices,
    tags: npt.NDArray[np.int32],
    surfaces: Mapping[int, ExactSurface],
) -> Array:
    """Return the nodes (n, 3), with nodes of facets moved to their surfaces. Collective.

    The nodes of a cell that would become flat or inverted do not move. A warning is logged, and the
    next refinement tries again, with smaller cells.

    Args:
        cells: the cells.
        facets: (m, d) nodes of tagged facets.
        tags: (m,) tags of the facets.
        surfaces: tag -> the exact surface of the facets.

    Raises:
        InputError: a projection fails, or does not return one finite point for each node; or no
            facet has the tag of a projection.
    """
    mesh = cells.mesh
    comm, dim, index_map = mesh.comm, mesh.topology.dim, mesh.geometry.index_map()
    start = surface = mesh.geometry.x.copy()
    for tag, exact in surfaces.items():
        nodes = np.unique(facets[tags == tag])
        if reduce_array(comm, len(nodes)) == 0:
            raise InputError(f"the geometry has facets that there are not: none has the tag {tag}.")
        with errors_on_all_ranks(comm):
            target = project_points(surface[nodes], f"geometry[{tag}]", exact.project, dim)
        # another rank may know of a node, but of none of its facets
        values = np.column_stack([target, np.ones(len(nodes))])
        sums = summed_at_nodes(index_map, nodes, values)
        surface = np.where(sums[:, 3:] > 0.0, sums[:, :3] / np.maximum(sums[:, 3:], 1.0), surface)

    held: Mask = np.zeros(len(start), dtype=np.bool_)
    points, volumes = surface, cells.volumes(start)
    while True:
        flat = np.sign(volumes) * cells.volumes(points) < 0.1 * np.abs(volumes)
        more = held.copy()
        more[cells.nodes[flat]] = True
        every = np.arange(len(more))
        more = summed_at_nodes(index_map, every, more[:, None].astype(float))[:, 0] > 0.0
        if reduce_array(comm, (more & ~held).sum()) == 0:
            break
        held = more
        points = np.where(held[:, None], start, surface)
    back = held & (surface != start).any(axis=1)
    count = int(reduce_array(comm, back[: index_map.size_local].sum()))
    if count:
        log(
            comm,
            "%d nodes were not moved to their curved surface, where cells would have become flat "
            "or turned inside out; a finer mesh to begin with helps there",
            count,
            level=logging.WARNING,
        )
    return np.asarray(points)
