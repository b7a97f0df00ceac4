"""Contact of a surface with itself: which facets may meet, and which of two is secondary.

The facets of the surface may belong to many bodies, and parts of one body may touch each other.
Each facet sees other facets along its normal, as in a pair of two surfaces. A point where two
facets meet is seen from both facets, but must be constrained only once. So an order of the facets
decides which of two facets is secondary. This order depends on the undeformed mesh only: the roles
are the same in all configurations of finite sliding, and on any number of ranks.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.pairing.search.facets import (
    FACING_COSINE,
    NEGLIGIBLE,
    SHALLOW_DEPTH,
    Facets,
    SurfaceNodes,
    quadrature,
)

#: Ratio of the mean facet sizes of two bodies below which the finer body is secondary. If it were
#: 1, slight differences in size would decide, and between equal bricks rounding.
FINER = 2.0**-0.5

#: Number of candidates for the direction that orders the facets of a body.
DIRECTIONS = 12

#: A direction suits a facet of its body fully if the sine and the cosine of the angle between the
#: direction and the facet's normal are at least this. On a slit parallel to the direction rounding
#: would decide the roles facet by facet, and most nodes of the slit would lose their multipliers.
LEAST_COMPONENT = 0.3

#: Two facets of one body that are behind each other count as the two faces of one wall, whose
#: material is between them, if their distance is at least this part of their distance in the
#: undeformed mesh. (Walls are not compressed to half of their thickness.)
WALL_PART = 0.5


class SelfContact:
    """Data that decide which facet of a surface that touches itself is the secondary one.

    Attributes:
        body: (n,) the body of each facet.
        size: (n,) mean size of all facets of the facet's body [length].
        centre: (n, 3) centre of the facet in the undeformed mesh [length].
        normal: (n, 3) outward unit normal in the undeformed mesh.
        radius: (n,) radius of the facet in the undeformed mesh [length].
        direction: (n, 3) direction that orders the facets of the facet's body.
        corners: (n, corners) global numbers of the corners.
        place: (n, 3) centre in the present configuration [length].
        present_normal: (n, 3) outward unit normal in the present configuration.
    """

    def __init__(self, facets: Facets) -> None:
        """Take the data from the present corners of facets and their `origins`. Not collective."""
        columns = np.split(facets.origins, [1, 2, 5, 8, 9], axis=1)
        body, size, self.centre, self.normal, radius, self.direction = columns
        self.body, self.size, self.radius = body[:, 0].astype(np.intp), size[:, 0], radius[:, 0]
        self.corners = facets.nodes[:, : facets.corners]
        self.place = facets.points[:, : facets.corners].mean(axis=1)
        self.present_normal = facets.mean_normals

    def _facing_before(self, facet: Indices, partner: Indices) -> Mask:
        """Return, for pairs of facets (m,), whether undeformed normals are opposed, (m,)."""
        cosine = np.einsum("ni,ni->n", self.normal[facet], self.normal[partner])
        return np.asarray(cosine < -FACING_COSINE)

    def may_meet(self, facet: Indices, partner: Indices) -> Mask:
        """Return, for pairs of facets (m,), whether the two may come into contact, (m,).

        Facets of one body may not meet if they are neighbours, or if they are the two faces of a
        wall. Neighbours share a corner and do not face each other in the undeformed mesh; the two
        lips of a crack also share corners at its tip, but face each other. Two facets are the faces
        of a wall if each is behind the other, deeper than facets of curved surfaces penetrate each
        other (`SHALLOW_DEPTH`) or, if they share a corner as at the edge of a blade, deeper than
        touching lips (`NEGLIGIBLE`). This must be so both in the undeformed mesh and in the
        present configuration, and the present depth must exceed `WALL_PART` of the undeformed
        depth.
        """
        result = np.ones(len(facet), dtype=np.bool_)
        in_one_body = np.flatnonzero(self.body[facet] == self.body[partner])
        f, g = facet[in_one_body], partner[in_one_body]
        common = (self.corners[f][:, :, None] == self.corners[g][:, None]).any(axis=(1, 2))
        neighbours = common & ~self._facing_before(f, g)
        shallow = np.where(common, NEGLIGIBLE, SHALLOW_DEPTH)
        shallow = shallow * (self.radius[f] + self.radius[g])
        undeformed = _least_depth(self.centre, self.normal, f, g)
        present = _least_depth(self.place, self.present_normal, f, g)
        wall = (undeformed > shallow) & (present > np.maximum(shallow, WALL_PART * undeformed))
        result[in_one_body] = ~(neighbours | wall)
        return result

    def is_secondary(self, facet: Indices, partner: Indices) -> Mask:
        """Return, for pairs of facets (m,), whether the first one is secondary, (m,).

        Of two bodies, the body with finer facets is secondary; if neither is finer (`FINER`), the
        body that comes first in `label_bodies` is secondary. Two facets of one body are ordered by
        the body's `direction`. If they face each other in the undeformed mesh, as in a slit or a
        ring, the facet whose normal points along the direction is secondary; otherwise, as on a
        folded sheet, the facet that comes first in this direction is secondary.
        """
        f, g = facet, partner
        similar = np.minimum(self.size[f], self.size[g]) > FINER * np.maximum(
            self.size[f], self.size[g]
        )
        of_bodies = np.where(similar, self.body[f] < self.body[g], self.size[f] < self.size[g])
        towards = np.where(
            self._facing_before(f, g)[:, None],
            self.normal[f] - self.normal[g],
            self.centre[g] - self.centre[f],
        )
        in_body = np.einsum("ni,ni->n", towards, self.direction[f]) > 0.0
        return np.where(self.body[f] == self.body[g], in_body, of_bodies)


def _least_depth(centre: Array, normal: Array, facet: Indices, partner: Indices) -> Array:
    """Return the smaller depth (m,) of two facets' centres, each behind the other facet's plane."""
    offset = centre[partner] - centre[facet]
    behind = -np.einsum("ni,ni->n", offset, normal[facet])
    ahead = np.einsum("ni,ni->n", offset, normal[partner])
    return np.asarray(np.minimum(behind, ahead))


def facet_origins(V: Any, facets: Facets) -> Array:
    """Return `Facets.origins` of this rank's facets in the undeformed mesh. Collective.

    The columns are body, size, centre, normal, radius and direction, as in `SelfContact`.

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
    normals = facets.mean_normals
    directions = np.zeros((DIRECTIONS, 3))  # random ones, none of which is along an axis
    directions[:, : 1 + facets.dim] = np.random.default_rng(0).normal(
        size=(DIRECTIONS, 1 + facets.dim)
    )
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    cosine = np.abs(normals @ directions.T)
    along = np.minimum(np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), cosine)
    quality = np.zeros((number, DIRECTIONS))
    np.add.at(quality, body, area[:, None] * np.minimum(along, LEAST_COMPONENT))
    quality = reduce_array(comm, quality) / np.where(whole > 0.0, whole, 1.0)[:, None]
    best = np.round(quality, 6).argmax(axis=1)  # the rounding of sums depends on the partition
    direction = directions[best][body]
    return np.column_stack([body, size[body], centre, normals, radius, direction])


