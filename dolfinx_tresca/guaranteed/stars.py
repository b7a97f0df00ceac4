"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import bsr_array, csr_array

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, exchange
from dolfinx_tresca.guaranteed.cells import (
    OwnedCells,
    Simplices,
    mean_products,
    opposite,
    rigid_motions,
)

#: Stiffness, relative to that of a cell, that is added so that no star is loose. Equations of stars
#: are solved up to this number.
LOOSE = 1e-11


class Stars:
    """The stars of vertices: for each vertex the cells around it.

    A star balances the forces that are missing at its vertex, cell by cell in force and moment, by
    tractions on the facets at the vertex (docs/theory/guaranteed.md).

    Arguments and results are of the cells that this rank owns. Inside are the copies of all cells
    around the vertices that this rank owns, and tractions as arrays (facets, d * d): vertex,
    component. The first cell of a facet has them with the sign 1, the second with -1. A facet is in
    the stars of its d vertices, in which it has the same stiffness.
    """

    def __init__(self, owned: OwnedCells, stiffness: Array, free: Mask) -> None:
        """Number the facets of the stars, and factor the equations of all stars. Collective.

        Args:
            owned: the cells.
            stiffness: (n, d + 1, d * d, d * d) energies of tractions on each facet.
            free: (n, d + 1, d) whether the traction on a facet is unknown along an axis.
        """
        mesh, d, self._size = owned.V.mesh, owned.cells.d, len(free)
        self._comm = mesh.comm
        starts = mesh.comm.allgather(mesh.topology.index_map(0).local_range[0])
        owner = np.searchsorted(starts, owned.vertices, side="right") - 1
        # a copy of each cell for each rank that owns vertices of it
        ranks = np.sort(owner, axis=1)
        row, column = np.nonzero(np.diff(ranks, axis=1, prepend=-1))
        ranks = ranks[row, column]
        order = np.argsort(ranks, kind="stable")  # the order in which `exchange` sends
        self._copied_cells, self._ranks = row[order], ranks[order]
        _, self._ranks_of_copies = exchange(mesh.comm, self._copied_cells, self._ranks)
        numbers = mesh.topology.index_map(d - 1).local_to_global(owned.facets.ravel())
        data = owned.cells.points, owner, numbers.reshape(owned.facets.shape), stiffness, free
        points, owner, numbers, stiffness, free = map(self._copies, data)
        self._cells = Simplices(points)

        _, uses, facets = np.unique(numbers, return_index=True, return_inverse=True)
        facets = facets.reshape(numbers.shape)
        signs = np.full(numbers.shape, -1.0)
        signs.flat[uses] = 1.0
        shape = numbers.size, len(uses)
        self._signs = csr_array((signs.ravel(), facets.ravel(), np.arange(shape[0] + 1)), shape)
        self._softness = self._softnesses(stiffness, free)
        cell, facet = np.divmod(uses, d + 1)
        vertices = cell[:, None], opposite(d)[facet]
        self._on_this_rank = (owner == mesh.comm.rank)[vertices]  # the stars of a facet's vertices
        # work of tractions on the rigid motions about each vertex: the same for both cells
        arms = points[vertices][:, None] - points[vertices][:, :, None]
        work = mean_products(d, 2) @ rigid_motions(arms)
        work *= self._cells.areas[cell, facet, None, None, None, None]
        self._work = work.reshape(*arms.shape[:2], -1, d * d)

        self._cell, self._corner = np.nonzero(owner == mesh.comm.rank)
        sides, corner = opposite(d)[self._corner], self._corner[:, None]
        places = self._cell[:, None], sides
        unknown = d * facets[places] + corner - (corner > sides)
        starts = np.arange(0, unknown.size + 1, d)
        values = signs[places].ravel(), unknown.ravel(), starts
        self._incidence = csr_array(values, (len(corner), d * shape[1]))
        with errors_on_all_ranks(mesh.comm):
            self._factor = self._factored()

    def _softnesses(self, stiffness: Array, free: Mask) -> Array:
        """Return the inverse stiffnesses (facets, d * d, d * d) of tractions that are free."""
        sums = abs(self._signs).T @ stiffness.reshape(self._signs.shape[0], -1)
        sums = sums.reshape(-1, *stiffness.shape[2:])
        loose = abs(self._signs).T @ free.reshape(self._signs.shape[0], -1) > 0.0
        unknown = np.tile(loose, free.shape[2]).astype(np.float64)
        unknown = unknown[:, :, None] * unknown[:, None]
        diagonal = np.trace(sums, axis1=1, axis2=2)[:, None, None] * np.eye(sums.shape[1])
        return np.asarray(unknown * np.linalg.inv(unknown * sums + (1.0 - unknown) * diagonal))

    def _factored(self) -> PETSc.PC:
        """Return the factors of the equations of all stars: a graph's, with blocks as weights."""
        weights = self._work @ self._softness[:, None] @ np.swapaxes(self._work, 2, 3)
        size = weights.shape[-1]
        weights = weights.reshape(-1, size, size)
        entries = abs(self._incidence) @ np.einsum("nii->ni", weights)
        loose = np.where(entries > 0.0, LOOSE * entries, 1.0)[:, :, None] * np.eye(size)
        rows = np.arange(len(loose) + 1)
        signs = self._incidence.data[:, None, None]
        facets, starts = self._incidence.indices, self._incidence.indptr
        weighted = bsr_array((signs * weights[facets], facets, starts))
        incidence = bsr_array((signs * np.eye(size), facets, starts))
        blocks = weighted @ incidence.T + bsr_array((loose, rows[:-1], rows))
        blocks.sort_indices()
        pattern = (array.astype(PETSc.IntType) for array in (blocks.indptr, blocks.indices))
        csr = (*pattern, blocks.data.ravel())
        matrix = PETSc.Mat().createBAIJ(blocks.shape, size, csr=csr, comm=PETSc.COMM_SELF)
        factor = PETSc.PC().create(PETSc.COMM_SELF)
        factor.setType("lu")  # in blocks faster than "cholesky"
        factor.setFactorSolverType("petsc")
        factor.setFactorOrdering("rcm")
        factor.setOperators(matrix)
        factor.setUp()
        return factor

    def _copies(self, values: Any) -> Any:
        """Return the rows of all copies of cells on this rank. Collective."""
        copied = np.ascontiguousarray(values[self._copied_cells])
        return exchange(self._comm, copied, self._ranks)[0]

    def _on_cells(self, tractions: Array) -> Array:
        """Return tractions (n, d + 1, d, d) on the owned cells. Collective.

        They are the sums of the contributions (facets, d * d) of all ranks, with each cell's sign.
        """
        d = self._cells.d
        on_copies = (self._signs @ tractions).reshape(-1, d + 1, d, d)
        returned, _ = exchange(self._comm, on_copies, self._ranks_of_copies)
        result = np.zeros((self._size, *returned.shape[1:]))
        np.add.at(result, self._copied_cells, returned)
        return result

    def _balancing(self, missing: Array) -> Array:
        """Return the least tractions with the forces and moments (rows, r), of all stars."""
        supports = np.zeros_like(missing)
        right, result = (
            PETSc.Vec().createWithArray(array.ravel(), comm=PETSc.COMM_SELF)
            for array in (np.ascontiguousarray(missing), supports)
        )
        self._factor.apply(right, result)
        differences = (self._incidence.T @ supports).reshape(*self._work.shape[:3])
        forces = (differences[:, :, None] @ self._work).sum(axis=1)
        return np.asarray((forces @ self._softness)[:, 0])

    def preconditioned(self, gradient: Array) -> Array:
        """Return tractions without resultants that decrease a quadratic function. Collective.

        They are the sums of the best corrections of all stars, where the second derivative is
        replaced by the stiffnesses of facets.

        Args:
            gradient: (n, d + 1, d, d) minus its derivative by the tractions on the cells.
        """
        forces = self._signs.T @ self._copies(gradient).reshape(self._signs.shape[0], -1)
        tractions = (self._softness @ forces[:, :, None])[:, :, 0]
        resultants = (self._work @ tractions[:, None, :, None]).reshape(-1, self._work.shape[2])
        stars = self._on_this_rank.sum(axis=1, keepdims=True)
        return self._on_cells(stars * tractions - self._balancing(self._incidence @ resultants))

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
        d = self._cells.d
        means = self._signs.T @ self._copies(traction).reshape(self._signs.shape[0], -1)
        means /= abs(self._signs).sum(axis=0)[:, None]
        on_copies = (self._signs @ means).reshape(-1, d + 1, d, d)
        missing = self._copies(force) - self._cells.facet_forces(on_copies)
        # a force at the vertex itself has no moment about it
        missing = np.pad(missing[self._cell, self._corner], ((0, 0), (0, d * (d - 1) // 2)))
        # the traction at a vertex counts on the rank that owns the vertex
        means *= np.repeat(self._on_this_rank, d, axis=1)
        return self._on_cells(means + self._balancing(missing))
