"""The dual multiplier basis on facets."""

from __future__ import annotations

import numpy as np
import pytest
from sheets import CELLS, nodes_of, sheet

from dolfinx_tresca.pairing.coupling import (
    LEAST_EIGENVALUE,
    dual_coefficients,
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
