"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.guaranteed.cells import Simplices, mean_products, opposite, rigid_motions

#: Eigenvalue of a star's equations, relative to their mean diagonal entry, below which it belongs
#: to a rigid motion that nothing holds. Those eigenvalues are zero up to rounding.
FREE_EIGENVALUE = 1e-9


@dataclass(frozen=True)
class CellData:
    """The cells of stars, with the stresses and loads that tractions must balance.

    Attributes:
        points: (n, d + 1, d) the vertices [length], in ascending order of their numbers.
        vertices: (n, d + 1) global numbers of the vertices.
        facets: (n, d + 1) global numbers of the facets.
        owned: (n, d + 1) whether this rank has the star of a vertex.
        stiffness: (n, d + 1) energies of unit tractions on each facet.
        stress: (n, d + 1, d, d) stress at the vertices of a displacement in discrete equilibrium.
        load: (n, d + 1, d) load at the vertices.
        traction: (n, d + 1, d, d) tractions on the boundary, facet by facet at its vertices.
        held: (n, d + 1, d) whether the displacement is prescribed along an axis on a facet, whose
            traction is then free along this axis.
    """

    points: Array
    vertices: Indices
    facets: Indices
    owned: Mask
    stiffness: Array
    stress: Array
    load: Array
    traction: Array
    held: Mask


