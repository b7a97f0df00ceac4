"""The nearest one of several layers is paired."""

from __future__ import annotations

import numpy as np
import pytest
from sheets import CELLS, joined, nodes_of, part_of, sheet

from dolfinx_tresca.pairing.coupling import mortar_rows
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.search.facets import Facets
from scenes.scene import EPS


def gaps(secondary: Facets, primary: Facets) -> tuple[np.ndarray, np.ndarray]:
    """Return weights and mean gaps along the last axis at the secondary nodes."""
    nodes, others = nodes_of(secondary), nodes_of(primary)
    columns = int(max(secondary.nodes.max(), primary.nodes.max())) + 1
    everything = np.arange(len(secondary.points))
    integrals = MortarIntegrals(nodes, others, everything, np.inf)
    carries = np.ones(nodes.facet_nodes.shape, dtype=bool)
    found = mortar_rows(nodes, primary, integrals, columns, carries)
    height = np.zeros(columns)
    for side in (secondary, primary):
        height[side.nodes] = side.points[..., side.dim]
    return found.weights, (found.jump @ height) / found.weights


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("near_first", [True, False])
def test_nearer_one_of_two_layers_is_paired(cell, near_first):
    secondary = sheet(cell, 3, height=1.0, up=False, distort=0.3)
    near = sheet(cell, 4, height=0.9, first=100, distort=0.3)
    far = sheet(cell, 5, height=0.5, first=200, distort=0.3)
    layers = (near, far) if near_first else (far, near)
    weights, distance = gaps(secondary, joined(*layers))
    assert weights.sum() == pytest.approx(1.0, rel=1e3 * EPS)
    assert np.allclose(distance, 0.1, atol=1e4 * EPS)


@pytest.mark.parametrize("cell", CELLS)
def test_near_layer_that_covers_one_half(cell):
    """The border of the near layer lies on edges of both meshes, so that the area is exact."""
    secondary = sheet(cell, 4, height=1.0, up=False)
    part = sheet(cell, 8, (0.0, 1.0), height=0.9, first=100)
    inside = part.points.mean(axis=1)[:, 0] < 0.5
    near = part_of(part, inside)
    far = sheet(cell, 8, height=0.5, first=300)
    weights, distance = gaps(secondary, joined(near, far))
    assert weights.sum() == pytest.approx(1.0, rel=1e3 * EPS)
    x = nodes_of(secondary).points[:, 0]
    assert np.allclose(distance[x < 0.49], 0.1, atol=1e4 * EPS)
    assert np.allclose(distance[x > 0.51], 0.5, atol=1e4 * EPS)


def test_penetration_counts_by_its_absolute_value():
    """A layer 0.05 behind is nearer than a layer 0.4 ahead."""
    secondary = sheet("triangle", 3, height=1.0, up=False)
    behind = sheet("triangle", 4, height=1.05, first=100)
    ahead = sheet("triangle", 4, height=0.6, first=200)
    weights, distance = gaps(secondary, joined(ahead, behind))
    assert weights.sum() == pytest.approx(1.0, rel=1e3 * EPS)
    assert np.allclose(distance, -0.05, atol=1e4 * EPS)
