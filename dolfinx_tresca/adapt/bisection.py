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

from dolfinx_tresca._base.arrays import Array, Mask, splitmix64
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import exchange, reduce_array

#: Range of the shifts of nodes, relative to the shortest edge, that make equal edge lengths differ.
MOVED = 1e-5


class SharedNodes:
    """Nodes with keys: a node has the same key on all ranks that have the node.

    Each key determines one rank, its keeper. All ranks that have the node send their messages about
    it to the keeper.

    Attributes:
        numbers: (n,) numbers of this rank's nodes: 0, 1, ... over all ranks, in the order of their
            keys, for any partition.
    """

    def __init__(self, comm: MPI.Comm, keys: npt.NDArray[np.int64], limit: int) -> None:
        """Number the nodes. Collective.

        Args:
            comm: communicator of the ranks.
            keys: (n,) keys of this rank's nodes, ascending, without repetition.
            limit: a number larger than all keys.
        """
        self._comm = comm
        # ascending like the keys, so that answers come back in the order of the questions
        self._keepers = (keys // (limit // comm.size + 1)).astype(np.intp)
        asked, self._askers = exchange(comm, keys, self._keepers)
        kept, self._position = np.unique(asked, return_inverse=True)
        self._count = len(kept)
        start = sum(comm.allgather(self._count)[: comm.rank])
        self.numbers, _ = exchange(comm, (start + self._position).astype(np.int64), self._askers)

    def kept(self, rows: Array) -> Array:
        """Return the rows (m, k) of the nodes whose keeper is this rank, by ascending number.

        Collective.

        Args:
            rows: (n, k) rows of this rank's nodes, the same on all ranks that have them.
        """
        told, _ = exchange(self._comm, rows, self._keepers)
        result = np.zeros((self._count, rows.shape[1]))
        result[self._position] = told
        return result

    def known_values(self, rows: Array, is_known: Mask) -> tuple[Array, Mask]:
        """Return values at this rank's nodes, taken from any rank that knows them. Collective.

        Args:
            rows: (n, k) rows of this rank's nodes; known rows are the same on all ranks.
            is_known: (n,) whether this rank knows each row.

        Returns:
            The rows (n, k), unchanged where no rank knows them; and whether a rank knows each row,
            (n,).
        """
        told, _ = exchange(self._comm, np.column_stack([rows, is_known]), self._keepers)
        result = np.zeros((self._count, rows.shape[1] + 1))
        known_rows = told[:, -1] > 0.0
        result[self._position[known_rows]] = told[known_rows]
        answers, _ = exchange(self._comm, result[self._position], self._askers)
        return np.where(answers[:, -1:] > 0.0, answers[:, :-1], rows), answers[:, -1] > 0.0


@dataclass(frozen=True)
class BisectedCells:
    """The cells into which bisection cuts this rank's cells of a mesh, and the nodes of new cells.

    A node is a corner of the mesh, or the middle of an edge. Cells have the dimension d.

    Attributes:
        parent: (n,) the cell of the mesh that contains each cell.
        opposite: (n, d + 1, d + 1) whether a corner of the cell (second index) lies on the facet of
            the parent that is opposite to the parent's corner (third index).
        nodes: (n, d + 1) the corners of each cell, as positions in `points`.
        points: (nodes, 3) coordinates of the nodes [length].
        shared: numbering of the nodes over all ranks.
    """

    parent: npt.NDArray[np.int32]
    opposite: npt.NDArray[np.bool_]
    nodes: npt.NDArray[np.intp]
    points: Array
    shared: SharedNodes

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

        corners = geometry_dofmap(mesh)[parent]
        fine_corners = fine.geometry.x[geometry_dofmap(fine)[:count]]
        twice = _halves(moved[corners][:, :, :dim], fine_corners[:, :, :dim])
        # the parent's first and last corner with a nonzero barycentric coordinate: at a corner both
        # are this corner, at the middle of an edge they are its ends
        begin, end = (twice > 0).argmax(axis=2), dim - (twice[:, :, ::-1] > 0).argmax(axis=2)
        in_file = np.asarray(mesh.geometry.input_global_indices)[corners]
        begins, ends = (np.take_along_axis(in_file, which, axis=1) for which in (begin, end))
        # nodes of a submesh have the numbers of its parent mesh, with gaps
        largest = np.max(mesh.geometry.input_global_indices, initial=0)
        total = int(reduce_array(comm, largest, MPI.MAX)) + 1
        keys, position, nodes = np.unique(
            np.minimum(begins, ends) * total + np.maximum(begins, ends),
            return_index=True,
            return_inverse=True,
        )
        begins, ends = (
            np.take_along_axis(corners, which, axis=1).ravel()[position] for which in (begin, end)
        )
        x = mesh.geometry.x
        return cls(
            parent=parent,
            opposite=twice == 0,
            nodes=nodes.reshape(-1, dim + 1),
            points=0.5 * (x[begins] + x[ends]),
            shared=SharedNodes(comm, keys, total**2),
        )

    @property
    def dim(self) -> int:
        """Dimension of the cells."""
        return int(self.nodes.shape[1]) - 1

    def volumes(self, points: Array) -> Array:
        """Return the signed volumes (n,), times d!, for nodes at given points (nodes, 3)."""
        sides = points[self.nodes[:, 1:]] - points[self.nodes[:, :1]]
        return np.asarray(np.linalg.det(sides[:, :, : self.dim]))

    def volume_parts(self) -> Array:
        """Return the volumes (n,) of the cells, divided by the volumes of their parents."""
        volumes = np.abs(self.volumes(self.points))
        return np.asarray(volumes / np.bincount(self.parent, volumes)[self.parent])

    def inherited_facets(
        self, mesh: Any, tags: Any
    ) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.int32]]:
        """Return the nodes (m, d) and tags (m,) of the facets of the cells that inherit a tag.

        A facet inside a tagged facet of `mesh` gets this tag. A facet between two cells occurs
        twice. Not collective.
        """
        dim = self.dim
        mesh.topology.create_connectivity(dim, dim - 1)
        of_cell = mesh.topology.connectivity(dim, dim - 1).array.reshape(-1, dim + 1)
        value, tagged = _of_entities(of_cell.max(initial=-1) + 1, tags)
        facets = of_cell[self.parent]
        # all corners except one lie on the parent's facet
        cell, side = np.nonzero((self.opposite.sum(axis=1) == dim) & tagged[facets])
        on = self.opposite[cell, :, side]
        return self.nodes[cell][on].reshape(-1, dim), value[facets[cell, side]]

    def inherited_cells(self, tags: Any) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.int32]]:
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
    x = mesh.geometry.x
    start = x.copy()
    dim = mesh.geometry.dim
    in_file = np.asarray(mesh.geometry.input_global_indices).astype(np.uint64)
    random_bits = splitmix64(in_file[:, None] * np.uint64(dim) + np.arange(dim, dtype=np.uint64))
    corners = x[geometry_dofmap(mesh)]
    sides = [corners[:, i] - corners[:, j] for i, j in combinations(range(dim + 1), 2)]
    shortest = np.linalg.norm(sides, axis=2).min(initial=np.inf)
    size = float(reduce_array(mesh.comm, shortest, MPI.MIN))
    try:
        x[:, :dim] += MOVED * size * (random_bits / 2.0**64 - 0.5)
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
