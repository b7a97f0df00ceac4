"""The choice between the kinds of pairing."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from dolfinx_tresca._base.parallel import errors_on_all_ranks, log
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pairing import mortar, node, obstacle
from dolfinx_tresca.pairing.coupling import Coupling, Mask, owned
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.facets import Facets, gather_facets
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: Distance of two nodes, over the size of the smallest facet, up to which they are at one place.
SAME_PLACE = 1e-6


def pair_surfaces(V: Any, prescribed: Mask, pair: ContactPair) -> PairOperators:
    """Return N, T and the gap of a pair. Collective.

    Args:
        V: vector space of degree 1 or 2.
        prescribed: (owned dofs,) those with a Dirichlet condition.
        pair: the surfaces.

    Raises:
        InputError: tags or obstacle are wrong.
        PairingError: the surfaces cannot be paired in the way that was asked for, do not face each
            other, or all secondary nodes are prescribed.
    """
    facets, nodes = _side(V, prescribed, pair, pair.secondary, "secondary")
    if isinstance(pair.primary, RigidObstacle):
        coupling = obstacle.couple(V, pair, pair.primary, facets, nodes)
    else:
        others, other_nodes = _side(V, prescribed, pair, pair.primary, "primary")
        coupling = _with_surface(V, pair, facets, nodes, others, other_nodes)
    return PairOperators.of(V, coupling, nodes, pair.friction)


def _side(
    V: Any, prescribed: Mask, pair: ContactPair, tag: int, side: str
) -> tuple[Facets, SurfaceNodes]:
    """Return facets and nodes of a side; warn of nodes at one place. Collective."""
    facets = gather_facets(V, prescribed, pair.facet_tags, tag, side)
    nodes = SurfaceNodes.of(facets, tag, side)
    size = np.linalg.norm(np.ptp(facets.points, axis=1), axis=1).min()
    points = nodes.points[np.unique(nodes.numbers, return_index=True)[1]]
    places = np.round((points - points[0]) / (SAME_PLACE * size))
    twins = len(places) - len(np.unique(places, axis=0))
    if twins:
        log(
            V.mesh.comm,
            "the surface with tag %d (%s side) has %d nodes at the place of another one: it is "
            "torn there. Merge duplicated nodes of the mesh, unless these are edges of two bodies.",
            *(tag, side, twins),
            level=logging.WARNING,
        )
    return facets, nodes


def _with_surface(
    V: Any,
    pair: ContactPair,
    facets: Facets,
    nodes: SurfaceNodes,
    others: Facets,
    other_nodes: SurfaceNodes,
) -> Coupling:
    """Couple node-to-node where the meshes match in the overlap, or else by mortar. Collective."""
    with errors_on_all_ranks(V.mesh.comm):
        around = np.flatnonzero(owned(V, nodes)[nodes.facet_nodes].any(axis=1))
        limit = pair.search_limit
        integrals = MortarIntegrals.of(facets, nodes, others, other_nodes, around, limit)
    if pair.pairing == "mortar":
        return mortar.couple(V, pair, facets, nodes, others, integrals, "")
    if facets.degree > 1:
        reason = f"displacements have degree {facets.degree}"
    else:
        matching = node.match(V, facets, nodes, others, integrals)
        if not matching.mismatch:
            return node.couple(V, pair, nodes, matching)
        reason = matching.mismatch
    if pair.pairing == "nodes":
        raise PairingError(
            f"the surfaces cannot be paired node-to-node: {reason}. Mesh both surfaces alike, in "
            'degree 1, or take pairing="mortar".'
        )
    return mortar.couple(V, pair, facets, nodes, others, integrals, reason)
