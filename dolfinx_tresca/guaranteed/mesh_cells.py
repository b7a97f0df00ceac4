"""The cells of a mesh that a rank owns, values at their nodes, and checks on all ranks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI

import numpy as np

import basix

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import summed_at_nodes
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.guaranteed.cells import Simplices, basis_products, mean_products, opposite


@dataclass(frozen=True)
class OwnedCells:
    """The cells that this rank owns, with vertices in ascending order of their global numbers.

    Attributes:
        V: the space of the displacement.
        cells: the cells.
        order: (n, d + 1) numbers of the vertices in DOLFINx's cells.
        vertices: (n, d + 1) global numbers of the vertices.
        facets: (n, d + 1) numbers on this rank of the facets.
        nodes: (n, k) nodes of the displacement on this rank: at the vertices, and for degree 2 in
            the middles of the edges, in the order of `basis_products`.
    """

    V: Any
    cells: Simplices
    order: Indices
    vertices: GlobalNumbers
    facets: Indices
    nodes: Indices

    @cached_property
    def basis(self) -> Array:
        """The basis functions at `nodes`, see `basis_products`."""
        return basis_products(self.cells.d + 1, self.V.element.basix_element.degree)

    @cached_property
    def on_facets(self) -> Indices:
        """(d + 1, k) positions in `nodes` of the nodes on each facet, vertices before edges."""
        facets = opposite(self.cells.d)
        return np.array(
            [np.flatnonzero(self.basis[:, ends][:, :, ends].any(axis=(1, 2))) for ends in facets]
        )

    def nodal_forces(self, load: Array, traction: Array) -> Array:
        """Return the forces (nodes, d) of linear loads and tractions. Collective.

        Args:
            load: (n, d + 1, d) loads at the vertices.
            traction: (n, d + 1, d, d) tractions on facets at their vertices.
        """
        cells, forces = self.cells, np.zeros((*self.nodes.shape, self.cells.d))
        terms = [(np.arange(cells.d + 1), cells.volumes, load)]
        terms += zip(opposite(cells.d), cells.areas.T, np.moveaxis(traction, 1, 0), strict=True)
        for ends, sizes, values in terms:
            basis = self.basis[:, ends][:, :, ends]
            weights = np.einsum("kab,abc->kc", basis, mean_products(len(ends), 3))
            forces += sizes[:, None, None] * (weights @ values)
        return summed_at_nodes(self.V.dofmap.index_map, self.nodes, forces)

    @classmethod
    def from_space(cls, V: Any) -> OwnedCells:
        """Sort the vertices of the cells of a space's mesh. Collective."""
        mesh, topology = V.mesh, V.mesh.topology
        d, count = topology.dim, topology.index_map(topology.dim).size_local
        topology.create_connectivity(d, d - 1)
        topology.create_connectivity(d - 1, d)
        local = topology.connectivity(d, 0).array.reshape(-1, d + 1)[:count]
        numbers = topology.index_map(0).local_to_global(local.ravel()).reshape(local.shape)
        order = np.argsort(numbers, axis=1)
        points = mesh.geometry.x[geometry_dofmap(mesh)[:count], :d]
        facets = topology.connectivity(d, d - 1).array.reshape(-1, d + 1)[:count]
        ends = np.array(basix.topology(mesh.basix_cell())[1])
        edges = np.zeros((d + 1, d + 1), dtype=np.intp)
        edges[ends[:, 0], ends[:, 1]] = edges[ends[:, 1], ends[:, 0]] = np.arange(len(ends)) + d + 1
        i, j = np.triu_indices(d + 1, 1)
        own = np.hstack([order, edges[order[:, i], order[:, j]]])
        nodes = V.dofmap.list[:count]
        return cls(
            V=V,
            cells=Simplices(np.take_along_axis(points, order[:, :, None], axis=1)),
            order=order,
            vertices=np.take_along_axis(numbers, order, axis=1),
            facets=np.take_along_axis(facets, order, axis=1),
            nodes=np.take_along_axis(nodes, own[:, : nodes.shape[1]], axis=1),
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
