"""The dual multiplier basis on facets."""

from __future__ import annotations

import numpy as np
import pytest
from sheets import CELLS, nodes_of, sheet

from dolfinx_tresca.pairing.coupling import (
    LEAST_EIGENVALUE,
    assemble_rows,
    dual_coefficients,
    redistributed,
)
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals, whole_facet_integrals
from scenes.scene import EPS

ROUNDING = 1e3 * EPS

#: Rounding amplified by the inverse of a nearly singular mass matrix.
AMPLIFIED = EPS / LEAST_EIGENVALUE


def all_carry(hats: np.ndarray) -> np.ndarray:
    return np.ones(hats.shape[:2], dtype=bool)


def wavy(x: np.ndarray) -> np.ndarray:
    x[:, -1] += 0.1 * np.sin(3.0 * x[:, 0] + x[:, 1])
    return x


MOVES = pytest.mark.parametrize("move", [None, wavy])


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
@MOVES
def test_the_basis_is_biorthogonal_and_sums_to_one(cell, degree, move):
    """The integral of psi_i phi_j is the integral of phi_i for i = j, else 0."""
    facets = sheet(cell, 3, degree=degree, distort=0.6, move=move)
    hats, _ = whole_facet_integrals(facets)
    dual = dual_coefficients(hats, np.ones(len(facets.points), dtype=bool), all_carry(hats))
    products = dual @ hats
    weights = hats.sum(axis=2)
    assert (weights > 0.0).all()
    diagonal = weights[:, :, None] * np.eye(facets.corners)
    assert np.abs(products - diagonal).max() <= ROUNDING * weights.max()
    assert np.allclose(dual.sum(axis=1), 1.0, atol=ROUNDING)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("shift", [0.2, 0.973, 0.99])
def test_on_covered_parts_it_is_biorthogonal_too(cell, shift):
    """The covered part may be a strip or a corner of a facet."""
    secondary = sheet(cell, 3, (shift, 1.0 + shift), up=False)
    primary = sheet(cell, 4, first=1000)
    integrals = MortarIntegrals(
        nodes_of(secondary), nodes_of(primary), np.arange(3**secondary.dim), 1.0
    )
    hats = integrals.hats
    some = (hats.sum(axis=(1, 2)) > 0.0) & ~integrals.full
    assert some.any()
    dual = dual_coefficients(hats, integrals.full, all_carry(hats))[some]
    assert np.allclose(dual.sum(axis=1), 1.0, atol=AMPLIFIED)
    weights = hats.sum(axis=2)[some]
    error = dual @ hats[some] - weights[:, :, None] * np.eye(secondary.corners)
    assert (np.abs(error).max(axis=(1, 2)) <= AMPLIFIED * weights.sum(axis=1)).all()


@pytest.mark.parametrize("cell", CELLS)
def test_basis_with_corners_without_a_multiplier(cell):
    """It is biorthogonal to the redistributed hat functions, and sums to 1."""
    facets = sheet(cell, 2, distort=0.4)
    hats, _ = whole_facet_integrals(facets)
    weights = hats.sum(axis=2)
    carries = np.ones((len(facets.points), facets.corners), dtype=bool)
    carries[:, 0] = False
    dual = dual_coefficients(hats, np.ones(len(carries), dtype=bool), carries)
    assert not dual[:, 0].any()
    assert np.allclose(dual.sum(axis=1), 1.0, atol=ROUNDING)
    taken = redistributed(np.broadcast_to(np.eye(facets.corners), dual.shape), carries)
    products = dual @ hats @ taken.transpose(0, 2, 1)
    diagonal = (taken @ weights[:, :, None]) * np.eye(facets.corners)
    assert np.abs(products - diagonal).max() <= ROUNDING * weights.max()


@pytest.mark.parametrize("width", [1e-1, 1e-2, 1e-9])
def test_covered_strip_across_a_triangle(width):
    """On a narrow strip the hat functions are nearly linearly dependent."""
    x, w = np.polynomial.legendre.leggauss(4)
    along, across = np.meshgrid(0.25 + 0.25 * x, 0.5 + 0.5 * width * x)
    hats = np.stack([1.0 - along - across, along, across]).reshape(3, -1)
    products = ((np.outer(w, w).ravel() * hats) @ hats.T)[None]
    dual = dual_coefficients(products, np.zeros(1, dtype=bool), all_carry(products))
    assert np.allclose(dual.sum(axis=1), 1.0, atol=AMPLIFIED)
    assert np.abs(dual[0] @ hats).max() <= 2.0 / max(width, LEAST_EIGENVALUE**0.5)


def test_facets_without_covered_part_give_finite_values():
    facets = sheet("triangle", 2)
    covered, _ = whole_facet_integrals(facets)
    covered[0] = 0.0
    full = np.ones(len(facets.points), dtype=bool)
    full[0] = False
    assert np.isfinite(dual_coefficients(covered, full, all_carry(covered))).all()


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
@MOVES
def test_integrals_of_whole_facets(cell, degree, move):
    """Hat functions and basis functions are partitions of unity."""
    facets = sheet(cell, 3, degree=degree, distort=0.6, move=move)
    hats, values = whole_facet_integrals(facets)
    nodes = nodes_of(facets)
    assert np.allclose(values.sum(axis=2), hats.sum(axis=2), atol=ROUNDING)
    weights = np.zeros(len(nodes.numbers))
    np.add.at(weights, nodes.facet_nodes, hats.sum(axis=2))
    # the two quadratures differ if the area element is not a polynomial
    flat = move is None or (degree == 1 and cell != "quadrilateral")
    assert np.allclose(weights, nodes.weights, rtol=ROUNDING if flat else 1e-4)


def test_rows_are_summed_over_facets():
    facets = sheet("interval", 3)
    nodes = nodes_of(facets)
    values = np.ones((3, 2, 2))
    matrix = assemble_rows(nodes, nodes.facet_nodes, facets.nodes, values, 6).toarray()
    expected = np.zeros((4, 6))
    expected[:, :4] = [[1, 1, 0, 0], [1, 2, 1, 0], [0, 1, 2, 1], [0, 0, 1, 1]]
    assert np.array_equal(matrix, expected)


def test_rounding_has_no_entries():
    facets = sheet("interval", 1)
    nodes = nodes_of(facets)
    values = np.array([[[1.0, 1e-17], [1e-17, 1.0]]])
    matrix = assemble_rows(nodes, nodes.facet_nodes, facets.nodes, values, 2)
    assert matrix.nnz == 2
    assert np.array_equal(matrix.toarray(), np.eye(2))
