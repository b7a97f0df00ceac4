"""Contact of a surface with itself: which facets may meet, and which of two is secondary.

The facets of the surface may belong to many bodies, and parts of one body may touch each other.
Each facet sees the others along its normal, as in a pair of two surfaces. A place where two facets
meet is seen from both; it must be constrained once. So an order decides which facet of two is the
secondary one. It depends on the undeformed mesh only: the roles are the same in all configurations
of finite sliding, and on any number of ranks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.surface.facets import Facets, quadrature
from dolfinx_tresca.surface.numbering import label_bodies
from dolfinx_tresca.surface.visibility import SHALLOW_DEPTH

#: Ratio of the mean facet sizes of two bodies below which the finer body is secondary. With 1, the
#: parts of bricks that are cut differently would decide, and so rounding for equal bricks.
FINER = 2.0**-0.5

#: Direction along which two facets of one body are ordered. No face of a usual part is normal or
#: parallel to it: at such a face the facets would be ordered by the offsets of their centres.
DIRECTION = np.array([0.8, 0.53, 0.28])

#: Weight of the difference of two unit normals, times the radii of the facets, beside the
#: difference of the positions of the facets. Facets on both sides of a closed slit differ in their
#: normals only, and their offsets along the slit, which are up to the sum of the radii, must not
#: decide. With 1, they do on slits that are inclined to `DIRECTION` by less than 27 degrees, with 8
#: on those by less than 4.
NORMAL_WEIGHT = 8.0

#: Penetration of facets of one body, relative to the distance of the facets in the undeformed mesh,
#: from which they count as the two faces of one wall, whose material is between them. (Walls are
#: not compressed to half of their thickness.)
WALL_PART = 0.5


@dataclass(frozen=True)
class SelfContact:
    """The order of the facets of a surface that touches itself.

    Attributes:
        body: (n,) the body of each facet.
        size: (n,) mean size of the facets of this body [length].
        centre: (n, 3) centre of the facet in the undeformed mesh [length].
        normal: (n, 3) outward unit normal in the undeformed mesh.
        radius: (n,) radius of the facet in the undeformed mesh [length].
        corners: (n, corners) global numbers of the corners.
        place: (n, 3) centre in the present configuration [length].
        present_normal: (n, 3) outward unit normal in the present configuration.
    """

    body: Indices
    size: Array
    centre: Array
    normal: Array
    radius: Array
    corners: GlobalNumbers
    place: Array
    present_normal: Array

    @classmethod
    def of(cls, facets: Facets) -> SelfContact:
        """Return the order of facets with `Facets.origins`. Not collective."""
        body, size, x, normal, radius = np.split(facets.origins, [1, 2, 5, 8], axis=1)
        return cls(
            body[:, 0].astype(np.intp),
            size[:, 0],
            x,
            normal,
            radius[:, 0],
            facets.nodes[:, : facets.corners],
            facets.points[:, : facets.corners].mean(axis=1),
            facets.mean_normals,
        )

    def in_one_body(self, first: Indices, second: Indices) -> Mask:
        """Return whether two facets (m,), (m,) belong to the same body."""
        return self.body[first] == self.body[second]

    def may_meet(self, first: Indices, second: Indices) -> Mask:
        """Return whether two facets (m,), (m,) may come into contact, (m,).

        Facets of one body do not if they share a corner, or if they are the two faces of a wall:
        if each is behind the other one, now and in the undeformed mesh, by more than what facets of
        curved surfaces penetrate each other, and by more than `WALL_PART` of what it was there.
        """
        result = np.ones(len(first), dtype=np.bool_)
        some = np.flatnonzero(self.in_one_body(first, second))
        f, g = first[some], second[some]
        common = (self.corners[f][:, :, None] == self.corners[g][:, None]).any(axis=(1, 2))
        shallow = SHALLOW_DEPTH * (self.radius[f] + self.radius[g])
        was = _least_depth(self.centre, self.normal, f, g)
        now = _least_depth(self.place, self.present_normal, f, g)
        wall = (was > shallow) & (now > np.maximum(shallow, WALL_PART * was))
        result[some] = ~(common | wall)
        return result

    def is_secondary(self, first: Indices, second: Indices) -> Mask:
        """Return whether the first of two facets (m,), (m,) is the secondary one, (m,).

        Of two bodies it is the one with finer facets, else the first one in the order of
        `label_bodies`. In one body, it is the facet before the other one along `DIRECTION`.
        """
        f, g = first, second
        by_size = self.size[f] < self.size[g]
        similar = np.minimum(self.size[f], self.size[g]) > FINER * np.maximum(
            self.size[f], self.size[g]
        )
        bodies = np.where(similar, self.body[f] < self.body[g], by_size)
        reach = NORMAL_WEIGHT * (self.radius[f] + self.radius[g])
        towards = self.centre[g] - self.centre[f]
        towards = towards + reach[:, None] * (self.normal[f] - self.normal[g])
        return np.where(self.in_one_body(f, g), towards @ DIRECTION > 0.0, bodies)


def _least_depth(centre: Array, normal: Array, first: Indices, second: Indices) -> Array:
    """Return how far each of two facets is behind the plane of the other one at least, (m,)."""
    offset = centre[second] - centre[first]
    behind = -np.einsum("ni,ni->n", offset, normal[first])
    ahead = np.einsum("ni,ni->n", offset, normal[second])
    return np.minimum(behind, ahead)


def facet_origins(V: Any, facets: Facets) -> tuple[Array, int]:
    """Return `Facets.origins` of this rank's facets, and the number of bodies they are on.

    Collective. The mesh must be undeformed.

    Args:
        V: the space of the displacement.
        facets: the facets that this rank owns.
    """
    comm = V.mesh.comm
    labels = label_bodies(V)
    node = V.dofmap.index_map.global_to_local(facets.nodes[:, 0])
    body = labels[node]
    points, weights = quadrature(facets.cell, 2 * facets.degree)
    area = np.linalg.norm(facets.area_vectors(points), axis=2) @ weights
    number = int(reduce_array(comm, labels.max(initial=-1), MPI.MAX)) + 1
    count = reduce_array(comm, np.bincount(body, minlength=number))
    whole = reduce_array(comm, np.bincount(body, area, minlength=number))
    size = (whole / np.maximum(count, 1)) ** (1.0 / facets.dim)
    corners = facets.points[:, : facets.corners]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1, initial=0.0)
    origins = np.column_stack([body, size[body], centre, facets.mean_normals, radius])
    return origins, int(np.count_nonzero(count))
