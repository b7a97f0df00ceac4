"""Simplices: polynomials, shapes, constants, stresses; the cells of a mesh that a rank owns.

Vertices are in ascending order of their global numbers, so that two cells agree on the order of the
vertices of their common facet. Facet j is opposite to vertex j.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations, permutations
from math import factorial
from typing import Any

from mpi4py import MPI

import numpy as np

import basix

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices
from dolfinx_tresca._base.compat import geometry_dofmap
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


def mean_products(corners: int, factors: int) -> Array:
    """Return the means over a simplex of products of barycentric coordinates.

    Args:
        corners: number of vertices of the simplex.
        factors: number of factors of each product.

    Returns:
        an array with `factors` axes of length `corners`; its entry (i, j, ...) is the mean of
        lambda_i lambda_j ... over the simplex.
    """
    result = np.empty((corners,) * factors)
    scale = factorial(corners - 1) / factorial(corners - 1 + factors)
    for index in np.ndindex(*result.shape):
        powers = np.bincount(index, minlength=corners)
        result[index] = scale * np.prod([factorial(int(power)) for power in powers])
    return result


def basis_nodes(corners: int, degree: int) -> Array:
    """Return the barycentric coordinates (k, corners) of the nodes of Lagrange's basis.

    The nodes are the vertices, and for degree 2 the midpoints of the edges in the order of
    `combinations`.
    """
    unit = np.eye(corners)
    i, j = np.triu_indices(corners, 1)
    return unit if degree == 1 else np.vstack([unit, 0.5 * (unit[i] + unit[j])])


def basis_products(corners: int, degree: int) -> Array:
    """Return matrices A_k (k, corners, corners) of Lagrange's basis of degree 1 or 2.

    The basis function k, of the node k of `basis_nodes`, is the sum of A_k[i, j] lambda_i lambda_j.
    """
    unit = np.eye(corners)
    linear = 0.5 * (unit[:, :, None] + unit[:, None])
    if degree == 1:
        return linear
    i, j = np.triu_indices(corners, 1)
    edges = unit[i][:, :, None] * unit[j][:, None]
    vertices = 2.0 * unit[:, :, None] * unit[:, None] - linear
    return np.concatenate([vertices, 2.0 * (edges + np.swapaxes(edges, 1, 2))])


@cache
def basis_means(corners: int, degree: int) -> Array:
    """Return the means (k, k) over a simplex of products of two of Lagrange's basis functions."""
    basis = basis_products(corners, degree)
    means = mean_products(corners, 4)
    return np.asarray(np.einsum("pab,qcd,abcd->pq", basis, basis, means, optimize=True))


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
    """Simplices with d + 1 vertices.

    Attributes:
        points: (n, d + 1, d) the vertices [length].
    """

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

    def facet_forces(self, tractions: Array) -> Array:
        """Return the resultants (n, d + 1, d) at the vertices of tractions (n, d + 1, d, d).

        A linear displacement does the work of its values at the vertices times these forces.
        """
        forces = self.areas[:, :, None, None] * (mean_products(self.d, 2) @ tractions)
        result = np.zeros_like(self.points)
        for j, vertices in enumerate(opposite(self.d)):
            result[:, vertices] += forces[:, j]
        return result

    def volume_forces(self, load: Array) -> Array:
        """Return the resultants (n, d + 1, d) at the vertices of a linear load there."""
        return np.asarray(self.volumes[:, None, None] * (mean_products(self.d + 1, 2) @ load))

    @cached_property
    def stretches(self) -> Array:
        """(n,) s^2 / t of the largest and least singular values s, t of affine maps [length].

        The maps are those from the simplex of `POINCARE`, with the order of the vertices whose path
        is the shortest.
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
        return self.stretches * POINCARE[self.d]

    @property
    def trace_factors(self) -> Array:
        """(n, d + 1) upper bounds of |w|_F / |sym grad w| [length^(1/2)] on each facet F."""
        ratios = self.areas / (factorial(self.d) * self.volumes[:, None])
        return np.asarray(self.stretches[:, None] * np.sqrt(ratios) * TRACE[self.d])


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
    Mercier (1978; in any dimension Gopalakrishnan, Guzman and Lee 2024): subcell i has the vertices
    of the simplex without vertex i, and the centroid. Here stresses are symmetric, quadratic in
    each subcell, and have continuous tractions between subcells. For all linear tractions on the
    facets and all linear divergences that balance each other in force and moment there is such a
    stress; of all, that of the least norm is taken. It depends linearly on these data, and
    reproduces linear stresses.

    Returns:
        (nsym (nsym + 1) / 2, m, m) means over the simplex of products of two components of stresses
        in `symmetric_basis`, in the order of `triu_indices`, twice if the components differ. The m
        data are (facet i, vertex of this facet, component) S grad lambda_i with the stress S, then
        (vertex, component) the divergence.
    """
    n, basis = d + 1, symmetric_basis(d)
    nsym = len(basis)
    nodal = basis_products(n, 2)
    size = len(nodal)
    places = basis_nodes(n, 2)
    mass = basis_means(n, 2) / n

    # unknown stresses at the nodes of subcells, in units of which the norm is Euclidean; vertex i
    # of subcell i is the centroid
    root = np.linalg.inv(np.linalg.cholesky(mass)).T
    unknown = np.eye(n * size * nsym).reshape(n, size, nsym, -1)
    scaled = np.einsum("pq,iqaz->ipaz", root, unknown)
    stress = np.einsum("ipaz,akl->ipklz", scaled, basis)
    inner = np.linalg.inv(_regular_frame(d))
    gradients = np.vstack([-inner.sum(axis=0), inner])
    data = np.eye(n * d * d + n * d).reshape(n * d + n, d, -1)
    tractions = data[: n * d].reshape(n, d, d, -1)
    equations, right = [], []
    for i, vertices in enumerate(opposite(d)):
        on_facet = [p for p in range(size) if places[p, i] == 0.0]
        equations.append(np.einsum("pklz,l->pkz", stress[i, on_facet], gradients[i]))
        right.append(np.einsum("pj,jkz->pkz", places[on_facet][:, vertices], tractions[i]))
        slopes = gradients - gradients[i]
        slopes[i] = n * gradients[i]
        derivatives = 2.0 * np.einsum("pab,bl->pal", nodal, slopes)  # at vertices a
        equations.append(np.einsum("pklz,pal->akz", stress[i], derivatives))
        corners = np.eye(n)
        corners[i] = 1.0 / n
        right.append(np.einsum("aj,jkz->akz", corners, data[n * d :]))
        for j in range(i):
            # nodes on the common facet: vertex i of subcell i is vertex j of subcell j
            exchanged = places.copy()
            exchanged[:, [i, j]] = exchanged[:, [j, i]]
            common = [p for p in range(size) if places[p, j] == 0.0]
            twins = [int(np.argmin(np.abs(exchanged - places[p]).sum(axis=1))) for p in common]
            jump = stress[i, common] - stress[j, twins]
            equations.append(np.einsum("pklz,l->pkz", jump, gradients[i] - gradients[j]))
            right.append(np.zeros((len(common), d, data.shape[2])))
    matrix = np.concatenate(equations).reshape(-1, unknown.shape[-1])
    least = np.linalg.pinv(matrix, 1e-10) @ np.concatenate(right).reshape(len(matrix), -1)
    least = least.reshape(n * size, nsym, -1)  # orthonormal at the nodes of each subcell
    rows, columns = np.triu_indices(nsym)
    products = np.einsum("pax,pby->abxy", least, least, optimize=True)
    products = products[rows, columns] + products[columns, rows]
    products[rows == columns] *= 0.5
    return np.asarray(products)


