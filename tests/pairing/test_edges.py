"""Smooth patches: sharp edges partition the facets at a node."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from rotations import rotation
from sheets import nodes_of, sheet

from dolfinx_tresca import PairingError
from dolfinx_tresca.pairing.pair_surfaces import _surface_nodes
from dolfinx_tresca.pairing.search.facets import EDGE_ANGLE, smooth_patches


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


def test_a_rank_without_facets_has_no_patches():
    patch, of_patch = smooth_patches(np.zeros(0, dtype=np.intp), np.zeros((0, 3)))
    assert len(patch) == len(of_patch) == 0


def test_error_names_a_node_whose_normals_cancel():
    """The triangles all contain the same axis, like a needle."""
    count = 12
    turn = 2.0 * np.pi * np.arange(count) / count
    spokes = np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    side = np.stack([-spokes[:, 1], spokes[:, 0], spokes[:, 2]], axis=1)
    tip = np.array([0.0, 0.0, 1.0])
    points = np.stack([0 * spokes, tip + 0 * spokes, tip + side], axis=1)
    one = sheet("triangle", 1)
    needle = dataclasses.replace(
        one,
        nodes=np.array([[0, 1, 2 + k] for k in range(count)]),
        points=points,
        free=np.ones((count, 3, 3), dtype=bool),
        file_numbers=np.array([[0, 1, 2 + k] for k in range(count)]),
        outward=np.ones(count),
    )
    nodes = nodes_of(needle)
    assert np.array_equal(np.flatnonzero(nodes.has_no_normal), [0, 1])
    assert np.isfinite(nodes.normals).all()
    pair = SimpleNamespace(side=lambda name: "tag 1")
    space = SimpleNamespace(
        mesh=SimpleNamespace(comm=MPI.COMM_SELF),
        dofmap=SimpleNamespace(index_map=SimpleNamespace(local_range=(1, count + 2))),
    )
    with pytest.raises(PairingError, match=r"no normal at \[0\. 0\. 1\.\].*Repair the mesh"):
        _surface_nodes(space, pair, "secondary", needle, needle, moved=False)
