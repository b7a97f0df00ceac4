"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from scipy.sparse import coo_array, csr_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask
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
            stiffness: (n, d + 1) energies of unit tractions on each facet.
            free: (n, d + 1, d) whether the traction on a facet is unknown along an axis.
        """
        mesh = owned.V.mesh
        self._size, d = len(free), owned.cells.d
        numbers = mesh.topology.index_map(d - 1).local_to_global(owned.facets.ravel())
        self._copies, owner = Copies.around_vertices(owned)
        data = owned.cells.points, owned.vertices, numbers.reshape(owned.facets.shape), owner
        points, vertices, numbers, owner = map(self._copies.spread, data)
        stiffness, free = map(self._copies.spread, (stiffness, free))
        self._cells, self._owned = Simplices(points), owner == mesh.comm.rank
        _, uses, facets, self._counts = np.unique(
            numbers, return_index=True, return_inverse=True, return_counts=True
        )
        self._facets: Indices = facets.reshape(numbers.shape)
        self._signs = np.full((*numbers.shape, 1, 1), -1.0)
        self._signs.flat[uses] = 1.0
        loose = self._on_facets(free.astype(np.float64)) > 0.0
        softness = loose / self._on_facets(stiffness)[:, None]

        self._cell, self._corner = cell, corner = np.nonzero(self._owned)
        sides = opposite(d)[corner]  # (rows, d) the facets at the vertex
        keys = self._facets[cell[:, None], sides]
        keys = vertices[cell, corner][:, None] * len(self._counts) + keys
        keys, uses, unknown = np.unique(keys, return_index=True, return_inverse=True)
        self._unknowns = keys % len(self._counts)  # the facet of each
        self._softness = np.tile(softness[self._unknowns], d)
        # work of tractions on the rigid motions about the vertex: the same for both cells
        row, side = np.divmod(uses, d)
        cells, facet = cell[row], sides[row, side]
        arms = points[cells[:, None], opposite(d)[facet]] - points[cells, corner[row], None]
        work = mean_products(d, 2) @ rigid_motions(arms)
        work *= self._cells.areas[cells, facet, None, None, None]
        self._work = work.reshape(len(keys), -1, d * d)
        signs = self._signs[cell[:, None], sides].ravel()
        starts = np.arange(0, len(signs) + 1, d)
        shape = len(cell), len(keys)
        self._incidence = csr_array((signs, unknown.ravel(), starts), shape=shape)
        with errors_on_all_ranks(mesh.comm):
            self._factor = self._factored()

    def _factored(self) -> PETSc.PC:
        """Return the factors of the equations of all stars: a graph's, with blocks as weights."""
        weights = (self._work * self._softness[:, None]) @ np.swapaxes(self._work, 1, 2)
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
        return np.asarray(self._softness * (differences[:, None] @ self._work)[:, 0])

    def _on_facets(self, values: Array) -> Array:
        """Return sums (facets, ...) of values of both cells."""
        result = np.zeros((len(self._counts), *values.shape[2:]))
        np.add.at(result, self._facets, values)
        return result

    def _on_cells(self, unknowns: Array) -> Array:
        """Return the sums over stars (n, d + 1, d, d) of tractions on copies of cells."""
        d = self._cells.d
        result = np.zeros((len(self._counts), d, d))
        np.add.at(result, self._unknowns, unknowns.reshape(-1, d, d))
        return np.asarray(self._signs * result[self._facets])

    def preconditioned(self, gradient: Array) -> Array:
        """Return tractions without resultants that decrease a quadratic function. Collective.

        They are the sums of the best corrections of all stars, where the second derivative is
        replaced by the stiffnesses of facets.

        Args:
            gradient: (n, d + 1, d, d) minus its derivative by the tractions on the cells.
        """
        gradient = self._signs * self._copies.spread(gradient)
        forces = self._on_facets(gradient)[self._unknowns].reshape(self._softness.shape)
        tractions = self._softness * forces
        resultants = (self._work @ tractions[:, :, None])[:, :, 0]
        tractions -= self._balancing(self._incidence @ resultants)
        return self._copies.summed(self._on_cells(tractions), self._size)

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
        means = self._on_facets(self._signs * traction) / self._counts[:, None, None]
        traction = self._signs * means[self._facets]
        missing = (force - self._cells.facet_forces(traction))[self._cell, self._corner]
        # a force at the vertex itself has no moment about it
        d = self._cells.d
        missing = np.pad(missing, ((0, 0), (0, d * (d - 1) // 2)))
        corrections = self._balancing(missing)
        # the traction at a vertex counts on the rank that owns the vertex
        traction *= self._owned[:, opposite(d), None]
        result = traction + self._on_cells(corrections)
        return self._copies.summed(result, self._size)
