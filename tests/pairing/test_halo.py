"""Halos: a rank has all facets that its own facets may meet, and few others."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca.pairing.search.balls import (
    Balls,
    Pieces,
    at_own_nodes,
    facets_at_own_nodes,
    halos,
)
from dolfinx_tresca.pairing.search.facets import Facets
from dolfinx_tresca.pairing.search.tagged import tagged_facets
from scenes.patches import LOWER, UPPER, patch


def owned_sides(scene: Any) -> tuple[Facets, Facets]:
    """Return the facets of both sides that this rank owns."""
    prescribed = np.zeros(scene.V.dofmap.index_map.size_local * scene.V.dofmap.bs, dtype=bool)
    return tuple(
        tagged_facets(scene.V, prescribed, scene.facet_tags, tag, "secondary")
        for tag in (UPPER, LOWER)
    )


def keys(comm: MPI.Comm, facets: Any, *, everywhere: bool = False) -> set[tuple[int, ...]]:
    """Return the sorted nodes of facets, of this rank or of all ranks."""
    own = set(map(tuple, np.sort(facets.nodes, axis=1).tolist()))
    return set().union(*comm.allgather(own)) if everywhere else own


def ring(x: np.ndarray) -> np.ndarray:
    """Bend blocks around an axis."""
    last = 2 if np.ptp(x[:, 2]) > 0.0 else 1
    result, angle, radius = x.copy(), 2.5 * x[:, 0], 1.0 + x[:, last]
    result[:, 0], result[:, last] = radius * np.sin(angle), radius * np.cos(angle)
    return result


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["triangle", "hexahedron"])
def test_owner_of_a_node_has_all_facets_at_the_node(comm, kind):
    scene = patch(comm, kind, split=True)
    low, high = scene.V.dofmap.index_map.local_range
    for owned in owned_sides(scene):
        everywhere = keys(comm, owned, everywhere=True)
        wanted = {facet for facet in everywhere if any(low <= node < high for node in facet)}
        assert keys(comm, facets_at_own_nodes(scene.V, owned)) == wanted


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
@pytest.mark.parametrize("limit", [np.inf, 0.2])
def test_halo_contains_all_facets_along_the_normals(comm, kind, limit):
    """One ring is inside another; normals also meet the opposite side unless the limit is small."""
    scene = patch(comm, kind, upper=(7, 2), lower=(5, 2), warp=ring, gap=0.1)
    sides = owned_sides(scene)
    whole = [comm.allgather(owned) for owned in sides]
    secondary, primary = halos(scene.V, *sides, limit)
    mine = Pieces.from_facets(secondary)
    some = np.isin(mine.facet, at_own_nodes(scene.V, secondary))
    for halo, parts in zip((secondary, primary), whole, strict=True):
        found = keys(comm, halo)
        for facets in parts:
            pieces = Pieces.from_facets(facets)
            _, second = Balls(pieces.centres, pieces.radii).on_normals(
                mine.centres[some], mine.normals[some], mine.radii[some], limit
            )
            needed = np.sort(facets.nodes[pieces.facet[second]], axis=1)
            assert set(map(tuple, needed.tolist())) <= found
    # all facets at the corners of these facets, which their normals need
    corners = np.unique(secondary.nodes[at_own_nodes(scene.V, secondary)])
    for facets in whole[0]:
        beside = np.isin(facets.nodes, corners).any(axis=1)
        assert set(map(tuple, np.sort(facets.nodes[beside], axis=1).tolist())) <= keys(
            comm, secondary
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
        owned = keys(comm, owned_facets)
        for nodes, points in zip(halo.nodes, halo.points, strict=True):
            if tuple(sorted(nodes.tolist())) not in owned:
                low = scene.V.dofmap.index_map.local_range
                of_node = ((nodes >= low[0]) & (nodes < low[1])).any()
                near = np.abs(treated[:, None] - points[:, 0]).min(initial=np.inf) < 4.0 / n
                assert of_node or near