class Stars:
    """The stars of vertices: for each vertex the cells around it.

    A star has tractions on the facets at its vertex, linear on each, that are in equilibrium, cell
    by cell, with the part lambda_z of the loads and of the discrete stress (docs/theory/
    guaranteed.md). Their sum over all vertices is in equilibrium with the whole load.

    Tractions on facets are arrays (facets of this rank, d, d): vertex, component. The first cell of
    a facet has them with the sign 1, the second with -1.
    """

    def __init__(self, data: CellData) -> None:
        """Number the facets of the stars, and factor the equations of all stars. Not collective."""
        self.data, self.cells = data, Simplices(data.points)
        self.d = d = self.cells.d
        _, uses, facets, self.counts = np.unique(
            data.facets, return_index=True, return_inverse=True, return_counts=True
        )
        self.facets: Indices = facets.reshape(data.facets.shape)
        self.signs = np.full(self.facets.shape, -1.0)
        self.signs.flat[uses] = 1.0
        single = (self.counts == 1)[self.facets]
        self.free = np.ones((len(self.counts), d), dtype=np.bool_)
        self.free[self.facets[single]] = data.held[single]
        # inverse stiffnesses of tractions (facets * d^2,), which are zero where they are given
        softness = self.free / self._on_facets(data.stiffness)[:, None]
        softness = np.repeat(softness[:, None], d, axis=1).reshape(-1, d * d)
        self.softness = softness.ravel()

        cell, corner = np.nonzero(data.owned)
        order = np.argsort(data.vertices[cell, corner], kind="stable")
        self.cell, self.corner = cell[order], corner[order]
        _, start, star = np.unique(
            data.vertices[self.cell, self.corner], return_index=True, return_inverse=True
        )
        sides = opposite(d)[self.corner]  # (m, d) the facets at the vertex
        facets = self.facets[self.cell[:, None], sides]
        arms = data.points[self.cell]
        arms = arms - arms[np.arange(len(arms)), self.corner][:, None]
        lengths = np.zeros(len(start))
        np.maximum.at(lengths, star, np.linalg.norm(arms, axis=2).max(axis=1))
        self.motions = rigid_motions(arms / lengths[star, None, None])  # (m, r, d + 1, d)

        # resultants of tractions: a block for each cell of a star, and each of its facets
        ends = opposite(d)[sides]  # (m, d, d) vertices of these facets
        work = np.swapaxes(self.motions, 1, 2)[np.arange(len(ends))[:, None, None], ends]
        work = np.swapaxes(mean_products(d, 2) @ work.reshape(*ends.shape, -1), 2, 3)
        scale = (self.signs * self.cells.areas)[self.cell[:, None], sides]
        work = (scale[:, :, None, None] * work).reshape(facets.size, -1, d, d)
        blocks = np.swapaxes(work, 2, 3).reshape(facets.size, -1, d * d)
        keys, column = np.unique(star[:, None] * len(self.counts) + facets, return_inverse=True)
        self.uses = np.bincount(keys % len(self.counts), minlength=len(self.counts))
        by_star = self._block_rows(blocks, column, len(keys))
        softened = self._block_rows(blocks * softness[facets.ravel()][:, None], column, len(keys))
        self._factor((softened @ by_star.T).tobsr(blocksize=2 * self.motions.shape[1:2]), start)
        self.resultants = self._block_rows(blocks, facets, len(self.counts))
        self.transposed = self.resultants.T

    def _block_rows(self, blocks: Array, columns: Indices, width: int) -> Any:
        """Return the matrix with d blocks in each row of blocks, in `width` columns of blocks."""
        _, rows, size = blocks.shape
        count = len(self.cell)
        return bsr_array(
            (blocks, columns.ravel(), np.arange(0, len(blocks) + 1, self.d)),
            shape=(count * rows, width * size),
        )

    def _on_facets(self, values: Array) -> Array:
        """Return sums (facets, ...) of values of both cells (n, d + 1, ...)."""
        result = np.zeros((len(self.counts), *values.shape[2:]))
        for sign in (1.0, -1.0):  # no facet has the same sign twice
            side = self.signs == sign
            result[self.facets[side]] += values[side]
        return result

    def _on_cells(self, tractions: Array) -> Array:
        """Return tractions (n, d + 1, d, d) on the cells from those on facets, flat or not."""
        on_facets = tractions.reshape(len(self.counts), self.d, self.d)
        return np.asarray(self.signs[:, :, None, None] * on_facets[self.facets])

    def _factor(self, matrix: Any, start: Indices) -> None:
        """Factor the equations of all stars, whose matrix has a small bandwidth.

        Args:
            matrix: sparse matrix with a row of blocks for each cell of each star.
            start: the first cell of each star.
        """
        size, count = matrix.blocksize[0], len(self.cell)
        # rigid motions that nothing holds are fixed in a cell of the star
        whole = np.add.reduceat(matrix.data, matrix.indptr[start])
        values, vectors = np.linalg.eigh(whole)
        scale = np.add.reduceat(matrix.diagonal().reshape(count, -1).mean(axis=1), start)
        scale[scale == 0.0] = 1.0  # all tractions are given
        loose = vectors * (values < FREE_EIGENVALUE * scale[:, None])[:, None]
        rows = np.repeat(np.arange(count), np.diff(matrix.indptr))
        fixed = np.flatnonzero((rows == matrix.indices) & np.isin(rows, start))
        matrix.data[fixed] += scale[:, None, None] * loose @ np.swapaxes(loose, 1, 2)
        graph = csr_array((np.ones(len(rows)), matrix.indices, matrix.indptr), (count, count))
        self.order = reverse_cuthill_mckee(graph, symmetric_mode=True)
        place = np.argsort(self.order)
        i, j = place[rows], place[matrix.indices]
        below = np.flatnonzero(i >= j)
        i, j = i[below], j[below]
        band = np.zeros(((int((i - j).max(initial=0)) + 1) * size, count * size))
        for k, m in np.ndindex(size, size):
            inside = (i > j) | (k >= m)
            row = (i - j) * size + k - m
            band[row[inside], j[inside] * size + m] = matrix.data[below[inside], k, m]
        self.factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)

    def _supports(self, missing: Array) -> Array:
        """Return the multipliers of the equations of all stars, for missing resultants (m, r)."""
        flat = missing.reshape(len(self.order), -1)[self.order]
        solved = cho_solve_banded((self.factor, True), flat.ravel(), check_finite=False)
        result = np.empty_like(flat)
        result[self.order] = solved.reshape(flat.shape)
        return np.asarray(result.ravel())

    def preconditioned(self, gradient: Array) -> Array:
        """Return tractions on the cells without resultants that decrease a quadratic function.

        They are the sums of the best corrections of all stars, where the second derivative is
        replaced by the stiffnesses of facets.

        Args:
            gradient: (n, d + 1, d, d) minus its derivative by the tractions on the cells.
        """
        forces = self._on_facets(self.signs[:, :, None, None] * gradient)
        supports = self._supports(self.resultants @ (self.softness * forces.ravel()))
        forces *= self.uses[:, None, None]
        return self._on_cells(self.softness * (forces.ravel() - self.transposed @ supports))

    def equilibrated(self) -> Array:
        """Return tractions on the cells that balance the data.

        They are the given tractions, elsewhere the means of the discrete stress of both sides, with
        the least corrections of all stars.
        """
        data, d = self.data, self.d
        signs = self.signs[:, :, None, None]
        stress = data.stress[:, opposite(d)]
        means = self._on_facets(signs * np.einsum("njkab,njb->njka", stress, self.cells.normals))
        means /= self.counts[:, None, None]
        given = self._on_facets(signs * data.traction)
        tractions = self._on_cells(np.where(self.free[:, None], means, given))
        forces = self._forces(tractions)
        missing = (self.motions.reshape(*self.motions.shape[:2], -1) @ forces)[:, :, 0]
        supports = self._supports(missing)
        tractions *= data.owned[:, opposite(d), None]
        return tractions + self._on_cells(self.softness * (self.transposed @ supports))

    def _forces(self, tractions: Array) -> Array:
        """Return forces (m, (d + 1) d, 1) at the vertices of the cells of stars, to be balanced.

        A linear displacement w does the work of the discrete stress along the gradient of
        lambda_z w, minus that of the loads and tractions along lambda_z w.
        """
        data, d, cell, corner = self.data, self.d, self.cell, self.corner
        entries = np.arange(len(cell))[:, None]
        flux = data.stress[cell] @ self.cells.gradients[cell, corner][:, None, :, None]
        result = mean_products(d + 1, 2) @ flux[..., 0]
        result -= mean_products(d + 1, 3)[corner] @ data.load[cell]
        result *= self.cells.volumes[cell, None, None]
        for facet in opposite(d)[corner].T:
            place = corner - (corner > facet)
            products = mean_products(d, 3)[place] @ tractions[cell, facet]
            areas = self.cells.areas[cell, facet]
            result[entries, opposite(d)[facet]] -= areas[:, None, None] * products
        shares = self._edge_forces()[cell, corner]
        result += shares
        result[entries[:, 0], corner] -= shares.sum(axis=1)
        return result.reshape(len(cell), -1, 1)

    def _edge_forces(self) -> Array:
        """Return forces (n, d + 1, d + 1, d) that balance the moments of stars, for degree 1.

        lambda_z W (x - z) with a rotation W is no displacement of degree 1, but a sum of bubbles of
        the edges at z. The residual's work with the bubble of an edge is added as a force at its
        other end in the stars of both ends, in parts of the volume around. The moments of these
        forces about both ends cancel each other.
        """
        data, cells, d = self.data, self.cells, self.d
        stress = np.einsum("kl,nlab->nkab", mean_products(d + 1, 2), data.stress)
        flux = np.einsum("niab,njb->nija", stress, cells.gradients)
        loads = np.einsum("ijk,nka->nija", mean_products(d + 1, 3), data.load)
        residual = loads - flux - np.swapaxes(flux, 1, 2)
        residual *= cells.volumes[:, None, None, None]
        for facet, ends in enumerate(opposite(d)):
            products = np.einsum("ijk,nka->nija", mean_products(d, 3), data.traction[:, facet])
            areas = cells.areas[:, facet, None, None, None]
            residual[:, ends[:, None], ends] += areas * products
        i, j = np.triu_indices(d + 1, 1)
        keys = data.vertices[:, i] * (data.vertices.max(initial=0) + 1) + data.vertices[:, j]
        edges, edge = np.unique(keys, return_inverse=True)
        edge = edge.reshape(keys.shape)
        outside = [np.setdiff1d(range(d + 1), ends) for ends in zip(i, j, strict=True)]
        held = np.stack([data.held[:, facets].any(axis=1) for facets in outside], axis=1)
        total, around = np.zeros((len(edges), d)), np.zeros(len(edges))
        fixed = np.zeros(total.shape, dtype=np.bool_)
        np.add.at(total, edge, residual[:, i, j])
        np.add.at(around, edge, cells.volumes[:, None])
        np.logical_or.at(fixed, edge, held)
        total[fixed] = 0.0
        result = np.zeros_like(residual)
        result[:, i, j] = total[edge] * (cells.volumes[:, None] / around[edge])[:, :, None]
        return np.asarray(result + np.swapaxes(result, 1, 2))
