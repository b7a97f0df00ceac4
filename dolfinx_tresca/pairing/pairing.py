"""How a pair is coupled: the choice, and what all kinds of pairing have in common."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, diags_array

from dolfinx_tresca._parallel import errors_on_all_ranks, log, reduce_array
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.obstacle import RigidObstacle
from dolfinx_tresca.pair import ContactPair
from dolfinx_tresca.pairing.dual_basis import dual_coefficients, rows, whole, without_rounding
from dolfinx_tresca.pairing.mortar import mortar_rows
from dolfinx_tresca.pairing.node import Matching, match
from dolfinx_tresca.pairing.operators import Coupling, FloatArray, PairOperators
from dolfinx_tresca.surface.facets import Facets, gather_facets
from dolfinx_tresca.surface.nodes import SurfaceNodes
from dolfinx_tresca.surface.pieces import Pieces

Mask = npt.NDArray[np.bool_]

#: Part of a node's area that must be in contact for it to carry a multiplier.
SHARE = 1e-3


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
    facets = gather_facets(V, prescribed, pair.facet_tags, pair.secondary, "secondary")
    nodes = SurfaceNodes.of(facets, pair.secondary, "secondary")
    _warn_of_tears(V, pair.secondary, "secondary", facets, nodes)
    if isinstance(pair.primary, RigidObstacle):
        coupling = _on_obstacle(V, pair, pair.primary, facets, nodes)
    else:
        coupling = _on_surface(V, prescribed, pair, facets, nodes)
    return PairOperators.of(V, coupling, nodes, pair.friction)


def _on_surface(
    V: Any, prescribed: Mask, pair: ContactPair, facets: Facets, nodes: SurfaceNodes
) -> Coupling:
    """Couple with another surface. Collective."""
    assert not isinstance(pair.primary, RigidObstacle)
    others = gather_facets(V, prescribed, pair.facet_tags, pair.primary, "primary")
    other_nodes = SurfaceNodes.of(others, pair.primary, "primary")
    _warn_of_tears(V, pair.primary, "primary", others, other_nodes)
    limit = math.inf if pair.search_distance is None else float(pair.search_distance)
    if pair.pairing == "mortar":
        return _by_mortar(V, pair, facets, nodes, others, other_nodes, limit, "")
    if facets.degree > 1:
        reason = f"displacements of degree {facets.degree}"
    else:
        matching = match(nodes, other_nodes, Pieces.of(others), limit)
        reason = matching.mismatch
        if not reason and (pair.pairing == "nodes" or (matching.partner >= 0).any()):
            return _by_nodes(V, pair, nodes, other_nodes, matching)
    if pair.pairing == "nodes" and reason:
        raise PairingError(
            f"the meshes of the two surfaces do not match: {reason}. Mesh both surfaces alike, or "
            'take pairing="mortar".'
        )
    return _by_mortar(V, pair, facets, nodes, others, other_nodes, limit, reason)


def _by_nodes(
    V: Any, pair: ContactPair, nodes: SurfaceNodes, others: SurfaceNodes, matching: Matching
) -> Coupling:
    """Couple each secondary node with its primary node. Collective."""
    beyond = matching.partner < 0
    shared = nodes.numbers == others.numbers[matching.partner]
    position = _positions(V, pair, nodes, beyond, shared & ~beyond, "node-to-node", "")
    partner = matching.partner[position]
    numbers = np.stack([nodes.numbers[position], others.numbers[partner]], axis=1)
    n = len(position)
    jump = csr_array(
        (np.tile([1.0, -1.0], n), numbers.ravel(), np.arange(0, 2 * n + 1, 2)),
        shape=(n, V.dofmap.index_map.size_global),
    )
    return Coupling(
        "node-to-node", position, nodes.weights[position], nodes.normals[position], jump,
        others.points[partner] - nodes.points[position],
    )  # fmt: skip


def _by_mortar(
    V: Any,
    pair: ContactPair,
    facets: Facets,
    nodes: SurfaceNodes,
    others: Facets,
    other_nodes: SurfaceNodes,
    limit: float,
    reason: str,
) -> Coupling:
    """Couple by integrals over the overlap of both surfaces. Collective."""
    low, high = V.dofmap.index_map.local_range
    with errors_on_all_ranks(V.mesh.comm):
        own = (nodes.numbers >= low) & (nodes.numbers < high)
        selected = np.flatnonzero(own[nodes.facet_nodes].any(axis=1))
        found = mortar_rows(
            facets, nodes, others, other_nodes, selected, limit, V.dofmap.index_map.size_global
        )
    beyond = found.weights <= SHARE * nodes.weights
    shared = np.isin(nodes.numbers, others.nodes)
    position = _positions(V, pair, nodes, beyond, shared & ~beyond, "mortar", reason)
    weights = found.weights[position]
    jump = diags_array(1.0 / weights) @ found.jump[position]
    way = -_at_nodes(jump, [facets, others])
    rise = (found.rise[position] / weights)[:, None] * nodes.normals[position]
    return Coupling(
        "mortar", position, weights, nodes.normals[position], jump.tocsr(), way - rise
    )


def _on_obstacle(
    V: Any, pair: ContactPair, obstacle: RigidObstacle, facets: Facets, nodes: SurfaceNodes
) -> Coupling:
    """Couple with a rigid obstacle: its distance is interpolated like a displacement. Collective."""
    where = facets.points.reshape(-1, 3)
    with errors_on_all_ranks(V.mesh.comm):
        distance, _ = obstacle.at(where)
        _, away = obstacle.at(nodes.points)
    integrals = whole(facets)
    dual = dual_coefficients(integrals, np.ones(len(facets.points), dtype=np.bool_))
    weighed = dual @ integrals.values
    columns = V.dofmap.index_map.size_global
    jump = diags_array(1.0 / nodes.weights) @ rows(
        nodes, nodes.facet_nodes, facets.nodes, weighed, columns
    )
    jump = without_rounding(jump.tocsr(), np.ones(len(nodes.numbers)))
    gap = np.einsum("nak,nk->na", weighed, distance.reshape(facets.nodes.shape))
    distances = np.zeros(len(nodes.numbers))
    np.add.at(distances, nodes.facet_nodes, gap)
    distances /= nodes.weights
    limit = math.inf if pair.search_distance is None else float(pair.search_distance)
    beyond = (np.einsum("ni,ni->n", nodes.normals, away) >= 0.0) | (np.abs(distances) > limit)
    none = np.zeros(len(beyond), dtype=np.bool_)
    position = _positions(V, pair, nodes, beyond, none, "obstacle", "")
    normals = -away[position]
    return Coupling(
        "with its distance", position, nodes.weights[position], normals, jump[position],
        distances[position, None] * normals,
    )  # fmt: skip


def _at_nodes(jump: Any, sides: list[Facets]) -> FloatArray:
    """Return what a jump (n, nodes of V) makes of the nodes' positions, (n, 3)."""
    numbers, first = np.unique(
        np.concatenate([side.nodes.ravel() for side in sides]), return_index=True
    )
    points = np.concatenate([side.points.reshape(-1, 3) for side in sides])[first]
    csr = jump.tocsr()
    columns = np.searchsorted(numbers, csr.indices)
    compact = csr_array((csr.data, columns, csr.indptr), shape=(csr.shape[0], len(numbers)))
    # from the middle: differences of large coordinates lose digits
    return np.asarray(compact @ (points - points.mean(axis=0)))