def redundant_nodes(nodes: SurfaceNodes, paired: Indices, opposite: Indices) -> Mask:
    """Return the nodes whose jump another node already constrains. Not collective.

    `SelfContact` decides which of two facets is the secondary one. Where its choice changes from
    facet to facet, two opposite nodes may each be secondary on one facet and primary on the next.
    Both nodes would have the same jump: only the node that comes first in the mesh file has a
    multiplier, and the second node is returned. A node that is opposite to itself, such as the tip
    of a crack, has no jump, and is returned.

    Args:
        nodes: the nodes of the surface.
        paired: (p, 2) pairs of a secondary and a primary facet that overlap.
        opposite: (q, 2) pairs of facets that see each other with exchanged roles.

    Returns:
        (n,) whether the node has no multiplier for this reason; valid for nodes whose facets are
        all on this rank.
    """
    count, in_file = nodes.facets.corners, nodes.facets.file_numbers

    def rows(pairs: Indices) -> Indices:
        """Return rows (node, its number in the mesh file, this number of an opposite node).

        There is a row for each corner of the first facet of a pair, with each corner of the second.
        """
        own, theirs = pairs.T
        columns = (
            np.repeat(nodes.facet_nodes[own], count, axis=1),
            np.repeat(in_file[own], count, axis=1),
            np.tile(in_file[theirs], count),
        )
        result: Indices = np.column_stack([column.ravel() for column in columns])
        return np.unique(result, axis=0)

    together = np.concatenate([rows(paired), rows(opposite)])
    seen, times = np.unique(together, axis=0, return_counts=True)
    own, theirs = seen[:, 1], seen[:, 2]
    second = seen[(own == theirs) | (times > 1) & (own > theirs), 0]
    result = np.zeros(len(nodes.numbers), dtype=np.bool_)
    result[second] = True
    return result


def opposite_bodies(nodes: SurfaceNodes, paired: Indices, order: SelfContact) -> Indices:
    """Return the body that is opposite to each node. Not collective.

    `couple` treats patches of a node on a sharp edge that face different bodies like different
    nodes.

    Args:
        nodes: the nodes of the surface.
        paired: (p, 2) pairs of a secondary and a primary facet that overlap.
        order: the bodies of the facets.

    Returns:
        (n,) the number of the body, the least number if there are several bodies; -1 for nodes
        without an opposite facet.
    """
    no_body = np.iinfo(np.intp).max
    result = np.full(len(nodes.numbers), no_body)
    facet, partner = paired.T
    np.minimum.at(result, nodes.facet_nodes[facet], order.body[partner][:, None])
    return np.where(result == no_body, -1, result)
