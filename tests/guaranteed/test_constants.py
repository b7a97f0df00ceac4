"""The constants of cells, and the stress element, alone."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dolfinx_tresca.guaranteed.simplices import Simplices, mean_products, moments
from dolfinx_tresca.guaranteed.stress_element import CellStresses, stress_element

SHAPES = {
    "equilateral": [(0, 0), (1, 0), (0.5, 0.75**0.5)],
    "right": [(0, 0), (1, 0), (0, 1)],
    "flat": [(0, 0), (1, 0), (0.4, 0.2)],
    "regular": [(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)],
    "Kuhn": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)],
    "corner": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
}


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


def rule(corners: np.ndarray, order: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss points (q, d) and weights (q,) of a simplex of dimension k in d dimensions."""
    x, w = np.polynomial.legendre.leggauss(order)
    x, w = 0.5 * (x + 1.0), 0.5 * w
    k = len(corners) - 1
    points, weights = [], []
    for index in itertools.product(range(order), repeat=k):
        rest, weight, coordinates = 1.0, 1.0, []
        for axis, i in enumerate(index):
            coordinates.append(rest * x[i])
            weight *= w[i] * (1.0 - x[i]) ** (k - 1 - axis)
            rest *= 1.0 - x[i]
        points.append(coordinates)
        weights.append(weight)
    edges = corners[1:] - corners[0]
    volume = np.sqrt(np.linalg.det(edges @ edges.T))
    return corners[0] + np.array(points) @ edges, volume * np.array(weights)


