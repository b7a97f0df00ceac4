"""The nodes of a surface that may carry multipliers: weights, normals, tangents."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca.surface.edges import smooth_patches
from dolfinx_tresca.surface.facets import Facets, quadrature

#: Length of the sum of the facets' weighted normals, over the sum of their lengths, up to which a
#: node has no normal: rounding.
FOLDED_LENGTH = 1e-6

#: Stands for the normal of such a node; an error follows if the node is a rank's own.
NO_NORMAL = np.array([1.0, 0.0, 0.0])

REFERENCE_CORNERS = {
    "interval": np.array([[0.0], [1.0]]),
    "triangle": np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
    "quadrilateral": np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]),
}

#: The corners on both sides of each one.
NEIGHBOURS = {
    "interval": ((1, 0), (1, 0)),
    "triangle": ((1, 2, 0), (2, 0, 1)),
    "quadrilateral": ((1, 3, 0, 2), (2, 0, 3, 1)),
}

#: Length of a unit vector's part within the free directions above which a node can move along it:
#: a normal may lean out of a symmetry plane by the mesh's error, a few degrees, not by 84.
FREE_PART = 0.1


@dataclass(frozen=True)
class SurfaceNodes:
    """The corners of facets: weights and normals are right where all facets round a node are there.

    A node on a sharp edge (surface/edges.py) is there once for each smooth patch that meets in it.

    Attributes:
        numbers: (n,) their global numbers in V, ascending; of a number that is there several times
            the patch with the largest weight comes last.
        points: (n, 3) where they are [length].
        weights: (n,) the integral of each one's hat function over its patch [length^2, in 2D
            length].
        corner_weights: (facets, corners) the part of each facet in that.
        normals: (n, 3) outward unit normals: the mean over the facets of the patch around the node,
            without what is prescribed of it. (At the edge of a curved surface on a symmetry plane
            the mean leans out of that plane.)
        free: (n, dim of space) directions in which the displacement is not prescribed.
        facet_nodes: (facets, corners) the position of each facet's corners in these arrays.
        folded: (n,) whether there is no normal: those of the facets cancel.
    """

    numbers: GlobalNumbers
    points: Array
    weights: Array
    corner_weights: Array
    normals: Array
    free: Mask
    facet_nodes: Indices
    folded: Mask

    @classmethod
    def of(cls, facets: Facets) -> SurfaceNodes:
        """Return the corners of facets."""
        corners = facets.corners
        unique, node = np.unique(facets.nodes[:, :corners], return_inverse=True)
        normals, spread = _corner_normals(facets)
        patch, node_of_patch = smooth_patches(node.ravel(), normals.reshape(-1, 3))
        x, w = quadrature(facets.cell, 2 * facets.degree + 2)
        area = np.linalg.norm(facets.area_vectors(x), axis=2)
        corner_weights = np.einsum("nq,qc->nc", area, facets.hats(x) * w[:, None])
        # the largest patch of a node last
        weights = np.bincount(patch, corner_weights.ravel(), minlength=len(node_of_patch))
        order = np.lexsort((weights, node_of_patch))
        weights, numbers = weights[order].astype(np.float64), unique[node_of_patch[order]]
        position = np.empty_like(order)
        position[order] = np.arange(len(order))
        position = position[patch]

        def summed(values: Array) -> Array:
            sums = np.bincount(position, values.ravel(), minlength=len(numbers))
            return sums.astype(np.float64)

        vectors = np.stack([summed(spread * normals[:, :, i]) for i in range(3)], axis=1)
        lengths = summed(spread)
        first = np.unique(position, return_index=True)[1]
        points = facets.points[:, :corners].reshape(-1, 3)[first]
        free = facets.free.reshape(-1, facets.free.shape[2])[first]
        folded = np.linalg.norm(vectors, axis=1) <= FOLDED_LENGTH * lengths
        return cls(
            numbers,
            points,
            weights,
            corner_weights,
            _free_normals(np.where(folded[:, None], NO_NORMAL, vectors), free),
            free,
            position.reshape(-1, corners),
            folded,
        )


def _corner_normals(facets: Facets) -> tuple[Array, Array]:
    """Return outward unit normals (n, corners, 3) of the facets at their corners, and weights.

    The weight is the sine of the angle between the sides that meet in the corner, over their
    lengths; in 2D it is 1 over the length of the segment. With these the sum over the facets round
    a node is normal to a sphere through all their corners, whatever their shapes and sizes (Max
    1999, Weights for computing vertex normals from facet normals).
    """
    corners = facets.points[:, : facets.corners]
    normals = facets.area_vectors(REFERENCE_CORNERS[facets.cell])
    normals = normals / np.linalg.norm(normals, axis=2)[:, :, None]
    before, after = (corners[:, list(order)] - corners for order in NEIGHBOURS[facets.cell])
    squares = np.square(before).sum(axis=2) * np.square(after).sum(axis=2)
    if facets.dim == 1:
        weights = squares**-0.25
    else:
        weights = np.linalg.norm(np.cross(before, after), axis=2) / squares
    return np.asarray(normals), weights


def _free_normals(vectors: Array, free: Mask) -> Array:
    """Return unit normals within the free directions, or the whole one if little is left of it."""
    normals: Array = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    movable = normals.copy()
    movable[:, : free.shape[1]][~free] = 0.0
    length = np.linalg.norm(movable, axis=1)
    some = (length > FREE_PART) & ~free.all(axis=1)
    normals[some] = movable[some] / length[some, None]
    return normals


def tangents(normals: Array, frame: Array) -> Array:
    """Return orthonormal tangents (n, d - 1, d) for unit normals (n, d).

    The first one points to the first point of a frame as seen from the node, the second to the side
    of the second one: tangents turn with the surface, so that results do not depend on the axes.

    Args:
        normals: unit normals.
        frame: (n, 2, d) from the node to each of two points.
    """
    if normals.shape[1] == 2:
        first = np.stack([-normals[:, 1], normals[:, 0]], axis=1)
        sign = np.where(np.einsum("ni,ni->n", first, frame[:, 0]) < 0.0, -1.0, 1.0)
        return np.asarray((sign[:, None] * first)[:, None])
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = _across(frame[:, 0], normals)
    length = np.linalg.norm(first, axis=1)
    size = np.linalg.norm(frame, axis=2).max(axis=1, initial=0.0)
    first = np.where((length > 1e-6 * size)[:, None], first, _across(axis, normals))
    first /= np.linalg.norm(first, axis=1)[:, None]
    second = np.cross(normals, first)
    sign = np.where(np.einsum("ni,ni->n", second, frame[:, 1]) < 0.0, -1.0, 1.0)
    return np.stack([first, sign[:, None] * second], axis=1)


def _across(v: Array, normals: Array) -> Array:
    """Return the part of v (n, d) across the normals."""
    return np.asarray(v - np.einsum("ni,ni->n", v, normals)[:, None] * normals)
