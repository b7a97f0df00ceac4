"""The bodies (connected parts) of a mesh, with numbers independent of the partition."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from dolfinx import la

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import exchange, gather_rows, reduce_array

#: Difference of coordinates, relative to the mesh's largest coordinate, that counts as rounding.
ONE_PLACE = 1e-10


def label_bodies(V: Any) -> npt.NDArray[np.int64]:
    """Return the body, 0, 1, ..., of each node of V on this rank, ghosts included. Collective.

    Nodes of one cell are in one body. The numbers are the same for any number of ranks: bodies are
    sorted by their least x, then y, then z, then by their largest x, y and z, and finally by their
    order in the mesh file.
    """
    comm = V.mesh.comm
    nodes = V.dofmap.index_map
    local = _connected_nodes(V.dofmap.list, nodes.size_local + nodes.num_ghosts)

    # Parts on two ranks belong to one body if a node of one part is a ghost in the other part.
    sizes = comm.allgather(int(local.max(initial=-1)) + 1)
    local = local + sum(sizes[: comm.rank])
    label = la.vector(nodes, 1, np.float64)
    label.array[:] = local
    label.scatter_forward()
    links = gather_rows(comm, np.unique(np.column_stack([local, label.array.astype(int)]), axis=0))
    total = sum(sizes)
    graph = csr_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(total, total))
    _, merged = connected_components(graph, directed=False)
    body = merged[local]

    order = _reading_order(V, body, int(merged.max(initial=-1)) + 1)
    rank_of = np.empty(len(order), dtype=np.int64)
    rank_of[order] = np.arange(len(order))
    numbered: npt.NDArray[np.int64] = rank_of[body]
    return numbered


def _connected_nodes(cells: npt.NDArray[np.int32], count: int) -> npt.NDArray[np.int32]:
    """Return a number for each of `count` nodes, the same for nodes that cells connect.

    Args:
        cells: (m, k) the nodes of each cell.
        count: number of nodes; a node without cells has a number of its own.
    """
    # a graph of nodes and cells, since a graph of nodes alone would have many times the edges
    cell = np.repeat(np.arange(count, count + len(cells)), cells.shape[1])
    size = count + len(cells)
    graph = coo_array((np.ones(cells.size, np.int8), (cells.ravel(), cell)), shape=(size, size))
    labels: npt.NDArray[np.int32] = connected_components(graph, directed=False)[1][:count]
    return labels


def _reading_order(V: Any, body: npt.NDArray[Any], number: int) -> npt.NDArray[np.int64]:
    """Return the bodies (number,) sorted by the lowest, then highest corners of their boxes.

    Coordinates that differ by rounding count as equal; bodies with equal bounding boxes are sorted
    by their order in the mesh file. So the order does not depend on the partition or the processor.
    Collective.
    """
    corners = body_bounds(V, body, number)
    rounding = ONE_PLACE * np.abs(corners).max(initial=0.0)
    places = np.empty(corners.shape, dtype=np.int64)
    for place, values in zip(places.T, corners.T, strict=True):
        ascending = np.argsort(values)
        steps = np.diff(values[ascending], prepend=values[ascending[:1]])
        place[ascending] = np.cumsum(steps > rounding)
    mesh = V.mesh
    nodes = geometry_dofmap(mesh)
    least_node = np.full(number, np.iinfo(np.int64).max)
    numbers = np.asarray(mesh.geometry.input_global_indices, dtype=np.int64)[nodes]
    np.minimum.at(
        least_node, body[V.dofmap.list[: len(nodes), 0]], numbers.min(axis=1, initial=least_node[0])
    )
    in_file = reduce_array(mesh.comm, least_node, MPI.MIN)
    order: npt.NDArray[np.int64] = np.lexsort([in_file, *places.T[::-1]])
    return order


def labels_of(
    V: Any, label: npt.NDArray[np.int64], numbers: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Return the labels (n,) of nodes of any rank. Collective.

    Args:
        V: the space whose nodes have labels.
        label: (owned nodes of V,) the label of each node.
        numbers: (n,) ascending global numbers of nodes.
    """
    comm, (start, end) = V.mesh.comm, V.dofmap.index_map.local_range
    owners = np.searchsorted(np.array(comm.allgather(end)), numbers, side="right")
    asked, source = exchange(comm, numbers, owners)
    labels: npt.NDArray[np.int64] = exchange(comm, label[asked - start], source)[0]
    return labels


def body_bounds(V: Any, body: npt.NDArray[Any], number: int) -> Array:
    """Return the bounds (number, 6) of the bodies: least x, y, z, then largest. Collective."""
    points = V.tabulate_dof_coordinates()
    bounds: Array = np.full((number, 6), np.inf)
    np.minimum.at(bounds, body, np.hstack([points, -points]))
    bounds = reduce_array(V.mesh.comm, bounds, MPI.MIN)
    bounds[:, 3:] *= -1.0
    return bounds
