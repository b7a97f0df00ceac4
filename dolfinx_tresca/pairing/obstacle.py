"""Pairing of a surface with a rigid obstacle."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Mask, scaled_rows
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.pairing.coupling import Coupling, nodes_with_multipliers
from dolfinx_tresca.pairing.dual_basis import (
    assemble_rows,
    drop_rounding,
    dual_coefficients,
    force_moments,
    redistributed,
    whole_facet_integrals,
)
from dolfinx_tresca.pairing.group import PairGroup
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.surface.facets import Facets, quadrature
from dolfinx_tresca.surface.nodes import REFERENCE_CORNERS, SurfaceNodes
from dolfinx_tresca.surface.smooth_surface import SmoothSurface
from dolfinx_tresca.surface.visibility import FACING_COSINE


def couple(
    V: Any, group: PairGroup, obstacle: RigidObstacle, facets: Facets, nodes: SurfaceNodes
) -> Coupling:
    """Find the jumps at the nodes of a surface that faces a rigid obstacle. Collective.

    The signed distance is interpolated like a displacement and averaged with the dual basis; with
    degree 1, gap and jump are then the nodal values. With degree 2 the distance at nodes on
    straight edges is measured from the smooth curved surface (`SmoothSurface`), since a body of degree 2
    can take the shape of the obstacle. The normals are the negative normals of the obstacle. Only
    facets that face the obstacle contribute.

    Raises:
        InputError: the signed distance does not return distances and unit normals.
        PairingError: no node can carry a multiplier.
    """
    pair = group.surfaces
    # the patches of a node share the normal of the obstacle: only one entry per node is kept
    node_entry = np.searchsorted(nodes.numbers, nodes.numbers, side="right") - 1
    with errors_on_all_ranks(V.mesh.comm):
        distance, _ = obstacle.at(facets.points.reshape(-1, 3))
        height = np.zeros_like(distance)
        if facets.degree > 1:
            surface = SmoothSurface(facets, nodes).nodes_on_surface()
            height = distance - obstacle.at(surface.reshape(-1, 3))[0]
        _, obstacle_normals = obstacle.at(nodes.points[node_entry])
        faces = _facing_corners(facets, obstacle, obstacle_normals[nodes.facet_nodes])
    facet_nodes = node_entry[nodes.facet_nodes]
    integrals = whole_facet_integrals(facets)
    weighted = dual_coefficients(integrals, np.ones(len(facets.points), dtype=np.bool_))
    weighted = weighted @ integrals.values
    corner_weights = redistributed(nodes.corner_weights[:, :, None], faces)[:, :, 0]

    def summed(values: Array) -> Array:
        sums = np.bincount(facet_nodes.ravel(), values.ravel(), minlength=len(node_entry))
        return sums.astype(np.float64)

    weights = summed(corner_weights)
    shares = np.zeros((len(weights), len(group.pairs)))
    pair_of_facet = group.pair_of_tags[facets.tag_index, 0]
    np.add.at(shares, (facet_nodes, pair_of_facet[:, None]), corner_weights)
    scale = 1.0 / np.where(weights > 0.0, weights, 1.0)
    columns = V.dofmap.index_map.size_global
    rows = redistributed(weighted, faces)
    jump = assemble_rows(nodes, facet_nodes, facets.nodes, rows, columns)
    jump = scaled_rows(drop_rounding(jump, facets, facet_nodes, weights), scale)

    def nodal_means(at_nodes: Array) -> Array:
        """Return means (nodes,) of values at facets' nodes, by the dual basis on facing facets."""
        values = np.einsum("nak,nk->na", weighted, at_nodes.reshape(facets.nodes.shape))
        return scale * summed(values / nodes.corner_weights * corner_weights)

    secondary_sagitta = nodal_means(height)
    gap = nodal_means(distance) - secondary_sagitta
    unpaired = (weights == 0.0) | (np.abs(gap) > pair.search_limit)
    position = nodes_with_multipliers(V, pair, nodes, unpaired, np.zeros_like(unpaired))
    normals = -obstacle_normals[position]
    place = scale[:, None] * force_moments(nodes, facet_nodes, facets.points, rows)
    return Coupling(
        position,
        weights[position],
        shares[position],
        normals,
        jump[position],
        csr_array((len(position), columns)),
        gap[position],
        place[position],
        secondary_sagitta[position],
    )


def _facing_corners(facets: Facets, obstacle: RigidObstacle, normals: Array) -> Mask:
    """Return at which corners (n, corners) facets face the obstacle.

    A facet faces the obstacle at a corner if the normals of both are opposed at this corner and at
    the centre of the facet. So, if an edge of the body lies in a corner between walls of the
    obstacle, only the facets in front of the wall that is nearest to this edge count at the edge's
    nodes.

    Args:
        facets: the facets of the surface.
        obstacle: the rigid obstacle.
        normals: (n, corners, 3) unit normals of the obstacle at the corners.
    """
    middle, _ = quadrature(facets.cell, 1)
    centres = np.einsum("qk,nki->nqi", facets.basis(middle), facets.points)[:, 0]
    _, centre_normals = obstacle.at(centres)

    def opposed(x: Array, normals: Array) -> Mask:
        vectors = facets.area_vectors(x)
        cosine = np.einsum("nqi,nqi->nq", vectors, normals) / np.linalg.norm(vectors, axis=2)
        return np.asarray(cosine < -FACING_COSINE)

    at_corners = opposed(REFERENCE_CORNERS[facets.cell], normals)
    return at_corners & opposed(middle, centre_normals[:, None])
