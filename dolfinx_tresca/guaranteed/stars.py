"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, exchange, summed_at_nodes
from dolfinx_tresca.guaranteed.cells import OwnedCells, mean_products, opposite, rigid_motions

#: Stiffness, relative to that of a cell, that is added so that no star is loose. Equations of stars
#: are solved up to this number.
LOOSE = 1e-11


class Stars:
    """The stars of vertices: for each vertex the cells around it.

    A star balances the forces that are missing at its vertex, cell by cell in force and moment, by
    tractions on the facets at the vertex (docs/theory/guaranteed.md). The stiffness of a facet is
    the sum of those of its two sides, the same in the stars of its d vertices.

    Values are of the cells that this rank owns, those of facets (n, d + 1, ...) on both sides;
    tractions on both sides are opposite. The equations of a star, with a row for each of its cells,
    are solved by the rank that owns the vertex.
    """

    def __init__(self, owned: OwnedCells, stiffness: Array, free: Mask) -> None:
        """Factor the equations of all stars. Collective.

        Args:
            owned: the cells.
            stiffness: (n, d + 1, d * d, d * d) energies of tractions on each facet.
            free: (n, d + 1, d) whether the traction on a facet is unknown along an axis.
        """
        cells, mesh, d = owned.cells, owned.V.mesh, owned.cells.d
        self._owned, self._comm = owned, mesh.comm
        self._index_map = mesh.topology.index_map(d - 1)
        count = self._index_map.size_local + self._index_map.num_ghosts
        places = owned.facets.ravel(), np.arange(owned.facets.size)
        shape = count, owned.facets.size
        self._facet_sides = csr_array((np.ones(owned.facets.size), places), shape)
        self._sides = self._sums(np.ones((*owned.facets.shape, 1)))
        sums = self._sums(stiffness)
        unknown = np.tile(free, d).astype(np.float64)
        unknown = unknown[..., None] * unknown[..., None, :]
        diagonal = np.trace(sums, axis1=2, axis2=3)[..., None, None] * np.eye(d * d)
        self._softness = unknown * np.linalg.inv(unknown * sums + (1.0 - unknown) * diagonal)
        # work of tractions on the rigid motions about each vertex of a facet: equal on both sides
        points = cells.points[:, opposite(d)]
        arms = points[:, :, None] - points[:, :, :, None]
        work = mean_products(d, 2) @ rigid_motions(arms)
        work *= cells.areas[..., None, None, None, None]
        self._work = work.reshape(*arms.shape[:3], -1, d * d)

        starts = mesh.comm.allgather(mesh.topology.index_map(0).local_range[0])
        self._owner = np.searchsorted(starts, owned.vertices.ravel(), side="right") - 1
        self._factor = self._factored()

    def _sums(self, values: Array) -> Array:
        """Return the sums over both sides of facets of values (n, d + 1, ...). Collective."""
        facets = self._owned.facets
        sums = self._facet_sides @ values.reshape(facets.size, -1)
        if self._comm.size > 1:
            sums = summed_at_nodes(self._index_map, np.arange(len(sums)), sums)
        return np.asarray(sums[facets].reshape(values.shape))

    def _factored(self) -> PETSc.PC:
        """Return the factors of the equations of the stars of this rank's vertices. Collective.

        They are those of graphs: cells are the nodes, facets the edges, with blocks as weights.
        """
        sides, (n, corners) = opposite(self._owned.cells.d), self._owned.facets.shape
        weights = self._work @ self._softness[:, :, None] @ np.swapaxes(self._work, 3, 4)
        size = weights.shape[-1]
        blocks = np.zeros((n, corners, size, size))
        for facet, vertices in enumerate(sides):
            blocks[:, vertices] += weights[:, facet]
        entries = np.einsum("ncii->nci", blocks)
        loose = np.where(entries > 0.0, LOOSE * entries, 1.0)
        blocks += loose[..., None] * np.eye(size)

        # the rows at the owners of the vertices, of cells and of their neighbours across facets
        received, self._senders = exchange(self._comm, self._owner, self._owner)
        count = len(received)
        numbers = self._returned(np.arange(count)).reshape(n, corners)
        near = numbers[:, sides]
        across = np.rint(self._sums(near.astype(np.float64))).astype(np.intp) - near
        inside = np.broadcast_to(self._sides == 2.0, near.shape)
        rows = np.concatenate([numbers.ravel(), near[inside]])
        columns = np.concatenate([numbers.ravel(), across[inside]])
        values = np.concatenate([blocks.reshape(-1, size, size), -weights[inside]])
        at_facets = self._owner.reshape(n, corners)[:, sides]
        owners = np.concatenate([self._owner, at_facets[inside]])
        rows, columns, values = (
            exchange(self._comm, array, owners)[0] for array in (rows, columns, values)
        )
        order = csr_array((np.arange(len(rows)), (rows, columns)), (count, count))
        order.sort_indices()
        pattern = (array.astype(PETSc.IntType) for array in (order.indptr, order.indices))
        csr = (*pattern, values[order.data].ravel())
        shape = count * size, count * size
        matrix = PETSc.Mat().createBAIJ(shape, size, csr=csr, comm=PETSc.COMM_SELF)
        factor = PETSc.PC().create(PETSc.COMM_SELF)
        factor.setType("lu")  # in blocks faster than "cholesky"
        factor.setFactorSolverType("petsc")
        factor.setFactorOrdering("rcm")
        factor.setOperators(matrix)
        with errors_on_all_ranks(self._comm):
            factor.setUp()
        return factor

    def _returned(self, rows: Any) -> Any:
        """Return rows of stars to the cells (n (d + 1), ...) that they are of. Collective."""
        back, _ = exchange(self._comm, rows, self._senders)
        if self._comm.size == 1:
            return back
        result = np.empty_like(back)
        result[np.argsort(self._owner, kind="stable")] = back
        return result

    def _balancing(self, missing: Array) -> Array:
        """Return the least tractions with the forces and moments (n, d + 1, r), of all stars."""
        size = missing.shape[-1]
        rows, _ = exchange(self._comm, missing.reshape(-1, size), self._owner)
        supports = np.zeros_like(rows)
        right, result = (
            PETSc.Vec().createWithArray(array.ravel(), comm=PETSc.COMM_SELF)
            for array in (np.ascontiguousarray(rows), supports)
        )
        self._factor.apply(right, result)
        near = self._returned(supports).reshape(missing.shape)
        near = near[:, opposite(self._owned.cells.d)]
        forces = ((2.0 * near - self._sums(near))[..., None, :] @ self._work).sum(axis=2)
        return np.asarray((forces @ self._softness)[:, :, 0])

    def preconditioned(self, gradient: Array) -> Array:
        """Return tractions without resultants that decrease a quadratic function. Collective.

        They are the sums of the best corrections of all stars, where the second derivative is
        replaced by the stiffnesses of facets.

        Args:
            gradient: (n, d + 1, d, d) minus its derivative by the tractions on the cells.
        """
        n, corners, d, _ = gradient.shape
        forces = (2.0 * gradient - self._sums(gradient)).reshape(n, corners, d * d, 1)
        tractions = self._softness @ forces
        resultants = (self._work @ tractions[:, :, None])[..., 0]
        total = np.zeros((n, corners, resultants.shape[-1]))
        for facet, vertices in enumerate(opposite(d)):
            total[:, vertices] += resultants[:, facet]
        tractions = d * tractions[..., 0] - self._balancing(total)
        return np.asarray(tractions.reshape(gradient.shape))

    def equilibrated(self, traction: Array, force: Array) -> Array:
        """Return tractions (n, d + 1, d, d) in equilibrium. Collective.

        They are the given ones, elsewhere the means of those of both sides, with the least
        corrections of all stars.

        Args:
            traction: (n, d + 1, d, d) tractions on facets at their vertices: those that are given,
                and approximate ones.
            force: (n, d + 1, d) forces at the vertices of cells, which the tractions are to
                balance. Their sums around vertices are those of the given tractions.
        """
        d = self._owned.cells.d
        means = (2.0 * traction - self._sums(traction)) / self._sides[..., None]
        missing = force - self._owned.cells.facet_forces(means)
        # a force at the vertex itself has no moment about it
        missing = np.pad(missing, ((0, 0), (0, 0), (0, d * (d - 1) // 2)))
        return means + self._balancing(missing).reshape(means.shape)
