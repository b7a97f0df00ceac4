"""Simplices: polynomials, shapes, constants, stresses; the cells of a mesh that a rank owns.

Vertices are in ascending order of their global numbers, so that two cells agree on their order in a
common facet. Facet j is opposite to vertex j. A *loading* of n cells (n, d + 1, d + 1, d) holds in
[:, j, :d] the tractions on facet j at its d vertices, in [:, j, d] the load in the cell at vertex
j; both are linear. A stress is in equilibrium with it if the load is minus its divergence.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations, permutations
from math import factorial
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.compat import geometry_degree, geometry_dofmap
from dolfinx_tresca._base.parallel import summed_at_nodes
from dolfinx_tresca.errors import InputError

#: Constants of the simplex with the vertices 0, e_1, e_1 + e_2, ..., by its dimension: upper bounds
#: of |w| / |sym grad w|, and of |w|_F / |F|^(1/2) / |sym grad w| on its facets F, where w minus its
#: nearest linear function is in |w|: docs/theory/guaranteed.md, tests/guaranteed/test_constants.py.
POINCARE = {2: 0.540, 3: 0.768}
TRACE = {2: 1.522, 3: 4.473}


@cache
def mean_products(corners: int, factors: int) -> Array:
    """Return the mean of lambda_i lambda_j ... in a simplex at [i, j, ...] (`factors` axes)."""
    index = np.indices((corners,) * factors)
    result = np.full(index.shape[1:], factorial(corners - 1) / factorial(corners - 1 + factors))
    for k in range(1, factors):  # the factorial of each power
        result *= 1.0 + (index[:k] == index[k]).sum(axis=0)
    return result


def midpoint_values(values: Array) -> Array:
    """Return the means (..., k, k, c) of each two values (..., k, c) at vertices, for midpoints."""
    return np.asarray(0.5 * (values[..., :, None, :] + values[..., None, :, :]))


def bernstein(values: Array) -> Array:
    """Return coefficients C (..., k, k, c) of the quadratic functions sum C_ij lambda_i lambda_j.

    The mean of the values [i, j] and [j, i] is that in the middle between the vertices i and j.
    """
    corners = np.einsum("...iic->...ic", values)
    return np.asarray(values + np.swapaxes(values, -3, -2) - midpoint_values(corners))


@cache
def lagrange(corners: int) -> tuple[Array, Array, Array]:
    """Return Lagrange's basis of degree 2: q functions, with a node for each two vertices i <= j.

    The result has the nodes' barycentric coordinates (q, corners), in the order of `triu_indices`,
    `bernstein`'s coefficients (corners, corners, q), and means (q, q) of two functions' products.
    """
    i, j = np.triu_indices(corners)
    values = np.zeros((corners, corners, len(i)))
    values[i, j, range(len(i))] = values[j, i, range(len(i))] = 1.0
    basis = bernstein(values)
    means = np.einsum("abp,cdq,abcd->pq", basis, basis, mean_products(corners, 4), optimize=True)
    return midpoint_values(np.eye(corners))[i, j], basis, means


@cache
def symmetric(d: int) -> Array:
    """Return an orthonormal basis (d * d, k) of matrices like stresses, with k = d (d + 1) / 2."""
    # transposition has the eigenvalues -1, of antisymmetric matrices, and 1, in this order
    transposed = np.swapaxes(np.eye(d * d).reshape(d, d, -1), 0, 1).reshape(d * d, -1)
    return np.asarray(np.linalg.eigh(transposed)[1][:, d * (d - 1) // 2 :])


def facet_vertices(d: int) -> Indices:
    """Return the vertices (d + 1, d) of each facet j of a simplex: all but vertex j."""
    return np.array([[k for k in range(d + 1) if k != j] for j in range(d + 1)])


def rigid_motions(arms: Array) -> Array:
    """Return d translations, then rotations about 0 (..., r, k, d), at points (..., k, d)."""
    d = arms.shape[-1]
    result = np.zeros((*arms.shape[:-2], d * (d + 1) // 2, *arms.shape[-2:]))
    result[..., range(d), :, range(d)] = 1.0
    for row, (i, j) in enumerate(combinations(range(d), 2), d):
        result[..., row, :, i], result[..., row, :, j] = -arms[..., j], arms[..., i]
    return result


class Simplices:
    """The shapes of n simplices with d + 1 vertices, whether they belong to a mesh or not.

    Attributes:
        points: (n, d + 1, d) the vertices [length].
        frames: (n, d, d) matrices whose columns are the edges from vertex 0 to the other vertices.
        volumes: (n,) volumes, in 2D areas.
        gradients: (n, d + 1, d) gradients of the barycentric coordinates.
        heights: (n, d + 1) heights of the vertices over the opposite facets.
        areas: (n, d + 1) areas of the facets, in 2D lengths.
        normals: (n, d + 1, d) outward unit normals of the facets.
    """

    def __init__(self, points: Array) -> None:
        """Compute the shapes."""
        self.points, self.d = points, points.shape[2]
        self.frames = np.swapaxes(points[:, 1:] - points[:, :1], 1, 2)
        self.volumes: Array = np.abs(np.linalg.det(self.frames)) / factorial(self.d)
        inner = np.linalg.inv(self.frames)
        self.gradients = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
        self.heights: Array = 1.0 / np.linalg.norm(self.gradients, axis=2)
        self.areas: Array = self.d * self.volumes[:, None] / self.heights
        self.normals = -self.gradients * self.heights[:, :, None]

    def resultants(self, loading: Array) -> Array:
        """Return forces (n, d + 1, d) at vertices with a loading's work on linear displacements."""
        volumes, areas = self.volumes[:, None, None], self.areas[:, :, None, None]
        forces = volumes * (mean_products(self.d + 1, 2) @ loading[:, :, self.d])
        products = mean_products(self.d, 2)
        for j, vertices in enumerate(facet_vertices(self.d)):
            forces[:, vertices] += areas[:, j] * (products @ loading[:, j, : self.d])
        return forces

    def load_factors(self) -> Array:
        """Return upper bounds (n, d + 2) of |w| and of |w|_F on each facet F, over |sym grad w|.

        w is any displacement minus its nearest linear function. `POINCARE` is multiplied by s^2 / t
        [length], with the largest and the least singular value s and t of the matrix whose columns
        are the edges of a path through all vertices: the path with the least sum of squares.
        """
        paths = list(permutations(range(self.d + 1)))
        steps = np.diff(self.points[:, paths], axis=2)
        shortest = np.square(steps).sum(axis=(2, 3)).argmin(axis=1)
        steps = steps[np.arange(len(steps)), shortest]
        squares = np.linalg.eigvalsh(steps @ np.swapaxes(steps, 1, 2))
        factors = np.insert(self.areas / self.volumes[:, None] / factorial(self.d), 0, 1.0, axis=1)
        factors = np.sqrt(factors) * ([POINCARE[self.d]] + (self.d + 1) * [TRACE[self.d]])
        return np.asarray((squares[:, -1] / np.sqrt(squares[:, 0]))[:, None] * factors)

    def to_loading(self, stress: Array) -> Array:
        """Return the loading of linear stresses, which are given at vertices (n, d + 1, d, d)."""
        products = np.einsum("nkab,njb->njka", stress, self.normals)
        tractions = products[:, np.arange(self.d + 1)[:, None], facet_vertices(self.d)]
        load = -np.einsum("nkab,nkb->na", stress, self.gradients)[:, None, None]
        return np.concatenate([tractions, np.repeat(load, self.d + 1, axis=1)], axis=2)


