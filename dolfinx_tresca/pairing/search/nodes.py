"""The corners of a surface's facets, which may carry multipliers: weights, normals, tangents."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask, cross
from dolfinx_tresca.pairing.search.facets import Facets, lagrange_points, quadrature

#: Angle between the normals of two facets at a node [degrees] beyond which there is a sharp edge
#: between them. Regular polygons with seven or more sides are smooth, as approximations of circles
#: (51.4 degrees and less); boxes and hexagonal prisms have sharp edges (60 degrees and more).
EDGE_ANGLE = 55.0

#: Length of the sum of the facets' weighted normals, relative to the sum of the weights, up to
#: which the normals cancel and the node has no normal.
NORMAL_ROUNDING = 1e-6

#: Placeholder for the normal of a node without normal; it is an error if a rank owns the node.
NO_NORMAL = np.array([1.0, 0.0, 0.0])

#: The corners before and after each corner, in the order round the facet.
NEIGHBOURS = {
    "interval": ((1, 0), (1, 0)),
    "triangle": ((1, 2, 0), (2, 0, 1)),
    "quadrilateral": ((1, 3, 0, 2), (2, 0, 3, 1)),
}

#: If a unit normal has a projection onto the free directions that is longer than this, the
#: projection, scaled to length 1, replaces the normal. (The mesh error tilts a normal out of a
#: symmetry plane by a few degrees, not by 84.)
FREE_PART = 0.1


@dataclass(frozen=True)
class SurfaceNodes:
    """The corners of facets; a node on a sharp edge has one entry for each smooth patch.

    Weights and normals are valid at nodes whose adjacent facets are all on this rank. See
    `smooth_patches` for the patches.

    Attributes:
        facets: the facets.
        numbers: (n,) global numbers of the nodes in V, ascending. Among the entries of one node the
            patch with the largest weight comes last.
        points: (n, 3) positions [length].
        weights: (n,) integral of the node's hat function over its patch [length^2, in 2D length].
        corner_weights: (facets, corners) contribution of each facet to the weights of its corners.
        normals: (n, 3) outward unit normals: means over the facets of the patch at the node,
            without prescribed components. (At the edge of a curved surface on a symmetry plane the
            mean over one side is tilted out of this plane.)
        free: (n, dim of space) whether a component of the displacement is not prescribed.
        facet_nodes: (facets, corners) index of each facet's corners in the arrays above.
        has_no_normal: (n,) whether the normals of the facets cancel.
    """

    facets: Facets
    numbers: GlobalNumbers
    points: Array
    weights: Array
    corner_weights: Array
    normals: Array
    free: Mask
    facet_nodes: Indices
    has_no_normal: Mask

    @classmethod
    def from_facets(cls, facets: Facets) -> SurfaceNodes:
        """Return the corners of facets, with their weights and normals."""
        corners = facets.corners
        unique, node = np.unique(facets.nodes[:, :corners], return_inverse=True)
        normals, spread = _corner_normals(facets)
        patch, node_of_patch = smooth_patches(node.ravel(), normals.reshape(-1, 3))
        x, w = quadrature(facets.cell, 2 * facets.degree + 2)
        corner_weights = facets.area_elements(x) @ (facets.hats(x) * w[:, None])
        # entries sorted by node, then by the weight of the patch
        weights = np.bincount(patch, corner_weights.ravel(), minlength=len(node_of_patch))
        order = np.lexsort((weights, node_of_patch))
        weights, numbers = weights[order].astype(np.float64), unique[node_of_patch[order]]
        position = np.empty_like(order)
        position[order] = np.arange(len(order))
        position = position[patch]

        position = position.reshape(-1, corners)
        vectors = node_sums(position, spread[:, :, None] * normals, len(numbers))
        lengths = node_sums(position, spread, len(numbers))
        corner = np.unique(position, return_index=True)[1]
        points = facets.points[:, :corners].reshape(-1, 3)[corner]
        free = facets.free.reshape(-1, facets.free.shape[2])[corner]
        has_no_normal = np.linalg.norm(vectors, axis=1) <= NORMAL_ROUNDING * lengths
        return cls(
            facets,
            numbers,
            points,
            weights,
            corner_weights,
            free_normals(np.where(has_no_normal[:, None], NO_NORMAL, vectors), free),
            free,
            position,
            has_no_normal,
        )


def _corner_normals(facets: Facets) -> tuple[Array, Array]:
    """Return outward unit normals (n, corners, 3) of facets at their corners, and their weights.

    The weight (n, corners) is sin(angle) / (|a| |b|) for the two sides a and b that meet in the
    corner; in 2D it is 1 / length of the segment. If all corners around a node lie on a sphere,
    the weighted sum is normal to the sphere, whatever the shapes and sizes of the facets (Max 1999,
    Weights for computing vertex normals from facet normals).
    """
    corners = facets.points[:, : facets.corners]
    normals = facets.area_vectors(lagrange_points(facets.cell, 1))
    normals = normals / np.linalg.norm(normals, axis=2)[:, :, None]
    before, after = (corners[:, list(order)] - corners for order in NEIGHBOURS[facets.cell])
    squares = np.square(before).sum(axis=2) * np.square(after).sum(axis=2)
    if facets.dim == 1:
        weights = squares**-0.25
    else:
        weights = np.linalg.norm(cross(before, after), axis=2) / squares
    return np.asarray(normals), weights


def free_normals(vectors: Array, free: Mask) -> Array:
    """Return unit normals (n, 3) along vectors (n, 3), without prescribed components.

    A vector keeps all components if its free part is at most `FREE_PART` of its length.

    Args:
        vectors: (n, 3) sums of the normals of facets.
        free: (n, dim of space) whether a component of the displacement is not prescribed.
    """
    normals: Array = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    movable = normals.copy()
    movable[:, : free.shape[1]][~free] = 0.0
    length = np.linalg.norm(movable, axis=1)
    turned = (length > FREE_PART) & ~free.all(axis=1)
    normals[turned] = movable[turned] / length[turned, None]
    return normals


def smooth_patches(node: Indices, normals: Array) -> tuple[Indices, Indices]:
    """Partition the facet corners at each node into smooth patches.

    Two corners at one node are in the same patch if their normals differ by at most `EDGE_ANGLE`,
    or if a chain of such corners connects them. So a fillet is smooth.

    Args:
        node: (n,) the node of each facet corner, numbered 0, 1, 2, ...
        normals: (n, 3) unit normals of the facets at the corners.

    Returns:
        The patch (n,) of each corner, numbered by ascending nodes, and the node (patches,) of each
        patch.
    """
    count = int(node.max(initial=-1)) + 1
    mean = np.stack([np.bincount(node, normals[:, i], count) for i in range(3)], axis=1)
    leans = np.einsum("ni,ni->n", normals, mean[node])
    # if all normals differ from their mean by half of EDGE_ANGLE at most, the node is smooth
    limit = math.cos(math.radians(0.5 * EDGE_ANGLE)) * np.linalg.norm(mean, axis=1)
    corners = np.flatnonzero(np.isin(node, node[leans <= limit[node]]))
    if len(corners) == 0:
        return node, np.arange(count)
    rows = np.arange(len(corners))
    at_node = coo_array((np.ones(len(corners)), (rows, node[corners])))
    corner, partner = (at_node @ at_node.T).nonzero()
    cosine = np.einsum("ni,ni->n", normals[corners[corner]], normals[corners[partner]])
    near = cosine >= math.cos(math.radians(EDGE_ANGLE))
    links = np.ones(near.sum()), (corner[near], partner[near])
    graph = coo_array(links, shape=(len(corners), len(corners)))
    component = np.zeros(len(node), dtype=np.intp)
    component[corners] = connected_components(graph, directed=False)[1]
    number = int(component.max()) + 1
    patches, patch = np.unique(node * number + component, return_inverse=True)
    return patch, patches // number


def node_sums(nodes: Indices, values: Array, count: int) -> Array:
    """Return the sums (count, ...) at nodes of values (facets, corners, ...) at facets' corners.

    Args:
        nodes: (facets, corners) the node of each corner.
        values: the values.
        count: the number of nodes.
    """
    sums = np.zeros((count, *values.shape[2:]))
    np.add.at(sums, nodes, values)
    return sums


def tangents(normals: Array) -> Array:
    """Return orthonormal tangents (n, d - 1, d) at nodes with unit normals (n, d).

    In 3D the first tangent is across the coordinate axis that is farthest from the normal.
    """
    if normals.shape[1] == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None]
    along = cross(np.eye(3)[np.abs(normals).argmin(axis=1)], normals)
    along /= np.linalg.norm(along, axis=1)[:, None]
    return np.stack([along, cross(normals, along)], axis=1)
