"""Inverse of the map from a reference facet to a plane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sheets import CELLS, sheet

import basix

from dolfinx_tresca.pairing.search.facets import project, quadrature, tabulate
from scenes.scene import EPS


def reference_nodes(cell: str, degree: int) -> np.ndarray:
    element = basix.create_element(basix.ElementFamily.P, basix.CellType[cell], degree,
                                   basix.LagrangeVariant.gll_warped)  # fmt: skip
    return element.points


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), size=st.sampled_from([1e-6, 1.0, 1e6]))
def test_projection_inverts_the_map(cell, degree, seed, size):
    """The facets are rotated, stretched and curved, but not folded."""
    rng = np.random.default_rng(seed)
    x, _ = quadrature(cell, 6)
    dim = x.shape[1]
    nodes = reference_nodes(cell, degree)
    nodes = nodes + 0.1 / degree * rng.uniform(-1.0, 1.0, nodes.shape) * (
        cell != "triangle" or degree > 1
    )
    stretch = np.linalg.qr(rng.standard_normal((dim, dim)))[0] * rng.uniform(0.2, 1.0, dim)
    nodes = size * (nodes @ stretch.T + rng.standard_normal(dim))
    places = tabulate(cell, degree, 0, x)[0] @ nodes
    facets = sheet(cell, 1, degree=degree)
    bent = degree > 1 or cell == "quadrilateral"
    object.__setattr__(facets, "bent", bent)
    found = project(facets, np.broadcast_to(nodes, (len(x), *nodes.shape)), places)
    assert np.abs(found - x).max() <= 1e4 * EPS


@pytest.mark.parametrize("cell", CELLS)
def test_points_outside_of_the_facet(cell):
    facets = sheet(cell, 1)
    nodes = 2.0 * reference_nodes(cell, 1) + 1.0
    place = np.full((1, nodes.shape[1]), 4.0)
    assert np.allclose(project(facets, nodes[None], place), 1.5, atol=10 * EPS)


def test_no_points():
    facets = sheet("quadrilateral", 1)
    assert project(facets, np.zeros((0, 4, 2)), np.zeros((0, 2))).shape == (0, 2)
