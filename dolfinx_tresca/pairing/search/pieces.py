"""Subdivision of facets into pieces with straight edges, for search and clipping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, cross
from dolfinx_tresca.pairing.search.facets import Facets, frames_along

# corners of each piece, in the order round it, as indices of the facet's nodes in basix' order
_WHOLE = {"interval": [[0, 1]], "triangle": [[0, 1, 2]], "quadrilateral": [[0, 1, 3, 2]]}
_QUARTERS = {
    "interval": [[0, 2], [2, 1]],
    "triangle": [[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]],
    "quadrilateral": [[0, 4, 8, 5], [4, 1, 6, 8], [8, 6, 3, 7], [5, 8, 7, 2]],
}


@dataclass(frozen=True)
class Pieces:
    """Segments, triangles or quadrilaterals that approximate facets.

    If any facet of the surface is curved (`Facets.bent`), each facet is cut into two (in 2D) or
    four pieces; else each facet is one piece.

    Attributes:
        facet: (n,) the facet of each piece, ascending.
        nodes: (n, corners) global numbers of the displacement's nodes at the corners.
        points: (n, corners, 3) corners in the order round the piece [length].
        centres: (n, 3) means of the corners [length].
        radii: (n,) largest distance of a corner from the centre [length].
        normals: (n, 3) outward unit normals of the (mean) planes.
    """

    facet: Indices
    nodes: GlobalNumbers
    points: Array
    centres: Array
    radii: Array
    normals: Array

    @classmethod
    def of(cls, facets: Facets) -> Pieces:
        """Cut facets into pieces."""
        corners = np.array((_QUARTERS if facets.bent else _WHOLE)[facets.cell])
        points = facets.points[:, corners].reshape(-1, corners.shape[1], 3)
        nodes = facets.nodes[:, corners].reshape(-1, corners.shape[1])
        facet = np.repeat(np.arange(len(facets.points)), len(corners))
        centres = points.mean(axis=1)
        if facets.dim == 1:
            vectors = cross(points[:, 1] - points[:, 0], np.array([0.0, 0.0, 1.0]))
        elif corners.shape[1] == 3:
            vectors = cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        else:  # the area vector of a quadrilateral is half the cross product of its diagonals
            vectors = cross(points[:, 2] - points[:, 0], points[:, -1] - points[:, 1])
        vectors = vectors * facets.outward[facet, None]
        return cls(
            facet,
            nodes,
            points,
            centres,
            np.linalg.norm(points - centres[:, None], axis=2).max(axis=1),
            np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None]),
        )

    def frames(self) -> Array:
        """Return orthonormal axes (n, dim + 1, 3) of the pieces: tangents, and the normal last."""
        axes = frames_along(self.points[:, 1] - self.points[:, 0], self.normals)
        return axes[:, [0, 2]] if self.points.shape[1] == 2 else axes

    def local_coordinates(self, frames: Array, piece: Indices, points: Array) -> Array:
        """Return the coordinates (n, k, dim + 1) of points (n, k, 3) in the frames of pieces (n,).

        The origin is the centre of the piece; the last coordinate is the height over its plane.
        """
        relative = points - self.centres[piece][:, None]
        return np.asarray(np.einsum("nki,ndi->nkd", relative, frames[piece]))
