"""Displacements of the mesh's geometry."""

from __future__ import annotations

from typing import Any

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import geometry_degree
from dolfinx_tresca._base.vertices import entities_per_cell
from dolfinx_tresca.pairing.search.facets import tabulate


def straightened(V: Any, u: Array) -> Array:
    """Return u without the part that would bend edges beyond the degree of the mesh's geometry.

    Not collective.

    If V has a higher degree than the geometry, each node that is not at a vertex is moved by the
    mean displacement of the vertices of its edge, face or cell; else the result is u.

    Args:
        V: the space of the displacement.
        u: (nodes, dim of space) displacement of this rank's nodes [length].
    """
    element = V.element.basix_element
    if element.degree <= geometry_degree(V.mesh):
        return u
    cells, corners = V.dofmap.list, entities_per_cell(V, 0)
    hats = tabulate(element.cell_type.name, 1, 0, element.points)[0]
    result = u.copy()
    result[cells] = hats @ u[cells[:, :corners]]
    return result
