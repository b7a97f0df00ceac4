"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, exchange
from dolfinx_tresca.guaranteed.cells import MeshCells, mean_products, opposite, rigid_motions

#: Stiffness, relative to that of a cell, that is added so that no star is loose. Equations of stars
#: are solved up to this number.
LOOSE = 1e-11


class Stars:
    """The stars of vertices: for each vertex the cells around it.

    A star balances the forces that are missing at its vertex, cell by cell in force and moment, by
    tractions on the facets at the vertex (docs/theory/guaranteed.md). The stiffness of a facet is
    the sum of those of its two sides, the same in the stars of its d vertices.

    Tractions are on this rank's facets, ghosts included; loadings are of the cells it owns. The
    rank that owns a vertex solves the equations of its star, with a row for each cell.
    """

    def __init__(self, cells: MeshCells, stiffness: Array, free: Mask) -> None:
        """Factor the equations of all stars. Collective.

        Tractions on facets have energies (n, d + 1, d * d, d * d), and are `free` (n, d + 1, d)
        along axes.
        """
        d, sides, comm = cells.d, opposite(cells.d), cells.V.mesh.comm
        self._cells, (n, corners) = cells, cells.facets.shape
        self._sides = cells.facet_sums(np.ones((*cells.facets.shape, 1, 1)))
        sums = cells.facet_sums(stiffness)
        unknown = np.tile(cells.facet_sums(free[:, :, None].astype(np.float64)) > 0.0, d)
        diagonal = np.trace(sums, axis1=1, axis2=2)[:, None, None] * np.eye(d * d)
        both = np.swapaxes(unknown, 1, 2) & unknown
        self._softness = both * np.linalg.inv(np.where(both, sums, diagonal))
        # work of tractions on the rigid motions about each vertex of a facet: equal on both sides
        points, areas = np.zeros((len(sums), 1, d, d)), np.zeros((len(sums), 1, 1, 1, 1))
        points[cells.facets, 0] = cells.points[:, sides]
        areas[cells.facets, 0, 0, 0, 0] = cells.areas
        motions = rigid_motions(points - np.swapaxes(points, 1, 2))
        work = areas * (mean_products(d, 2) @ motions)
        self._work = work.reshape(len(sums), d, -1, d * d)

        # equations of graphs: cells are the nodes, facets the edges, with blocks as weights
        weights = self._work @ self._softness[:, None] @ np.swapaxes(self._work, 2, 3)
        size = weights.shape[-1]
        # numbers of rows at the owners of the vertices: of cells, and of those across facets
        starts = comm.allgather(cells.V.mesh.topology.index_map(0).local_range[0])
        owner = np.searchsorted(starts, cells.vertices.ravel(), side="right") - 1
        received, senders = exchange(comm, owner, owner)
        start = comm.scan(len(received)) - len(received)
        numbers = np.empty(owner.shape)
        numbers[np.argsort(owner, kind="stable")], _ = exchange(
            comm, start + np.arange(float(len(received))), senders
        )
        numbers = numbers.reshape(n, corners)
        # a block for each facet at the vertex of a row, and one in place of the opposite facet
        columns = np.repeat(numbers[:, :, None], corners, axis=2)
        blocks = np.zeros((n, corners, corners, size, size))
        near, inside = numbers[:, sides, None], self._sides[cells.facets] == 2.0
        across = np.where(inside, cells.facet_sums(near)[cells.facets] - near, near)
        weights, facet = weights[cells.facets], np.arange(corners)[:, None]
        columns[:, sides, facet] = across[..., 0]
        blocks[:, sides, facet] = np.where(inside[..., None], -weights, 0.0)
        for j, vertices in enumerate(sides):
            blocks[:, vertices, vertices] += weights[:, j]
        diagonal = np.einsum("nvvii->nvi", blocks)  # a view
        diagonal += np.where(diagonal > 0.0, LOOSE * diagonal, 1.0)

        layout = size * len(received), PETSc.DETERMINE
        matrix = PETSc.Mat().createBAIJ((layout, layout), size, nnz=(corners, 0), comm=comm)
        starts = np.arange(0, columns.size + 1, corners)
        pattern = [array.ravel().astype(PETSc.IntType) for array in (starts, columns, numbers)]
        matrix.setValuesBlockedIJV(
            *pattern[:2], blocks.ravel(), addv=PETSc.InsertMode.ADD, rowmap=pattern[2]
        )
        matrix.assemble()
        rows = PETSc.IS().createBlock(size, pattern[2], comm=PETSc.COMM_SELF)
        self._at_cells = PETSc.Vec().createSeq(blocks.shape[0] * corners * size)
        self._missing, self._supports = matrix.createVecs()
        self._scatter = PETSc.Scatter().create(self._missing, rows, self._at_cells, None)
        self._factors = PETSc.PC().create(PETSc.COMM_SELF)
        self._factors.setType("lu")  # in blocks faster than "cholesky"
        self._factors.setFactorSolverType("petsc")
        self._factors.setFactorOrdering("rcm")
        self._factors.setOperators(matrix.getDiagonalBlock())
        with errors_on_all_ranks(comm):
            self._factors.setUp()

    def _balancing(self, missing: Array) -> Array:
        """Return the least tractions with the forces and moments (n, d + 1, r), of all stars."""
        cells, insert = self._cells, PETSc.InsertMode.INSERT
        self._at_cells.array = missing.ravel()
        self._scatter.scatter(self._at_cells, self._missing, insert, PETSc.ScatterMode.REVERSE)
        right, result = (
            PETSc.Vec().createWithArray(vector.array, comm=PETSc.COMM_SELF)
            for vector in (self._missing, self._supports)
        )
        self._factors.apply(right, result)
        self._scatter.scatter(self._supports, self._at_cells, insert)
        supports = self._at_cells.array.reshape(missing.shape)[:, opposite(cells.d)]
        differences = cells.facet_sums(cells.signs * supports)
        forces = (differences[:, :, None] @ self._work).sum(axis=1)
        return np.asarray((forces @ self._softness)[:, 0])

    def preconditioned(self, gradient: Array) -> Array:
        """Return a loading without resultants that decreases a quadratic function. Collective.

        It is the sum of the best corrections of all stars, with the stiffnesses of facets in place
        of the second derivative; `gradient` (n, d + 1, d + 1, d) is minus the derivative by the
        loading.
        """
        cells, d = self._cells, self._cells.d
        forces = cells.facet_sums(cells.signs * gradient[:, :, :d]).reshape(-1, d * d, 1)
        tractions = self._softness @ forces
        resultants = (self._work @ tractions[:, None])[..., 0]
        total = np.zeros((*cells.facets.shape, resultants.shape[-1]))
        for j, vertices in enumerate(opposite(d)):
            total[:, vertices] += cells.signs[:, j] * resultants[cells.facets[:, j]]
        return cells.on_sides(d * tractions[..., 0] - self._balancing(total))

    def equilibrated(self, loading: Array, force: Array) -> Array:
        """Return a loading that balances forces (n, d + 1, d) at vertices of cells. Collective.

        Its tractions are the given ones, elsewhere the means of those of both sides, with the least
        corrections of all stars. Sums of the forces around vertices are those of the loads and
        given tractions.
        """
        cells, d = self._cells, self._cells.d
        means = cells.facet_sums(cells.signs * loading[:, :, :d]) / self._sides
        result = cells.on_sides(means.reshape(-1, d * d))
        result[:, :, d] = loading[:, :, d]
        missing = force - cells.resultants(result)
        # a force at the vertex itself has no moment about it
        missing = np.pad(missing, ((0, 0), (0, 0), (0, d * (d - 1) // 2)))
        return result + cells.on_sides(self._balancing(missing))
