"""Facets of two surfaces whose corners match."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.pairing.search.facets import Facets

#: Distance of two corners, relative to the size of the facet, up to which they match, in addition
#: to the rounding of coordinates. Twice as much would admit meshes that are twice as far apart;
#: those of a mesh generator differ by 1e-10 or less.
MATCHING_DISTANCE = 1e-8

#: Overlap of two facets, relative to the area of the secondary facet, up to which the facets count
#: as sharing only an edge or a corner. A mismatch of `MATCHING_DISTANCE` causes smaller overlaps.
RIM_PART = 1e-6


def facets_coincide(secondary: Facets, facet: Indices, primary: Facets, other: Indices) -> Mask:
    """Return whether each pair (p,) of a secondary and a primary facet has the same corners."""
    offset, allowed = _offsets(secondary, facet, primary, other)
    distance = np.linalg.norm(offset, axis=3).min(axis=2)
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
    offset, allowed = _offsets(secondary, facet, primary, other)
    normal = secondary.mean_normals[facet][:, None, None]
    along = (offset * normal).sum(axis=3, keepdims=True)
    return np.linalg.norm(offset - along * normal, axis=3).min(axis=2), allowed


def _offsets(
    secondary: Facets, facet: Indices, primary: Facets, other: Indices
) -> tuple[Array, Array]:
    """Return the vectors (p, corners, corners, 3) between corners of pairs of facets.

    The second result are the distances (p,) up to which corners match [length].
    """
    corners = secondary.points[facet, : secondary.corners]
    offset = primary.points[other, None, : primary.corners] - corners[:, :, None]
    size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
    return offset, (MATCHING_DISTANCE + secondary.rounding[facet]) * size
