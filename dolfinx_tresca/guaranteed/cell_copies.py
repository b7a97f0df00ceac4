"""Copies of cells on the ranks that own their vertices."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.exchange import exchange


class CellCopies:
    """Sends data of owned cells to all ranks that own a vertex of the cell, and results back.

    Attributes:
        vertices: (m, d + 1) global numbers of the vertices of the cells and copies on this rank.
        owned: (m, d + 1) whether this rank owns the vertex.
    """

    def __init__(self, mesh: Any) -> None:
        """Find the owners of the vertices of this rank's cells. Collective."""
        topology, self._comm = mesh.topology, mesh.comm
        cells = topology.index_map(topology.dim).size_local
        index_map = topology.index_map(0)
        local = topology.connectivity(topology.dim, 0).array.reshape(-1, topology.dim + 1)[:cells]
        numbers: GlobalNumbers = index_map.local_to_global(local.ravel().astype(np.int32))
        rank = mesh.comm.rank
        owners = np.full(index_map.size_local + index_map.num_ghosts, rank)
        owners[index_map.size_local :] = index_map.owners
        vertices, owner = numbers.reshape(local.shape), owners[local]
        # this rank has its own cells, other ranks have copies
        cell, _ = np.nonzero(np.ones_like(local))
        pairs = np.unique(np.column_stack([owner.ravel(), cell]), axis=0)
        pairs = pairs[pairs[:, 0] != rank]
        self._ranks: Indices = np.concatenate([np.full(cells, rank), pairs[:, 0]])
        self._cells: Indices = np.concatenate([np.arange(cells), pairs[:, 1]])
        order = np.argsort(self._ranks, kind="stable")  # the order in which `exchange` sends
        self._ranks, self._cells = self._ranks[order], self._cells[order]
        self.vertices, self._sources = exchange(self._comm, vertices[self._cells], self._ranks)
        owner, _ = exchange(self._comm, owner[self._cells], self._ranks)
        self.owned: Mask = owner == rank
        self._size = cells

    def spread(self, values: Any) -> Any:
        """Return values of owned cells (n, ...) on cells and copies (m, ...). Collective."""
        return exchange(self._comm, np.ascontiguousarray(values[self._cells]), self._ranks)[0]

    def summed(self, values: Array) -> Array:
        """Return sums (n, ...) over the copies of cells of values (m, ...). Collective."""
        returned, _ = exchange(self._comm, values, self._sources)
        result = np.zeros((self._size, *values.shape[1:]))
        np.add.at(result, self._cells, returned)
        return result
