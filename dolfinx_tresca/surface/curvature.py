"""The sagitta of a smooth surface: its height over the flat facets that stand for it."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.fitted_normals import fitted_normals
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: Least cosine between a facet's normal and those at its corners (26 degrees): with less one of
#: them is on an edge, and the facet counts as flat.
SMOOTH_COSINE = 0.9

#: Sagitta over the radius of a facet that is rounding.
HEIGHT_ROUNDING = 1e-10


class Sagitta:
    """The height of a smooth surface over straight facets, by the normals of their corners.

    At each corner the tangent plane is known (`fitted_normals`). The mean over the corners,
    weighted with the hat functions, of the heights of these planes is twice the height of a
    parabolic surface, so half of it is taken: exact to second order in the size of the facet. A
    flat surface has none.
    """

    def __init__(self, facets: Facets, nodes: SurfaceNodes) -> None:
        """Prepare for a surface."""
        corners = facets.points[:, : facets.corners]
        middle = corners.mean(axis=1)
        self._relative = corners - middle[:, None]
        self._normals = fitted_normals(facets, nodes)[nodes.facet_nodes]
        mean = np.einsum("nci,ni->nc", self._normals, facets.mean_normals)
        edge = (mean < SMOOTH_COSINE).any(axis=1)
        self._mean = np.where(edge[:, None], facets.mean_normals, 0.0)
        self._normals[edge] = 0.0
        self._level = np.einsum("nci,nci->nc", self._normals, self._relative)
        size = np.linalg.norm(self._relative, axis=2).max(axis=1)
        heights = self._level[:, :, None] - np.einsum("nci,ndi->ncd", self._normals, self._relative)
        #: whether any facet of this rank has one
        self.nonzero = not facets.bent and bool(
            (np.abs(heights).max(axis=(1, 2)) > HEIGHT_ROUNDING * size).any()
        )

    def raised_nodes(self, facets: Facets) -> Array:
        """Return the nodes (n, k, 3) of the displacement, put on the surface [length].

        Corners are there; with degree 2 the others are on straight edges.
        """
        if not self.nonzero:
            return facets.points
        hats = facets.hats_at_nodes
        count = len(facets.points)
        heights = self.at(np.repeat(np.arange(count), len(hats)), np.tile(hats, (count, 1)))
        raised = heights.reshape(count, -1, 1) * facets.mean_normals[:, None]
        return np.asarray(facets.points + raised)

    def at(self, facet: Indices, hats: Array) -> Array:
        """Return heights (n,) along the outward normal [length].

        Args:
            facet: (n,) facets.
            hats: (n, corners) values of their hat functions.
        """
        place = np.einsum("nc,nci->ni", hats, self._relative[facet])
        normal = np.einsum("nc,nci->ni", hats, self._normals[facet])
        level = np.einsum("nc,nc->n", hats, self._level[facet])
        return np.asarray(0.5 * (level - np.einsum("ni,ni->n", place, normal)))

    def normals(self, facet: Indices, hats: Array) -> Array:
        """Return outward unit normals (n, 3) of the surface there; see `at`."""
        normals = np.einsum("nc,nci->ni", hats, self._normals[facet]) + self._mean[facet]
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])
