"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from scipy.sparse import coo_array, csr_array

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.guaranteed.cells import Simplices, mean_products, opposite, rigid_motions
from dolfinx_tresca.guaranteed.mesh_cells import Copies, OwnedCells

#: Stiffness, relative to that of a cell, that is added so that no star is loose. Equations of stars
#: are solved up to this number.
LOOSE = 1e-11


class Stars:
    """The stars of vertices: for each vertex the cells around it.

    A star balances the forces that are missing at its vertex, cell by cell in force and moment, by
    tractions on the facets at the vertex (docs/theory/guaranteed.md).

    Arguments and results are of the cells that this rank owns. Inside are the copies of all cells
    around the vertices that this rank owns, and tractions as arrays (unknowns, d, d): vertex,
    component, for each facet of each star. The first cell of a facet has them with the sign 1, the
    second with -1.
    """

    def __init__(self, owned: OwnedCells, stiffness: Array, free: Mask) -> None:
        """Number the facets of the stars, and factor the equations of all stars. Collective.

        Args:
            owned: the cells.
            stiffness: (n, d + 1, d * d, d * d) energies of tractions on each facet.
            free: (n, d + 1, d) whether the traction on a facet is unknown along an axis.
        """
        mesh, d = owned.V.mesh, owned.cells.d
        self._size = len(free)
        numbers = mesh.topology.index_map(d - 1).local_to_global(owned.facets.ravel())
        self._copies, owner = Copies.around_vertices(owned)
        data = owned.cells.points, owned.vertices, numbers.reshape(owned.facets.shape), owner
        points, vertices, numbers, owner = map(self._copies.spread, data)
        stiffness, free = map(self._copies.spread, (stiffness, free))
        self._cells, self._owned = Simplices(points), owner == mesh.comm.rank
        _, uses, facets = np.unique(numbers, return_index=True, return_inverse=True)
        facets = facets.reshape(numbers.shape)
        signs = np.full(numbers.shape, -1.0)
        signs.flat[uses] = 1.0
        shape = numbers.size, len(uses)
        self._sides = csr_array((signs.ravel(), facets.ravel(), np.arange(shape[0] + 1)), shape)

        self._cell, self._corner = cell, corner = np.nonzero(self._owned)
        sides = opposite(d)[corner]  # (rows, d) the facets at the vertex
        keys = vertices[cell, corner][:, None] * shape[1] + facets[cell[:, None], sides]
        keys, uses, unknown = np.unique(keys, return_index=True, return_inverse=True)
        self._on_cells = csr_array(self._sides.tocsc()[:, keys % shape[1]])
        self._softness = self._softnesses(stiffness, free)[keys % shape[1]]
        # work of tractions on the rigid motions about the vertex: the same for both cells
        row, side = np.divmod(uses, d)
        cells, facet = cell[row], sides[row, side]
        arms = points[cells[:, None], opposite(d)[facet]] - points[cells, corner[row], None]
        work = mean_products(d, 2) @ rigid_motions(arms)
        work *= self._cells.areas[cells, facet, None, None, None]
        self._work = work.reshape(len(keys), -1, d * d)
        starts = np.arange(0, unknown.size + 1, d)
        values = signs[cell[:, None], sides].ravel(), unknown.ravel(), starts
        self._incidence = csr_array(values, (len(cell), len(keys)))
        with errors_on_all_ranks(mesh.comm):
            self._factor = self._factored()

    def _softnesses(self, stiffness: Array, free: Mask) -> Array:
        """Return the inverse stiffnesses (facets, d * d, d * d) of tractions that are free."""
        sums = abs(self._sides).T @ stiffness.reshape(self._sides.shape[0], -1)
        sums = sums.reshape(-1, *stiffness.shape[2:])
        loose = abs(self._sides).T @ free.reshape(self._sides.shape[0], -1) > 0.0
        unknown = np.tile(loose, free.shape[2]).astype(np.float64)
        unknown = unknown[:, :, None] * unknown[:, None]
        diagonal = np.trace(sums, axis1=1, axis2=2)[:, None, None] * np.eye(sums.shape[1])
        return np.asarray(unknown * np.linalg.inv(unknown * sums + (1.0 - unknown) * diagonal))

    def _factored(self) -> PETSc.PC:
        """Return the factors of the equations of all stars: a graph's, with blocks as weights."""
        weights = self._work @ self._softness @ np.swapaxes(self._work, 1, 2)
        count, size = self._incidence.shape[0], weights.shape[1]
        diagonal = abs(self._incidence) @ weights.reshape(len(weights), -1)
        entries = diagonal[:, :: size + 1]
        entries += np.where(entries > 0.0, LOOSE * entries, 1.0)
        columns = self._incidence.tocsc()
        uses = np.diff(columns.indptr)
        pairs = columns.indices[np.repeat(uses == 2, uses)].reshape(-1, 2)
        between = -weights[uses == 2]
        blocks = np.concatenate([diagonal.reshape(-1, size, size), between, between])
        row, column = np.concatenate([np.indices((count,)).T.repeat(2, 1), pairs, pairs[:, ::-1]]).T
        order = coo_array((np.arange(len(blocks)), (row, column)), shape=(count, count)).tocsr()
        pattern = (array.astype(PETSc.IntType) for array in (order.indptr, order.indices))
        rows = (*pattern, blocks[order.data].ravel())
        shape = count * size, count * size
        matrix = PETSc.Mat().createBAIJ(shape, size, csr=rows, comm=PETSc.COMM_SELF)
        factor = PETSc.PC().create(PETSc.COMM_SELF)
        factor.setType("lu")  # in blocks faster than "cholesky"
        factor.setFactorSolverType("petsc")
        factor.setFactorOrdering("rcm")
        factor.setOperators(matrix)
        factor.setUp()
        return factor

    def _balancing(self, missing: Array) -> Array:
        """Return the least tractions (unknowns, d * d) with the forces and moments (rows, r)."""
        supports = np.zeros_like(missing)
        right, result = (
            PETSc.Vec().createWithArray(array.ravel(), comm=PETSc.COMM_SELF)
            for array in (np.ascontiguousarray(missing), supports)
        )
        self._factor.apply(right, result)
        differences = self._incidence.T @ supports
        return np.asarray((differences[:, None] @ self._work @ self._softness)[:, 0])

    def _summed(self, tractions: Array) -> Array:
        """Return the sums (n, d + 1, d, d) of tractions on the sides of copies. Collective."""
        d = self._cells.d
        return self._copies.summed(tractions.reshape(-1, d + 1, d, d), self._size)

    def preconditioned(self, gradient: Array) -> Array:
        """Return tractions without resultants that decrease a quadratic function. Collective.

        They are the sums of the best corrections of all stars, where the second derivative is
        replaced by the stiffnesses of facets.

        Args:
            gradient: (n, d + 1, d, d) minus its derivative by the tractions on the cells.
        """
        gradient = self._copies.spread(gradient).reshape(self._sides.shape[0], -1)
        forces = self._on_cells.T @ gradient
        tractions = (self._softness @ forces[:, :, None])[:, :, 0]
        resultants = (self._work @ tractions[:, :, None])[:, :, 0]
        tractions -= self._balancing(self._incidence @ resultants)
        return self._summed(self._on_cells @ tractions)

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
        traction, force = map(self._copies.spread, (traction, force))
        shape, d = traction.shape, self._cells.d
        counts = abs(self._sides).sum(axis=0)
        means = self._sides.T @ traction.reshape(self._sides.shape[0], -1) / counts[:, None]
        traction = (self._sides @ means).reshape(shape)
        missing = (force - self._cells.facet_forces(traction))[self._cell, self._corner]
        # a force at the vertex itself has no moment about it
        missing = np.pad(missing, ((0, 0), (0, d * (d - 1) // 2)))
        # the traction at a vertex counts on the rank that owns the vertex
        traction *= self._owned[:, opposite(d), None]
        corrections = self._on_cells @ self._balancing(missing)
        return self._summed(traction.reshape(corrections.shape) + corrections)
