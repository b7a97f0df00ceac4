"""Straight pieces of facets, and the search for them along lines, here and on all ranks.

The halo of a side are the facets that a rank needs: its own, and copies from other ranks.
They are requested only from ranks that may have them, judged by the bounding box of the facets that
each rank owns, and are in the order of the ranks that own them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import chain
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask, cross, dots
from dolfinx_tresca._base.parallel import exchange, gather_rows
from dolfinx_tresca.pairing.facets import FACET_ARRAYS, FACING_COSINE, Facets, frames_along

#: Number of lines that are processed at once, which bounds the memory; of pairs of facets it is
#: four times this number, and of points and what may hide them 50 times.
AT_ONCE = 2048

#: A point's penetration along the normal counts only if the point's least distance from the other
#: side's surface, in any direction, is at least this part of the penetration. The distance is equal
#: to the penetration for parallel surfaces, and zero if the normal runs along a face.
CREDIBLE_PART = 0.1

#: Least component of a direction: lines meet planes to which they are parallel very far away.
PARALLEL = 1e-30


def flattened(lists: Sequence[Sequence[int]]) -> tuple[Indices, Indices]:
    """Concatenate lists; return the index (m,) of each member's list, and the members (m,)."""
    counts = np.fromiter(map(len, lists), dtype=np.intp, count=len(lists))
    together = np.fromiter(chain.from_iterable(lists), dtype=np.intp, count=counts.sum())
    return np.repeat(np.arange(len(lists)), counts), together


def line_intervals(
    box: Array, origins: Array, directions: Array, reach: Array
) -> tuple[Array, Array]:
    """Intersect lines with a box (2, 3), widened on all sides by the reach (n,) of each line.

    Return the parameters (n,) [length] at which lines with origins (n, 3) and unit directions
    (n, 3) enter and leave the box. A line that misses the box enters later than it leaves.
    """
    slopes = np.where(np.abs(directions) < PARALLEL, PARALLEL, directions)
    at_low = (box[0] - reach[:, None] - origins) / slopes
    at_high = (box[1] + reach[:, None] - origins) / slopes
    return np.minimum(at_low, at_high).max(axis=1), np.maximum(at_low, at_high).min(axis=1)


