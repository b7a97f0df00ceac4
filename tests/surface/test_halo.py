"""What a rank has of surfaces: all that its facets may meet, and not much more."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.surface.halo import Halo, extend_halos
from dolfinx_tresca.surface.pieces import Pieces
from dolfinx_tresca.surface.search import Balls
from dolfinx_tresca.surface.tagged import tagged_facets
from scenes.patches import LOWER, UPPER, patch


def halos(scene: Any) -> tuple[Halo, Halo]:
    """Return both sides before anything is asked for."""
    prescribed = np.zeros(scene.V.dofmap.index_map.size_local * scene.V.dofmap.bs, dtype=bool)
    return tuple(
        Halo(scene.V, tagged_facets(scene.V, prescribed, scene.facet_tags, tag, "secondary"))
        for tag in (UPPER, LOWER)
    )


def keys(comm: MPI.Comm, facets: Any, *, everywhere: bool = False) -> set[tuple[int, ...]]:
    """Return facets by their nodes; those of all ranks if need be."""
    own = set(map(tuple, np.sort(facets.nodes, axis=1).tolist()))
    return set().union(*comm.allgather(own)) if everywhere else own


def ring(x: np.ndarray) -> np.ndarray:
    """Bend blocks round an axis."""
    last = 2 if np.ptp(x[:, 2]) > 0.0 else 1
    result, angle, radius = x.copy(), 2.5 * x[:, 0], 1.0 + x[:, last]
    result[:, 0], result[:, last] = radius * np.sin(angle), radius * np.cos(angle)
    return result


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["triangle", "hexahedron"])
def test_all_facets_round_a_node_are_with_its_owner(comm, kind):
    scene = patch(comm, kind, split=True)
    low, high = scene.V.dofmap.index_map.local_range
    for halo in halos(scene):
        everywhere = keys(comm, halo.facets, everywhere=True)
        wanted = {facet for facet in everywhere if any(low <= node < high for node in facet)}
        found = keys(comm, halo.facets)
        assert wanted <= found
        some = halo.facets.nodes[halo.facets_at_own_nodes()]
        assert set(map(tuple, np.sort(some, axis=1).tolist())) == wanted


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
@pytest.mark.parametrize("limit", [np.inf, 0.2])
def test_what_lies_along_the_normals_is_here(comm, kind, limit):
    """A ring in a ring, from one side only where the distance is limited."""
    scene = patch(comm, kind, upper=(7, 2), lower=(5, 2), warp=ring, gap=0.1)
    secondary, primary = halos(scene)
    whole = [comm.allgather(halo._owned.facets) for halo in (secondary, primary)]
    extend_halos(secondary, primary, limit)
    mine = Pieces.of(secondary.facets)
    some = np.isin(mine.facet, secondary.facets_at_own_nodes())
    for halo, parts in zip((secondary, primary), whole, strict=True):
        found = keys(comm, halo.facets)
        for facets in parts:
            pieces = Pieces.of(facets)
            _, second = Balls(pieces.centres, pieces.radii).on_normals(
                mine.centres[some], mine.normals[some], mine.radii[some], limit
            )
            needed = np.sort(facets.nodes[pieces.facet[second]], axis=1)
            assert set(map(tuple, needed.tolist())) <= found
    # all facets round the corners of those: their normals are right
    corners = np.unique(secondary.facets.nodes[secondary.facets_at_own_nodes()])
    for facets in whole[0]:
        beside = np.isin(facets.nodes, corners).any(axis=1)
        assert set(map(tuple, np.sort(facets.nodes[beside], axis=1).tolist())) <= keys(
            comm, secondary.facets
        )


@pytest.mark.parallel
def test_a_rank_has_what_it_faces_and_no_more(comm):
    """Along a line: nothing that is farther than some facets from what a rank treats."""
    n = 60
    scene = patch(comm, "triangle", upper=(n, 1), lower=(n - 7, 1))
    secondary, primary = halos(scene)
    extend_halos(secondary, primary, np.inf)
    treated = secondary.facets.points[secondary.facets_at_own_nodes()][..., 0].ravel()
    for halo in (secondary, primary):
        owned = keys(comm, halo._owned.facets)
        for nodes, points in zip(halo.facets.nodes, halo.facets.points, strict=True):
            if tuple(sorted(nodes.tolist())) not in owned:
                low = scene.V.dofmap.index_map.local_range
                of_node = ((nodes >= low[0]) & (nodes < low[1])).any()
                near = np.abs(treated[:, None] - points[:, 0]).min(initial=np.inf) < 4.0 / n
                assert of_node or near


@pytest.mark.parallel
def test_nodes_at_one_place_are_counted_on_any_rank(comm, caplog):
    """The upper block is torn along a plane: its nodes there are twins."""
    scene = patch(comm, "tetrahedron", upper=(4, 1), tear=lambda x: x[:, 0] < 0.5)
    pair_surfaces(scene.V, np.zeros(3 * scene.V.dofmap.index_map.size_local, bool), scene.pair)
    if comm.rank == 0:
        assert "secondary side) has 5 nodes at the place of another one" in caplog.text
