"""Node-to-node pairing: for surfaces whose meshes match."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from dolfinx_tresca.pair import ContactPair
from dolfinx_tresca.pairing.coupling import Coupling, carriers
from dolfinx_tresca.surface.facets import FloatArray
from dolfinx_tresca.surface.nodes import SurfaceNodes
from dolfinx_tresca.surface.pieces import Pieces

#: Distance across the normal, over the size of the node's area, up to which two nodes match.
#: Meshes that match meet to rounding; curved ones with a gap between them a little less well.
MATCH = 0.05


@dataclass(frozen=True)
class Matching:
    """Which node meets which.

    Attributes:
        partner: (n,) for each secondary node its primary node, -1 beyond the primary side.
        mismatch: why this is no matching of all nodes; empty if it is one.
    """

    partner: npt.NDArray[np.intp]
    mismatch: str


def match(
    secondary: SurfaceNodes,
    primary: SurfaceNodes,
    pieces: Pieces,
    other_pieces: Pieces,
    limit: float,
) -> Matching:
    """Return for each secondary node the primary node that lies on its normal.

    Nodes that face no facet of the other side take no part: only the overlap of the surfaces is in
    contact. In it all nodes of both sides must meet one. The same on all ranks.

    Args:
        secondary: nodes of that side.
        primary: nodes of that side.
        pieces: facets of the secondary side.
        other_pieces: facets of the primary side.
        limit: distance [length] beyond which nothing is in contact.
    """
    partner, mismatch = _partners("secondary", secondary, primary, other_pieces, limit)
    if mismatch:
        return Matching(partner, mismatch)
    matched = partner >= 0
    _, times = np.unique(partner[matched], return_counts=True)
    if times.max(initial=1) > 1:
        twice = int((times > 1).sum())
        return Matching(partner, f"{twice} primary nodes face more than one secondary node")
    _, mismatch = _partners("primary", primary, secondary, pieces, limit)
    # surfaces beside each other may have nodes along an edge in common, but no area
    whole = matched[secondary.facet_nodes].all(axis=1)
    faces = np.zeros_like(matched)
    faces[secondary.facet_nodes[whole]] = True
    return Matching(np.where(faces, partner, -1), mismatch)


def _partners(
    side: str, nodes: SurfaceNodes, others: SurfaceNodes, pieces: Pieces, limit: float
) -> tuple[npt.NDArray[np.intp], str]:
    """Return the node of another side that each node meets, or -1; and what is wrong with that."""
    x, n = nodes.points, nodes.normals
    size = nodes.weights if _curves(pieces) else np.sqrt(nodes.weights)
    number = min(8, len(others.points))
    near = cKDTree(others.points).query(x, k=number)[1].reshape(len(x), number)
    way = others.points[near] - x[:, None]
    along = np.einsum("nki,ni->nk", way, n)
    across = np.linalg.norm(way - along[:, :, None] * n[:, None], axis=2)
    facing = (np.einsum("nki,ni->nk", others.normals[near], n) < 0.0) & (np.abs(along) <= limit)
    # the least distance across the normal; of two as good the nearer, where both sides are tagged
    rank = np.where(facing, across + 1e-6 * np.abs(along), np.inf)
    best = (np.arange(len(x)), rank.argmin(axis=1))
    partner, distance, opposed = near[best], across[best] / size, facing[best]
    matched = (distance <= MATCH) & opposed
    off = _faces_any(x, n, pieces, limit) & ~matched & opposed
    mismatch = ""
    if off.any():
        other = "primary" if side == "secondary" else "secondary"
        worst = int(np.where(off, distance, 0.0).argmax())
        mismatch = (
            f"{off.sum()} {side} nodes face the {other} side away from its nodes; the worst, at "
            f"{tuple(round(float(c), 6) for c in x[worst])}, by {distance[worst]:.2f} times its "
            f"own size (allowed: {MATCH})"
        )
    return np.where(matched, partner, -1), mismatch


def couple(
    V: Any, pair: ContactPair, nodes: SurfaceNodes, others: SurfaceNodes, matching: Matching
) -> Coupling:
    """Couple each secondary node with its primary node. Collective.

    Raises:
        PairingError: no node can carry a multiplier.
    """
    kind = "node-to-node"
    shared = nodes.numbers == others.numbers[matching.partner]
    reason = "every node meets a node" if pair.pairing == "auto" else ""
    position = carriers(V, pair, nodes, matching.partner < 0, shared, kind, reason)
    partner = matching.partner[position]
    numbers = np.stack([nodes.numbers[position], others.numbers[partner]], axis=1)
    n = len(position)
    jump = csr_array(
        (np.tile([1.0, -1.0], n), numbers.ravel(), np.arange(0, 2 * n + 1, 2)),
        shape=(n, V.dofmap.index_map.size_global),
    )
    way = others.points[partner] - nodes.points[position]
    return Coupling(kind, position, nodes.weights[position], nodes.normals[position], jump, way)


def _curves(pieces: Pieces) -> bool:
    """Whether the surfaces are curves in 2D."""
    return pieces.points.shape[1] == 2


def _faces_any(x: FloatArray, n: FloatArray, pieces: Pieces, limit: float) -> npt.NDArray[np.bool_]:
    """Return for each point whether the line along its normal meets a nearby facet."""
    number = min(16, len(pieces.centres))
    near = cKDTree(pieces.centres).query(x, k=number)[1].reshape(len(x), number)
    corners = pieces.points[near] - x[:, None, None]
    if _curves(pieces):
        side = np.cross(n, [0.0, 0.0, 1.0])
        turns = np.einsum("nfci,ni->nfc", corners, side) * np.array([1.0, -1.0])
    else:
        following = np.roll(corners, -1, axis=2)
        turns = np.einsum("nfci,ni->nfc", np.cross(corners, following), n)
    rounding = 1e-9 * np.abs(turns).sum(axis=2, keepdims=True)
    inside = (turns > -rounding).all(axis=2) | (turns < rounding).all(axis=2)
    apart = np.abs(np.einsum("nfci,ni->nfc", corners, n)).min(axis=2)
    opposed = np.einsum("nfi,ni->nf", pieces.normals[near], n) < 0.0
    return np.asarray((inside & opposed & (apart <= limit)).any(axis=1))