class Pieces:
    """Segments, triangles or quadrilaterals that approximate facets, for searches and overlaps.

    If any facet is curved (`Facets.bent`), each is cut into two (2D) or four pieces, else into one.

    Attributes:
        facet: (n,) the facet of each piece, ascending.
        nodes: (n, corners) global numbers of the displacement's nodes at the corners.
        points: (n, corners, 3) corners in the order round the piece [length].
        centres: (n, 3) means of the corners [length].
        radii: (n,) largest distance of a corner from the centre [length].
        normals: (n, 3) outward unit normals of the (mean) planes.
        areas: (n,) areas of the pieces, projected onto these planes [length^2, in 2D length].
    """

    def __init__(self, facets: Facets) -> None:
        """Cut facets into pieces."""
        corners = facets.corners_round[None]
        if facets.bent:  # the nodes of each piece, in the order round it
            halves = [[0, 2], [2, 1]]
            triangles = [[0, 5, 4], [1, 3, 5], [2, 4, 3], [5, 3, 4]]
            squares = [[0, 4, 8, 5], [1, 6, 8, 4], [3, 7, 8, 6], [2, 5, 8, 7]]
            cells = {"interval": halves, "triangle": triangles, "quadrilateral": squares}
            corners = np.array(cells[facets.cell])
        self.facet = np.repeat(np.arange(len(facets.points)), len(corners))
        self.nodes: GlobalNumbers = facets.nodes[:, corners].reshape(-1, corners.shape[1])
        self.points: Array = facets.points[:, corners].reshape(-1, corners.shape[1], 3)
        self.centres: Array = self.points.mean(axis=1)
        arms = self.points - self.centres[:, None]
        self.radii: Array = np.linalg.norm(arms, axis=2).max(axis=1)
        # in 3D the area vector is half the cross product of the diagonals, or of two sides
        along = self.points[:, facets.dim] - self.points[:, 0]
        e_z = np.array([0.0, 0.0, 1.0])
        across = self.points[:, -1] - self.points[:, 1] if facets.dim == 2 else e_z
        vectors = cross(along, across) / facets.dim
        self.areas: Array = np.linalg.norm(vectors, axis=1)
        self.normals: Array = vectors / (facets.outward[self.facet] * self.areas)[:, None]

    @cached_property
    def frames(self) -> Array:
        """Orthonormal axes (n, dim + 1, 3) of the pieces: tangents, and the normal last."""
        axes = frames_along(self.points[:, 1] - self.points[:, 0], self.normals)
        return axes[:, [0, 2]] if self.points.shape[1] == 2 else axes

    @cached_property
    def _trees(self) -> list[tuple[Indices, Any]]:
        """For radii between two powers of two each: the pieces, and a tree of their centres."""
        _, exponent = np.frexp(self.radii)
        classes = [np.flatnonzero(exponent == power) for power in np.unique(exponent)]
        return [(members, cKDTree(self.centres[members])) for members in classes]

    def on_normals(
        self, centres: Array, normals: Array, radii: Array, limit: Array
    ) -> tuple[Indices, Indices]:
        """Find pieces along normals: those whose enclosing balls are met by moving balls.

        Balls with centres (n, 3) and radii (n,), around other pieces, move along unit normals
        (n, 3) by at most `limit` (n,) both ways [length]; pieces slightly beyond may be met, too.
        Return the moving ball (m,) of each pair, ascending, and the piece (m,) that it meets.

        The search advances along a line as far as the distance to the nearest piece allows: the
        work is proportional to the number of lines times the logarithm of this distance.
        """
        # pairs as single numbers: moving ball times the number of pieces, plus piece
        pairs = [np.zeros(0, dtype=np.int64)]
        for members, tree in self._trees:
            reach = radii + self.radii[members].max()
            # the interval of each line in which it may meet pieces, within the limit
            start, end = line_intervals(np.stack([tree.mins, tree.maxes]), centres, normals, reach)
            start, end = np.maximum(start, -limit - reach), np.minimum(end, limit + reach)
            # A ball of radius sqrt(2) r around a point of the line contains the part from -r to r
            # of the cylinder of radius r around the line. If the centre nearest to the point has
            # the distance d, the cylinder is empty from -sqrt(d^2 - r^2) to sqrt(d^2 - r^2).
            place = start + reach
            lines = np.flatnonzero(start <= end)
            while len(lines):
                x = centres[lines] + place[lines, None] * normals[lines]
                r = reach[lines]
                clear = np.sqrt(np.maximum(tree.query(x)[0] ** 2 - r**2, 0.0))
                near = clear <= r
                lists = tree.query_ball_point(x[near], np.sqrt(2.0) * r[near] * (1.0 + 1e-9))
                line, member = flattened(lists)
                pairs.append(lines[near][line] * len(self.centres) + members[member])
                covered = place[lines] + np.where(near, r, clear)
                place[lines] = covered + r
                lines = lines[covered < end[lines]]
        # the pairs, each once, whose balls meet indeed
        moving, met = np.divmod(np.unique(np.concatenate(pairs)), max(len(self.centres), 1))
        offset = self.centres[met] - centres[moving]
        along = dots(offset, normals[moving])
        aside = np.linalg.norm(offset - along[:, None] * normals[moving], axis=1)
        meet = aside <= (radii[moving] + self.radii[met]) * (1.0 + 1e-9)
        return moving[meet], met[meet]

    def facing(
        self, chosen: Indices, partners: Pieces, limit: Array
    ) -> Iterator[tuple[Indices, Indices]]:
        """Yield pairs of chosen (m,) pieces, ascending, and partners along normals, in blocks.

        The normals of both are opposed. All pairs of a piece are in one block; `limit` (pieces,) is
        the search distance [length].
        """
        for start in range(0, len(chosen), AT_ONCE):
            own = chosen[start : start + AT_ONCE]
            centres, normals = self.centres[own], self.normals[own]
            line, partner = partners.on_normals(centres, normals, self.radii[own], limit[own])
            piece = own[line]
            opposed = dots(self.normals[piece], partners.normals[partner]) < -FACING_COSINE
            yield piece[opposed], partner[opposed]

    def local_coordinates(self, piece: Indices, points: Array) -> Array:
        """Return points (n, k, 3), as (n, k, dim + 1), in the frames at centres of pieces (n,)."""
        relative = points - self.centres[piece][:, None]
        return np.asarray(np.einsum("nki,ndi->nkd", relative, self.frames[piece]))

    def near(self, points: Array, reach: Array) -> tuple[Indices, Indices]:
        """Return pairs: index of a point (n, 3), ascending, and of a piece within reach (n,)."""
        within = reach + self.radii.max(initial=0.0)
        point, piece = flattened(cKDTree(self.centres).query_ball_point(points, within))
        # the distance from the sides of the piece, with the parameter of each side's nearest point
        corners = self.points[piece] - points[point][:, None]
        along = np.roll(corners, -1, axis=1) - corners
        share = np.clip(-dots(corners, along) / dots(along, along), 0.0, 1.0)
        distance = np.linalg.norm(corners + share[:, :, None] * along, axis=2).min(axis=1)
        if corners.shape[1] > 2:  # from the plane, if the point is above the inside of the polygon
            normals = self.normals[piece]
            turns = dots(cross(corners, along), normals[:, None])
            projects_inside = (turns >= 0.0).all(axis=1) | (turns <= 0.0).all(axis=1)
            height = np.abs(dots(corners.mean(axis=1), normals))
            distance = np.where(projects_inside, height, distance)
        is_near = distance < reach[point]
        return point[is_near], piece[is_near]