def _regular_frame(d: int) -> Array:
    """Return the matrix (d, d) of the edges at a vertex, its columns, of a regular simplex."""
    return np.asarray(np.linalg.cholesky(0.5 * (np.eye(d) + 1.0)).T)


@cache
def stress_products(d: int) -> Array:
    """Return matrices A_ij (k, k, m, m) that give the norms of stresses on the regular simplex.

    A squared norm is y'(sum C_ij A_ij) y times the volume: C (k, k) is the compliance in the basis
    `symmetric`, and y the m entries of a loading, but with S grad lambda_j for tractions S n of the
    stress S. S is that of least norm in the element of Johnson and Mercier (1978): symmetric,
    quadratic in each subcell (i has the centroid as vertex i), of continuous tractions.
    """
    n, (nodes, shapes, means) = d + 1, lagrange(d + 1)  # n vertices, and as many subcells
    # unknown stresses at the nodes of subcells, in units of which the norm is Euclidean
    root = np.kron(np.linalg.inv(np.linalg.cholesky(means / n)).T, symmetric(d))
    stress = np.kron(np.eye(n), root).reshape(n, len(nodes), d, d, -1)
    loading = np.eye(n * n * d).reshape(n, n, d, -1)
    gradients = Simplices(np.vstack([np.zeros(d), _regular_frame(d).T])[None]).gradients[0]
    corners = np.tile(np.eye(n), (n, 1, 1))  # of the subcells, in barycentric coordinates
    corners[range(n), range(n)] = 1.0 / n
    points = (nodes @ corners).reshape(-1, n).round(9)
    numbers = np.unique(points, axis=0, return_inverse=True)[1].reshape(n, -1)
    equations, right = [], []
    for i, vertices in enumerate(facet_vertices(d)):
        # on the facet of the simplex, the tractions of the loading
        on_facet = nodes[:, i] == 0.0
        equations.append(np.einsum("pklz,l->pkz", stress[i, on_facet], gradients[i]))
        right.append(np.tensordot(nodes[on_facet][:, vertices], loading[i, :d], axes=1))
        # at the vertices of the subcell, the load is minus the divergence
        slopes = np.linalg.solve(corners[i].T, gradients)
        divergence = 2.0 * np.einsum("abp,pklz,bl->akz", shapes, stress[i], slopes, optimize=True)
        equations.append(-divergence)
        right.append(np.tensordot(corners[i], loading[:, d], axes=1))
        for j in range(i):
            _, ours, theirs = np.intersect1d(numbers[i], numbers[j], return_indices=True)
            jump = stress[i, ours] - stress[j, theirs]
            equations.append(np.einsum("pklz,l->pkz", jump, gradients[i] - gradients[j]))
            right.append(np.zeros((len(ours), d, n * n * d)))
    matrix = np.concatenate(equations).reshape(-1, stress.shape[-1])
    least = np.linalg.pinv(matrix, 1e-10) @ np.concatenate(right).reshape(len(matrix), -1)
    least = least.reshape(n * len(nodes), symmetric(d).shape[1], -1)
    return np.asarray(np.einsum("pax,pby->abxy", least, least, optimize=True))


