"""The facets that a rank works with: its own, and those of other ranks that meet them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.exchange import exchange
from dolfinx_tresca.surface.box import Box
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.pieces import Pieces
from dolfinx_tresca.surface.search import Balls, blocks, expanded_ranges, flattened
from dolfinx_tresca.surface.visibility import CREDIBLE_PART, FACING_COSINE, SHALLOW_DEPTH

#: The arrays of `Facets`, which have a row per facet; its other attributes belong to the surface.
FACET_ARRAYS = ("nodes", "points", "free", "file_numbers", "outward", "offsets")


class Halo:
    """One side's facets on this rank; grows by those of other ranks.

    From the start it has the facets that this rank owns, and all facets round the nodes that it
    owns. What it asks other ranks for goes to those whose boxes say that they may have it.

    Attributes:
        comm: the ranks.
    """

    def __init__(self, V: Any, owned: Facets) -> None:
        """Get the facets round this rank's nodes. Collective.

        Args:
            V: the space of the displacement.
            owned: the facets that each rank owns.
        """
        self.comm: MPI.Comm = V.mesh.comm
        self._range = V.dofmap.index_map.local_range
        self._ends = np.array(self.comm.allgather(self._range[1]))
        count = len(owned.points)
        first = sum(self.comm.allgather(count)[: self.comm.rank])
        self._owned = _Numbered(owned, np.arange(first, first + count))
        self._here = self._owned
        corners = owned.nodes[:, : owned.corners]
        facet = np.repeat(np.arange(count), owned.corners)
        self._send(self._owned, facet, self._owners(corners.ravel()))
        self._round_nodes = self._here
        if self.comm.size > 1:
            self._pieces = Pieces.of(owned)
            self._reach = self._pieces.radii.max(initial=0.0)
            row = np.append(Box.around(self._pieces.centres).as_row(), [self._reach, count])
            self._boxes = np.empty((self.comm.size, len(row)))
            self.comm.Allgather(row, self._boxes)

    @property
    def facets(self) -> Facets:
        """Those that are here, in the order of the ranks that own them."""
        return self._here.facets

    @property
    def numbers(self) -> GlobalNumbers:
        """Their numbers (n,), ascending, the same on all ranks."""
        return self._here.number

    def round_own_nodes(self) -> Indices:
        """Return the positions of the facets with a corner that this rank owns. Not collective."""
        corners = self.facets.nodes[:, : self.facets.corners]
        own = (corners >= self._range[0]) & (corners < self._range[1])
        return np.flatnonzero(own.any(axis=1))

    def largest_radius(self) -> float:
        """Return the largest radius of a piece of the whole surface [length]. Not collective."""
        return float(self._boxes[:, -2].max())

    def add_crossed(self, lines: Array) -> None:
        """Get the facets that lines come close to. Collective.

        Args:
            lines: (n, 8) a point, a unit normal, the radius of the ball that moves along it, and
                how far it does so, both ways [length]; see `Balls.facing`.
        """
        asked = []
        for rank, box, reach in self._others():
            near = lines[:, 6] + reach
            enter, leave = box.crossed(lines[:, :3], lines[:, 3:6], near)
            far = lines[:, 7] + near
            asked.append((rank, np.maximum(enter, -far) <= np.minimum(leave, far)))
        lines, source = self._ask(lines, asked)
        balls = Balls(self._pieces.centres, self._pieces.radii)
        pairs: list[Indices] = [np.zeros((0, 2), dtype=np.intp)]
        for some in blocks(len(lines)):
            line, piece = balls.facing(
                lines[some, :3], lines[some, 3:6], lines[some, 6], lines[some, 7]
            )
            found = np.column_stack([self._pieces.facet[piece], source[some][line]])
            pairs.append(np.unique(found, axis=0))
        self._send(self._owned, *np.concatenate(pairs).T)

    def add_near(self, balls: Array) -> None:
        """Get the facets that are nowhere farther from points than a radius. Collective.

        Args:
            balls: (n, 4) the point and the radius [length].
        """
        asked = [
            (rank, box.near(balls[:, :3], balls[:, 3] + reach))
            for rank, box, reach in self._others()
        ]
        balls, source = self._ask(balls, asked)
        tree = cKDTree(self._pieces.centres)
        pairs: list[Indices] = [np.zeros((0, 2), dtype=np.intp)]
        for some in blocks(len(balls)):
            lists = tree.query_ball_point(balls[some, :3], balls[some, 3] + self._reach)
            ball, piece = flattened(lists)
            found = np.column_stack([self._pieces.facet[piece], source[some][ball]])
            pairs.append(np.unique(found, axis=0))
        self._send(self._owned, *np.concatenate(pairs).T)

    def add_round_corners(self, numbers: GlobalNumbers) -> None:
        """Get all facets round the corners of some that are here, by `numbers`. Collective."""
        facets = np.searchsorted(self.numbers, numbers)
        nodes = np.unique(self.facets.nodes[facets, : self.facets.corners])
        owners = self._owners(nodes)
        elsewhere = owners != self.comm.rank
        nodes, source = exchange(self.comm, nodes[elsewhere], owners[elsewhere])
        corners = self._round_nodes.facets.nodes[:, : self.facets.corners]
        order = np.argsort(corners, axis=None)
        ascending = corners.ravel()[order]
        starts = np.searchsorted(ascending, nodes)
        count = np.searchsorted(ascending, nodes, side="right") - starts
        node, place = expanded_ranges(starts, count)
        self._send(self._round_nodes, order[place] // self.facets.corners, source[node])

    def _owners(self, nodes: GlobalNumbers) -> Indices:
        """Return the ranks that own nodes (n,)."""
        return np.searchsorted(self._ends, nodes, side="right")

    def _others(self) -> list[tuple[int, Box, float]]:
        """Return the other ranks that have facets, with their boxes and largest radii."""
        return [
            (rank, Box.of_row(row[:-2]), row[-2])
            for rank, row in enumerate(self._boxes)
            if rank != self.comm.rank and row[-1] > 0
        ]

    def _ask(self, rows: Array, asked: list[tuple[int, Mask]]) -> tuple[Array, Indices]:
        """Send each rank those of the rows (n, k) that it is asked; return what comes."""
        chosen = [np.flatnonzero(mask) for _, mask in asked]
        ranks = np.repeat([rank for rank, _ in asked], [len(some) for some in chosen])
        some = np.concatenate([*chosen, np.zeros(0, dtype=np.intp)])
        return exchange(self.comm, rows[some], ranks.astype(np.intp))

    def _send(self, source: _Numbered, facet: Indices, rank: Indices) -> None:
        """Send facets (n,) of some to ranks (n,), each once, and add those that come."""
        size = self.comm.size
        elsewhere = rank != self.comm.rank
        pairs = np.unique(facet[elsewhere] * size + rank[elsewhere])
        rows, _ = exchange(self.comm, source.rows(pairs // size), pairs % size)
        self._here = self._here.joined(rows)


@dataclass(frozen=True)
class _Numbered:
    """Facets with numbers (n,), ascending, that belong to them on all ranks."""

    facets: Facets
    number: GlobalNumbers

    def rows(self, some: Indices) -> npt.NDArray[Any]:
        """Return some of them as records."""
        of_facets = {name: getattr(self.facets, name) for name in FACET_ARRAYS}
        arrays = {"number": self.number, **of_facets}
        kinds = [(name, array.dtype, array.shape[1:]) for name, array in arrays.items()]
        result = np.empty(len(some), dtype=kinds)
        for name, array in arrays.items():
            result[name] = array[some]
        return result

    def joined(self, rows: npt.NDArray[Any]) -> _Numbered:
        """Return these and others, each once."""
        if len(rows) == 0:
            return self
        number, first = np.unique(np.concatenate([self.number, rows["number"]]), return_index=True)
        together: dict[str, Any] = {
            name: np.concatenate([getattr(self.facets, name), rows[name]])[first]
            for name in FACET_ARRAYS
        }
        return _Numbered(replace(self.facets, **together), number)


def extend_halos(secondary: Halo, primary: Halo, limit: float) -> None:
    """Get what the facets round a rank's nodes may be paired with, or hidden by. Collective.

    That is what lies along their normals, on both sides; what is near those that penetrate the
    primary side; and the facets round the corners of what is paired, for the normals there.

    Args:
        secondary: that side.
        primary: the other one.
        limit: distance beyond which nothing is in contact [length].
    """
    if secondary.comm.size == 1:
        return
    mine = secondary.round_own_nodes()
    pieces = Pieces.of(secondary.facets)
    some = np.flatnonzero(np.isin(pieces.facet, mine))
    centres, normals, radii = pieces.centres[some], pieces.normals[some], pieces.radii[some]
    # what is within the limit in a part of a facet may be behind others that are not
    far = limit + radii + 2.0 * max(secondary.largest_radius(), primary.largest_radius())
    lines = np.column_stack([centres, normals, radii, far])
    mine = secondary.numbers[mine]
    primary.add_crossed(lines)
    secondary.add_crossed(lines)

    others = Pieces.of(primary.facets)
    balls = Balls(others.centres, others.radii)
    depth: Array = np.zeros(len(some))
    paired = np.zeros(len(primary.facets.points), dtype=np.bool_)
    for block in blocks(len(some)):
        first, second = balls.facing(centres[block], normals[block], radii[block], far[block])
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
    primary.add_near(np.column_stack([centres, reach])[deep])

    secondary.add_round_corners(mine)
    primary.add_round_corners(theirs)
