"""Nodes of a tagged surface."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import EPS, moved, rotation, two_bricks

from dolfinx_tresca import InputError
from dolfinx_tresca.surface.nodes import surface_nodes, tangents


def nodes_of(scene, name: str):
    return surface_nodes(scene.V, scene.bricks.facet_tags, scene.bricks.tags[name], "secondary")


AREAS = {
    "upper_contact": (2.0, (0, 0, -1)),
    "lower_contact": (2.0, (0, 0, 1)),
    "upper_fixed": (1.0, (1, 0, 0)),
    "lower_fixed": (1.0, (-1, 0, 0)),
}


@pytest.mark.parametrize("hexahedra", [False, True])
@pytest.mark.parametrize("name", AREAS)
def test_weights_add_up_to_the_area_and_normals_point_out(comm, name, hexahedra):
    area, normal = AREAS[name]
    N = 4
    surface = nodes_of(two_bricks(comm, N, hexahedra=hexahedra), name)
    assert comm.allreduce(float(surface.weights.sum())) == pytest.approx(area, rel=1e-12)
    assert (surface.weights > 0.0).all()
    assert np.allclose(surface.normals, normal, atol=100 * EPS)
    assert comm.allreduce(len(surface.nodes)) == (N * (N + 1) if area == 2.0 else N * N)


def test_every_node_is_owned_once(comm):
    scene = two_bricks(comm, 4)
    surface = nodes_of(scene, "upper_contact")
    points = np.concatenate(comm.allgather(np.round(surface.points, 9)))
    assert len(np.unique(points, axis=0)) == len(points)
    assert np.allclose(scene.V.tabulate_dof_coordinates()[surface.nodes], surface.points)


def test_a_turned_surface_has_turned_normals(comm):
    R = rotation(1)
    surface = nodes_of(moved(comm, lambda x: x @ R.T, turn=R), "upper_contact")
    assert np.allclose(surface.normals, R @ [0, 0, -1], atol=1e3 * EPS)
    assert comm.allreduce(float(surface.weights.sum())) == pytest.approx(2.0, rel=1e-12)


def test_an_unused_tag_is_named_with_those_in_use(comm):
    scene = two_bricks(comm, 3)
    with pytest.raises(InputError, match=r"tag 99 .*secondary.*11, 12, 13, 21, 22, 23, 24"):
        surface_nodes(scene.V, scene.bricks.facet_tags, 99, "secondary")


@settings(deadline=None, derandomize=True, max_examples=100)
@given(st.integers(0, 10**6), st.integers(0, 20))
def test_tangents_are_orthonormal_and_right_handed(seed, number):
    rng = np.random.default_rng(seed)
    n = rng.standard_normal((number, 3)) * (rng.random((number, 3)) < 0.7) + 1e-30
    n /= np.linalg.norm(n, axis=1)[:, None]
    n = np.concatenate([n, np.eye(3), -np.eye(3)])
    t = tangents(n)
    frames = np.concatenate([n[:, None], t], axis=1)
    assert np.allclose(np.einsum("nai,nbi->nab", frames, frames), np.eye(3), atol=20 * EPS)
    assert np.allclose(np.linalg.det(frames), 1.0, atol=20 * EPS)
