"""Facets of two surfaces that match corner by corner."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.surface.facets import Facets

#: Tangential distance of two corners, relative to the size of the facet, up to which they match, in
#: addition to the rounding of coordinates. Twice as much would admit meshes that are twice as far
#: apart; those of a mesh generator differ by 1e-10 or less.
MATCHING_DISTANCE = 1e-8

#: Overlap of two facets, relative to the area of the secondary facet, up to which the facets count
#: as sharing only an edge or a corner. A mismatch of `MATCHING_DISTANCE` causes smaller overlaps.
RIM_PART = 1e-6


def facets_match(secondary: Facets, facet: Indices, primary: Facets, other: Indices) -> Mask:
    """Return whether each pair (p,) of a secondary and a primary facet has the same corners.

    Corners are compared along the secondary facet, whatever their distance along its normal is.
    """
    distance, allowed = corner_distances(secondary, facet, primary, other)
    return np.asarray((distance <= allowed[:, None]).all(axis=1))


def corner_distances(
    secondary: Facets, facet: Indices, primary: Facets, other: Indices
) -> tuple[Array, Array]:
    """Measure the distances of corners from the nearest corner of a primary facet.

    Args:
        secondary: facets of the secondary side.
        facet: (p,) secondary facet of each pair.
        primary: facets of the primary side.
        other: (p,) primary facet of each pair.

    Returns:
        The distances (p, corners) along the secondary facets, and the distances (p,) up to which
        corners match [length].
    """
    corners = secondary.points[facet, : secondary.corners]
    offset = primary.points[other, None, : primary.corners] - corners[:, :, None]
    normal = secondary.mean_normals[facet][:, None, None]
    along = np.einsum("pcdi,pcdi->pcd", offset, np.broadcast_to(normal, offset.shape))
    distance = np.linalg.norm(offset - along[..., None] * normal, axis=3).min(axis=2)
    size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
    return distance, (MATCHING_DISTANCE + secondary.rounding[facet]) * size
