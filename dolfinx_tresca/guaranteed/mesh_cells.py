"""The cells of a mesh that a rank owns, values at nodes, and checks on all ranks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import summed_at_nodes
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.guaranteed.cells import Simplices


@dataclass(frozen=True)
class OwnedCells:
    """The cells that this rank owns, with vertices in ascending order of their global numbers.

    Attributes:
        V: the space of the displacement.
        cells: the cells.
        order: (n, d + 1) numbers of the vertices in DOLFINx's cells.
        vertices: (n, d + 1) global numbers of the vertices.
        facets: (n, d + 1) numbers on this rank of the facets.
        facet_nodes: (n, d + 1, k) nodes of the displacement on each facet, those at its vertices
            before those in the middles of its edges, as in `bernstein_points`.
    """

    V: Any
    cells: Simplices
    order: Indices
    vertices: GlobalNumbers
    facets: Indices
    facet_nodes: Indices

    @classmethod
    def from_space(cls, V: Any) -> OwnedCells:
        """Sort the vertices of the cells of a space's mesh. Collective."""
        mesh, topology = V.mesh, V.mesh.topology
        d, count = topology.dim, topology.index_map(topology.dim).size_local
        topology.create_connectivity(d, d - 1)
        topology.create_connectivity(d - 1, d)
        local, facets = (
            topology.connectivity(d, k).array.reshape(-1, d + 1)[:count] for k in (0, d - 1)
        )
        numbers = topology.index_map(0).local_to_global(local.ravel()).reshape(local.shape)
        order = np.argsort(numbers, axis=1)
        points = mesh.geometry.x[geometry_dofmap(mesh)[:count], :d]
        layout = V.dofmap.dof_layout
        on_facets = np.array([layout.entity_closure_dofs(d - 1, j) for j in range(d + 1)])
        nodes = V.dofmap.list[:count][:, on_facets]
        return cls(
            V=V,
            cells=Simplices(np.take_along_axis(points, order[:, :, None], axis=1)),
            order=order,
            vertices=np.take_along_axis(numbers, order, axis=1),
            facets=np.take_along_axis(facets, order, axis=1),
            facet_nodes=np.take_along_axis(nodes, order[:, :, None], axis=1),
        )


def spread(V: Any, owned: Array) -> Array:
    """Return values (owned nodes, k) at this rank's nodes, ghosts included. Collective."""
    return summed_at_nodes(V.dofmap.index_map, np.arange(len(owned)), owned)


def require(comm: MPI.Comm, holds: Any, needed: str) -> None:
    """Check what the bound needs on all ranks. Collective.

    Raises:
        InputError: it does not hold on a rank.
    """
    if not comm.allreduce(bool(holds), op=MPI.LAND):
        raise InputError(f"a guaranteed bound needs {needed}.")
