"""Nodes of a function space at the vertices of the mesh."""

from __future__ import annotations

from typing import Any

import numpy as np

import basix

from dolfinx_tresca._base.arrays import GlobalNumbers, LocalNumbers
from dolfinx_tresca._base.compat import geometry_dofmap


def entities_of_cell(V: Any, dim: int) -> int:
    """Return how many entities of a dimension the cells of a mesh have. Not collective."""
    return len(basix.topology(V.element.basix_element.cell_type)[dim])


def nodes_of_vertices(V: Any) -> LocalNumbers:
    """Return for each node of the mesh's geometry the node of V there. Not collective.

    Args:
        V: a Lagrange space. Nodes of its own on edges and in cells have no part in this; nor have
            those of a curved geometry, which get zero.
    """
    vertices = entities_of_cell(V, 0)
    nodes = np.zeros(len(V.mesh.geometry.x), dtype=np.int32)
    nodes[geometry_dofmap(V.mesh)[:, :vertices]] = V.dofmap.list[:, :vertices]
    return nodes


def numbers_in_file(V: Any) -> GlobalNumbers:
    """Return the number in the mesh file of each node of V at a vertex, else 0. Not collective.

    Neither the partition nor the degree of V changes them.
    """
    index_map, vertices = V.dofmap.index_map, entities_of_cell(V, 0)
    numbers = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=np.int64)
    in_file = np.asarray(V.mesh.geometry.input_global_indices)
    numbers[V.dofmap.list[:, :vertices]] = in_file[geometry_dofmap(V.mesh)[:, :vertices]]
    return numbers
