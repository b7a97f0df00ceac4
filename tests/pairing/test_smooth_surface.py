"""The sagitta: height of a smooth surface over its flat facets."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from sheets import CELLS, joined, nodes_of, sheet

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


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_sagitta_of_a_cylinder_with_distorted_facets(cell):
    """Fitted normals converge; with mean normals the error is a fixed part of the sagitta."""
    for n in (8, 16, 32):
        facets = sheet(cell, n, (-0.5, 0.5), height=RADIUS, distort=0.6, move=on_cylinder)
        found, true = heights(facets, nodes_of(facets), np.array([1.0, 0.0, 1.0]))
        inner = (np.abs(facets.points[:, :, :2]).max(axis=1) < 0.5 * 0.7).all(axis=1)
        error = np.abs(found - true).reshape(len(facets.points), -1)[inner].max()
        assert error < 0.01 * np.abs(true).max()


@pytest.mark.parametrize("cell", CELLS)
def test_flat_surface_has_no_sagitta(cell):
    facets = sheet(cell, 4, distort=0.5)
    surface = SmoothSurface(nodes_of(facets))
    assert not surface.nonzero


@pytest.mark.parametrize("cell", CELLS)
def test_sharp_edge_has_no_sagitta(cell):
    """The mean normal at the ridge of a roof belongs to neither side."""

    def roof(x: np.ndarray) -> np.ndarray:
        x[:, 1 if cell == "interval" else 2] -= np.abs(x[:, 0] - 0.5)
        return x

    facets = sheet(cell, 4, move=roof)
    assert not SmoothSurface(nodes_of(facets)).nonzero


def test_smooth_surface_beside_a_sharp_edge_keeps_its_sagitta():
    cap = sheet("triangle", 6, (-0.5, 0.5), height=RADIUS, move=on_sphere)
    wall = sheet(
        "triangle",
        6,
        (-0.5, 0.5),
        height=0.5,
        first=100,
        move=lambda x: x[:, [1, 2, 0]] + [0.0, 0.0, RADIUS - 1.0],
        away=lambda x: np.array([0.0, 1.0, 0.0]),
    )
    both = joined(cap, wall)
    surface = SmoothSurface(nodes_of(both))
    hats = np.full((2, 3), 1.0 / 3.0)
    found = surface.heights(np.array([30, len(cap.points) + 5]), hats)
    assert surface.nonzero and found[0] > 0.0 and abs(found[1]) < 1e-12


def test_curved_facets_have_no_sagitta():
    facets = sheet("triangle", 4, (-0.5, 0.5), degree=2, height=RADIUS, move=on_sphere)
    assert not SmoothSurface(nodes_of(facets)).nonzero
