"""Halos: the facets that a rank owns, and copies of the facets of other ranks that it needs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.exchange import exchange
from dolfinx_tresca.pairing.search.box import Box
from dolfinx_tresca.pairing.search.facets import FACET_ARRAYS, Facets
from dolfinx_tresca.pairing.search.pieces import Pieces
from dolfinx_tresca.pairing.search.search import Balls, blocks, expanded_ranges, flattened
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
        count = len(owned.points)
        first = sum(self.comm.allgather(count)[: self.comm.rank])
        self._owned = _NumberedFacets(owned, np.arange(first, first + count))
        self._local = self._owned
        corners = owned.nodes[:, : owned.corners]
        facet = np.repeat(np.arange(count), owned.corners)
        self._send_facets(self._owned, facet, self._owners(corners.ravel()))
        self._at_own_nodes = self._local
        if self.comm.size > 1:
            self._pieces = Pieces.of(owned)
            self._reach = self._pieces.radii.max(initial=0.0)
            row = np.append(Box.around(self._pieces.centres).to_row(), [self._reach, count])
            self._boxes = np.empty((self.comm.size, len(row)))
            self.comm.Allgather(row, self._boxes)

    @property
    def owned(self) -> Facets:
        """The facets that this rank owns."""
        return self._owned.facets

    @property
    def facets(self) -> Facets:
        """The facets of the halo, in the order of `numbers`."""
        return self._local.facets

    @property
    def numbers(self) -> GlobalNumbers:
        """The global numbers (n,) of the facets, ascending."""
        return self._local.number

    def facets_at_own_nodes(self) -> Indices:
        """Return the indices of the facets with a corner owned by this rank. Not collective."""
        corners = self.facets.nodes[:, : self.facets.corners]
        own = (corners >= self._range[0]) & (corners < self._range[1])
        return np.flatnonzero(own.any(axis=1))

    def largest_radius(self) -> float:
        """Return the largest radius [length] of all ranks' pieces; for two or more ranks."""
        return float(self._boxes[:, -2].max())

    def add_near_lines(self, lines: Array) -> None:
        """Add the facets of all ranks that are close to lines. Collective.

        Args:
            lines: (n, 8) lines as rows: a point (3), a unit vector along the line (3), the distance
                within which facets are close, and the length of the line in both directions from
                the point [length]; see `Balls.on_normals`.
        """
        queries = []
        for rank, box, reach in self._other_ranks():
            near = lines[:, 6] + reach
            enter, leave = box.line_intervals(lines[:, :3], lines[:, 3:6], near)
            far = lines[:, 7] + near
            queries.append((rank, np.maximum(enter, -far) <= np.minimum(leave, far)))
        lines, source = self._send_queries(lines, queries)
        balls = Balls(self._pieces.centres, self._pieces.radii)
        pairs: list[Indices] = [np.zeros((0, 2), dtype=np.intp)]
        for some in blocks(len(lines)):
            line, piece = balls.on_normals(
                lines[some, :3], lines[some, 3:6], lines[some, 6], lines[some, 7]
            )
            found = np.column_stack([self._pieces.facet[piece], source[some][line]])
            pairs.append(np.unique(found, axis=0))
        self._send_facets(self._owned, *np.concatenate(pairs).T)

    def add_near_points(self, balls: Array) -> None:
        """Add the facets of all ranks that meet balls, and maybe further facets nearby. Collective.

        Args:
            balls: (n, 4) balls as rows: the centre (3) and the radius [length].
        """
        queries = [
            (rank, box.within_reach(balls[:, :3], balls[:, 3] + reach))
            for rank, box, reach in self._other_ranks()
        ]
        balls, source = self._send_queries(balls, queries)
        tree = cKDTree(self._pieces.centres)
        pairs: list[Indices] = [np.zeros((0, 2), dtype=np.intp)]
        for some in blocks(len(balls)):
            lists = tree.query_ball_point(balls[some, :3], balls[some, 3] + self._reach)
            ball, piece = flattened(lists)
            found = np.column_stack([self._pieces.facet[piece], source[some][ball]])
            pairs.append(np.unique(found, axis=0))
        self._send_facets(self._owned, *np.concatenate(pairs).T)

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
        corners = self._at_own_nodes.facets.nodes[:, : self.facets.corners]
        order = np.argsort(corners, axis=None)
        ascending = corners.ravel()[order]
        starts = np.searchsorted(ascending, nodes)
        count = np.searchsorted(ascending, nodes, side="right") - starts
        node, place = expanded_ranges(starts, count)
        self._send_facets(self._at_own_nodes, order[place] // self.facets.corners, source[node])

    def faced_within(self, reach: Array, points: Array, normals: Array) -> Mask:
        """Return whether points (n,) have an opposed facet of any rank nearby. Collective.

        Args:
            reach: (n,) distance within which a facet is near [length].
            points: (n, 3) the points [length].
            normals: (n, 3) normals of the points; the normal of an opposed facet is against them.
        """
        if self.comm.size > 1:
            self.add_near_points(np.column_stack([points, reach]))
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

    def _other_ranks(self) -> list[tuple[int, Box, float]]:
        """Return the other ranks that own facets, with box and largest radius of their pieces."""
        return [
            (rank, Box.from_row(row[:-2]), row[-2])
            for rank, row in enumerate(self._boxes)
            if rank != self.comm.rank and row[-1] > 0
        ]

    def _send_queries(self, rows: Array, queries: list[tuple[int, Mask]]) -> tuple[Array, Indices]:
        """Send some rows to each rank; return the received rows and their senders. Collective.

        Args:
            rows: (n, k) the rows.
            queries: pairs of a rank and the mask (n,) of the rows to send to it.
        """
        chosen = [np.flatnonzero(mask) for _, mask in queries]
        ranks = np.repeat([rank for rank, _ in queries], [len(some) for some in chosen])
        some = np.concatenate([*chosen, np.zeros(0, dtype=np.intp)])
        return exchange(self.comm, rows[some], ranks.astype(np.intp))

    def _send_facets(self, source: _NumberedFacets, facet: Indices, rank: Indices) -> None:
        """Send the facets (n,) of `source` to ranks (n,); add received facets. Collective."""
        size = self.comm.size
        elsewhere = rank != self.comm.rank
        pairs = np.unique(facet[elsewhere] * size + rank[elsewhere])
        rows, _ = exchange(self.comm, source.records(pairs // size), pairs % size)
        self._local = self._local.joined_with(rows)


@dataclass(frozen=True)
class _NumberedFacets:
    """Facets with their global numbers (n,), ascending."""

    facets: Facets
    number: GlobalNumbers

    def records(self, some: Indices) -> npt.NDArray[Any]:
        """Return the facets with given indices as records, for communication."""
        of_facets = {name: getattr(self.facets, name) for name in FACET_ARRAYS}
        arrays = {"number": self.number, **of_facets}
        kinds = [(name, array.dtype, array.shape[1:]) for name, array in arrays.items()]
        result = np.empty(len(some), dtype=kinds)
        for name, array in arrays.items():
            result[name] = array[some]
        return result

    def joined_with(self, rows: npt.NDArray[Any]) -> _NumberedFacets:
        """Return these facets and the facets in records, each facet once."""
        if len(rows) == 0:
            return self
        number, first = np.unique(np.concatenate([self.number, rows["number"]]), return_index=True)
        together: dict[str, Any] = {
            name: np.concatenate([getattr(self.facets, name), rows[name]])[first]
            for name in FACET_ARRAYS
        }
        return _NumberedFacets(replace(self.facets, **together), number)


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
    lines = np.column_stack([centres, normals, radii, far])
    mine = secondary.numbers[mine]
    primary.add_near_lines(lines)
    secondary.add_near_lines(lines)

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
    primary.add_near_points(np.column_stack([centres, reach])[deep])

    secondary.add_neighbours(mine)
    primary.add_neighbours(theirs)
