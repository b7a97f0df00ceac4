"""Symmetric stresses on simplices, by their tractions on facets and their divergence.

A simplex with d + 1 vertices is divided by its centroid into d + 1 subcells, as in the element of
Johnson and Mercier (1978; in any dimension Gopalakrishnan, Guzman and Lee 2024): subcell i has the
vertices of the simplex without vertex i, and the centroid. Here stresses are symmetric, quadratic
in each subcell, and have continuous tractions between subcells. For all linear tractions on the
facets and all linear divergences that balance each other in force and moment there is such a
stress; of all, the one of the least norm on the reference simplex is taken. It depends linearly on
these data, and reproduces linear stresses.

The reference simplex has the vertices 0, e_1, ..., e_d. For x = x_0 + B X the stress is B S B',
with the reference stress S.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.guaranteed.simplices import Simplices, mean_products


@dataclass(frozen=True)
class StressElement:
    """The reference element; nsym = d (d + 1) / 2, and q nodes of a quadratic function.

    Nodes of a subcell are its d + 1 vertices and the midpoints of its edges; its vertex i is the
    centroid of the simplex in subcell i.

    Attributes:
        basis: (nsym, d, d) orthonormal basis of the symmetric matrices.
        values: (d + 1, q, nsym, m) stresses at the nodes of subcells for unit data. The m data are
            first (facet i, vertex j != i, component) S grad lambda_i at the vertices of facet i,
            where lambda_i is the barycentric coordinate; then (vertex, component) the divergence at
            the vertices of the simplex. The data must be in equilibrium.
        elevation: (q, d + 1) values at the nodes of the barycentric coordinates of a subcell.
        mass: (q, q) integrals over a subcell of products of nodal functions, relative to the volume
            of the simplex.
        products: (nsym, nsym, m, m) integrals of the products of the components of two stresses,
            relative to the volume of the simplex.
    """

    basis: Array
    values: Array
    elevation: Array
    mass: Array
    products: Array


@cache
def stress_element(d: int) -> StressElement:
    """Return the reference element in dimension d."""
    n, nsym = d + 1, d * (d + 1) // 2
    basis = np.zeros((nsym, d, d))
    pairs = [(k, k) for k in range(d)] + list(combinations(range(d), 2))
    for k, (i, j) in enumerate(pairs):
        basis[k, i, j] = basis[k, j, i] = 1.0 if i == j else np.sqrt(0.5)
    edges = list(combinations(range(n), 2))
    size = n + len(edges)
    ends = np.eye(n)[np.array(edges)]
    elevation = np.vstack([np.eye(n), ends.mean(axis=1)])
    # lambda_k (2 lambda_k - 1) and 4 lambda_a lambda_b as sums of products
    nodal = np.zeros((size, n, n))
    nodal[range(n), range(n), range(n)] = 2.0
    nodal[:n] -= 0.5 * (np.eye(n)[:, :, None] + np.eye(n)[:, None])
    nodal[n:] = 2.0 * (
        ends[:, 0, :, None] * ends[:, 1, None] + ends[:, 1, :, None] * ends[:, 0, None]
    )
    mass = np.einsum("pab,qcd,abcd->pq", nodal, nodal, mean_products(n, 4), optimize=True) / n

    # unknown stresses, in units of which the norm is Euclidean
    root = np.linalg.inv(np.linalg.cholesky(mass)).T
    unknown = np.eye(n * size * nsym).reshape(n, size, nsym, -1)
    scaled = np.einsum("pq,iqaz->ipaz", root, unknown)
    stress = np.einsum("ipaz,akl->ipklz", scaled, basis)
    gradients = np.vstack([-np.ones(d), np.eye(d)])
    facets = n * d * d
    data = np.eye(facets + n * d).reshape(n * d + n, d, -1)
    tractions = np.zeros((n, n, d, data.shape[2]))
    tractions[~np.eye(n, dtype=np.bool_)] = data[: n * d]
    equations, right = [], []
    for i in range(n):
        opposite = [p for p in range(size) if elevation[p, i] == 0.0]
        equations.append(np.einsum("pklz,l->pkz", stress[i, opposite], gradients[i]))
        right.append(np.einsum("pj,jkz->pkz", elevation[opposite], tractions[i]))
        slopes = gradients - gradients[i]
        slopes[i] = n * gradients[i]  # of the centroid, vertex i of the subcell
        derivatives = 2.0 * np.einsum("pab,bl->pal", nodal, slopes)  # at vertices a
        equations.append(np.einsum("pklz,pal->akz", stress[i], derivatives))
        vertices = np.eye(n)
        vertices[i] = 1.0 / n
        right.append(np.einsum("aj,jkz->akz", vertices, data[n * d :]))
        for j in range(i):
            # nodes on the common facet: vertex i of subcell i is vertex j of subcell j
            exchanged = elevation.copy()
            exchanged[:, [i, j]] = exchanged[:, [j, i]]
            own = [p for p in range(size) if elevation[p, j] == 0.0]
            its = [int(np.argmin(np.abs(exchanged - elevation[p]).sum(axis=1))) for p in own]
            jump = stress[i, own] - stress[j, its]
            equations.append(np.einsum("pklz,l->pkz", jump, gradients[i] - gradients[j]))
            right.append(np.zeros((len(own), d, data.shape[2])))
    matrix = np.concatenate(equations).reshape(-1, unknown.shape[-1])
    least = np.linalg.pinv(matrix, 1e-10) @ np.concatenate(right).reshape(len(matrix), -1)
    values = np.einsum("pq,iqam->ipam", root, least.reshape(n, size, nsym, -1))
    products = np.einsum("ijax,jk,ikby->abxy", values, mass, values, optimize=True)
    return StressElement(basis, values, elevation, mass, products)


@dataclass(frozen=True)
class CellStresses:
    """Stresses of the element in cells, and their energies.

    Tractions on cells are arrays (n, d + 1, d + 1, d): `tractions[:, j, k]` acts on facet j of a
    cell at its vertex k, and is zero for j = k. Stresses are arrays (n, d + 1, q, nsym) as in
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
        """Return the stresses with these tractions, and divergence (n, d + 1, d) at vertices."""
        n, corners = tractions.shape[:2]
        scaled = tractions @ np.swapaxes(self.reference_tractions, 2, 3)
        scaled = scaled[:, ~np.eye(corners, dtype=np.bool_)].reshape(n, -1)
        values = self.element.values
        if divergence is None:
            return np.asarray(np.tensordot(scaled, values[..., : scaled.shape[1]], axes=([1], [3])))
        pulled = np.einsum("nab,njb->nja", self.cells.inverses, divergence).reshape(n, -1)
        return np.asarray(np.tensordot(np.hstack([scaled, pulled]), values, axes=([1], [3])))

    def of_linear(self, stresses: Array) -> Array:
        """Return linear stresses in cells, from symmetric matrices (n, d + 1, d, d) at vertices."""
        inner = self.cells.inverses
        pulled = inner[:, None] @ stresses @ np.swapaxes(inner, 1, 2)[:, None]
        at_vertices = np.tensordot(pulled, self.element.basis, axes=([2, 3], [1, 2]))
        corners = at_vertices.shape[1]
        result = np.repeat(at_vertices[:, None], corners, axis=1)
        result[:, range(corners), range(corners)] = at_vertices.mean(axis=1, keepdims=True)
        return np.asarray(self.element.elevation @ result)

    def energies(self, stresses: Array) -> Array:
        """Return the squared norms (n,) of stresses, of twice the complementary energy."""
        products = (stresses * self._weighted(stresses)).sum(axis=(1, 2, 3))
        return np.asarray(self.cells.volumes * products)

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
        return np.asarray(result @ self.reference_tractions)

    def _weighted(self, stresses: Array) -> Array:
        flat = stresses.reshape(len(stresses), -1, stresses.shape[3])
        strains = flat @ self.reference_compliance
        return np.asarray(self.element.mass @ strains.reshape(stresses.shape))

    def facet_stiffness(self) -> Array:
        """Return the quadratic forms of the tractions on each facet alone.

        (n, d + 1, d, d, d, d): facet, its vertices in ascending order, components, the same again.
        """
        n, corners, d = self.cells.points.shape
        size, nsym = d * d, self.compliance.shape[1]
        products = self.element.products[:, :, : corners * size, : corners * size]
        blocks = products.reshape(nsym * nsym, corners, size, corners, size)
        blocks = np.stack([blocks[:, j, :, j] for j in range(corners)], axis=1)
        forms = self.reference_compliance.reshape(n, -1) @ blocks.reshape(nsym * nsym, -1)
        forms = (
            forms.reshape(n, corners, d, d, d, d)
            * self.cells.volumes[:, None, None, None, None, None]
        )
        matrix = self.reference_tractions[:, :, None]
        forms = np.swapaxes(matrix, -1, -2) @ forms.reshape(n, corners, d, d, size)
        forms = forms.reshape(n, corners, size * d, d) @ self.reference_tractions
        return np.asarray(forms.reshape(n, corners, d, d, d, d))