class StressEnergies:
    """The energies of stresses in cells, as quadratic functions of their data.

    The data are arrays (n, (d + 1)(d + 1), d): tractions on facets at their vertices, facet by
    facet, then the divergence at the vertices. They must be in equilibrium.
    """

    def __init__(self, cells: Simplices, compliance: Array) -> None:
        """Compute the matrices of all cells.

        Args:
            cells: the cells.
            compliance: (n, nsym, nsym) the inverse of the elasticity tensor in
                `symmetric_basis`.
        """
        d, self.cells = cells.d, cells
        basis, products = symmetric_basis(d), stress_products(d)
        frames = cells.frames @ np.linalg.inv(_regular_frame(d))
        self.count = d * (d + 1)  # of tractions
        inner = np.swapaxes(np.linalg.inv(frames), 1, 2)
        scales = np.ones((len(frames), self.count + d + 1))
        scales[:, : self.count] = np.repeat(-1.0 / cells.heights, d, axis=1)
        self._to_reference, self._scales = inner, scales[:, :, None]
        # the stress is B S B' with the reference stress S
        stresses = frames[:, None] @ basis @ np.swapaxes(frames, 1, 2)[:, None]
        rows = np.tensordot(stresses, basis, axes=([2, 3], [1, 2]))
        pulled = rows @ compliance @ np.swapaxes(rows, 1, 2) * cells.volumes[:, None, None]
        i, j = np.triu_indices(len(basis))
        matrices = pulled[:, i, j] @ products.reshape(len(i), -1)
        self._matrices = matrices.reshape(len(frames), *products.shape[1:])

    def derivative(self, data: Array) -> Array:
        """Return half the derivative (n, k, d) of the energy; data may be tractions alone."""
        k = data.shape[1]
        reference = (data @ self._to_reference) * self._scales[:, :k]
        size = k * self.cells.d
        products = self._matrices[:, :size, :size] @ reference.reshape(-1, size, 1)
        products = products.reshape(reference.shape) * self._scales[:, :k]
        return np.asarray(products @ np.swapaxes(self._to_reference, 1, 2))

    def squared_norms(self, data: Array) -> Array:
        """Return the squared norms (n,) of stresses, twice the complementary energy."""
        return np.asarray((data * self.derivative(data)).sum(axis=(1, 2)))

    def facet_stiffness(self) -> Array:
        """Return matrices (n, d + 1, d * d, d * d): the energies of tractions on each facet."""
        n, d, _ = self._to_reference.shape
        turn = np.einsum("kl,nab->nkalb", np.eye(d), self._to_reference).reshape(n, d * d, d * d)
        facets = [slice(j * d * d, (j + 1) * d * d) for j in range(d + 1)]
        blocks = np.stack([self._matrices[:, facet, facet] for facet in facets], axis=1)
        blocks = turn[:, None] @ blocks @ np.swapaxes(turn, 1, 2)[:, None]
        return np.asarray(blocks / np.square(self.cells.heights)[:, :, None, None])


