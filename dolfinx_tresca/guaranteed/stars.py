"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, exchange, summed_at_nodes
from dolfinx_tresca.guaranteed.cells import hat_means, opposite, rigid_motions
from dolfinx_tresca.guaranteed.mesh_cells import OwnedCells

#: Stiffness, relative to that of a cell, that is added so that no star is loose. Equations of stars
#: are solved up to this number.
LOOSE = 1e-11


class Stars:
    """The stars of vertices: for each vertex the cells around it.

    A star balances the forces that are missing at its vertex, cell by cell in force and moment, by
    tractions on the facets at the vertex (docs/theory/guaranteed.md). A facet is in the stars of
    its d vertices, in which it has the same stiffness.

    Tractions (n, d + 1, d, d) are those on the facets of the cells that this rank owns, at their
    vertices; they are opposite on both sides of a facet. The equations of a star have a row for
    each of its cells: r forces and moments of the vertex of the cell (n, d + 1, r). They are solved
    by the rank that owns the vertex of the star.
    """

    def __init__(self, owned: OwnedCells, stiffness: Array, free: Mask) -> None:
        """Factor the equations of all stars. Collective.

        Args:
            owned: the cells.
            stiffness: (n, d + 1, d * d, d * d) energies of tractions on each facet.
            free: (n, d + 1, d) whether the traction on a facet is unknown along an axis.
        """
        self._owned, topology, d = owned, owned.V.mesh.topology, owned.cells.d
        self._facet_map, self._comm = topology.index_map(d - 1), owned.V.mesh.comm
        # stiffnesses where tractions are unknown; identities elsewhere, which are left out
        sums = stiffness + self._across(stiffness)
        unknown = np.tile(free, d).astype(np.float64)
        unknown = unknown[..., None] * unknown[..., None, :]
        sizes = np.trace(sums, axis1=2, axis2=3)[..., None, None] * np.eye(d * d)
        self._softness = unknown * np.linalg.inv(unknown * sums + (1.0 - unknown) * sizes)
        # the work of tractions on rigid motions about the centre of a facet, the same for both
        # cells, and the moments about each vertex of forces at the centre
        vertices = owned.cells.points[:, opposite(d)]
        centres = vertices.mean(axis=2, keepdims=True)
        work = hat_means(rigid_motions(vertices - centres))
        work *= owned.cells.areas[:, :, None, None, None]
        self._work = work.reshape(*work.shape[:3], d * d)
        self._moments = rigid_motions((centres - vertices)[:, :, :, None])[..., d:, 0, :]
        size = self._work.shape[2]
        moved = np.tile(np.eye(size), (*vertices.shape[:3], 1, 1))
        moved[..., d:, :d] = self._moments
        weights = self._work @ self._softness @ np.swapaxes(self._work, 2, 3)
        weights = moved @ weights[:, :, None] @ np.swapaxes(moved, 3, 4)

        starts = self._comm.allgather(topology.index_map(0).local_range[0])
        owner = np.searchsorted(starts, owned.vertices.ravel(), side="right") - 1
        self._order = np.argsort(owner, kind="stable")
        self._ranks = owner[self._order]
        facets = self._facet_map.local_to_global(owned.facets.ravel()).reshape(owned.facets.shape)
        stars = facets[:, opposite(d)] * topology.index_map(0).size_global
        stars += owned.vertices[:, :, None]
        data = stars.reshape(-1, d), self._at_corners(weights).reshape(-1, d, size, size)
        numbers, weights = (exchange(self._comm, x[self._order], self._ranks)[0] for x in data)
        with errors_on_all_ranks(self._comm):
            self._factor = _factored(numbers, weights)

    def _across(self, values: Array) -> Array:
        """Return for each facet (n, d + 1, ...) the values of the cell beyond, or 0. Collective."""
        facets = self._owned.facets
        flat = values.reshape(*facets.shape, -1)
        sums = summed_at_nodes(self._facet_map, facets, flat)[facets]
        return np.asarray((sums - flat).reshape(values.shape))

    def _at_corners(self, values: Array) -> Array:
        """Return (n, d + 1, d, ...) from values of facets at their vertices, by the vertices."""
        sides = opposite(self._owned.cells.d)
        corner = np.arange(len(sides))[:, None]
        return np.asarray(values[:, sides, corner - (corner > sides)])

    def _softened(self, forces: Array) -> Array:
        """Return the tractions (n, d + 1, d, d) that forces cause on facets."""
        d = self._owned.cells.d
        flat = forces.reshape(*forces.shape[:2], d * d)
        tractions = np.einsum("nfst,nft->nfs", self._softness, flat)
        return np.asarray(tractions.reshape(*flat.shape[:2], d, d))

    def _balancing(self, missing: Array) -> Array:
        """Return the least tractions with the forces and moments (n, d + 1, r). Collective."""
        size = missing.shape[2]
        rows = missing.reshape(-1, size)[self._order]
        right, sources = exchange(self._comm, rows, self._ranks)
        supports = np.zeros_like(right)
        vectors = (
            PETSc.Vec().createWithArray(array.ravel(), comm=PETSc.COMM_SELF)
            for array in (right, supports)
        )
        self._factor.apply(*vectors)
        returned, _ = exchange(self._comm, supports, sources)
        result = np.empty_like(rows)
        result[self._order] = returned
        of_facets = result.reshape(missing.shape)[:, opposite(self._owned.cells.d)]
        motions = of_facets.sum(axis=2)
        d = self._moments.shape[-1]
        motions[..., :d] += np.einsum("nfskd,nfsk->nfd", self._moments, of_facets[..., d:])
        forces = np.einsum("nfrt,nfr->nft", self._work, motions)
        return self._softened(forces - self._across(forces))

    def preconditioned(self, gradient: Array) -> Array:
        """Return tractions without resultants that decrease a quadratic function. Collective.

        They are the sums of the best corrections of all stars, where the second derivative is
        replaced by the stiffnesses of facets.

        Args:
            gradient: (n, d + 1, d, d) minus its derivative by the tractions on the cells.
        """
        d = self._owned.cells.d
        tractions = self._softened(gradient - self._across(gradient))
        flat = tractions.reshape(*tractions.shape[:2], d * d)
        resultants = np.einsum("nfrt,nft->nfr", self._work, flat)
        of_stars = np.repeat(resultants[:, :, None], d, axis=2)
        of_stars[..., d:] += np.einsum("nfskd,nfd->nfsk", self._moments, resultants[..., :d])
        return d * tractions - self._balancing(self._at_corners(of_stars).sum(axis=2))

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
        means = (traction - self._across(traction)) / (1.0 + self._across(np.ones_like(traction)))
        missing = force - self._owned.cells.facet_forces(means)
        # a force at the vertex itself has no moment about it
        missing = np.pad(missing, ((0, 0), (0, 0), (0, d * (d - 1) // 2)))
        return np.asarray(means + self._balancing(missing))


def _factored(stars: GlobalNumbers, weights: Array) -> PETSc.PC:
    """Return the factors of the equations of stars: a graph's, with blocks as weights.

    Args:
        stars: (rows, d) numbers of each facet of a row, in the star of its vertex.
        weights: (rows, d, r, r) weights of these facets.
    """
    rows, d, size, _ = weights.shape
    diagonal = weights.sum(axis=1)
    entries = np.einsum("nii->ni", diagonal)
    diagonal += np.where(entries > 0.0, LOOSE * entries, 1.0)[:, :, None] * np.eye(size)
    order = np.argsort(stars.ravel(), kind="stable")
    alike = np.diff(stars.ravel()[order]) == 0
    facet, beyond = order[:-1][alike], order[1:][alike]  # of the cells on both sides
    blocks = np.concatenate([diagonal, -weights.reshape(-1, size, size)[facet]])
    own, inner = np.arange(rows), np.arange(rows, len(blocks))
    row = np.concatenate([own, facet // d, beyond // d])
    column = np.concatenate([own, beyond // d, facet // d])
    numbers = csr_array((np.concatenate([own, inner, inner]), (row, column)), (rows, rows))
    pattern = (array.astype(PETSc.IntType) for array in (numbers.indptr, numbers.indices))
    matrix = PETSc.Mat().createBAIJ(
        (size * rows, size * rows),
        size,
        csr=(*pattern, blocks[numbers.data].ravel()),
        comm=PETSc.COMM_SELF,
    )
    factor = PETSc.PC().create(PETSc.COMM_SELF)
    factor.setType("lu")  # in blocks faster than "cholesky"
    factor.setFactorSolverType("petsc")
    factor.setFactorOrdering("rcm")
    factor.setOperators(matrix)
    factor.setUp()
    return factor
