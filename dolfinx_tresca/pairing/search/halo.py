"""Halos: the facets that a rank owns, and copies of the facets of other ranks that it needs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.exchange import exchange
from dolfinx_tresca.pairing.search.balls import (
    Balls,
    blocks,
    bounding_box,
    expanded_ranges,
    flattened,
    line_intervals,
)
from dolfinx_tresca.pairing.search.facets import FACET_ARRAYS, Facets, Pieces
from dolfinx_tresca.pairing.search.visibility import (
    CREDIBLE_PART,
    FACING_COSINE,
    SHALLOW_DEPTH,
    distances,
)


class Halo:
    """The facets of one side on this rank, to which facets of other ranks can be added.

    At first the halo consists of the facets that this rank owns and of all facets at nodes that
    this rank owns. Further facets are requested only from ranks that may have such facets, judged
    by the bounding box of the facets that each rank owns.

    Attributes:
        comm: the communicator.
        owned: the facets that this rank owns.
        facets: the facets of the halo.
        numbers: (n,) global numbers of the facets of the halo, ascending.
    """

    def __init__(self, V: Any, owned: Facets) -> None:
        """Get all facets at the nodes that this rank owns. Collective.

        Args:
            V: the space of the displacement.
            owned: the facets that this rank owns.
        """
        self.comm: MPI.Comm = V.mesh.comm
        self._range = V.dofmap.index_map.local_range
        self._ends = np.array(self.comm.allgather(self._range[1]))
        self.owned = self.facets = owned
        count = len(owned.points)
        start = sum(self.comm.allgather(count)[: self.comm.rank])
        self.numbers: GlobalNumbers = start + np.arange(count)
        self._records = self._owned_records = self._as_records()
        corners = owned.nodes[:, : owned.corners]
        facet = np.repeat(np.arange(count), owned.corners)
        self._send(self._owned_records, facet, self._owners(corners.ravel()))
        self._records_at_own_nodes = self._records
        self._pieces = Pieces.of(owned)
        size = [self._pieces.radii.max(initial=0.0), count, 0.0]
        box = np.vstack([bounding_box(self._pieces.centres), size])
        #: (ranks, 3, 3): the box of the centres of each rank's pieces; their largest radius, number
        self._boxes = np.array(self.comm.allgather(box))

    def facets_at_own_nodes(self) -> Indices:
        """Return the indices of the facets with a corner owned by this rank. Not collective."""
        corners = self.facets.nodes[:, : self.facets.corners]
        own = (corners >= self._range[0]) & (corners < self._range[1])
        return np.flatnonzero(own.any(axis=1))

    def largest_radius(self) -> float:
        """Return the largest radius [length] of all ranks' pieces. Not collective."""
        return float(self._boxes[:, 2, 0].max())

    def add_near_lines(
        self, points: Array, directions: Array, reach: Array, length: Array | float
    ) -> None:
        """Add the facets of all ranks that are close to lines, and maybe others nearby. Collective.

        See `Balls.on_normals`. Lines without length are points.

        Args:
            points: (n, 3) a point of each line [length].
            directions: (n, 3) unit vectors along the lines.
            reach: (n,) distance within which facets are close [length].
            length: length of the lines in both directions from their points [length]; a number, or
                an array (n,).
        """
        chosen = []
        for rank, (low, high, (largest_radius, count, _)) in enumerate(self._boxes):
            width = reach + largest_radius
            enter, leave = line_intervals(np.stack([low, high]), points, directions, width)
            far = length + width
            near = np.maximum(enter, -far) <= np.minimum(leave, far)
            chosen.append(np.flatnonzero(near & (rank != self.comm.rank) & (count > 0.0)))
        ranks = np.repeat(np.arange(self.comm.size), [len(indices) for indices in chosen])
        length = np.broadcast_to(length, len(points))
        lines = np.column_stack([points, directions, reach, length])[np.concatenate(chosen)]
        lines, source = exchange(self.comm, lines, ranks)
        balls = Balls(self._pieces.centres, self._pieces.radii)
        pairs: list[Indices] = [np.zeros((0, 2), dtype=np.intp)]
        for block in blocks(len(lines)):
            line, piece = balls.on_normals(
                lines[block, :3], lines[block, 3:6], lines[block, 6], lines[block, 7]
            )
            facet = self._pieces.facet[piece]
            pairs.append(np.unique(np.column_stack([facet, source[block][line]]), axis=0))
        self._send(self._owned_records, *np.concatenate(pairs).T)

    def add_neighbours(self, numbers: GlobalNumbers) -> None:
        """Add two rings of facets around those with global numbers (m,). Collective.

        A ring are all facets at the corners of facets: `SmoothSurface` depends on two of them.
        """
        facets = np.searchsorted(self.numbers, numbers)
        nodes = np.unique(self.facets.nodes[facets, : self.facets.corners])
        self._add_facets_at(nodes)
        corners = self.facets.nodes[:, : self.facets.corners]
        self._add_facets_at(np.unique(corners[np.isin(corners, nodes).any(axis=1)]))

    def _add_facets_at(self, nodes: GlobalNumbers) -> None:
        """Add all facets with a corner at nodes (m,). Collective."""
        owners = self._owners(nodes)
        elsewhere = owners != self.comm.rank
        nodes, source = exchange(self.comm, nodes[elsewhere], owners[elsewhere])
        corners = self._records_at_own_nodes["nodes"][:, : self.facets.corners]
        order = np.argsort(corners, axis=None)
        ascending = corners.ravel()[order]
        starts = np.searchsorted(ascending, nodes)
        count = np.searchsorted(ascending, nodes, side="right") - starts
        node, place = expanded_ranges(starts, count)
        facet = order[place] // self.facets.corners
        self._send(self._records_at_own_nodes, facet, source[node])

    def faced_within(self, reach: Array, points: Array, normals: Array) -> Mask:
        """Return whether points (n,) have an opposed facet of any rank nearby. Collective.

        Args:
            reach: (n,) distance within which a facet is near [length].
            points: (n, 3) the points [length].
            normals: (n, 3) normals of the points; the normal of an opposed facet is against them.
        """
        self.add_near_lines(points, normals, reach, 0.0)
        pieces = Pieces.of(self.facets)
        lists = cKDTree(pieces.centres).query_ball_point(
            points, reach + pieces.radii.max(initial=0)
        )
        point, piece = flattened(lists)
        opposed = np.einsum("ni,ni->n", normals[point], pieces.normals[piece]) < -FACING_COSINE
        point, piece = point[opposed], piece[opposed]
        result = np.zeros(len(points), dtype=np.bool_)
        result[point[distances(pieces, piece, points[point]) <= reach[point]]] = True
        return result

    def _owners(self, nodes: GlobalNumbers) -> Indices:
        """Return the rank (n,) that owns each of the nodes (n,)."""
        return np.searchsorted(self._ends, nodes, side="right")

    def _as_records(self) -> npt.NDArray[Any]:
        """Return the facets and their numbers as records (n,), for communication."""
        arrays = {"number": self.numbers}
        arrays |= {name: getattr(self.facets, name) for name in FACET_ARRAYS}
        kinds = [(name, array.dtype, array.shape[1:]) for name, array in arrays.items()]
        result = np.empty(len(self.numbers), dtype=kinds)
        for name, array in arrays.items():
            result[name] = array
        return result

    def _send(self, records: npt.NDArray[Any], facet: Indices, rank: Indices) -> None:
        """Send the facets (n,) among records to ranks (n,); add received facets. Collective."""
        elsewhere = rank != self.comm.rank
        pairs = np.unique(facet[elsewhere] * self.comm.size + rank[elsewhere])
        rows, _ = exchange(self.comm, records[pairs // self.comm.size], pairs % self.comm.size)
        if len(rows):
            together = np.concatenate([self._records, rows])
            self.numbers, kept = np.unique(together["number"], return_index=True)
            self._records = together[kept]
            arrays: dict[str, Any] = {name: self._records[name].copy() for name in FACET_ARRAYS}
            self.facets = replace(self.facets, **arrays)


def extend_halos(secondary: Halo, primary: Halo, limit: float) -> None:
    """Add all facets that the pairing of the facets at this rank's nodes depends on. Collective.

    These are the facets of both sides that lie along the normals of the rank's facets; if facets of
    the rank penetrate the primary side, the primary facets near them; and all facets at the corners
    of paired facets, since the normals at these corners are means over all facets there.

    Args:
        secondary: halo of the secondary side.
        primary: halo of the primary side.
        limit: search distance, beyond which no points are paired [length].
    """
    if secondary.comm.size == 1:
        return
    mine = secondary.facets_at_own_nodes()
    pieces = Pieces.of(secondary.facets)
    some = np.flatnonzero(np.isin(pieces.facet, mine))
    centres, normals, radii = pieces.centres[some], pieces.normals[some], pieces.radii[some]
    # a facet whose centre is beyond the limit may have a part within it, or hide such a part
    far = limit + radii + 2.0 * max(secondary.largest_radius(), primary.largest_radius())
    mine = secondary.numbers[mine]
    primary.add_near_lines(centres, normals, radii, far)
    secondary.add_near_lines(centres, normals, radii, far)

    others = Pieces.of(primary.facets)
    balls = Balls(others.centres, others.radii)
    depth: Array = np.zeros(len(some))
    paired = np.zeros(len(primary.facets.points), dtype=np.bool_)
    for block in blocks(len(some)):
        first, second = balls.on_normals(centres[block], normals[block], radii[block], far[block])
        first += block.start
        opposed = np.einsum("ni,ni->n", normals[first], others.normals[second]) < -FACING_COSINE
        first, second = first[opposed], second[opposed]
        paired[others.facet[second]] = True
        corners = others.points[second] - centres[first][:, None]
        heights = np.einsum("nci,ni->nc", corners, normals[first]).min(axis=1)
        np.maximum.at(depth, first, -heights)
    theirs = primary.numbers[paired]
    flat = secondary.facets.plane and primary.facets.plane
    depth = np.minimum(depth + (0.0 if flat else radii), far)
    deep = depth > 0.5 * SHALLOW_DEPTH * radii
    reach = 2.0 * radii + CREDIBLE_PART * depth
    primary.add_near_lines(centres[deep], normals[deep], reach[deep], 0.0)

    secondary.add_neighbours(mine)
    primary.add_neighbours(theirs)
