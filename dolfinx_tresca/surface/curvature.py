"""The sagitta of a smooth surface: its height over the flat facets that approximate it."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, cross
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: Least cosine between a facet's normal and the normals at its corners (26 degrees). Below it a
#: corner is on an edge, and the facet counts as flat.
SMOOTH_COSINE = 0.9

#: Sagitta, relative to the radius of a facet, that counts as rounding, in addition to the rounding
#: of coordinates.
HEIGHT_ROUNDING = 1e-10

#: Weights of the Tikhonov regularisation of the quadratic fit, relative to the weight of a
#: neighbour's height: the weights of the two slopes, of the mean curvature and of the two
#: differences of curvatures. With few neighbours the fit stays close to a sphere with the mean
#: normal.
TILT_COST, CURVATURE_COSTS = 1e-1, (0.0, 1e-3, 1e-3)


class Sagitta:
    """The height of a smooth surface over straight facets, from the normals at their corners.

    These heights reduce the gap of curved bodies. The tangent planes at the corners are known
    (`fitted_normals`). At each point of a facet the mean of the heights of these planes, weighted
    with the hat functions, is twice the height of a parabolic surface. Half of this mean is
    therefore correct to second order in the size of the facet, and zero for a flat surface.
    """

    def __init__(self, facets: Facets, nodes: SurfaceNodes) -> None:
        """Compute the tangent planes at the corners of all facets. Not collective."""
        corners = facets.points[:, : facets.corners]
        middle = corners.mean(axis=1)
        self._relative = corners - middle[:, None]
        self._normals = fitted_normals(facets, nodes)[nodes.facet_nodes]
        mean = facets.mean_normals
        edge = (np.einsum("nci,ni->nc", self._normals, mean) < SMOOTH_COSINE).any(axis=1)
        self._mean = np.where(edge[:, None], mean, 0.0)
        self._normals[edge] = 0.0
        self._level = np.einsum("nci,nci->nc", self._normals, self._relative)
        size = np.linalg.norm(self._relative, axis=2).max(axis=1)
        heights = self._level[:, :, None] - np.einsum("nci,ndi->ncd", self._normals, self._relative)
        #: whether any facet of this rank has a sagitta above rounding
        self.nonzero = not facets.bent and bool(
            (np.abs(heights).max(axis=(1, 2)) > (HEIGHT_ROUNDING + facets.rounding) * size).any()
        )

    def nodes_on_surface(self, facets: Facets) -> Array:
        """Return the nodes (n, k, 3) of the displacement, moved to the smooth surface [length].

        Corners are on the surface already; the other nodes of degree 2 are on straight edges.
        """
        if not self.nonzero:
            return facets.points
        hats = facets.hats_at_nodes
        count = len(facets.points)
        heights = self.heights(np.repeat(np.arange(count), len(hats)), np.tile(hats, (count, 1)))
        raised = heights.reshape(count, -1, 1) * facets.mean_normals[:, None]
        return np.asarray(facets.points + raised)

    def heights(self, facet: Indices, hats: Array) -> Array:
        """Return the heights (n,) of the surface over facets, along the outward normal [length].

        Args:
            facet: (n,) the facet of each point.
            hats: (n, corners) values of the facet's hat functions at each point.
        """
        place = np.einsum("nc,nci->ni", hats, self._relative[facet])
        normal = np.einsum("nc,nci->ni", hats, self._normals[facet])
        level = np.einsum("nc,nc->n", hats, self._level[facet])
        return np.asarray(0.5 * (level - np.einsum("ni,ni->n", place, normal)))

    def normals(self, facet: Indices, hats: Array) -> Array:
        """Return outward unit normals (n, 3) of the surface at the points of `heights`."""
        normals = np.einsum("nc,nci->ni", hats, self._normals[facet]) + self._mean[facet]
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])


def fitted_normals(facets: Facets, nodes: SurfaceNodes) -> Array:
    """Return unit normals (n, 3) of quadratic surfaces fitted to each node and its neighbours.

    The mean of the facets' normals (`SurfaceNodes.normals`) is exact on a sphere. On a cylinder
    with facets of different sizes and shapes, as after local refinement, the error of the mean is a
    fixed part of the angle between facets. Then the relative error of the sagitta (the height of
    the surface over a facet) does not vanish as the mesh is refined. A least-squares fit of a
    quadratic height function does not have this error (Cazals and Pouget 2005, Estimating
    differential quantities using polynomial fitting of osculating jets). With too few neighbours
    the mean normal is kept. The result is valid at nodes whose adjacent facets are all on this
    rank.

    Not collective.

    Args:
        facets: the facets of a surface.
        nodes: the corners of the facets.
    """
    count, corners = len(nodes.numbers), facets.corners
    node = np.repeat(nodes.facet_nodes, corners, axis=1).ravel()
    neighbour = np.tile(nodes.facet_nodes, corners).ravel()
    node, neighbour = node[node != neighbour], neighbour[node != neighbour]
    across = np.eye(3)[np.abs(nodes.normals).argmin(axis=1)]
    if facets.dim == 1:
        across = np.broadcast_to([0.0, 0.0, 1.0], across.shape)
    x_axis = cross(across, nodes.normals)
    x_axis /= np.linalg.norm(x_axis, axis=1)[:, None]
    y_axis = cross(nodes.normals, x_axis)
    offset = nodes.points[neighbour] - nodes.points[node]
    squares = np.bincount(node, np.square(offset).sum(axis=1), minlength=count)
    size = np.sqrt(squares / np.maximum(np.bincount(node, minlength=count), 1))
    offset = offset / size[node][:, None]
    x, y, height = (
        np.einsum("ni,ni->n", offset, axis[node]) for axis in (x_axis, y_axis, nodes.normals)
    )
    # equal weights of the last two terms make the fit independent of the choice of axes
    terms = np.stack([x, y, x * x + y * y, x * x - y * y, 2.0 * x * y], axis=1)
    matrix, load = np.zeros((count, 5, 5)), np.zeros((count, 5))
    np.add.at(matrix, node, terms[:, :, None] * terms[:, None, :])
    np.add.at(load, node, terms * height[:, None])
    matrix += np.diag(np.square([TILT_COST, TILT_COST, *CURVATURE_COSTS]))
    slopes = np.linalg.solve(matrix, load[:, :, None])[:, :2, 0]
    normals = nodes.normals - slopes[:, :1] * x_axis - slopes[:, 1:] * y_axis
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])
