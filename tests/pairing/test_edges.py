"""Smooth patches: sharp edges partition the facets at a node."""

from __future__ import annotations

import numpy as np
import pytest
from rotations import rotation

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Frictionless, PairingError, RigidPlane
from dolfinx_tresca.pairing.facets import EDGE_ANGLE, smooth_patches
from scenes.elasticity import elasticity, no_load


def fan(angles: np.ndarray) -> np.ndarray:
    """Return unit normals at angles [degrees] in a rotated plane."""
    turns = np.radians(angles)
    flat = np.stack([np.cos(turns), np.sin(turns), np.zeros(len(turns))], axis=1)
    return flat @ rotation(5).T


@pytest.mark.parametrize(
    ("angles", "patches"),
    [
        ((0.0, 0.0), 1),
        ((0.0, EDGE_ANGLE - 1.0), 1),
        ((0.0, EDGE_ANGLE + 1.0), 2),
        ((0.0, 90.0, 0.0, 90.0), 2),
        ((0.0, 45.0, 90.0), 1),  # a fillet
        ((0.0, 360.0 / 7.0), 1),  # a heptagon is smooth
        ((0.0, 60.0), 2),  # a hexagon has sharp edges
        ((0.0, 180.0), 2),
        ((0.0, 120.0, 240.0), 3),
        ((0.0, 30.0, 120.0, 150.0), 2),
    ],
)
def test_patch_is_a_chain_of_normals(angles, patches):
    """The result does not depend on the order; a flat node comes before and another one after."""
    for order in (slice(None), slice(None, None, -1)):
        normals = fan(np.array([0.0, 1.0, *angles[order], 90.0]))
        node = np.array([0, 0, *[1] * len(angles), 2])
        patch, of_patch = smooth_patches(node, normals)
        assert np.array_equal(of_patch[patch], node)
        assert np.bincount(of_patch).tolist() == [1, patches, 1]
        near = normals @ normals.T >= np.cos(np.radians(EDGE_ANGLE))
        assert (patch[:, None] == patch)[near & (node[:, None] == node)].all()


@pytest.mark.parallel
def test_a_node_whose_normals_cancel_is_an_error(comm):
    """Two slender cones share their tips, and their sides are nearly parallel there."""
    k, angle = np.arange(8), 0.25 * np.pi * np.arange(8)
    ring = 0.2 * np.column_stack([np.cos(angle), np.sin(angle)])
    x, cells = [np.zeros((1, 3))], []
    for start, height in ((1, -1.0), (10, 1.0)):
        x += [[[0.0, 0.0, height]], np.column_stack([ring, np.full(8, height)])]
        cells.append(
            np.column_stack([0 * k, 0 * k + start, start + 1 + k, start + 1 + (k + 1) % 8])
        )
    rows = slice(None) if comm.rank == 0 else slice(0)
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    cones = dolfinx.mesh.create_mesh(
        comm=comm, cells=np.vstack(cells)[rows], x=np.vstack(x)[rows], e=ufl.Mesh(element)
    )
    cones.topology.create_connectivity(2, 3)
    facets = dolfinx.mesh.exterior_facet_indices(cones.topology)
    tags = dolfinx.mesh.meshtags(cones, 2, facets, np.full(len(facets), 1, dtype=np.int32))
    V = fem.functionspace(cones, ("Lagrange", 1, (3,)))
    pair = ContactPair(tags, 1, RigidPlane((-0.2, 0.0, 0.0), (1.0, 0.0, 0.0)), Frictionless())
    with pytest.raises(PairingError, match=r"no normal at .*Repair the mesh"):
        ContactProblem(elasticity(V, 1.0), no_load(V), [pair], [])
