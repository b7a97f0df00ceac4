"""The cells into which bisection cuts the cells of a mesh."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import reduce_array, summed_at_nodes

#: Range of the shifts of nodes, relative to the shortest edge, that make equal edge lengths differ.
MOVED = 1e-5

#: The shift of a node along axis i is the sine of row i times the coordinates over the shortest
#: edge: numbers without common multiples, so that shifts of neighbours have nothing in common.
WAVES = 100.0 * np.exp(np.arange(9.0).reshape(3, 3) / np.pi)


@dataclass(frozen=True)
class BisectedCells:
    """The cells into which bisection cuts this rank's cells of a mesh.

    Cells have the dimension d.

    Attributes:
        mesh: the mesh of the new cells, which are on the ranks of their parents.
        parent: (n,) the cell of the old mesh that contains each new cell of this rank.
        opposite: (n, d + 1, d + 1) whether a corner of the cell (second index) lies on the facet of
            the parent that is opposite to the parent's corner (third index).
        nodes: (n, d + 1) nodes of `mesh` at the corners of each cell.
    """

    mesh: Any
    parent: npt.NDArray[np.int32]
    opposite: npt.NDArray[np.bool_]
    nodes: Indices

    @classmethod
    def from_marked(cls, mesh: Any, marked: Mask, every_edge: bool = True) -> BisectedCells:
        """Bisect edges of marked cells, and further edges as needed. Collective.

        DOLFINx uses the method of Plaza and Carey (2000, Local refinement of simplicial grids based
        on the skeleton): angles stay away from zero after any number of bisections.

        Args:
            mesh: mesh of simplices.
            marked: (owned cells,) whether each cell is marked.
            every_edge: whether to bisect all edges of a marked cell, or only its longest edge.
        """
        dim, comm = mesh.topology.dim, mesh.comm
        mesh.topology.create_entities(1)
        mesh.topology.create_connectivity(dim, 1)
        mesh.topology.create_connectivity(1, dim)
        cells = np.flatnonzero(marked).astype(np.int32)
        option = dolfinx.mesh.RefinementOption.parent_cell
        with _without_ties(mesh) as moved:
            edges = (
                dolfinx.mesh.compute_incident_entities(mesh.topology, cells, dim, 1)
                if every_edge
                else _longest_edges(mesh, cells)
            )
            fine, parent, _ = dolfinx.mesh.refine(mesh, edges, None, option)
        # `parent` has the order of the cells before DOLFINx renumbered them
        count = len(parent)
        start = sum(comm.allgather(count)[: comm.rank])
        parent = parent[np.asarray(fine.topology.original_cell_index)[:count] - start]

        corners, nodes = geometry_dofmap(mesh)[parent], geometry_dofmap(fine)[:count]
        twice = _halves(moved[corners][:, :, :dim], fine.geometry.x[nodes][:, :, :dim])
        # the parent's first and last corner with a nonzero barycentric coordinate: at a corner both
        # are this corner, at the middle of an edge they are its ends
        begin, end = (twice > 0).argmax(axis=2), dim - (twice[:, :, ::-1] > 0).argmax(axis=2)
        begin, end = (np.take_along_axis(corners, which, axis=1) for which in (begin, end))
        fine.geometry.x[nodes] = 0.5 * (mesh.geometry.x[begin] + mesh.geometry.x[end])
        return cls(fine, parent, twice == 0, nodes.astype(np.intp))

    @property
    def numbers(self) -> npt.NDArray[np.int64]:
        """(nodes,) the numbers of this rank's nodes over all ranks. Not collective."""
        count = np.arange(len(self.mesh.geometry.x), dtype=np.int32)
        return np.asarray(self.mesh.geometry.index_map().local_to_global(count))

    def volumes(self, points: Array) -> Array:
        """Return the signed volumes (n,), times d!, for nodes at given points (nodes, 3)."""
        sides = points[self.nodes[:, 1:]] - points[self.nodes[:, :1]]
        return np.asarray(np.linalg.det(sides[:, :, : self.mesh.topology.dim]))

    def on_any_rank(self, nodes: Mask) -> Mask:
        """Return whether nodes (nodes,) are true on any rank that has them. Collective."""
        every = np.arange(len(nodes))
        sums = summed_at_nodes(self.mesh.geometry.index_map(), every, nodes[:, None].astype(float))
        return np.asarray(sums[:, 0] > 0.0)

    def inherited_facets(self, mesh: Any, tags: Any) -> tuple[Indices, npt.NDArray[np.int32]]:
        """Return the nodes (m, d) and tags (m,) of the facets of the cells that inherit a tag.

        A facet inside a tagged facet of the old `mesh` gets this tag. A facet between two cells
        occurs twice. Not collective.
        """
        dim = mesh.topology.dim
        mesh.topology.create_connectivity(dim, dim - 1)
        facets_of_cells = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)
        value, tagged = _of_entities(facets_of_cells.max(initial=-1) + 1, tags)
        facets = facets_of_cells[self.parent]
        # all corners except one lie on the parent's facet
        cell, side = np.nonzero((self.opposite.sum(axis=1) == dim) & tagged[facets])
        corners = self.opposite[cell, :, side]
        return self.nodes[cell][corners].reshape(-1, dim), value[facets[cell, side]]

    def inherited_cells(self, tags: Any) -> tuple[Indices, npt.NDArray[np.int32]]:
        """Return nodes (m, d + 1) and tags (m,) of cells with tagged parents. Not collective."""
        value, tagged = _of_entities(int(self.parent.max(initial=-1)) + 1, tags)
        kept = tagged[self.parent]
        return self.nodes[kept], value[self.parent[kept]]