#: Distance from a piece, relative to the radius of the largest piece, within which all facets of
#: two rings around it begin. With half of it, curved facets there would have other normals.
TWO_RINGS = 4.0


def owns(V: Any, nodes: GlobalNumbers) -> Mask:
    """Return the mask (...) of nodes, global numbers (...), that this rank owns. Not collective."""
    low, high = V.dofmap.index_map.local_range
    return np.asarray((nodes >= low) & (nodes < high))


def owners_flags(V: Any, nodes: GlobalNumbers, flags: Mask) -> Mask:
    """Return for each node the flag (n,) of its owner, which has all facets at it. Collective."""
    return np.isin(nodes, gather_rows(V.mesh.comm, nodes[flags & owns(V, nodes)]))


def facets_at_own_nodes(V: Any, owned: Facets) -> Facets:
    """Return all facets with a corner that this rank owns, given the facets it owns. Collective."""
    # each facet is sent to the owners of its corners; ranks own nodes in ascending order
    ends = V.mesh.comm.allgather(V.dofmap.index_map.local_range[1])
    owners = np.searchsorted(ends, owned.nodes[:, : owned.corners], side="right")
    facet = np.repeat(np.arange(len(owners)), owned.corners)
    result = _sent(V.mesh.comm, owned, facet, owners.ravel())
    has_own_corner = owns(V, result.nodes[:, : result.corners]).any(axis=1)
    return result.selected(np.flatnonzero(has_own_corner))


def near_lines(
    comm: MPI.Comm,
    owned: Facets,
    points: Array,
    directions: Array,
    reach: Array,
    length: Array | float,
) -> Facets:
    """Return the facets that this rank owns, and all that are close to its lines. Collective.

    Lines go through points (n, 3) along unit directions (n, 3) by `length`, a number or (n,), both
    ways [length]; with length 0 they are points. Facets of any rank within `reach` (n,) are close.
    """
    if comm.size == 1:
        return owned
    pieces = Pieces(owned)
    low = pieces.centres.min(axis=0, initial=np.inf)
    high = pieces.centres.max(axis=0, initial=-np.inf)
    box = comm.allgather((np.stack([low, high]), pieces.radii.max(initial=0.0)))
    length = np.broadcast_to(length, len(points))
    # for each other rank, the lines that meet the box of its facets are sent to it
    chosen = []
    for rank, (corners, radius) in enumerate(box):
        enter, leave = line_intervals(corners, points, directions, reach + radius)
        far = length + reach + radius
        near = np.maximum(enter, -far) <= np.minimum(leave, far)
        chosen.append(np.flatnonzero(near & (rank != comm.rank)))
    ranks = np.repeat(np.arange(comm.size), [len(indices) for indices in chosen])
    lines = np.column_stack([points, directions, reach, length])[np.concatenate(chosen)]
    lines, source = exchange(comm, lines, ranks)
    # facets of this rank that received lines meet, and the ranks that sent them
    pairs: list[Indices] = [np.zeros((0, 2), dtype=np.intp)]
    for start in range(0, len(lines), AT_ONCE):
        block = lines[start : start + AT_ONCE]
        line, piece = pieces.on_normals(block[:, :3], block[:, 3:6], block[:, 6], block[:, 7])
        met = np.column_stack([pieces.facet[piece], source[start + line]])
        pairs.append(np.unique(met, axis=0))
    facet, sender = np.concatenate(pairs).T
    return _sent(comm, owned, facet, sender)


