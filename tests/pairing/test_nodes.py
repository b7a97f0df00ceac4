"""Nodes of a tagged surface: weights, normals, tangents."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sheets import CELLS, sheet
from sheets import nodes_of as nodes_of_facets

from dolfinx_tresca.pairing.coupling import owned_nodes
from dolfinx_tresca.pairing.search.balls import facets_at_own_nodes
from dolfinx_tresca.pairing.search.facets import SurfaceNodes, tangents
from dolfinx_tresca.pairing.search.tagged import tagged_facets
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.scene import EPS
from scenes.two_bricks import two_bricks


def nodes_of(scene, name: str) -> SurfaceNodes:
    tag = scene.tags[name]
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        facets = tagged_facets(scene.V, system.prescribed, scene.facet_tags, tag, "secondary")
    return SurfaceNodes.from_facets(facets_at_own_nodes(scene.V, facets))


@pytest.mark.parallel
def test_smooth_surface_has_one_entry_per_node(comm):
    scene = two_bricks(comm, 4)
    surface = nodes_of(scene, "upper_contact")
    assert (np.diff(surface.numbers) > 0).all()
    assert len(np.unique(np.round(surface.points, 9), axis=0)) == len(surface.points)
    own = owned_nodes(scene.V, surface)
    local = surface.numbers[own] - scene.V.dofmap.index_map.local_range[0]
    assert np.allclose(scene.V.tabulate_dof_coordinates()[local], surface.points[own])


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("degree", [1, 2])
def test_normals_of_a_sphere(cell, degree):
    """Their error is O(h^2) inside; at the rim, where facets are on one side only, it is larger."""
    errors = []
    for n in (4, 8):
        facets = sheet(
            cell,
            n,
            (-0.5, 0.5),
            degree=degree,
            height=1.0,
            move=lambda x: x / np.linalg.norm(x, axis=1)[:, None],
        )
        nodes = nodes_of_facets(facets)
        inside = np.abs(
            nodes.points[:, :2] / nodes.points[:, -1 if cell != "interval" else 1, None]
        )
        inner = inside[:, 0] < 0.4
        if cell != "interval":
            inner &= inside[:, 1] < 0.4
        error = np.linalg.norm(nodes.normals - nodes.points, axis=1)
        errors.append(error[inner].max())
        assert error.max() < 0.2
    assert errors[1] < 0.5 * errors[0] or errors[1] < 100 * EPS


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(0, 20), st.sampled_from([2, 3]))
def test_tangents_are_orthonormal(seed, number, dim):
    """Some normals are along the axes."""
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((number, dim)) * (rng.random((number, dim)) < 0.7) + 1e-30
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    normals = np.concatenate([normals, np.eye(dim), -np.eye(dim)])
    t = tangents(normals)
    assert t.shape == (len(normals), dim - 1, dim)
    axes = np.concatenate([normals[:, None], t], axis=1)
    assert np.allclose(np.einsum("nai,nbi->nab", axes, axes), np.eye(dim), atol=100 * EPS)
