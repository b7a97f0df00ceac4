"""Simplices: polynomials, shapes, constants, stresses; the cells of a mesh that a rank owns.

Vertices are in ascending order of their global numbers, so that two cells agree on the order of the
vertices of their common facet. Facet j is opposite to vertex j.

The *loading* of cells, (n, d + 1, d + 1, d), are for each j the tractions on facet j at its
vertices, then the load in the cell at vertex j; both are linear. A stress is in equilibrium with
its loading: the load is minus its divergence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations, permutations
from math import factorial
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices
from dolfinx_tresca._base.compat import geometry_degree, geometry_dofmap
from dolfinx_tresca._base.parallel import summed_at_nodes
from dolfinx_tresca.errors import InputError

#: Constants of the simplex with the vertices 0, e_1, e_1 + e_2, ..., by its dimension: upper bounds
#: of |w| / |sym grad w|, and of |w|_F / |F|^(1/2) / |sym grad w| on its facets F, for w minus its
#: nearest linear function; and the latter for the quadratic part of w on F, its projection onto
#: quadratic functions that are orthogonal to linear ones. Their proof is in
#: docs/theory/guaranteed.md, and tests/guaranteed/test_constants.py computes them.
POINCARE = {2: 0.540, 3: 0.768}
TRACE = {2: 1.522, 3: 4.473}
QUADRATIC_TRACE = {2: 1.378, 3: 3.259}


@cache
def mean_products(corners: int, factors: int) -> Array:
    """Return the means over a simplex of products of barycentric coordinates.

    The result has `factors` axes of length `corners`; its entry (i, j, ...) is the mean of lambda_i
    lambda_j ...
    """
    result = np.empty((corners,) * factors)
    scale = factorial(corners - 1) / factorial(corners - 1 + factors)
    for index in np.ndindex(*result.shape):
        powers = np.bincount(index, minlength=corners)
        result[index] = scale * np.prod([factorial(int(power)) for power in powers])
    return result


def pair_means(values: Array) -> Array:
    """Return the means (..., k, k, c) of the values (..., k, c) at each two vertices."""
    return np.asarray(0.5 * (values[..., :, None, :] + values[..., None, :, :]))


def bernstein(values: Array) -> Array:
    """Return Bernstein's coefficients C (..., k, k, c) of quadratic functions on simplices.

    A function is the sum of C_ij lambda_i lambda_j, and between its least and largest coefficient.
    The mean of values (i, j) and (j, i) is that in the middle between the vertices i and j.
    """
    corners = np.einsum("...iic->...ic", values)
    return np.asarray(values + np.swapaxes(values, -3, -2) - pair_means(corners))


@cache
def lagrange(corners: int) -> tuple[Array, Array, Array]:
    """Return Lagrange's basis of degree 2 on a simplex, with a node for each two vertices i <= j.

    Returns:
        the barycentric coordinates (k, corners) of the nodes, in the order of `triu_indices`;
        `bernstein`'s coefficients (corners, corners, k) of the basis; and the means (k, k) of
        products of two basis functions.
    """
    i, j = np.triu_indices(corners)
    values = np.zeros((corners, corners, len(i)))
    values[i, j, range(len(i))] = values[j, i, range(len(i))] = 1.0
    basis = bernstein(values)
    means = np.einsum("abp,cdq,abcd->pq", basis, basis, mean_products(corners, 4), optimize=True)
    return pair_means(np.eye(corners))[i, j], basis, means


def opposite(d: int) -> Indices:
    """Return the vertices (d + 1, d) of each facet of a simplex."""
    return np.array([[k for k in range(d + 1) if k != j] for j in range(d + 1)])


def rigid_motions(arms: Array) -> Array:
    """Return translations and rotations (..., r, k, d) at the ends of arms (..., k, d)."""
    d = arms.shape[-1]
    turns = list(combinations(range(d), 2))
    result = np.zeros((*arms.shape[:-2], d + len(turns), *arms.shape[-2:]))
    result[..., range(d), :, range(d)] = 1.0
    for row, (i, j) in enumerate(turns, d):
        result[..., row, :, i], result[..., row, :, j] = -arms[..., j], arms[..., i]
    return result


@dataclass(frozen=True)
class Simplices:
    """Simplices with d + 1 vertices at `points` (n, d + 1, d) [length]."""

    points: Array

    @property
    def d(self) -> int:
        """The dimension."""
        return int(self.points.shape[2])

    @cached_property
    def frames(self) -> Array:
        """(n, d, d) the matrices B of the maps x = x_0 + B X from the reference simplex."""
        return np.swapaxes(self.points[:, 1:] - self.points[:, :1], 1, 2)

    @cached_property
    def volumes(self) -> Array:
        """(n,) volumes, in 2D areas."""
        return np.asarray(np.abs(np.linalg.det(self.frames)) / factorial(self.d))

    @cached_property
    def gradients(self) -> Array:
        """(n, d + 1, d) gradients of the barycentric coordinates."""
        inner = np.linalg.inv(self.frames)
        return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)

    @cached_property
    def heights(self) -> Array:
        """(n, d + 1) heights of the vertices over the opposite facets."""
        return np.asarray(1.0 / np.linalg.norm(self.gradients, axis=2))

    @cached_property
    def areas(self) -> Array:
        """(n, d + 1) areas of the facets, in 2D lengths."""
        return np.asarray(self.d * self.volumes[:, None] / self.heights)

    @cached_property
    def normals(self) -> Array:
        """(n, d + 1, d) outward unit normals of the facets."""
        return -self.gradients * self.heights[:, :, None]

    def terms(self, loading: Array) -> Iterator[tuple[Indices, Array, Array]]:
        """Yield vertices (k,), sizes (n,) and a view (n, k, d) of each term of a loading.

        They are those of the cells, then of each facet.
        """
        yield np.arange(self.d + 1), self.volumes, loading[:, :, self.d]
        for j, vertices in enumerate(opposite(self.d)):
            yield vertices, self.areas[:, j], loading[:, j, : self.d]

    def resultants(self, loading: Array) -> Array:
        """Return forces (n, d + 1, d) at vertices that do the work of a loading there.

        Their work on a linear displacement is that of its values at the vertices.
        """
        result = np.zeros_like(self.points)
        for vertices, sizes, values in self.terms(loading):
            means = mean_products(len(vertices), 2) @ values
            result[:, vertices] += sizes[:, None, None] * means
        return result

    def internal_forces(self, stress: Array) -> Array:
        """Return the forces (n, d + 1, d) at vertices of linear stresses (n, d + 1, d, d) there."""
        means = self.volumes[:, None, None] * stress.mean(axis=1)
        return np.asarray(self.gradients @ np.swapaxes(means, 1, 2))

    @cached_property
    def map_factors(self) -> Array:
        """(n,) factors [length] with which the constants of `POINCARE` and `TRACE` grow.

        They are s^2 / t with the largest and the least singular value s, t of the affine map from
        the simplex of `POINCARE`. Its columns are the edges of a path through all vertices. Each
        path gives a bound; the shortest is taken.
        """
        squares = np.square(self.points[:, :, None] - self.points[:, None]).sum(axis=3)
        orders = np.array(list(permutations(range(self.d + 1))))
        lengths = squares[:, orders[:, :-1], orders[:, 1:]].sum(axis=2)
        shortest = orders[lengths.argmin(axis=1)]
        steps = np.diff(np.take_along_axis(self.points, shortest[:, :, None], axis=1), axis=1)
        values = np.linalg.eigvalsh(steps @ np.swapaxes(steps, 1, 2))
        return np.asarray(values[:, -1] / np.sqrt(values[:, 0]))

    @property
    def poincare_factors(self) -> Array:
        """(n,) upper bounds of |w| / |sym grad w| [length], w minus its linear part."""
        return self.map_factors * POINCARE[self.d]

    @property
    def trace_factors(self) -> Array:
        """(n, d + 1) upper bounds of |w|_F / |sym grad w| [length^(1/2)] on each facet F."""
        ratios = self.areas / (factorial(self.d) * self.volumes[:, None])
        return np.asarray(self.map_factors[:, None] * np.sqrt(ratios) * TRACE[self.d])

    @property
    def quadratic_ratio(self) -> float:
        """The ratio of the bounds `trace_factors` of quadratic functions to those of all."""
        return QUADRATIC_TRACE[self.d] / TRACE[self.d]

    def loading_of(self, stress: Array) -> Array:
        """Return the loading of linear stresses (n, d + 1, d, d) at the vertices."""
        d = self.d
        tractions = np.einsum("njkab,njb->njka", stress[:, opposite(d)], self.normals)
        divergence = np.einsum("nkab,nkb->na", stress, self.gradients)[:, None, None]
        load = np.broadcast_to(-divergence, (len(stress), d + 1, 1, d))
        return np.concatenate([tractions, load], axis=2)


@cache
def symmetric_basis(d: int) -> Array:
    """Return an orthonormal basis (d (d + 1) / 2, d, d) of the symmetric matrices."""
    axes = np.eye(d)
    i, j = np.triu_indices(d)
    outer = axes[i][:, :, None] * axes[j][:, None]
    scales = np.where(i == j, 0.5, np.sqrt(0.5))
    return np.asarray(scales[:, None, None] * (outer + np.swapaxes(outer, 1, 2)))


def _regular_frame(d: int) -> Array:
    """Return the matrix (d, d) whose columns are the edges at a vertex of the regular simplex."""
    return np.asarray(np.linalg.cholesky(0.5 * (np.eye(d) + 1.0)).T)


@cache
def stress_products(d: int) -> Array:
    """Return products of stresses of the stress element on the regular simplex of edge length 1.

    The simplex is divided by its centroid into d + 1 subcells, as in the element of Johnson and
    Mercier (1978; in any dimension Gopalakrishnan, Guzman and Lee 2024): subcell i has the centroid
    in place of vertex i. Here stresses are symmetric, quadratic in each subcell, and have
    continuous tractions between subcells. For each loading in equilibrium there is such a stress;
    of all, that of the least norm is taken. It depends linearly on the loading, and reproduces
    linear stresses.

    Returns:
        (nsym, nsym, m, m) means over the simplex of products of two components of stresses in
        `symmetric_basis`. The m data are the entries of the loading, with tractions S grad lambda_j
        of the stress S.
    """
    n, basis = d + 1, symmetric_basis(d)
    places, shapes, means = lagrange(n)
    size, nsym = len(places), len(basis)
    # unknown stresses at the nodes of subcells, in units of which the norm is Euclidean
    root = np.linalg.inv(np.linalg.cholesky(means / n)).T
    unknown = np.eye(n * size * nsym).reshape(n, size, nsym, -1)
    stress = np.einsum("pq,iqaz,akl->ipklz", root, unknown, basis, optimize=True)
    loading = np.eye(n * n * d).reshape(n, n, d, -1)
    inner = np.linalg.inv(_regular_frame(d))
    gradients = np.vstack([-inner.sum(axis=0), inner])
    corners = np.tile(np.eye(n), (n, 1, 1))  # of the subcells, in barycentric coordinates
    corners[range(n), range(n)] = 1.0 / n
    points = (places @ corners).reshape(-1, n).round(9)
    numbers = np.unique(points, axis=0, return_inverse=True)[1].reshape(n, size)
    equations, right = [], []
    for i, vertices in enumerate(opposite(d)):
        on_facet = places[:, i] == 0.0
        equations.append(np.einsum("pklz,l->pkz", stress[i, on_facet], gradients[i]))
        right.append(np.tensordot(places[on_facet][:, vertices], loading[i, :d], axes=1))
        slopes = np.linalg.solve(corners[i].T, gradients)
        divergence = 2.0 * np.einsum("abp,pklz,bl->akz", shapes, stress[i], slopes, optimize=True)
        equations.append(-divergence)  # at vertices a
        right.append(np.tensordot(corners[i], loading[:, d], axes=1))
        for j in range(i):
            _, ours, theirs = np.intersect1d(numbers[i], numbers[j], return_indices=True)
            jump = stress[i, ours] - stress[j, theirs]
            equations.append(np.einsum("pklz,l->pkz", jump, gradients[i] - gradients[j]))
            right.append(np.zeros((len(ours), d, n * n * d)))
    matrix = np.concatenate(equations).reshape(-1, unknown.shape[-1])
    least = np.linalg.pinv(matrix, 1e-10) @ np.concatenate(right).reshape(len(matrix), -1)
    least = least.reshape(n * size, nsym, -1)  # orthonormal at the nodes of each subcell
    return np.asarray(np.einsum("pax,pby->abxy", least, least, optimize=True))


class StressEnergies:
    """Squared norms of the stresses of the element, as quadratic functions of their loadings.

    The loadings must be in equilibrium. A squared norm is twice the complementary energy.
    """

    def __init__(self, cells: Simplices, compliance: Array) -> None:
        """Compute the matrices of all cells; compliances (n, nsym, nsym) as `symmetric_basis`."""
        d = cells.d
        basis, products = symmetric_basis(d), stress_products(d)
        frames = cells.frames @ np.linalg.inv(_regular_frame(d))
        # the stress is B S B' with the reference stress S, whose loading is B^-1 times as large,
        # with tractions S grad lambda_j
        self._to_reference = np.swapaxes(np.linalg.inv(frames), 1, 2)
        scales = np.ones((*cells.heights.shape, d + 1))
        scales[:, :, :d] = -1.0 / cells.heights[:, :, None]
        self._scales = scales.reshape(len(frames), -1, 1)
        stresses = frames[:, None] @ basis @ np.swapaxes(frames, 1, 2)[:, None]
        rows = np.tensordot(stresses, basis, axes=([2, 3], [1, 2]))
        pulled = rows @ compliance @ np.swapaxes(rows, 1, 2) * cells.volumes[:, None, None]
        matrices = pulled.reshape(len(frames), -1) @ products.reshape(len(basis) ** 2, -1)
        self._matrices = matrices.reshape(len(frames), *products.shape[2:])

    def derivative(self, loading: Array) -> Array:
        """Return half the derivative (n, d + 1, d + 1, d) of the squared norms."""
        n, *_, d = loading.shape
        reference = loading.reshape(n, -1, d) @ self._to_reference * self._scales
        products = (self._matrices @ reference.reshape(n, -1, 1)).reshape(n, -1, d) * self._scales
        derivative = products @ np.swapaxes(self._to_reference, 1, 2)
        return np.asarray(derivative.reshape(loading.shape))

    def squared_norms(self, loading: Array) -> Array:
        """Return the squared norms (n,) of the stresses with a loading."""
        return np.asarray((loading * self.derivative(loading)).sum(axis=(1, 2, 3)))

    def of_facets(self) -> Array:
        """Return the matrices (n, d + 1, d * d, d * d) of tractions on each facet alone."""
        n, d, _ = self._to_reference.shape
        shape = n, d + 1, d * d, d * d
        blocks = self._matrices.reshape(n, d + 1, (d + 1) * d, d + 1, (d + 1) * d)
        blocks = np.einsum("njajb->njab", blocks)[:, :, : d * d, : d * d]
        for _ in range(2):  # rows, then columns
            blocks = self._to_reference[:, None, None] @ blocks.reshape(n, d + 1, d, d, d * d)
            blocks = np.swapaxes(blocks.reshape(shape), 2, 3)
        return np.asarray(blocks * np.square(self._scales[:, :: d + 1, :, None]))


@dataclass(frozen=True)
class MeshCells(Simplices):
    """The cells that this rank owns, with vertices in ascending order of their global numbers.

    Attributes:
        V: the space of the displacement.
        quadratics: the space of vectors that are quadratic in cells.
        dofs: (n, k) nodes of `quadratics` on this rank, in the order of `lagrange`.
        vertices: (n, d + 1) global numbers of the vertices.
        facets: (n, d + 1) numbers on this rank of the facets.
        nodes: (n, d + 1, d + 1) nodes of V on this rank, whose displacements are as in `bernstein`:
            for degree 1 at vertex i, for degree 2 in the middle between the vertices i and j.
    """

    V: Any
    quadratics: Any
    dofs: Indices
    vertices: GlobalNumbers
    facets: Indices
    nodes: Indices

    @classmethod
    def from_space(cls, V: Any) -> MeshCells:
        """Sort the vertices of the cells of a space's mesh. Collective."""
        cell = V.mesh.topology.cell_name()
        if cell not in ("triangle", "tetrahedron"):
            raise InputError(
                f"a guaranteed bound needs triangles or tetrahedra, found {cell} cells. Divide "
                "them into simplices."
            )
        if geometry_degree(V.mesh) != 1:
            raise InputError("a guaranteed bound needs cells with straight edges.")
        mesh, topology = V.mesh, V.mesh.topology
        d, count = topology.dim, topology.index_map(topology.dim).size_local
        topology.create_connectivity(d, d - 1)
        topology.create_connectivity(d - 1, d)
        local = topology.connectivity(d, 0).array.reshape(-1, d + 1)[:count]
        numbers = topology.index_map(0).local_to_global(local.ravel()).reshape(local.shape)
        order = np.argsort(numbers, axis=1)
        points = mesh.geometry.x[geometry_dofmap(mesh)[:count], :d]
        facets = topology.connectivity(d, d - 1).array.reshape(-1, d + 1)[:count]
        between = np.diag(np.arange(d + 1))
        for edge, (i, j) in enumerate(basix.topology(mesh.basix_cell())[1], d + 1):
            between[i, j] = between[j, i] = edge
        pairs = between[order[:, :, None], order[:, None]]
        nodes = pairs if V.element.basix_element.degree == 2 else order[:, :, None] + 0 * pairs
        quadratics = fem.functionspace(mesh, ("DG", 2, (d,)))
        cell, (i, j) = np.arange(count), np.triu_indices(d + 1)
        return cls(
            points=np.take_along_axis(points, order[:, :, None], axis=1),
            V=V,
            quadratics=quadratics,
            dofs=quadratics.dofmap.list[cell[:, None], pairs[:, i, j]],
            vertices=np.take_along_axis(numbers, order, axis=1),
            facets=np.take_along_axis(facets, order, axis=1),
            nodes=V.dofmap.list[cell[:, None, None], nodes],
        )

    @cached_property
    def facet_nodes(self) -> Indices:
        """(n, d + 1, d, d) the nodes of V on each facet, as in `nodes`."""
        sides = opposite(self.d)
        return self.nodes[:, sides[:, :, None], sides[:, None]]

    @cached_property
    def signs(self) -> Array:
        """(n, d + 1, 1, 1) 1 on one side of each facet and -1 on the other one."""
        sides = (-1.0) ** np.arange(self.d + 1) * np.linalg.det(self.frames)[:, None]
        return np.asarray(np.sign(sides)[:, :, None, None])

    def facet_sums(self, values: Array) -> Array:
        """Return the sums (facets, a, b) over both sides of values (n, d + 1, a, b). Collective."""
        index_map = self.V.mesh.topology.index_map(self.d - 1)
        rows = values.reshape(*self.facets.shape, -1)
        return summed_at_nodes(index_map, self.facets, rows).reshape(-1, *values.shape[2:])

    def on_sides(self, tractions: Array) -> Array:
        """Return the loading of tractions (facets, d * d), which are opposite on both sides."""
        result = np.zeros((*self.facets.shape, self.d + 1, self.d))
        shape = *self.facets.shape, self.d, self.d
        result[:, :, : self.d] = self.signs * tractions[self.facets].reshape(shape)
        return result

    def nodal_forces(self, loading: Array) -> Array:
        """Return the forces (nodes of this rank, d) of a loading. Collective."""
        forces = np.zeros((*self.nodes.shape, self.d))
        for vertices, sizes, values in self.terms(loading):
            k = len(vertices)
            means = mean_products(k, 3).reshape(-1, k) @ (sizes[:, None, None] * values)
            forces[:, vertices[:, None], vertices] += means.reshape(-1, k, k, self.d)
        # they do the work of `bernstein`'s coefficients
        forces *= 2.0
        forces -= np.eye(self.d + 1)[:, :, None] * forces.sum(axis=2, keepdims=True) / 2.0
        return summed_at_nodes(self.V.dofmap.index_map, self.nodes, forces)

    def spread(self, owned: Array) -> Array:
        """Return values (owned nodes, k) at this rank's nodes, ghosts included. Collective."""
        return summed_at_nodes(self.V.dofmap.index_map, np.arange(len(owned)), owned)

    def stresses(self, w: Any, stiffness: Array) -> Array:
        """Return the stresses (n, d + 1, d, d) at vertices of a Function w on V.

        The elasticity tensors (n, nsym, nsym) are in `symmetric_basis`.
        """
        tensors = symmetric_basis(self.d)
        coefficients = bernstein(w.x.array.reshape(-1, self.d)[self.nodes])
        slopes = 2.0 * np.swapaxes(coefficients, 2, 3) @ self.gradients[:, None]
        strains = np.tensordot(slopes, tensors, axes=([2, 3], [1, 2]))
        return np.asarray(np.tensordot(strains @ stiffness, tensors, axes=1))

    def require(self, holds: Any, needed: str) -> None:
        """Check what the bound needs on all ranks. Collective."""
        if not self.V.mesh.comm.allreduce(bool(holds), op=MPI.LAND):
            raise InputError(f"a guaranteed bound needs {needed}.")