class StressEnergies:
    """Squared norms of the stresses of `stress_products` as quadratic functions of loadings.

    A squared norm is twice the complementary energy; a loading that is no balance is projected.
    """

    def __init__(self, cells: Simplices, compliance: Array) -> None:
        """Compute the matrices of all cells; `compliance` (n, k, k) is in the basis `symmetric`."""
        n, corners, d = cells.points.shape
        from_regular = cells.frames @ np.linalg.inv(_regular_frame(d))
        maps = np.einsum("nia,njb->nabij", from_regular, from_regular).reshape(n, d * d, d * d)
        maps = symmetric(d).T @ maps @ symmetric(d)  # transposed, of stresses S to B S B'
        pulled = maps @ compliance @ np.swapaxes(maps, 1, 2) * cells.volumes[:, None, None]
        self._matrices = np.tensordot(pulled, stress_products(d), 2)
        # stresses S of the regular simplex become B S B'; tractions S grad lambda_j, with the
        # barycentric lambda_j and the height h_j, become B S B'n = -h_j B S grad lambda_j
        self._scales = np.ones((n, corners, corners, 1))
        self._scales[:, :, :d] = -1.0 / cells.heights[:, :, None, None]
        self._inverses = np.linalg.inv(from_regular)

    def derivative(self, loading: Array) -> Array:
        """Return half the derivative (n, d + 1, d + 1, d) of squared norms by the loading."""
        (n, m, _), d = self._matrices.shape, self._inverses.shape[1]
        values = (self._scales * loading).reshape(n, m // d, d) @ np.swapaxes(self._inverses, 1, 2)
        products = (self._matrices @ values.reshape(n, m, 1)).reshape(n, m // d, d)
        return np.asarray(self._scales * (products @ self._inverses).reshape(loading.shape))

    def squared_norms(self, loading: Array) -> Array:
        """Return the squared norms (n,) of the stresses with a loading."""
        return np.asarray((loading * self.derivative(loading)).sum(axis=(1, 2, 3)))

    def of_facets(self) -> Array:
        """Return Q (n, d + 1, d * d, d * d): t'Q t is the squared norm for t on one facet alone."""
        n, d, _ = self._inverses.shape
        blocks = self._matrices.reshape(n, d + 1, (d + 1) * d, d + 1, (d + 1) * d)
        blocks = np.einsum("njajb->njab", blocks)[:, :, : d * d, : d * d]
        maps = np.kron(np.eye(d)[None], self._inverses)[:, None]
        return np.asarray(self._scales[:, :, :1] ** 2 * (np.swapaxes(maps, 2, 3) @ blocks @ maps))


class MeshCells(Simplices):
    """The cells that this rank owns, with vertices in ascending order of their global numbers.

    Attributes:
        order: (n, d + 1) the local numbers of the vertices in DOLFINx.
        quadratics: the space of vectors that are quadratic in cells, and may jump between cells.
        dofs: (n, q) nodes of `quadratics` on this rank, in the order of `lagrange`.
        vertices: (n, d + 1) global numbers of the vertices.
        facets: (n, d + 1) numbers on this rank of the facets, which `facet_map` distributes.
        nodes: (n, d + 1, d + 1) nodes of V on this rank: for degree 1 at vertex i, for degree 2 in
            the middle between the vertices i and j; `bernstein` takes means of (i, j) and (j, i).
        facet_nodes: (n, d + 1, d, d) the nodes of V on each facet, as in `nodes`.
        signs: (n, d + 1, 1, 1) 1 on one side of each facet and -1 on the other one.
        sides: (facets, 1, 1) the number of cells at each facet of this rank.
    """

    def __init__(self, V: Any) -> None:
        """Number vertices and nodes of cells in an order that neighbours share. Collective."""
        mesh, topology = V.mesh, V.mesh.topology
        kind, degree = topology.cell_name(), geometry_degree(mesh)
        if kind not in ("triangle", "tetrahedron") or degree != 1:
            raise InputError(
                "a guaranteed bound needs triangles or tetrahedra with straight edges, found "
                f"{kind} cells of degree {degree}. Divide cells into simplices."
            )
        d, count = topology.dim, topology.index_map(topology.dim).size_local
        topology.create_connectivity(d, d - 1)
        topology.create_connectivity(d - 1, d)
        self.facet_map = topology.index_map(d - 1)
        local, facets = (
            topology.connectivity(d, dim).array.reshape(-1, d + 1)[:count] for dim in (0, d - 1)
        )
        numbers = topology.index_map(0).local_to_global(local.ravel()).reshape(local.shape)
        cell, order = np.arange(count)[:, None], np.argsort(numbers, axis=1)
        super().__init__(mesh.geometry.x[geometry_dofmap(mesh)[cell, order], :d])
        self.V, self.order = V, order
        self.vertices, self.facets = numbers[cell, order], facets[cell, order]
        # local numbers of nodes of degree 2: vertices i = j, and middles between vertices i and j
        between = np.diag(np.arange(d + 1))
        for edge, (i, j) in enumerate(basix.topology(mesh.basix_cell())[1], d + 1):
            between[i, j] = between[j, i] = edge
        edges = between[order[:, :, None], order[:, None]]
        is_quadratic = V.element.basix_element.degree == 2
        nodes = edges if is_quadratic else np.repeat(order[:, :, None], d + 1, axis=2)
        self.nodes = V.dofmap.list[cell[:, None], nodes]
        self.quadratics = fem.functionspace(mesh, ("DG", 2, (d,)))
        self.dofs = self.quadratics.dofmap.list[cell, edges[(slice(None), *np.triu_indices(d + 1))]]
        self.facet_nodes = self.nodes[:, facet_vertices(d)[:, :, None], facet_vertices(d)[:, None]]
        # the orientation of a facet in the boundary of a cell, opposite for its two cells
        turns = (-1.0) ** np.arange(d + 1) * np.linalg.det(self.frames)[:, None]
        self.signs = np.sign(turns)[:, :, None, None]
        self.sides = self.facet_sums(np.ones_like(self.signs))

    def facet_sums(self, values: Array) -> Array:
        """Return the sums (facets, a, b) over both sides of values (n, d + 1, a, b). Collective."""
        rows = values.reshape(*self.facets.shape, values.shape[2] * values.shape[3])
        return summed_at_nodes(self.facet_map, self.facets, rows).reshape(-1, *values.shape[2:])

    def on_sides(self, tractions: Array) -> Array:
        """Return the loading of tractions (facets, d * d) and their opposites on the -1 side."""
        on_cells = self.signs * tractions.reshape(-1, self.d, self.d)[self.facets]
        return np.pad(on_cells, ((0, 0), (0, 0), (0, 1), (0, 0)))

    def spread(self, owned: Array) -> Array:
        """Return values (owned nodes of V, k) at all nodes of V on this rank. Collective."""
        return summed_at_nodes(self.V.dofmap.index_map, np.arange(len(owned)), owned)

    def require(self, holds: Any, needed: str) -> None:
        """Raise an InputError with what a bound needs, unless it holds on all ranks. Collective."""
        if not self.V.mesh.comm.allreduce(bool(holds), op=MPI.LAND):
            raise InputError(f"a guaranteed bound needs {needed}.")
