"""Halos: a rank has all facets that its own facets may meet, and few others."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca.pairing.search.balls import at_own_nodes, halos
from dolfinx_tresca.pairing.search.facets import Facets
from dolfinx_tresca.pairing.search.tagged import tagged_facets
from scenes.assembled import points_of
from scenes.nodal import global_vector
from scenes.patches import LOWER, UPPER, patch
from scenes.scene import EPS


def owned_sides(scene: Any) -> tuple[Facets, Facets]:
    """Return the facets of both sides that this rank owns."""
    prescribed = np.zeros(scene.V.dofmap.index_map.size_local * scene.V.dofmap.bs, dtype=bool)
    return tuple(
        tagged_facets(scene.V, prescribed, scene.facet_tags, tag, "secondary")
        for tag in (UPPER, LOWER)
    )


@pytest.mark.parallel
def test_halo_contains_no_distant_facets(comm):
    """All facets of other ranks are within a few facets of this rank's facets on a line."""
    n = 60
    scene = patch(comm, "triangle", upper=(n, 1), lower=(n - 7, 1))
    sides = owned_sides(scene)
    secondary, primary = halos(scene.V, *sides, np.inf)
    treated = secondary.points[at_own_nodes(scene.V, secondary)][..., 0].ravel()
    for halo, owned_facets in zip((secondary, primary), sides, strict=True):
        owned = set(map(tuple, np.sort(owned_facets.nodes, axis=1).tolist()))
        for nodes, points in zip(halo.nodes, halo.points, strict=True):
            if tuple(sorted(nodes.tolist())) not in owned:
                low = scene.V.dofmap.index_map.local_range
                of_node = ((nodes >= low[0]) & (nodes < low[1])).any()
                near = np.abs(treated[:, None] - points[:, 0]).min(initial=np.inf) < 4.0 / n
                assert of_node or near


def ring(x: np.ndarray) -> np.ndarray:
    """Bend blocks around an axis."""
    last = 2 if np.ptp(x[:, 2]) > 0.0 else 1
    result, angle, radius = x.copy(), 2.5 * x[:, 0], 1.0 + x[:, last]
    result[:, 0], result[:, last] = radius * np.sin(angle), radius * np.cos(angle)
    return result


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
def test_curved_surfaces_have_the_same_gaps_on_any_number_of_ranks(comm, kind):
    """They depend on normals of facets around those that meet."""
    gaps = []
    for ranks in (MPI.COMM_SELF, comm):
        scene = patch(ranks, kind, upper=(12, 1), lower=(9, 1), warp=ring, gap=0.02)
        found = scene.operators()
        gaps.append(global_vector(ranks, points_of(scene, found), found.gap))
    assert np.abs(gaps[0] - gaps[1]).max() <= 1e4 * EPS
