"""The constants of cells, and the stress element, alone."""

from __future__ import annotations

import itertools
from functools import cached_property

import numpy as np
import pytest

import basix

from dolfinx_tresca.guaranteed.cells import (
    POINCARE,
    TRACE,
    Simplices,
    StressEnergies,
    facet_vertices,
    mean_products,
    rigid_motions,
)

SHAPES = {
    "equilateral": [(0, 0), (1, 0), (0.5, 0.75**0.5)],
    "right": [(0, 0), (1, 0), (0, 1)],
    "flat": [(0, 0), (1, 0), (0.4, 0.2)],
    "regular": [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)],
    "reference": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)],
    "corner": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
}


def identity(d: int, n: int) -> np.ndarray:
    """Return the compliance with which energies are squared norms."""
    return np.repeat(np.eye(d * (d + 1) // 2)[None], n, axis=0)


def divided(d: int, k: int) -> np.ndarray:
    """Return the k^d parts (n, d + 1, d) of the reference simplex, all alike, of size 1 / k."""
    parts = []
    for corner in itertools.product(range(k), repeat=d):
        for order in itertools.permutations(range(d)):
            points = np.vstack([corner, corner + np.cumsum(np.eye(d)[list(order)], axis=0)])
            if (np.diff(points.mean(axis=0)) < 0.0).all():  # where x_1 > x_2 > ...
                parts.append(points)
    return np.array(parts) / k


class DividedSimplex:
    """The reference simplex in k^d parts, with tractions on their facets and loads in them."""

    def __init__(self, d: int, k: int) -> None:
        self.k, self.cells = k, Simplices(divided(d, k))
        n = k**d
        assert len(self.cells.points) == n
        keys, self.dofs = {}, np.zeros((n, d + 1, d, d), dtype=int)
        self.signs, facets = np.ones((n, d + 1, 1, 1)), np.empty((n, d + 1), dtype=int)
        for cell, j in np.ndindex(n, d + 1):
            points = self.cells.points[cell, facet_vertices(d)[j]]
            order = np.lexsort(points.T)
            key = tuple(map(tuple, points[order].round(12)))
            self.signs[cell, j] = -1.0 if key in keys else 1.0
            number = facets[cell, j] = keys.setdefault(key, len(keys))
            self.dofs[cell, j, order] = number * d * d + np.arange(d * d).reshape(d, d)
        self.facet_points = np.array(list(keys))
        self.size = len(keys) * d * d
        self.inside = np.flatnonzero(np.bincount(facets.ravel()) == 2)

    @cached_property
    def matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """The energy of tractions and loads, and the forces and moments of all cells."""
        n, d = len(self.cells.points), self.cells.d
        total = self.size + n * (d + 1) * d
        loadings = np.zeros((total, n, d + 1, d + 1, d))
        cell, facet, vertex, axis = np.indices((n, d + 1, d, d), sparse=True)
        loadings[self.dofs, cell, facet, vertex, axis] = self.signs
        cell, vertex, axis = np.indices((n, d + 1, d), sparse=True)
        loads = np.arange(self.size, total).reshape(n, d + 1, d)
        loadings[loads, cell, vertex, d, axis] = -1.0
        energies = StressEnergies(self.cells, identity(d, n))
        derivatives = np.stack([energies.derivative(x) for x in loadings]).reshape(total, -1)
        motions = rigid_motions(self.cells.points)
        forces = np.stack([self.cells.resultants(x) for x in loadings])
        balance = np.einsum("nrkd,xnkd->nrx", motions, forces, optimize=True)
        return derivatives @ loadings.reshape(total, -1).T, balance.reshape(-1, total)

    @cached_property
    def whole(self) -> Simplices:
        """The reference simplex."""
        d = self.cells.d
        return Simplices(np.vstack([np.zeros(d), np.cumsum(np.eye(d), axis=0)])[None])

    def linear_loads(self, side: int | None) -> float:
        """Return the largest norm of the least stresses for loads of norm 1.

        The loads are linear in each part, or tractions that are linear on the parts of facet
        `side`, and orthogonal to linear functions on the whole.
        """
        d = self.cells.d
        if side is None:
            given = np.arange(self.size, len(self.matrices[0]))
            block = self.cells.volumes[0] * np.kron(mean_products(d + 1, 2), np.eye(d))
            points = self.cells.points
        else:
            offsets = self.facet_points - self.whole.points[0, side]
            heights = offsets @ self.whole.gradients[0, side] + 1.0
            (facets,) = np.nonzero(np.abs(heights).max(axis=1) < 1e-9)
            assert len(facets) == self.k ** (d - 1)
            given = (facets[:, None] * d * d + np.arange(d * d)).ravel()
            area = self.whole.areas[0, side] / len(facets)
            block = area * np.kron(mean_products(d, 2), np.eye(d))
            points = self.facet_points[facets]
        root = np.linalg.inv(np.linalg.cholesky(block)).T
        root = np.kron(np.eye(len(given) // len(root)), root)
        # loads that are orthogonal to linear functions, orthonormal
        monomials = np.insert(points.reshape(-1, d), 0, 1.0, axis=1)
        linear = np.kron(monomials.T, np.eye(d)) @ np.linalg.inv(root.T)
        _, values, right = np.linalg.svd(linear)
        return self.largest_norm(given, root @ right[(values > 1e-9).sum() :].T)

    @cached_property
    def inverse(self) -> np.ndarray:
        """The inverse of the optimality conditions of stresses of the least energy."""
        energy, balance = self.matrices
        free, nothing = self.free, np.zeros((len(balance), len(balance)))
        matrix = [[energy[np.ix_(free, free)], balance[:, free].T], [balance[:, free], nothing]]
        return np.linalg.pinv(np.block(matrix), 1e-11, hermitian=True)

    @property
    def free(self) -> np.ndarray:
        """The numbers of the tractions inside the simplex."""
        return (self.inside[:, None] * self.cells.d**2 + np.arange(self.cells.d**2)).ravel()

    def largest_norm(self, given: np.ndarray, loads: np.ndarray) -> float:
        """Return the largest norm of the least stresses for combinations of loads of norm 1."""
        (energy, balance), free = self.matrices, self.free
        right = -np.vstack([energy[np.ix_(free, given)], balance[:, given]]) @ loads
        answer = np.zeros((len(energy), loads.shape[1]))
        answer[given] = loads
        answer[free] = (self.inverse @ right)[: len(free)]
        assert np.allclose(balance @ answer, 0.0, atol=1e-9)
        return float(np.sqrt(np.linalg.eigvalsh(answer.T @ energy @ answer)[-1]))


@pytest.mark.parametrize(("d", "k"), [(2, 8), (3, 4)])
def test_constants_of_the_reference_simplex(d, k):
    """As proved in docs/theory/guaranteed.md, from the simplex in parts that are like the whole."""
    simplex = DividedSimplex(d, k)
    areas = simplex.whole.areas[0]
    constant = simplex.linear_loads(None) / np.sqrt(1.0 - 1.0 / k**2)
    assert POINCARE[d] == pytest.approx(constant, abs=1e-3)
    assert constant <= POINCARE[d]
    squares = np.array([simplex.linear_loads(side) ** 2 for side in range(d + 1)])
    squares += squares.max() / (1.0 - 1.0 / k) / k
    constant = np.sqrt((squares / areas).max())
    assert TRACE[d] == pytest.approx(constant, abs=1e-3)
    assert constant <= TRACE[d]


def polynomials(points: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return values (k, q) and gradients (k, q, d) of the monomials, without the constant."""
    d = points.shape[1]
    powers = [p for p in itertools.product(range(degree + 1), repeat=d) if 0 < sum(p) <= degree]
    values = np.stack([np.prod(points ** np.array(p), axis=1) for p in powers])
    slopes = np.zeros((*values.shape, d))
    for k, p in enumerate(powers):
        for axis in range(d):
            lower = np.array(p) - np.eye(d, dtype=int)[axis]
            if lower[axis] >= 0:
                slopes[k, :, axis] = p[axis] * np.prod(points**lower, axis=1)
    return values, slopes


def rule(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (q, d) and weights (q,) of a quadrature on a simplex in d dimensions."""
    simplex = ("interval", "triangle", "tetrahedron")[len(corners) - 2]
    points, weights = basix.make_quadrature(basix.CellType[simplex], 12)
    edges = corners[1:] - corners[0]
    return corners[0] + points @ edges, weights * np.sqrt(np.linalg.det(edges @ edges.T))


@pytest.mark.parametrize("shape", SHAPES)
def test_constants_exceed_the_ratios_of_polynomials(shape):
    """Ratios of |w| and |w| on a facet, without linear functions, to |sym grad w|."""
    corners = np.array(SHAPES[shape], dtype=float)
    corners -= corners.mean(axis=0)
    d = corners.shape[1]
    cell = Simplices(corners[None])
    degree = 6 if d == 2 else 4
    points, weights = rule(corners)
    values, slopes = polynomials(points, degree)
    count = len(values)
    slope = np.einsum("ij,kqa->kiqja", np.eye(d), slopes).reshape(-1, len(weights), d, d)
    strain = 0.5 * (slope + np.swapaxes(slope, 2, 3))

    def form(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        rows = (values.reshape(d * count, len(weights), -1) * np.sqrt(weights)[:, None]).reshape(
            d * count, -1
        )
        return rows @ rows.T

    size, vectors = np.linalg.eigh(form(strain, weights))
    vectors = vectors[:, size > 1e-9 * size.max()] / np.sqrt(size[size > 1e-9 * size.max()])

    def ratio(values: np.ndarray, points: np.ndarray, weights: np.ndarray) -> float:
        monomials, roots = np.insert(points, 0, 1.0, axis=1), np.sqrt(weights)[:, None]
        nearest = np.linalg.lstsq(roots * monomials, roots * values.T, rcond=None)[0]
        values = values - (monomials @ nearest).T
        values = np.einsum("ij,kq->kiqj", np.eye(d), values).reshape(-1, len(weights), d)
        return float(np.sqrt(np.linalg.eigvalsh(vectors.T @ form(values, weights) @ vectors)[-1]))

    largest = ratio(values, points, weights)
    of_cell, *of_facets = cell.load_factors()[0]
    assert largest <= of_cell
    if shape in ("right", "reference"):
        assert of_cell <= 1.5 * largest
    for j in range(d + 1):
        on_facet, its_weights = rule(np.delete(corners, j, axis=0))
        there, _ = polynomials(on_facet, degree)
        assert ratio(there, on_facet, its_weights) <= of_facets[j]


@pytest.mark.parametrize("d", [2, 3])
def test_linear_stresses_are_in_the_element(d):
    """They are determined by their tractions and their divergence."""
    rng = np.random.default_rng(d)
    cells = Simplices(rng.standard_normal((5, d + 1, d)))
    energies = StressEnergies(cells, identity(d, 5))
    linear = rng.standard_normal((5, d + 1, d, d))
    linear += np.swapaxes(linear, 2, 3)
    squares = np.einsum("kl,nkab,nlab->n", mean_products(d + 1, 2), linear, linear)
    assert np.allclose(energies.squared_norms(cells.to_loading(linear)), squares * cells.volumes)


@pytest.mark.parametrize("d", [2, 3])
def test_stresses_of_the_element_do_the_work_of_their_data(d):
    """For a linear displacement w: the integral of s : grad w, by tractions and divergence."""
    rng = np.random.default_rng(d)
    cells = Simplices(rng.standard_normal((1, d + 1, d)))
    energies, motions = StressEnergies(cells, identity(d, 1)), rigid_motions(cells.points)
    loading = np.zeros((1, d + 1, d + 1, d))
    loading[:, :, :d] = rng.standard_normal((1, d + 1, d, d))
    # a load in equilibrium with the tractions
    loads = np.zeros(((d + 1) * d, *loading.shape))
    loads[:, 0, :, d] = np.eye(len(loads)).reshape(-1, d + 1, d)
    columns = [np.einsum("nrkd,nkd->r", motions, cells.resultants(load)) for load in loads]
    right = np.einsum("nrkd,nkd->r", motions, cells.resultants(loading))
    size = np.linalg.lstsq(np.column_stack(columns), -right, rcond=None)[0]
    loading += np.tensordot(size, loads, axes=1)
    slope = rng.standard_normal((d, d))
    work = (cells.resultants(loading) * (cells.points @ slope.T)).sum()
    strain = cells.to_loading(np.broadcast_to(0.5 * (slope + slope.T), (1, d + 1, d, d)))
    assert np.isclose((strain * energies.derivative(loading)).sum(), work)
