"""The symmetric stress element of Johnson and Mercier on a simplex.

A simplex with d + 1 vertices is divided by its centroid c into d + 1 subcells; subcell i has the
vertices x_j, j != i, and c. Stresses are symmetric, linear in each subcell, and have continuous
tractions between subcells. Such a stress is determined by its tractions on the facets of the
simplex (linear on each facet) and by its divergence (constant in each subcell), which must be in
equilibrium of forces and moments [Johnson, Mercier 1978; Gopalakrishnan, Guzman, Lee 2024].

All arrays here belong to the reference simplex, with the vertices 0, e_1, ..., e_d. For
x = x_0 + B X the stress is B S B', with the reference stress S.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.guaranteed.simplices import Simplices, mean_products


@dataclass(frozen=True)
class StressElement:
    """The reference element; nsym = d (d + 1) / 2.

    Attributes:
        basis: (nsym, d, d) orthonormal basis of the symmetric matrices.
        values: (d + 1, d + 1, nsym, m) stresses at the vertices of subcells for unit data:
            `values[i, j]` belongs to vertex j of subcell i, `values[i, i]` to its centroid. The m
            data are first (facet i, vertex j != i, component) S grad lambda_i at the vertices of
            facet i, where lambda_i is the barycentric coordinate; then (subcell, component) the
            divergence. Data out of equilibrium are changed to their least-squares fit.
        mass: (d + 1, d + 1) integrals over a subcell of products of two of its barycentric
            coordinates, relative to the volume of the simplex.
        products: (nsym, nsym, m, m) integrals of the products of the components of two stresses,
            relative to the volume of the simplex.
    """

    basis: Array
    values: Array
    mass: Array
    products: Array


@cache
def stress_element(d: int) -> StressElement:
    """Return the reference element in dimension d."""
    n, nsym = d + 1, d * (d + 1) // 2
    basis = np.zeros((nsym, d, d))
    for k in range(d):
        basis[k, k, k] = 1.0
    for k, (i, j) in enumerate(combinations(range(d), 2), d):
        basis[k, i, j] = basis[k, j, i] = np.sqrt(0.5)
    gradients = np.vstack([-np.ones(d), np.eye(d)])  # of the barycentric coordinates
    facets = d * n * d
    unknown = np.eye(n * n * nsym).reshape(n, n, nsym, -1)
    stress = np.einsum("ijaz,akl->ijklz", unknown, basis)
    equations, data = [], []
    for row, (i, j) in enumerate((i, j) for i in range(n) for j in range(n) if j != i):
        equations.append(np.einsum("klz,l->kz", stress[i, j], gradients[i]))
        data.append(np.eye(d, facets + n * d, row * d))
    for i in range(n):
        # lambda of the centroid in subcell i is n lambda_i; that of vertex j is lambda_j - lambda_i
        own = gradients - gradients[i]
        own[i] = n * gradients[i]
        equations.append(np.einsum("jklz,jl->kz", stress[i], own))
        data.append(np.eye(d, facets + n * d, facets + i * d))
    for i, j in combinations(range(n), 2):
        jump = gradients[i] - gradients[j]
        for k in (k for k in range(n) if k not in (i, j)):
            equations.append((stress[i, k] - stress[j, k]).transpose(2, 0, 1) @ jump)
            equations[-1] = equations[-1].T
        equations.append(((stress[i, i] - stress[j, j]).transpose(2, 0, 1) @ jump).T)
    matrix = np.vstack(equations)
    right = np.vstack(data)
    right = np.vstack([right, np.zeros((len(matrix) - len(right), right.shape[1]))])
    values = (np.linalg.pinv(matrix) @ right).reshape(n, n, nsym, -1)
    mass = mean_products(n, 2) / n
    products = np.einsum("ijax,jk,ikby->abxy", values, mass, values, optimize=True)
    return StressElement(basis, values, mass, products)


@dataclass(frozen=True)
class CellStresses:
    """Stresses of the element in cells, and their energies.

    Tractions on cells are arrays (n, d + 1, d + 1, d): `tractions[:, j, k]` acts on facet j of a
    cell at its vertex k, and is zero for j = k. Stresses are arrays (n, d + 1, d + 1, nsym) as in
    `StressElement.values`, in reference coordinates.

    Attributes:
        cells: the cells.
        compliance: (n, nsym, nsym) the inverse of the elasticity tensor, in `StressElement.basis`.
    """

    cells: Simplices
    compliance: Array

    @property
    def element(self) -> StressElement:
        """The reference element."""
        return stress_element(self.cells.points.shape[2])

    @cached_property
    def reference_compliance(self) -> Array:
        """(n, nsym, nsym) the compliance for stresses in reference coordinates."""
        basis, frames = self.element.basis, self.cells.frames
        physical = np.einsum("nik,akl,njl->naij", frames, basis, frames, optimize=True)
        rows = np.tensordot(physical, basis, axes=([2, 3], [1, 2]))
        return np.asarray(rows @ self.compliance @ np.swapaxes(rows, 1, 2))

    @cached_property
    def reference_tractions(self) -> Array:
        """(n, d + 1, d, d) matrices from the traction on facet i to S grad lambda_i."""
        return -self.cells.inverses[:, None] / self.cells.heights[:, :, None, None]

    def of_tractions(self, tractions: Array, divergence: Array | None = None) -> Array:
        """Return the stresses with given tractions and divergence (n, d + 1, d), or without any."""
        n, corners, _, d = tractions.shape
        scaled = np.einsum("njab,njkb->njka", self.reference_tractions, tractions)
        scaled = scaled[:, ~np.eye(corners, dtype=np.bool_)].reshape(n, -1)
        values = self.element.values
        if divergence is None:
            return np.tensordot(scaled, values[..., : scaled.shape[1]], axes=([1], [3]))
        pulled = np.einsum("nab,njb->nja", self.cells.inverses, divergence).reshape(n, -1)
        return np.tensordot(np.hstack([scaled, pulled]), values, axes=([1], [3]))

    def of_linear(self, stresses: Array) -> Array:
        """Return linear stresses in cells, from symmetric matrices (n, d + 1, d, d) at vertices."""
        inner = self.cells.inverses
        pulled = np.einsum("nai,nkij,nbj->nkab", inner, stresses, inner, optimize=True)
        at_vertices = np.tensordot(pulled, self.element.basis, axes=([2, 3], [1, 2]))
        corners = at_vertices.shape[1]
        result = np.repeat(at_vertices[:, None], corners, axis=1)
        result[:, range(corners), range(corners)] = at_vertices.mean(axis=1, keepdims=True)
        return result

    def energies(self, stresses: Array) -> Array:
        """Return the squared norms (n,) of stresses, of twice the complementary energy."""
        return self.cells.volumes * np.einsum(
            "nija,nija->n", stresses, self._weighted(stresses), optimize=True
        )

    def gradient(self, stresses: Array) -> Array:
        """Return half the derivative of the sum of `energies` by the tractions on the cells."""
        n, corners, _, _ = stresses.shape
        d = corners - 1
        weighted = self._weighted(stresses) * self.cells.volumes[:, None, None, None]
        by_data = np.tensordot(
            weighted, self.element.values[..., : corners * d * d], axes=([1, 2, 3], [0, 1, 2])
        )
        result = np.zeros((n, corners, corners, d))
        result[:, ~np.eye(corners, dtype=np.bool_)] = by_data.reshape(n, -1, d)
        return np.einsum("njab,njka->njkb", self.reference_tractions, result)

    def _weighted(self, stresses: Array) -> Array:
        return np.einsum(
            "nija,jk,nab->nikb",
            stresses,
            self.element.mass,
            self.reference_compliance,
            optimize=True,
        )

    def stiffness(self, cell: Indices, facets: Indices) -> Array:
        """Return the quadratic form of the tractions on some facets of cells.

        Args:
            cell: (m,) cells.
            facets: (m, k) facets of each cell.

        Returns:
            (m, k, d, d, k, d, d): facets, their vertices in ascending order, components, twice.
        """
        d = self.cells.points.shape[2]
        size = (d + 1) * d * d
        products = self.element.products[:, :, :size, :size]
        forms = np.tensordot(self.reference_compliance[cell], products, axes=([1, 2], [0, 1]))
        forms = forms.reshape(-1, d + 1, d, d, d + 1, d, d) * self.cells.volumes[
            cell, None, None, None, None, None, None
        ]
        row = np.arange(len(cell))[:, None, None]
        forms = forms[row, facets[:, :, None], :, :, facets[:, None, :]]
        to_reference = self.reference_tractions[cell[:, None], facets]
        return np.einsum(
            "nfgskta,nfkx,ngay->nfsxgty", forms, to_reference, to_reference, optimize=True
        )
