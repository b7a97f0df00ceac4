"""Pairing with a rigid obstacle: one surface, no second mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import diags_array

from dolfinx_tresca._parallel import errors_on_all_ranks
from dolfinx_tresca.obstacle import RigidObstacle
from dolfinx_tresca.pair import ContactPair
from dolfinx_tresca.pairing.coupling import Coupling, carriers
from dolfinx_tresca.pairing.dual_basis import dual_coefficients, rows, whole, without_rounding
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import SurfaceNodes


def couple(
    V: Any, pair: ContactPair, obstacle: RigidObstacle, facets: Facets, nodes: SurfaceNodes
) -> Coupling:
    """Couple with a rigid obstacle. Collective.

    Its distance is interpolated like a displacement and weighed with the dual multiplier basis;
    with degree 1 gap and jump are then simply those of the node. Normals are the obstacle's, with
    the sign changed: they are what its distance changes along.

    Raises:
        InputError: the signed distance returns no distances and unit normals.
        PairingError: no node can carry a multiplier.
    """
    with errors_on_all_ranks(V.mesh.comm):
        distance, _ = obstacle.at(facets.points.reshape(-1, 3))
        _, away = obstacle.at(nodes.points)
    integrals = whole(facets)
    weighed = dual_coefficients(integrals, np.ones(len(facets.points), dtype=np.bool_))
    weighed = weighed @ integrals.values
    jump = rows(nodes, nodes.facet_nodes, facets.nodes, weighed, V.dofmap.index_map.size_global)
    scale = 1.0 / nodes.weights
    jump = diags_array(scale) @ without_rounding(jump, nodes.weights)
    at_corners = np.einsum("nak,nk->na", weighed, distance.reshape(facets.nodes.shape))
    gap = scale * np.bincount(nodes.facet_nodes.ravel(), at_corners.ravel())
    beyond = (np.einsum("ni,ni->n", nodes.normals, away) >= 0.0) | (np.abs(gap) > pair.search_limit)
    position = carriers(V, pair, nodes, beyond, np.zeros_like(beyond), "obstacle")
    normals = -away[position]
    return Coupling(
        "obstacle",
        position,
        nodes.weights[position],
        normals,
        jump.tocsr()[position],
        gap[position, None] * normals,
    )
