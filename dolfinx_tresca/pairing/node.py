"""Node-to-node pairing of surfaces with matching meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import ROUNDING, Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.exchange import row_of_least
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.pairing.coupling import Coupling, nodes_with_multipliers, owned_nodes
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: Tangential distance of two nodes, relative to the size of the facet, up to which they match.
MATCHING_DISTANCE = 1e-8

#: Overlap of two facets, relative to the area of the secondary facet, up to which the facets count
#: as sharing only an edge or a corner. A mismatch of `MATCHING_DISTANCE` causes smaller overlaps.
RIM_PART = 1e-6


@dataclass(frozen=True)
class Matching:
    """The primary node that matches each secondary node.

    Attributes:
        partner: (n,) global number of the primary node of each secondary node; -1 if it has none.
        gap_vector: (n, 3) vectors from the secondary to the primary node [length].
        weights: (n,) integral of the node's hat function over facets that have a matching facet
            [length^2, in 2D length]; 0 without a partner.
        mismatch: the reason why the meshes do not match; empty if they match. The same on all
            ranks.
    """

    partner: GlobalNumbers
    gap_vector: Array
    weights: Array
    mismatch: str


def match(
    V: Any,
    secondary: Facets,
    nodes: SurfaceNodes,
    primary: Facets,
    integrals: MortarIntegrals,
    extent: float,
) -> Matching:
    """Match each secondary node with a primary node. Collective.

    Facets that face each other must match corner by corner, so that both meshes are the same in
    the overlap. Facets that do not face the primary side are ignored, and do not contribute to the
    weights of nodes at the rim of the overlap.

    Args:
        V: the space of the displacement, of degree 1.
        secondary: facets of the secondary side.
        nodes: nodes of the secondary facets.
        primary: facets of the primary side.
        integrals: integrals over the overlap, for the facets at this rank's nodes.
        extent: largest coordinate of the secondary side, which determines its rounding [length].
    """
    n, corners = len(nodes.numbers), secondary.corners
    partner, gap_vector, weights = np.full(n, -1), np.zeros((n, 3)), np.zeros(n)
    with errors_on_all_ranks(V.mesh.comm):
        some = integrals.share > RIM_PART
        facet, other = integrals.secondary[some], integrals.primary[some]
        own_points = secondary.points[facet, :corners]
        nearest, distance, allowed = _nearest_corners(secondary, facet, primary, other, extent)
        corner = nodes.facet_nodes[facet]
        numbers = primary.nodes[other[:, None], nearest]
        partner[corner] = numbers
        gap_vector[corner] = primary.points[other[:, None], nearest] - own_points
        np.add.at(weights, corner, nodes.corner_weights[facet])
        # nodes that match several primary nodes
        ambiguous = numbers != partner[corner]
        # also unmatched: facets with different numbers of corners, and facets of which two corners
        # have the same nearest corner
        distinct = np.diff(np.sort(nearest, axis=1), axis=1).min(axis=1, initial=1) > 0
        unmatched = (distance > allowed) | ~distinct[:, None] | (primary.corners != corners)
    mismatch = _mismatch(V, nodes, corner, distance, unmatched, ambiguous)
    return Matching(partner, gap_vector, weights, mismatch)


def _nearest_corners(
    secondary: Facets,
    facet: Indices,
    primary: Facets,
    other: Indices,
    extent: float,
) -> tuple[Indices, Array, Array]:
    """Find the nearest corner of the primary facet for each corner of the secondary facet.

    The p pairs consist of the secondary facets `facet` (p,) and the primary facets `other` (p,).

    Returns:
        The nearest corners (p, corners), their tangential distances (p, corners) relative to the
        size of the secondary facet, and the relative distances (p, 1) up to which nodes match.
    """
    corners = secondary.points[facet, : secondary.corners]
    middle = np.full((len(facet), secondary.dim), 1.0 / 3.0)
    normal = secondary.area_vectors_at(facet, middle)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    offset = primary.points[other, None, : primary.corners] - corners[:, :, None]
    along = np.einsum("pcdi,pi->pcd", offset, normal)
    across = np.linalg.norm(offset - along[..., None] * normal[:, None, None], axis=3)
    size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)[:, None]
    allowed = MATCHING_DISTANCE + ROUNDING * extent / size
    return across.argmin(axis=2), across.min(axis=2) / size, allowed


def _mismatch(
    V: Any,
    nodes: SurfaceNodes,
    corner: Indices,
    distance: Array,
    unmatched: Mask,
    ambiguous: Mask,
) -> str:
    """Return the reason why nodes do not match, or an empty text. Collective.

    Args:
        V: the space of the displacement.
        nodes: the secondary nodes.
        corner: (p, corners) indices in `nodes` of the corners of facets.
        distance: (p, corners) tangential distance from the nearest corner of the primary facet,
            relative to the size of the facet.
        unmatched: (p, corners) whether a corner matches no corner of the primary facet.
        ambiguous: (p, corners) whether a corner matches several primary nodes.
    """
    comm, own = V.mesh.comm, owned_nodes(V, nodes)[corner]
    unmatched, ambiguous = unmatched & own, ambiguous & own
    number = comm.allreduce(len(np.unique(nodes.numbers[corner[unmatched]])))
    if number > 0:
        rows = np.column_stack([distance[unmatched], nodes.points[corner[unmatched]]])
        worst = row_of_least(comm, -distance[unmatched], rows)
        return (
            f"{number} secondary nodes face the primary side away from its nodes; the worst, at "
            f"{_point_text(worst[1:])}, by {worst[0]:.2g} times the size of its facet (allowed: "
            f"{MATCHING_DISTANCE:g})"
        )
    seam = row_of_least(comm, nodes.numbers[corner[ambiguous]], nodes.points[corner[ambiguous]])
    return (
        ""
        if seam is None
        else f"the secondary node at {_point_text(seam)} meets nodes of two bodies"
    )


def _point_text(point: Array) -> str:
    return str(tuple(round(float(c), 6) for c in point))


def couple(
    V: Any, pair: ContactPair, nodes: SurfaceNodes, matching: Matching, without: Mask | None = None
) -> Coupling:
    """Find the jump between each secondary node and its primary node. Collective.

    Args:
        V: the space of the displacement.
        pair: the contact pair.
        nodes: nodes of the secondary facets.
        matching: the primary node of each secondary node.
        without: (n,) whether a node has no multiplier. None: a node has no multiplier if it is its
            own primary node.

    Raises:
        PairingError: no node can carry a multiplier.
    """
    kind = "node-to-node"
    partner, weights = matching.partner, matching.weights
    reason = "the meshes match" if pair.pairing == "auto" else ""
    shared = nodes.numbers == partner if without is None else without
    position = nodes_with_multipliers(V, pair, nodes, partner < 0, shared, kind, reason)
    numbers = np.stack([nodes.numbers[position], partner[position]], axis=1)
    n = len(position)
    shape = (n, V.dofmap.index_map.size_global)
    jump = csr_array(
        (np.tile([1.0, -1.0], n), numbers.ravel(), np.arange(0, 2 * n + 1, 2)), shape=shape
    )
    primary = csr_array((np.ones(n), numbers[:, 1], np.arange(n + 1)), shape=shape)
    normals = nodes.normals[position]
    place, gap_vector = nodes.points[position], matching.gap_vector[position]
    flat: Array = np.zeros(len(position))
    weights = weights[position]
    return Coupling(kind, position, weights, normals, jump, primary, gap_vector, place, flat)
