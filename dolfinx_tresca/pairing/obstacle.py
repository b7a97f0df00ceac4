"""Pairing with a rigid obstacle: one surface, no second mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_array, diags_array

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.pairing.coupling import Coupling, nodes_with_multipliers
from dolfinx_tresca.pairing.dual_basis import (
    assembled_rows,
    dual_coefficients,
    moved_to,
    places,
    whole_facet_integrals,
    without_rounding,
)
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.curvature import Sagitta
from dolfinx_tresca.surface.facets import Facets, quadrature
from dolfinx_tresca.surface.nodes import REFERENCE_CORNERS, SurfaceNodes
from dolfinx_tresca.surface.visibility import FACING_COSINE


def couple(
    V: Any, pair: ContactPair, obstacle: RigidObstacle, facets: Facets, nodes: SurfaceNodes
) -> Coupling:
    """Couple with a rigid obstacle. Collective.

    Its distance is interpolated like a displacement and weighed with the dual multiplier basis;
    with degree 1 gap and jump are then simply those of the node. With degree 2 nodes in the middle
    of straight edges count where the curved surface is that these stand for: there the body can
    take the obstacle's shape, and the height over the edge would be most of the error. Normals are
    the obstacle's, with the sign changed: they are what its distance changes along. Only facets
    that face it count, whatever else has the tag.

    Raises:
        InputError: the signed distance returns no distances and unit normals.
        PairingError: no node can carry a multiplier.
    """
    # one contact node each: all smooth patches round a node have the obstacle's normal
    last = np.searchsorted(nodes.numbers, nodes.numbers, side="right") - 1
    with errors_on_all_ranks(V.mesh.comm):
        distance, _ = obstacle.at(facets.points.reshape(-1, 3))
        lower = np.zeros_like(distance)
        if facets.degree > 1:
            surface = Sagitta(facets, nodes).nodes_on_surface(facets)
            lower = distance - obstacle.at(surface.reshape(-1, 3))[0]
        _, away = obstacle.at(nodes.points[last])
        faces = _faces(facets, obstacle, away[nodes.facet_nodes])
    facet_nodes = last[nodes.facet_nodes]
    integrals = whole_facet_integrals(facets)
    weighed = dual_coefficients(integrals, np.ones(len(facets.points), dtype=np.bool_))
    weighed = weighed @ integrals.values
    corner_weights = moved_to(nodes.corner_weights[:, :, None], faces)[:, :, 0]

    def summed(values: Array) -> Array:
        sums = np.bincount(facet_nodes.ravel(), values.ravel(), minlength=len(last))
        return sums.astype(np.float64)

    weights = summed(corner_weights)
    scale = 1.0 / np.where(weights > 0.0, weights, 1.0)
    columns = V.dofmap.index_map.size_global
    moved = moved_to(weighed, faces)
    jump = assembled_rows(nodes, facet_nodes, facets.nodes, moved, columns)
    jump = diags_array(scale) @ without_rounding(jump, weights)

    def means(at_nodes: Array) -> Array:
        """Weigh values at the nodes of facets with the multiplier basis, where they face."""
        values = np.einsum("nak,nk->na", weighed, at_nodes.reshape(facets.nodes.shape))
        return scale * summed(values / nodes.corner_weights * corner_weights)

    raised = means(lower)
    gap = means(distance) - raised
    unpaired = (weights == 0.0) | (np.abs(gap) > pair.search_limit)
    position = nodes_with_multipliers(V, pair, nodes, unpaired, np.zeros_like(unpaired), "obstacle")
    normals = -away[position]
    place = scale[:, None] * places(nodes, facet_nodes, facets.points, moved)
    return Coupling(
        "obstacle",
        position,
        weights[position],
        normals,
        jump.tocsr()[position],
        csr_array((len(position), columns)),
        gap[position, None] * normals,
        place[position],
        raised[position],
    )


def _faces(facets: Facets, obstacle: RigidObstacle, away: Array) -> Mask:
    """Return which facets face the obstacle, at each of their corners (n, corners).

    They do so in their middle as well: on an edge of a body in a corner of an obstacle only the
    facets before the wall that is nearest to the edge count there.

    Args:
        facets: the surface.
        obstacle: before it.
        away: (n, corners, 3) the obstacle's normals at the corners.
    """
    middle, _ = quadrature(facets.cell, 1)
    centres = np.einsum("qk,nki->nqi", facets.basis(middle), facets.points)[:, 0]
    _, before = obstacle.at(centres)

    def opposed(x: Array, normals: Array) -> Mask:
        vectors = facets.area_vectors(x)
        cosine = np.einsum("nqi,nqi->nq", vectors, normals) / np.linalg.norm(vectors, axis=2)
        return np.asarray(cosine < -FACING_COSINE)

    at_corners = opposed(REFERENCE_CORNERS[facets.cell], away)
    return at_corners & opposed(middle, before[:, None])
