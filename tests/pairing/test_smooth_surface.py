"""The sagitta: height of a smooth surface over its flat facets."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sheets import CELLS, nodes_of, sheet

from dolfinx_tresca.pairing.contact_normal import SmoothSurface
from dolfinx_tresca.pairing.search.facets import quadrature

RADIUS = 2.0


def on_sphere(x: np.ndarray) -> np.ndarray:
    return RADIUS * x / np.linalg.norm(x, axis=1)[:, None]


def on_cylinder(x: np.ndarray) -> np.ndarray:
    """Map a plane onto a cylinder around the y-axis; x becomes the arc length."""
    angle = x[:, 0] / RADIUS
    return np.stack([RADIUS * np.sin(angle), x[:, 1], RADIUS * np.cos(angle)], axis=1)


def heights(facets, nodes, across) -> tuple[np.ndarray, np.ndarray]:
    """Return sagitta and exact height at quadrature points; `across` (3,): curved directions."""
    x, _ = quadrature(facets.cell, 4)
    hats = facets.hats(x)
    facet = np.repeat(np.arange(len(facets.points)), len(x))
    values = np.tile(hats, (len(facets.points), 1))
    points = np.einsum("qc,nci->nqi", hats, facets.points[:, : facets.corners]).reshape(-1, 3)
    surface = SmoothSurface(nodes)
    assert surface.nonzero
    return surface.heights(facet, values), RADIUS - np.linalg.norm(points * across, axis=1)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
@pytest.mark.parametrize("exact", [True, False])
def test_sagitta_is_correct_to_second_order(cell, shape, exact):
    """The sagitta is O(h^2), its error O(h^3) with mean normals, and less with exact ones.

    At the rim mean normals see facets on one side only, and the error is O(h^2).
    """
    across = np.array([1.0, 1.0, 1.0] if shape == "sphere" or cell == "interval" else [1.0, 0, 1.0])
    errors = []
    for n in (4, 8, 16):
        move = on_sphere if shape == "sphere" or cell == "interval" else on_cylinder
        facets = sheet(cell, n, (-0.5, 0.5), height=RADIUS, move=move)
        nodes = nodes_of(facets)
        if exact:
            out = nodes.points * across
            out = out / np.linalg.norm(out, axis=1)[:, None]
            nodes = dataclasses.replace(nodes, normals=out)
        found, true = heights(facets, nodes, across)
        size = np.abs(true).max()
        inner = np.ones(len(facets.points), dtype=bool)
        if not exact:
            span = np.abs(facets.points[:, : facets.corners, : facets.dim])
            inner = (span.max(axis=1) < 0.5 * 0.8).all(axis=1)
        error = np.abs(found - true).reshape(len(facets.points), -1)[inner].max()
        assert error < 0.2 * size
        errors.append(error)
    assert np.log2(errors[-2] / errors[-1]) > (3.0 if exact else 2.5)
