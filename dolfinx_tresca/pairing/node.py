"""Node-to-node pairing: for surfaces whose meshes match."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.exchange import row_of_least
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.pairing.coupling import Coupling, nodes_with_multipliers, owned
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: Distance of two nodes across the facet's normal, over the facet's size, up to which they meet:
#: rounding.
MATCHING_DISTANCE = 1e-8

#: The same over the largest coordinate of the surface: rounding.
COORDINATE_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)

#: Overlap over the facet's area up to which facets only touch along their rims: what a mismatch of
#: `MATCHING_DISTANCE` leaves, and more.
RIM_PART = 1e-6


@dataclass(frozen=True)
class Matching:
    """Which node meets which.

    Attributes:
        partner: (n,) for each secondary node of this rank the number of its primary node, else -1.
        gap_vector: (n, 3) from the one to the other [length].
        weights: (n,) the area of the facets round each node that meet a facet of the other side
            [length^2, in 2D length]; 0 without a partner.
        mismatch: why this is no matching; empty if it is one. The same on all ranks.
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
    """Return for each secondary node the primary node that it meets. Collective.

    Facets that face each other must meet corner by corner, so that in the overlap both meshes are
    the same. Facets that face nothing take no part, and add nothing to the weights of nodes at the
    rim of the overlap.

    Args:
        V: the space, of degree 1.
        secondary: facets of that side.
        nodes: their nodes.
        primary: facets of the other side.
        integrals: over the overlap of both sides, round this rank's nodes.
        extent: the largest coordinate of the secondary side.
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
        # a node of one body that meets nodes of two
        torn = numbers != partner[corner]
        # facets of two kinds, or corners that meet the same one
        alike = np.diff(np.sort(nearest, axis=1), axis=1).min(axis=1, initial=1) > 0
        apart = (distance > allowed) | ~alike[:, None] | (primary.corners != corners)
    mismatch = _mismatch(V, nodes, corner, distance, apart, torn)
    return Matching(partner, gap_vector, weights, mismatch)


def _nearest_corners(
    secondary: Facets,
    facet: Indices,
    primary: Facets,
    other: Indices,
    extent: float,
) -> tuple[Indices, Array, Array]:
    """Return which corner of the other facet each corner of a facet comes nearest.

    Returns:
        (p, corners) corners, their distance across the normal over the size of the facet, and (p,
        1) how large it may be.
    """
    corners = secondary.points[facet, : secondary.corners]
    middle = np.full((len(facet), secondary.dim), 1.0 / 3.0)
    normal = secondary.area_vectors_at(facet, middle)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    offset = primary.points[other, None, : primary.corners] - corners[:, :, None]
    along = np.einsum("pcdi,pi->pcd", offset, normal)
    across = np.linalg.norm(offset - along[..., None] * normal[:, None, None], axis=3)
    size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)[:, None]
    allowed = MATCHING_DISTANCE + COORDINATE_ROUNDING * extent / size
    return across.argmin(axis=2), across.min(axis=2) / size, allowed


def _mismatch(
    V: Any,
    nodes: SurfaceNodes,
    corner: Indices,
    distance: Array,
    apart: Mask,
    torn: Mask,
) -> str:
    """Return why nodes do not match. Collective.

    Args:
        V: the space.
        nodes: secondary nodes.
        corner: (p, corners) positions there of the corners of facets.
        distance: (p, corners) how far they are from those of the facet before them, over the size
            of their facet.
        apart: (p, corners) those that meet none of that.
        torn: (p, corners) those that meet several nodes.
    """
    comm, own = V.mesh.comm, owned(V, nodes)[corner]
    apart, torn = apart & own, torn & own
    number = comm.allreduce(len(np.unique(nodes.numbers[corner[apart]])))
    if number > 0:
        rows = np.column_stack([distance[apart], nodes.points[corner[apart]]])
        worst = row_of_least(comm, -distance[apart], rows)
        return (
            f"{number} secondary nodes face the primary side away from its nodes; the worst, at "
            f"{_text(worst[1:])}, by {worst[0]:.2g} times the size of its facet (allowed: "
            f"{MATCHING_DISTANCE:g})"
        )
    seam = row_of_least(comm, nodes.numbers[corner[torn]], nodes.points[corner[torn]])
    return "" if seam is None else f"the secondary node at {_text(seam)} meets nodes of two bodies"


def _text(point: Array) -> str:
    return str(tuple(round(float(c), 6) for c in point))


def couple(V: Any, pair: ContactPair, nodes: SurfaceNodes, matching: Matching) -> Coupling:
    """Couple each secondary node with its primary node. Collective.

    Raises:
        PairingError: no node can carry a multiplier.
    """
    kind = "node-to-node"
    partner, weights = matching.partner, matching.weights
    reason = "every node meets a node" if pair.pairing == "auto" else ""
    position = nodes_with_multipliers(
        V, pair, nodes, partner < 0, nodes.numbers == partner, kind, reason
    )
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