def _sent(comm: MPI.Comm, owned: Facets, facet: Indices, rank: Indices) -> Facets:
    """Send owned facets (n,) to ranks (n,); return the owned and the received ones. Collective."""
    arrays = {name: getattr(owned, name) for name in FACET_ARRAYS}
    count = len(owned.points)
    kinds = [(name, array.dtype, array.shape[1:]) for name, array in arrays.items()]
    records = np.empty(count, dtype=kinds)  # one for each facet: each rank gets a single message
    for name, array in arrays.items():
        records[name] = array
    # pairs of facet and rank as single numbers, each once, with the pairs of the own rank
    kept = np.arange(count) * comm.size + comm.rank
    facet, rank = np.divmod(np.union1d(kept, facet * comm.size + rank), comm.size)
    rows, _ = exchange(comm, records[facet], rank)
    received: dict[str, Any] = {name: rows[name].copy() for name in FACET_ARRAYS}
    return replace(owned, **received)


def with_neighbours(V: Any, owned: Facets) -> Facets:
    """Return all facets at nodes that this rank owns, and two rings around them. Collective.

    A ring is all facets at the corners of the facets inside it: `SmoothSurface` depends on two.
    """
    comm, mine = V.mesh.comm, Pieces(facets_at_own_nodes(V, owned))
    largest = comm.allreduce(Pieces(owned).radii.max(initial=0.0), op=MPI.MAX)
    reach = mine.radii + TWO_RINGS * largest
    return near_lines(comm, owned, mine.centres, mine.normals, reach, 0.0)


def halos(V: Any, secondary: Facets, primary: Facets, limit: float) -> tuple[Facets, Facets]:
    """Return all facets that the pairing of the facets at this rank's nodes depends on. Collective.

    Given are the facets of both sides that this rank owns, and the search distance `limit`. The
    result has the facets of both sides along the normals of the secondary facets at this rank's
    nodes; the primary facets near those that penetrate; and two rings around all.
    """
    comm = V.mesh.comm
    if comm.size == 1:
        return secondary, primary
    mine = Pieces(facets_at_own_nodes(V, secondary))
    largest = max(Pieces(side).radii.max(initial=0.0) for side in (secondary, primary))
    rings = TWO_RINGS * comm.allreduce(largest, op=MPI.MAX)
    # a facet whose centre is beyond the limit may have a part within it, or hide such a part
    far, reach = limit + mine.radii + rings, mine.radii + rings
    halo = near_lines(comm, secondary, mine.centres, mine.normals, reach, far)
    primary_halo = near_lines(comm, primary, mine.centres, mine.normals, reach, far)
    partners = Pieces(primary_halo)
    # if a facet may penetrate deeply, the primary facets around it decide whether it does
    depth: Array = np.zeros(len(far))
    for own, partner in mine.facing(np.arange(len(far)), partners, far):
        offsets = mine.centres[own] - partners.centres[partner]
        np.maximum.at(depth, own, dots(offsets, mine.normals[own]) + partners.radii[partner])
    near = 2.0 * mine.radii + CREDIBLE_PART * np.minimum(depth + mine.radii, far)
    deep = near > reach
    if comm.allreduce(deep.any(), MPI.LOR):
        # the lines as before, and points (lines of length 0) with a greater reach
        centres = np.concatenate([mine.centres, mine.centres[deep]])
        normals = np.concatenate([mine.normals, mine.normals[deep]])
        reach = np.concatenate([reach, near[deep]])
        length = np.concatenate([far, np.zeros(deep.sum())])
        primary_halo = near_lines(comm, primary, centres, normals, reach, length)
    return halo, primary_halo
