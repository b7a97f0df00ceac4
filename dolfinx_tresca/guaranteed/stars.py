"""Tractions in equilibrium on the facets of a mesh of simplices, star by star."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.guaranteed.simplices import mean_products, moments
from dolfinx_tresca.guaranteed.stress_element import CellStresses

#: Eigenvalue of a star's equations, relative to their mean diagonal entry, below which it belongs
#: to a rigid motion that nothing holds. Those eigenvalues are zero up to rounding.
FREE_EIGENVALUE = 1e-9

#: Part of the squared resultants of tractions in the stiffness of a facet, relative to the rest.
#: (With a tenth or ten times of it, the bound after some steps changes by 1 %.)
RESULTANT_PART = 0.1


@dataclass(frozen=True)
class CellData:
    """Stresses and loads that the tractions on cells must balance.

    Attributes:
        stress: (n, d + 1, d, d) stress at the vertices of a displacement in discrete equilibrium.
        load: (n, d + 1, d + 1, d) integrals of f lambda_i lambda_k over the cells.
        traction: (n, d + 1, d + 1, d + 1, d) integrals of t lambda_i lambda_k over facet j on the
            boundary in `traction[:, j, i, k]`.
        held: (n, d + 1, d) whether the displacement is prescribed along an axis on facet j, whose
            traction is then free along this axis.
    """

    stress: Array
    load: Array
    traction: Array
    held: Mask


class Stars:
    """The stars of vertices: for each vertex the cells around it.

    A star has tractions on the facets at its vertex, linear on each, that are in equilibrium, cell
    by cell, with the part lambda_z of the loads and of the discrete stress (docs/theory/
    guaranteed.md). Their sum over all vertices is in equilibrium with the whole load.
    """

    def __init__(
        self,
        stresses: CellStresses,
        vertices: Indices,
        owned: Mask,
        data: CellData,
        linear_stress: bool,
    ) -> None:
        """Number the facets of the stars. Not collective.

        Args:
            stresses: the cells of all stars, with their compliances.
            vertices: (n, d + 1) global numbers of the vertices of cells.
            owned: (n, d + 1) whether this rank has the star of a vertex.
            data: stresses and loads that the tractions must balance.
            linear_stress: whether the stress is linear in cells, from displacements of degree 2.
        """
        self.stresses, self.cells, self.data = stresses, stresses.cells, data
        self.vertices, self._linear_stress = vertices, linear_stress
        n, corners = vertices.shape
        self.d = d = corners - 1
        self.opposite = np.array([[k for k in range(corners) if k != j] for j in range(corners)])
        order = np.argsort(vertices[:, self.opposite], axis=2)
        keys = np.take_along_axis(vertices[:, self.opposite], order, axis=2).reshape(-1, d)
        _, first_use, facets, uses = np.unique(
            keys, axis=0, return_index=True, return_inverse=True, return_counts=True
        )
        self.facets = facets.reshape(n, corners)
        self.signs = np.full((n, corners), -1.0)
        self.signs.flat[first_use] = 1.0
        # the position of vertex k among the sorted vertices of facet j; both cells agree on it
        self.slots = np.zeros((n, corners, corners), dtype=np.intp)
        np.put_along_axis(
            self.slots,
            np.take_along_axis(np.broadcast_to(self.opposite, order.shape), order, axis=2),
            np.broadcast_to(np.arange(d), order.shape),
            axis=2,
        )
        self.single = uses == 1
        self.fixed = np.zeros((len(uses), d), dtype=np.bool_)
        boundary = self.single[self.facets]
        self.fixed[self.facets[boundary]] = ~data.held[boundary]

        cell, corner = np.nonzero(owned)
        ascending = np.argsort(vertices[cell, corner], kind="stable")
        self.cell, self.corner = cell[ascending], corner[ascending]
        _, self.start, self.count = np.unique(
            vertices[self.cell, self.corner], return_index=True, return_counts=True
        )
        star = np.repeat(np.arange(len(self.start)), self.count)
        self.sides = self.opposite[self.corner]  # (m, d) the facets at the vertex
        facets = self.facets[self.cell[:, None], self.sides]
        keys, entry = np.unique(star[:, None] * len(uses) + facets, return_inverse=True)
        self.entry = entry.reshape(facets.shape)  # (m, d) number among the facets of all stars
        self.facet = keys % len(uses)
        self.facet_start = np.searchsorted(keys, np.arange(len(self.start)) * len(uses))
        self.facet_count = np.diff(self.facet_start, append=len(keys))
        # positions of the tractions at the vertices of these facets, in ascending order of vertices
        self.corners = self.opposite[self.sides]
        self.places = self.slots[self.cell[:, None, None], self.sides[:, :, None], self.corners]
        self.side_signs = self.signs[self.cell[:, None], self.sides]

    def equilibrated(self) -> Array:
        """Return tractions on the cells that balance the data; factors all stars."""
        tractions = self._means()
        missing, self.size = self._missing(tractions)
        self._factor(missing)
        return self._on_cells(tractions + self._corrections(missing, np.zeros_like(tractions)))

    def preconditioned(self, gradient: Array) -> Array:
        """Return tractions on the cells without resultants that decrease a quadratic function.

        Args:
            gradient: (n, d + 1, d + 1, d) minus its derivative by the tractions on the cells.
        """
        on_facets = np.zeros((len(self.single), self.d, self.d))
        for sign in (1.0, -1.0):
            cell, j = np.nonzero(self.signs == sign)
            k = self.opposite[j]
            place = self.facets[cell, j][:, None], self.slots[cell[:, None], j[:, None], k]
            on_facets[place] += sign * gradient[cell[:, None], j[:, None], k]
        nothing = np.zeros(self.equations.shape[::2])
        return self._on_cells(self._corrections(nothing, on_facets[self.facet]))

    def _corrections(self, missing: Array, gradient: Array) -> Array:
        """Return the best tractions (facets of stars, d, d) with given resultants.

        Args:
            missing: (m, r) the resultants on each cell of each star.
            gradient: (facets of stars, d, d) minus the derivative by tractions; the second
                derivative is replaced by the part that couples the tractions of one facet.
        """
        softness = self.softness[self.facet]
        free = (softness @ gradient.reshape(len(gradient), -1, 1))[:, :, 0]
        right = missing - (self.equations @ free[self.entry][..., None])[..., 0].sum(axis=1)
        supports = np.empty_like(right)
        flat = right[self.order].ravel()
        solved = cho_solve_banded((self.factor, True), flat, check_finite=False)
        supports[self.order] = solved.reshape(right.shape)
        forces = (supports[:, None, None] @ self.equations)[:, :, 0]
        sums = np.zeros_like(free)
        for sign in (1.0, -1.0):  # no facet of a star has the same sign twice
            side = self.side_signs == sign
            sums[self.entry[side]] += forces[side]
        result = free + (softness @ sums[:, :, None])[:, :, 0]
        return np.asarray(result.reshape(gradient.shape))

    def _on_cells(self, tractions: Array) -> Array:
        """Return the sums over all stars of tractions (facets of stars, d, d), on the cells."""
        result = np.zeros((*self.vertices.shape, self.d + 1, self.d))
        values = tractions[self.entry[:, :, None], self.places]
        values *= self.side_signs[:, :, None, None]
        for corner in range(self.d + 1):  # no cell twice
            own = self.corner == corner
            place = self.cell[own, None, None], self.sides[own][:, :, None], self.corners[own]
            result[place] += values[own]
        return result

    def _means(self) -> Array:
        """Return the given tractions, elsewhere the means of the discrete stress of both sides.

        They are multiplied by the hat function of the star's vertex, and projected onto linear
        functions: (facets of stars, d, d).
        """
        d, c = self.d, self.cell[:, None]
        result = np.zeros((len(self.facet), d, d))
        inverse = np.linalg.inv(mean_products(d, 2))
        at_vertex = self.corners == self.corner[:, None, None]  # (m, d, d)
        normals = self.cells.normals[c, self.sides]
        stress = self.data.stress[c[:, :, None], self.corners]
        own = np.einsum("mjkab,mjb->mjka", stress, normals)
        hats = np.einsum("mjz,zki->mjki", at_vertex.astype(np.float64), mean_products(d, 3))
        own = np.einsum("li,mjki,mjka->mjla", inverse, hats, own, optimize=True)
        fixed = self.fixed[self.facet[self.entry]]
        shares = np.where(self.single[self.facet[self.entry]], 1.0, 0.5)[:, :, None, None]
        given = (
            self.data.traction[
                c[:, :, None], self.sides[:, :, None], self.corner[:, None, None], self.corners
            ]
            / self.cells.areas[c, self.sides][:, :, None, None]
        )
        given = np.einsum("li,mjia->mjla", inverse, given)
        values = np.where(fixed[:, :, None, :], given, shares * own)
        values *= self.side_signs[:, :, None, None]
        for sign in (1.0, -1.0):
            side = self.side_signs == sign
            result[self.entry[side][:, None], self.places[side]] += values[side]
        return result

    @cached_property
    def arms(self) -> Array:
        """(m, d + 1, d) vectors from the star's vertex to the vertices of its cells."""
        points = self.cells.points[self.cell]
        return np.asarray(points - points[np.arange(len(points)), self.corner][:, None])

    @cached_property
    def lengths(self) -> Array:
        """(m,) largest arm of the star of each cell [length], by which moments are divided."""
        largest = np.linalg.norm(self.arms, axis=2).max(axis=1)
        return np.repeat(np.maximum.reduceat(largest, self.start), self.count)

    def _missing(self, tractions: Array) -> tuple[Array, float]:
        """Return resultants (m, r) that tractions lack, and the size of forces."""
        d, c, arms = self.d, self.cell, self.arms
        load = self.data.load[c, self.corner]
        flux = (
            np.einsum("mjab,mb->mja", self.data.stress[c], self.cells.gradients[c, self.corner])
            * (self.cells.volumes[c, None, None])
        )
        force = flux.mean(axis=1) - load.sum(axis=1)
        mass = mean_products(d + 1, 2)
        moment = moments(arms, mass @ flux - load).sum(axis=1)
        size = np.abs(flux).max(initial=0.0) + np.abs(load).max(initial=0.0)
        values = tractions[self.entry[:, :, None], self.places]
        areas = self.side_signs * self.cells.areas[c[:, None], self.sides]
        values = areas[:, :, None, None] * values
        force -= values.sum(axis=(1, 2)) / d
        lever = mean_products(d, 2) @ self._facet_arms
        moment -= moments(lever, values).sum(axis=(1, 2))
        if not self._linear_stress:
            moment += self._edge_moments()
        return np.hstack([force, moment / self.lengths[:, None]]), float(size)

    @cached_property
    def _facet_arms(self) -> Array:
        """(m, d, d, d) `arms` at the vertices of each facet at the star's vertex."""
        return np.asarray(self.arms[np.arange(len(self.cell))[:, None, None], self.corners])

    def _edge_moments(self) -> Array:
        """Return moments (m, .) that balance each star for displacements of degree 1.

        lambda_z W (x - z) with a rotation W is no displacement of degree 1, but a sum of bubbles of
        the edges at z. The residual's moment with the bubble of an edge is added in the star of one
        end and subtracted in the star of the other end, in equal parts of the volume around.
        """
        d, n = self.d, len(self.vertices)
        i, j = np.array(list(combinations(range(d + 1), 2))).T
        ends = np.sort(np.stack([self.vertices[:, i], self.vertices[:, j]], axis=2), axis=2)
        _, edge = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
        edge = edge.reshape(n, -1)
        volumes = self.cells.volumes
        residual = self.data.load[:, i, j] + self.data.traction[:, :, i, j].sum(axis=1)
        slopes = self.cells.gradients[:, i] + self.cells.gradients[:, j]
        stress = self.data.stress[:, 0] * (volumes / (d + 1))[:, None, None]
        residual -= np.einsum("nab,neb->nea", stress, slopes)
        total, around = np.zeros((edge.max() + 1, d)), np.zeros(edge.max() + 1)
        np.add.at(total, edge, residual)
        np.add.at(around, edge, volumes[:, None])
        held = np.zeros(total.shape, dtype=np.bool_)
        cell, facet = np.nonzero(self.data.held.any(axis=2))
        inside = (facet[:, None] != i) & (facet[:, None] != j)
        flags = np.broadcast_to(self.data.held[cell, facet][:, None], (*inside.shape, d))
        np.logical_or.at(held, edge[cell][inside], flags[inside])
        total[held] = 0.0
        shares = total[edge] * (volumes[:, None] / around[edge])[:, :, None]
        own = shares[self.cell]
        ahead = moments(self.arms[:, j], own) * (self.corner[:, None] == i)[:, :, None]
        behind = moments(self.arms[:, i], own) * (self.corner[:, None] == j)[:, :, None]
        return np.asarray((ahead + behind).sum(axis=1))

    def _factor(self, missing: Array) -> None:
        """Set up the equations of all stars, the stiffnesses of facets, and their inverses."""
        d, cells, count = self.d, self.cells, len(self.cell)
        lever = mean_products(d, 2) @ self._facet_arms / self.lengths[:, None, None, None]
        local = _resultants(lever)
        areas = self.side_signs * cells.areas[self.cell[:, None], self.sides]
        local *= areas[:, :, None, None, None]
        equations = np.empty((count, d, local.shape[-1], d, d))
        row, side = np.arange(count)[:, None, None], np.arange(d)[:, None]
        equations[row, side, :, self.places] = np.swapaxes(local, 3, 4)
        self.equations = equations.reshape(count, d, -1, d * d)
        self.softness = self._facet_softness()
        softened = self.equations @ self.softness[self.facet[self.entry]]
        # cells that share a facet of the star
        order = np.argsort(self.entry, axis=None, kind="stable")
        same = np.flatnonzero(np.diff(self.entry.flat[order]) == 0)
        sides = order[np.stack([same, same + 1])]
        flat = self.equations.reshape(count * d, -1, d * d)
        between = softened.reshape(flat.shape)[sides[0]] @ np.swapaxes(flat[sides[1]], 1, 2)
        inside = (softened @ np.swapaxes(self.equations, 2, 3)).sum(axis=1)
        upper, lower = sides // d
        # rigid motions that nothing holds must be balanced; they are fixed in a cell of the star
        size = inside.shape[1]
        whole = inside.copy()
        np.add.at(whole, upper, between + np.swapaxes(between, 1, 2))
        values, vectors = np.linalg.eigh(np.add.reduceat(whole, self.start))
        scale = np.add.reduceat(np.trace(inside, axis1=1, axis2=2), self.start) / size
        scale[scale == 0.0] = 1.0  # all tractions are given
        loose = vectors * (values < FREE_EIGENVALUE * scale[:, None])[:, None]
        unbalanced = np.add.reduceat(missing, self.start)[:, None] @ loose
        self.imbalance = float(np.abs(unbalanced).max(initial=0.0))
        inside[self.start] += scale[:, None, None] * loose @ np.swapaxes(loose, 1, 2)
        # the matrix of all stars has a small bandwidth
        graph = csr_array((np.ones(len(upper)), (upper, lower)), (count, count))
        self.order = reverse_cuthill_mckee(csr_array(graph + graph.T), symmetric_mode=True)
        place = np.argsort(self.order)
        ahead = place[upper] > place[lower]
        i = np.where(ahead, place[upper], place[lower])
        j = np.where(ahead, place[lower], place[upper])
        between = np.where(ahead[:, None, None], between, np.swapaxes(between, 1, 2))
        band = np.zeros(((int((i - j).max(initial=0)) + 1) * size, count * size))
        for k, m in np.ndindex(size, size):
            band[(i - j) * size + k - m, j * size + m] = between[:, k, m]
            if k >= m:
                band[k - m, place * size + m] = inside[:, k, m]
        self.factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)

    def _facet_softness(self) -> Array:
        """Return the inverses (facets, d^2, d^2) of the stiffnesses of the tractions on each facet.

        They are the quadratic forms of both cells for tractions on one facet. The squares of
        resultants are added, since tractions out of equilibrium have no energy.
        """
        d = self.d
        opposite = np.broadcast_to(self.opposite, (*self.facets.shape, d))
        places = np.take_along_axis(self.slots, opposite, axis=2)
        stiffness = self.stresses.facet_stiffness()
        total: Array = np.zeros((len(self.single), d, d, d, d))
        points = np.empty((len(self.single), d, d))
        for sign in (1.0, -1.0):
            cell, j = np.nonzero(self.signs == sign)
            facet, own = self.facets[cell, j][:, None], places[cell, j]
            points[facet, own] = self.cells.points[cell[:, None], self.opposite[j]]
            values = stiffness[cell, j].transpose(0, 1, 3, 2, 4)
            total[facet[:, :, None], own[:, :, None], :, own[:, None]] += values
        total = total.reshape(-1, d * d, d * d)
        arms = points - points.mean(axis=1, keepdims=True)
        arms /= np.linalg.norm(arms, axis=2).max(axis=1)[:, None, None]
        rows = _resultants(mean_products(d, 2) @ arms).reshape(len(points), d * d, -1)
        squares = rows @ np.swapaxes(rows, 1, 2)
        weight = RESULTANT_PART * np.trace(total, axis1=1, axis2=2)
        total += (weight / np.trace(squares, axis1=1, axis2=2))[:, None, None] * squares
        free = np.repeat(~self.fixed[:, None], d, axis=1).reshape(-1, d * d)
        both = free[:, :, None] & free[:, None]
        total[~both] = 0.0
        total[:, range(d * d), range(d * d)] += ~free
        return np.asarray(np.linalg.inv(total) * both)


def _resultants(arms: Array) -> Array:
    """Return force and moment of tractions at vertices, (..., d, d, r): vertex, component, row.

    Args:
        arms: (..., d, d) mean values of arms times the hat functions of the vertices.
    """
    d = arms.shape[-1]
    turns = np.stack([moments(arms, axis) for axis in np.eye(d)], axis=-2)
    forces = np.broadcast_to(np.eye(d) / d, (*turns.shape[:-1], d))
    return np.concatenate([forces, turns], axis=-1)