def stress_data(cells: Simplices, stress: Array) -> Array:
    """Return the data of linear stresses (n, d + 1, d, d) at the vertices, see `StressEnergies`."""
    n, d = len(stress), cells.d
    tractions = np.einsum("njkab,njb->njka", stress[:, opposite(d)], cells.normals)
    divergence = np.einsum("nkab,nkb->na", stress, cells.gradients)
    both = [tractions.reshape(n, -1, d), np.repeat(divergence[:, None], d + 1, axis=1)]
    return np.concatenate(both, axis=1)


@dataclass(frozen=True)
class OwnedCells:
    """The cells that this rank owns, with vertices in ascending order of their global numbers.

    Attributes:
        V: the space of the displacement.
        cells: the cells.
        order: (n, k) numbers of the vertices in DOLFINx's cells, then of the middles of the edges
            in the order of `basis_nodes`.
        vertices: (n, d + 1) global numbers of the vertices.
        facets: (n, d + 1) numbers on this rank of the facets.
        nodes: (n, k) nodes of the displacement on this rank, in the order of `order`.
    """

    V: Any
    cells: Simplices
    order: Indices
    vertices: GlobalNumbers
    facets: Indices
    nodes: Indices

    @cached_property
    def basis(self) -> Array:
        """The basis functions at `nodes`, see `basis_products`."""
        return basis_products(self.cells.d + 1, self.V.element.basix_element.degree)

    @cached_property
    def on_facets(self) -> Indices:
        """(d + 1, k) positions in `nodes` of the nodes on each facet, vertices before edges."""
        places = basis_nodes(self.cells.d + 1, self.V.element.basix_element.degree)
        return np.array([np.flatnonzero(place == 0.0) for place in places.T])

    def nodal_forces(self, load: Array, traction: Array) -> Array:
        """Return the forces (nodes, d) of linear loads and tractions. Collective.

        Args:
            load: (n, d + 1, d) loads at the vertices.
            traction: (n, d + 1, d, d) tractions on facets at their vertices.
        """
        cells, forces = self.cells, np.zeros((*self.nodes.shape, self.cells.d))
        terms = [(np.arange(cells.d + 1), cells.volumes, load)]
        terms += zip(opposite(cells.d), cells.areas.T, np.moveaxis(traction, 1, 0), strict=True)
        for ends, sizes, values in terms:
            basis = self.basis[:, ends][:, :, ends]
            weights = np.einsum("kab,abc->kc", basis, mean_products(len(ends), 3))
            forces += sizes[:, None, None] * (weights @ values)
        return summed_at_nodes(self.V.dofmap.index_map, self.nodes, forces)

    @classmethod
    def from_space(cls, V: Any) -> OwnedCells:
        """Sort the vertices of the cells of a space's mesh. Collective."""
        mesh, topology = V.mesh, V.mesh.topology
        d, count = topology.dim, topology.index_map(topology.dim).size_local
        topology.create_connectivity(d, d - 1)
        topology.create_connectivity(d - 1, d)
        local = topology.connectivity(d, 0).array.reshape(-1, d + 1)[:count]
        numbers = topology.index_map(0).local_to_global(local.ravel()).reshape(local.shape)
        order = np.argsort(numbers, axis=1)
        points = mesh.geometry.x[geometry_dofmap(mesh)[:count], :d]
        facets = topology.connectivity(d, d - 1).array.reshape(-1, d + 1)[:count]
        ends = np.array(basix.topology(mesh.basix_cell())[1])
        edges = np.zeros((d + 1, d + 1), dtype=np.intp)
        edges[ends[:, 0], ends[:, 1]] = edges[ends[:, 1], ends[:, 0]] = np.arange(len(ends)) + d + 1
        i, j = np.triu_indices(d + 1, 1)
        own = np.hstack([order, edges[order[:, i], order[:, j]]])
        nodes = V.dofmap.list[:count]
        return cls(
            V=V,
            cells=Simplices(np.take_along_axis(points, order[:, :, None], axis=1)),
            order=own,
            vertices=np.take_along_axis(numbers, order, axis=1),
            facets=np.take_along_axis(facets, order, axis=1),
            nodes=np.take_along_axis(nodes, own[:, : nodes.shape[1]], axis=1),
        )


def spread(V: Any, owned: Array) -> Array:
    """Return values (owned nodes, k) at this rank's nodes, ghosts included. Collective."""
    return summed_at_nodes(V.dofmap.index_map, np.arange(len(owned)), owned)


def require(comm: MPI.Comm, holds: Any, needed: str) -> None:
    """Check what the bound needs on all ranks. Collective.

    Raises:
        InputError: it does not hold on a rank.
    """
    if not comm.allreduce(bool(holds), op=MPI.LAND):
        raise InputError(f"a guaranteed bound needs {needed}.")