@contextmanager
def _without_ties(mesh: Any) -> Iterator[Array]:
    """Move the nodes of a mesh slightly within a `with` block; yield the moved coordinates.

    Among edges of equal length DOLFINx cuts the first one in the numbering of a rank, which depends
    on the partition. After the motion all lengths differ, in the same way for any partition.
    Collective.
    """
    x, dim = mesh.geometry.x, mesh.geometry.dim
    start = x.copy()
    corners = x[geometry_dofmap(mesh)]
    sides = [corners[:, i] - corners[:, j] for i, j in combinations(range(dim + 1), 2)]
    shortest = np.linalg.norm(sides, axis=2).min(initial=np.inf)
    size = float(reduce_array(mesh.comm, shortest, MPI.MIN))
    try:
        x[:, :dim] += 0.5 * MOVED * size * np.sin(start[:, :dim] / size @ WAVES[:dim, :dim].T)
        yield x.copy()
    finally:
        x[:] = start


def _longest_edges(mesh: Any, cells: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Return the longest edges of cells, each edge once. Not collective."""
    dim = mesh.topology.dim
    of_cell = mesh.topology.connectivity(dim, 1).array.reshape(-1, dim * (dim + 1) // 2)[cells]
    edges, position = np.unique(of_cell, return_inverse=True)
    if len(edges) == 0:  # DOLFINx 0.9 divides by this number
        return cells[:0]
    ends = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, 1, edges.astype(np.int32))]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[position.reshape(of_cell.shape)]
    longest = of_cell[np.arange(len(cells)), length.argmax(axis=1)]
    return np.asarray(np.unique(longest), dtype=np.int32)


def _halves(corners: Array, points: Array) -> npt.NDArray[np.int64]:
    """Return the barycentric coordinates (n, k, d + 1) of points, times 2: whole numbers.

    Args:
        corners: (n, d + 1, d) corners of simplices.
        points: (n, k, d) corners and middles of edges of each simplex.
    """
    sides = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    fractions = np.linalg.solve(sides, np.swapaxes(points - corners[:, :1], 1, 2))
    inner = np.rint(2.0 * np.swapaxes(fractions, 1, 2)).astype(np.int64)
    return np.concatenate([2 - inner.sum(axis=2, keepdims=True), inner], axis=2)


def _of_entities(count: int, tags: Any) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.bool_]]:
    """Return the tag (n,) of each entity, 0 if untagged, and whether it is tagged (n,).

    The number n is at least `count`, and large enough for all tagged entities.
    """
    count = max(count, int(tags.indices.max(initial=-1)) + 1)
    value, tagged = np.zeros(count, dtype=np.int32), np.zeros(count, dtype=np.bool_)
    value[tags.indices], tagged[tags.indices] = tags.values, True
    return value, tagged