@pytest.mark.parametrize("shape", SHAPES)
def test_constants_exceed_the_ratios_of_polynomials(shape):
    """Ratios of |w|, |w| on a facet and |grad w| to |sym grad w|, without rigid motions."""
    corners = np.array(SHAPES[shape], dtype=float)
    corners -= corners.mean(axis=0)
    d = corners.shape[1]
    cell = Simplices(corners[None])
    degree = 6 if d == 2 else 4
    points, weights = rule(corners)
    values, slopes = polynomials(points, degree)
    count = len(values)
    field = np.einsum("ij,kq->kiqj", np.eye(d), values).reshape(-1, len(weights), d)
    slope = np.einsum("ij,kqa->kiqja", np.eye(d), slopes).reshape(-1, len(weights), d, d)
    # without mean, and without mean rotation
    skew = 0.5 * (slope - np.swapaxes(slope, 2, 3))
    spin = np.einsum("q,kqab->kab", weights, skew) / weights.sum()
    slope = slope - spin[:, None]
    field = field - np.einsum("kab,qb->kqa", spin, points)
    mean = np.einsum("q,kqa->ka", weights, field) / weights.sum()
    strain = 0.5 * (slope + np.swapaxes(slope, 2, 3))

    def form(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        rows = (values.reshape(d * count, len(weights), -1) * np.sqrt(weights)[:, None]).reshape(
            d * count, -1
        )
        return rows @ rows.T

    size, vectors = np.linalg.eigh(form(strain, weights))
    vectors = vectors[:, size > 1e-9 * size.max()] / np.sqrt(size[size > 1e-9 * size.max()])

    def ratio(values: np.ndarray, weights: np.ndarray) -> float:
        return float(np.sqrt(np.linalg.eigvalsh(vectors.T @ form(values, weights) @ vectors)[-1]))

    assert 1.0 < ratio(slope, weights) <= cell.korn_factors[0]
    assert ratio(field - mean[:, None], weights) <= cell.poincare_factors[0]
    if d == 2:  # where Horgan and Payne's constant is sharp
        assert cell.korn_factors[0] <= 1.6 * ratio(slope, weights)
    for j in range(d + 1):
        on_facet, its_weights = rule(np.delete(corners, j, axis=0))
        there, _ = polynomials(on_facet, degree)
        there = np.einsum("ij,kq->kiqj", np.eye(d), there).reshape(-1, len(its_weights), d)
        there = there - np.einsum("kab,qb->kqa", spin, on_facet) - mean[:, None]
        assert ratio(there, its_weights) <= cell.trace_factors[0, j]


@pytest.mark.parametrize("d", [2, 3])
def test_linear_stresses_are_in_the_element(d):
    """They are determined by their tractions and their divergence."""
    rng = np.random.default_rng(d)
    cells = Simplices(rng.standard_normal((5, d + 1, d)))
    stresses = CellStresses(cells, np.repeat(np.eye(d * (d + 1) // 2)[None], 5, axis=0))
    linear = rng.standard_normal((5, d + 1, d, d))
    linear += np.swapaxes(linear, 2, 3)
    tractions = np.einsum("nkab,njb->njka", linear, cells.normals)
    tractions[:, range(d + 1), range(d + 1)] = 0.0
    divergence = np.einsum("nkab,nkb->na", linear, cells.gradients)
    found = stresses.of_tractions(tractions, np.repeat(divergence[:, None], d + 1, axis=1))
    wanted = stresses.of_linear(linear)
    assert np.allclose(stresses.energies(found - wanted), 0.0, atol=1e-18 * np.abs(found).max())
    constant = np.repeat(linear[:, :1], d + 1, axis=1)
    squares = np.einsum("nab,nab->n", linear[:, 0], linear[:, 0])
    assert np.allclose(stresses.energies(stresses.of_linear(constant)), squares * cells.volumes)


@pytest.mark.parametrize("d", [2, 3])
def test_stresses_of_the_element_do_the_work_of_their_data(d):
    """For a linear displacement w: the integral of s : grad w, by tractions and divergence."""
    rng = np.random.default_rng(d)
    cells = Simplices(rng.standard_normal((1, d + 1, d)))
    n = d + 1
    stresses = CellStresses(cells, np.eye(d * (d + 1) // 2)[None])
    # tractions in equilibrium with a linear divergence: correct them by a linear stress vector
    tractions = rng.standard_normal((1, n, n, d))
    tractions[:, range(n), range(n)] = 0.0
    mass, on_facet = mean_products(n, 2), mean_products(d, 2)
    centred = cells.points - cells.points.mean(axis=1, keepdims=True)

    def resultants(t: np.ndarray) -> np.ndarray:
        force, moment = np.zeros(d), np.zeros(d * (d - 1) // 2)
        for j in range(n):
            k = [k for k in range(n) if k != j]
            force += cells.areas[0, j] * t[0, j, k].mean(axis=0)
            moment += cells.areas[0, j] * moments(on_facet @ centred[0, k], t[0, j, k]).sum(axis=0)
        return np.concatenate([force, moment])

    def of_load(g: np.ndarray) -> np.ndarray:
        moment = moments(mass @ centred[0], g.reshape(n, d)).sum(axis=0)
        return cells.volumes[0] * np.concatenate([g.reshape(n, d).mean(axis=0), moment])

    columns = np.column_stack([of_load(e) for e in np.eye(n * d)])
    divergence = np.linalg.lstsq(columns, resultants(tractions), rcond=None)[0].reshape(1, n, d)
    values = stresses.of_tractions(tractions, divergence)
    slope = rng.standard_normal((d, d))
    w = centred[0] @ slope.T
    work = -cells.volumes[0] * np.einsum("ja,jk,ka->", divergence[0], mass, w)
    for j in range(n):
        k = [k for k in range(n) if k != j]
        work += cells.areas[0, j] * np.einsum("ka,kl,la->", tractions[0, j, k], on_facet, w[k])
    strain = np.broadcast_to(0.5 * (slope + slope.T), (1, n, d, d))
    both = stresses.energies(values + stresses.of_linear(strain))
    both -= stresses.energies(values - stresses.of_linear(strain))
    assert np.isclose(0.25 * both[0], work)


def test_the_element_is_symmetric_and_not_just_in_the_mean():
    for d in (2, 3):
        basis = stress_element(d).basis
        assert np.array_equal(basis, np.swapaxes(basis, 1, 2))
        assert np.allclose(np.einsum("aij,bij->ab", basis, basis), np.eye(len(basis)))
