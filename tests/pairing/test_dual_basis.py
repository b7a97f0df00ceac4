"""Multiplier bases on facets."""

from __future__ import annotations

import numpy as np
import pytest
from sheets import CELLS, nodes_of, sheet

from dolfinx_tresca.pairing.dual_basis import (
    assembled_rows,
    dual_coefficients,
    whole_facet_integrals,
    without_rounding,
)
from scenes.scene import EPS

ROUNDING = 1e3 * EPS


def wavy(x: np.ndarray) -> np.ndarray:
    x[:, -1] += 0.1 * np.sin(3.0 * x[:, 0] + x[:, 1])
    return x


MOVES = pytest.mark.parametrize("move", [None, wavy])


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
@MOVES
def test_the_basis_is_biorthogonal_and_sums_to_one(cell, degree, move):
    """Integrals of psi_i phi_j are those of phi_i for i = j, else 0."""
    facets = sheet(cell, 3, degree=degree, distort=0.6, move=move)
    integrals = whole_facet_integrals(facets)
    dual = dual_coefficients(integrals, np.ones(len(facets.points), dtype=bool))
    products = dual @ integrals.hats
    weights = integrals.weights
    assert (weights > 0.0).all()
    diagonal = weights[:, :, None] * np.eye(facets.corners)
    assert np.abs(products - diagonal).max() <= ROUNDING * weights.max()
    assert np.allclose(dual.sum(axis=1), 1.0, atol=ROUNDING)


@pytest.mark.parametrize("cell", CELLS)
def test_on_facets_that_are_covered_in_part_it_consists_of_hats(cell):
    facets = sheet(cell, 2)
    full = np.zeros(len(facets.points), dtype=bool)
    full[0] = True
    dual = dual_coefficients(whole_facet_integrals(facets), full)
    assert np.array_equal(dual[1:], np.broadcast_to(np.eye(facets.corners), dual[1:].shape))
    assert not np.allclose(dual[0], np.eye(facets.corners))


def test_facets_without_any_cover_give_no_nan():
    facets = sheet("triangle", 2)
    integrals = whole_facet_integrals(facets)
    integrals.hats[0] = 0.0
    full = np.ones(len(facets.points), dtype=bool)
    full[0] = False
    assert np.isfinite(dual_coefficients(integrals, full)).all()


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
@MOVES
def test_integrals_of_whole_facets(cell, degree, move):
    """Partition of unity on both sides: sums of hats and of the displacement's basis."""
    facets = sheet(cell, 3, degree=degree, distort=0.6, move=move)
    integrals = whole_facet_integrals(facets)
    nodes = nodes_of(facets)
    assert np.allclose(integrals.values.sum(axis=2), integrals.weights, atol=ROUNDING)
    weights = np.zeros(len(nodes.numbers))
    np.add.at(weights, nodes.facet_nodes, integrals.weights)
    # the two quadratures differ where the area is the root of a polynomial
    flat = move is None or (degree == 1 and cell != "quadrilateral")
    assert np.allclose(weights, nodes.weights, rtol=ROUNDING if flat else 1e-4)


def test_rows_are_summed_over_facets():
    facets = sheet("interval", 3)
    nodes = nodes_of(facets)
    values = np.ones((3, 2, 2))
    matrix = assembled_rows(nodes, nodes.facet_nodes, facets.nodes, values, 6).toarray()
    expected = np.zeros((4, 6))
    expected[:, :4] = [[1, 1, 0, 0], [1, 2, 1, 0], [0, 1, 2, 1], [0, 0, 1, 1]]
    assert np.array_equal(matrix, expected)


def test_entries_that_are_rounding_go():
    facets = sheet("interval", 1)
    nodes = nodes_of(facets)
    values = np.array([[[1.0, 1e-17], [1e-17, 1e-17]]])
    matrix = assembled_rows(nodes, nodes.facet_nodes, facets.nodes, values, 2)
    cleaned = without_rounding(matrix, np.array([1.0, 1e-17]))
    assert cleaned.nnz == 3
    assert np.array_equal(cleaned.toarray(), [[1.0, 0.0], [1e-17, 1e-17]])
