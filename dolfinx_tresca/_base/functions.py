"""Functions of DOLFINx: zeros, values of owned nodes, assembled forms, nodes at vertices."""

from __future__ import annotations

from typing import Any

import numpy as np

import basix
import dolfinx.la
import ufl
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, LocalNumbers
from dolfinx_tresca._base.compat import EntityMaps, geometry_dofmap


def zero_like(
    function: fem.Function, name: str, kind: type[fem.Function] = fem.Function
) -> fem.Function:
    """Return a Function of zeros, of type `kind`, on the space of a function. Not collective.

    On several ranks a new Function takes two of MPICH's 2,048 communicators; a copy shares them.
    """
    result = kind(function.function_space, function.copy().x, name=name)
    result.x.array[:] = 0.0
    return result


def owned_values(u: fem.Function) -> Array:
    """Return a view of the values (n, d) of u at the nodes that this rank owns. Not collective."""
    dofmap = u.function_space.dofmap
    return np.asarray(u.x.array.reshape(-1, dofmap.index_map_bs)[: dofmap.index_map.size_local])


def owned_size(function: fem.Function) -> int:
    """Return the number of values, nodes times components, that this rank owns. Not collective."""
    return int(function.x.index_map.size_local * function.x.block_size)


def with_owned_values(V: Any, values: Array, name: str | None = None) -> fem.Function:
    """Return the Function on V with values (n, d) or (n d,) at the rank's own nodes. Collective."""
    result = fem.Function(V, name=name)
    result.x.array[: values.size] = values.ravel()
    result.x.scatter_forward()
    return result


def assembled(form: ufl.Form, space: Any, entity_maps: EntityMaps | None = None) -> fem.Function:
    """Assemble a linear form into a Function on the space of its test function. Collective."""
    result = fem.Function(space)
    fem.assemble_vector(result.x.array, fem.form(form, entity_maps=entity_maps))
    result.x.scatter_reverse(dolfinx.la.InsertMode.add)
    result.x.scatter_forward()
    return result


def vertex_count(V: Any) -> int:
    """Return the number of vertices of each cell of V's mesh. Not collective."""
    return len(basix.topology(V.element.basix_element.cell_type)[0])


def nodes_of_vertices(V: Any) -> LocalNumbers:
    """Return for each geometry node at a vertex the node of V there, and 0 for others."""
    vertices = vertex_count(V)
    nodes = np.zeros(len(V.mesh.geometry.x), dtype=np.int32)
    nodes[geometry_dofmap(V.mesh)[:, :vertices]] = V.dofmap.list[:, :vertices]
    return nodes


def numbers_in_file(V: Any) -> GlobalNumbers:
    """Return for each node of V the number of its vertex in the mesh file, 0 at other nodes.

    If the mesh was not refined, the numbers depend neither on the degree of V nor on the partition.
    """
    index_map, vertices = V.dofmap.index_map, vertex_count(V)
    numbers = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=np.int64)
    in_file = np.asarray(V.mesh.geometry.input_global_indices)
    numbers[V.dofmap.list[:, :vertices]] = in_file[geometry_dofmap(V.mesh)[:, :vertices]]
    return numbers
