"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

import numpy as np
from scipy.sparse import bsr_array, diags_array
from scipy.sparse.linalg import splu

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

        self._cell, self._corner = np.nonzero(self._owned)
        sides = opposite(d)[self._corner]  # (m, d) the facets at the vertex
        facets = self._facets[self._cell[:, None], sides]
        arms = points[self._cell]
        arms = arms - arms[np.arange(len(arms)), self._corner][:, None]
        motions = rigid_motions(arms / self._cells.heights[self._cell].max(axis=1)[:, None, None])
        # work of tractions on a motion: a row of blocks for each cell of a star
        ends = opposite(d)[sides]  # (m, d, d) vertices of these facets
        work = np.swapaxes(motions, 1, 2)[np.arange(len(ends))[:, None, None], ends]
        work = np.swapaxes(mean_products(d, 2) @ work.reshape(*ends.shape, -1), 2, 3)
        scale = (self._signs[:, :, 0, 0] * self._cells.areas)[self._cell[:, None], sides]
        work = (scale[:, :, None, None] * work).reshape(facets.size, -1, d, d)
        blocks = np.swapaxes(work, 2, 3).reshape(facets.size, -1, d * d)
        star = vertices[self._cell, self._corner][:, None]
        keys, column = np.unique(star * len(self._counts) + facets, return_inverse=True)
        self._unknowns = keys % len(self._counts)  # the facet of each
        starts = np.arange(0, len(blocks) + 1, d)
        shape = starts[-1] // d * blocks.shape[1], len(keys) * d * d
        self._work = bsr_array((blocks, column.ravel(), starts), shape=shape)
        softness = (self._on_facets(free.astype(np.float64)) > 0.0) / self._on_facets(stiffness)[
            :, None
        ]
        self._softness = np.repeat(softness[self._unknowns][:, None], d, axis=1).ravel()
        matrix = self._work @ diags_array(self._softness) @ self._work.T
        diagonal = matrix.diagonal()
        matrix += diags_array(np.where(diagonal > 0.0, LOOSE * diagonal, 1.0))
        with errors_on_all_ranks(mesh.comm):
            symmetric = {"SymmetricMode": True}
            self._factor = splu(matrix.tocsc(), "MMD_AT_PLUS_A", 0.0, options=symmetric)

    def _on_facets(self, values: Array) -> Array:
        """Return sums (facets, ...) of values of both cells."""
        result = np.zeros((len(self._counts), *values.shape[2:]))
        np.add.at(result, self._facets, values)
        return result

    def _on_cells(self, unknowns: Array) -> Array:
        """Return the sums over stars (n, d + 1, d, d) of tractions, flat, on copies of cells."""
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
        forces = self._on_facets(gradient)[self._unknowns].ravel()
        supports = self._factor.solve(self._work @ (self._softness * forces))
        forces -= self._work.T @ supports
        return self._copies.summed(self._on_cells(self._softness * forces), self._size)

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
        corrections = self._work.T @ self._factor.solve(missing.ravel())
        # the traction at a vertex counts on the rank that owns the vertex
        traction *= self._owned[:, opposite(d), None]
        result = traction + self._on_cells(self._softness * corrections)
        return self._copies.summed(result, self._size)