def _positions(
    V: Any,
    pair: ContactPair,
    nodes: SurfaceNodes,
    beyond: Mask,
    shared: Mask,
    kind: str,
    reason: str,
) -> npt.NDArray[np.intp]:
    """Return the positions of this rank's nodes that carry multipliers. Collective.

    Args:
        V: the space.
        pair: the pair.
        nodes: its secondary nodes.
        beyond: (n,) those that face nothing; right for this rank's nodes.
        shared: (n,) those that belong to the primary side as well.
        kind: how they are paired, for the log.
        reason: why so.

    Raises:
        PairingError: there are none.
    """
    low, high = V.dofmap.index_map.local_range
    own = (nodes.numbers >= low) & (nodes.numbers < high)
    held = ~nodes.free.any(axis=1) & ~beyond
    takes_part = own & ~beyond & ~held & ~shared
    counts = [(own & part).sum() for part in (beyond, held, shared & ~held, takes_part)]
    outside, prescribed, common, number = reduce_array(V.mesh.comm, counts)
    total = len(nodes.numbers)
    if outside == total:
        within = "" if pair.search_distance is None else f" within {pair.search_distance:g}"
        raise PairingError(
            f"the surfaces do not face each other: from none of the {total} nodes of the secondary "
            f"side (tag {pair.secondary}) the outward normal leads to the primary side "
            f"({_other(pair)}){within}. Check the tags"
            + (" and the search distance." if within else ".")
        )
    if number == 0:
        raise PairingError(
            f"no node of the secondary side (tag {pair.secondary}) can carry a multiplier: of its "
            f"{total} nodes {outside} face nothing of the primary side ({_other(pair)}), "
            f"{prescribed} are prescribed and {common} shared with it. Check the tags."
        )
    log(
        V.mesh.comm,
        "pairing: %s, %s%d of %d secondary nodes take part (%d face nothing, %d are prescribed, "
        "%d shared)",
        *(pair, f"{kind}{f', as {reason}' if reason else ''}: ", number, total),
        *(outside, prescribed, common),
    )
    return np.flatnonzero(takes_part)


def _other(pair: ContactPair) -> str:
    return str(pair.primary) if isinstance(pair.primary, RigidObstacle) else f"tag {pair.primary}"


def _warn_of_tears(V: Any, tag: int, side: str, facets: Facets, nodes: SurfaceNodes) -> None:
    """Warn of nodes at the same place with different numbers. Not collective."""
    size = np.sqrt(np.square(np.ptp(facets.points, axis=1)).sum(axis=1)).min()
    places = np.round(nodes.points / (1e-6 * size)).astype(np.int64)
    twins = len(places) - len(np.unique(places, axis=0))
    if twins:
        log(
            V.mesh.comm,
            "the surface with tag %d (%s side) has %d nodes at the place of others: it is torn "
            "there. Unless these are edges of different bodies, merge duplicated nodes of the mesh.",
            *(tag, side, twins),
            level=logging.WARNING,
        )
