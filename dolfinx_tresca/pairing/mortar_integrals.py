"""Mortar integrals over the overlap of two surfaces, facet by facet."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.pairing.dual_basis import FacetIntegrals
from dolfinx_tresca.pairing.overlap import Overlap, OverlapIntegrals
from dolfinx_tresca.pairing.search.facets import Facets
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.pairing.search.pieces import Pieces
from dolfinx_tresca.pairing.search.search import Balls, blocks
from dolfinx_tresca.pairing.search.self_contact import SelfContact
from dolfinx_tresca.pairing.search.visibility import FACING_COSINE

#: (p,) secondary facets, (p,) primary facets -> (p,) whether both may be paired.
MayMeet: TypeAlias = Callable[[Indices, Indices], Mask]

#: A facet counts as fully covered if at most this part of its area is uncovered, by rounding.
COVER_ROUNDING = 1e-8

#: Distance, relative to the radius of a facet, within which opposite facets are sought first on a
#: surface that touches itself. Without this first search a wall of 2,046 bricks is paired in 71 s.
#: With half or twice this distance 150 bricks have the same number of contact nodes, but pairing
#: takes 1.1 or 1.4 times as long.
NEAR = 2.0

#: Number of pairs of facets that are integrated at once, which bounds the memory.
PAIRS_AT_ONCE = 8_000


@dataclass(frozen=True)
class MortarIntegrals:
    """Integrals over the covered parts of secondary facets, which face the primary side.

    Attributes:
        own: integrals of products of two secondary functions, for all secondary facets.
        sagitta: (n, corners) integrals of hat functions times the heights of both curved surfaces
            over their facets; zero over facets that coincide, or if an exact surface is known.
        secondary_sagitta: (n, corners) the part of `sagitta` that comes from the secondary side.
        distance: (n, corners) integrals of hat functions times the distance of the surfaces along
            the contact normal.
        normals: (n, corners, 3) integrals of hat functions times the contact normal.
        least: (n,) least distance of the surfaces over each facet; infinite where none is paired.
        full: (n,) whether the whole facet is covered.
        secondary: (p,) secondary facet of each overlapping pair.
        primary: (p,) primary facet of each overlapping pair.
        other: (p, corners, k) integrals of secondary hat functions times primary basis functions
            over the overlap of each pair.
        share: (p,) area of the overlap relative to the area of the secondary facet.
        opposite: (q, 2) pairs of facets that see each other, but whose roles are exchanged: the
            first facet, which was searched from, is primary, and the second one is secondary. Empty
            unless the surface touches itself.
    """

    own: FacetIntegrals
    sagitta: Array
    secondary_sagitta: Array
    distance: Array
    normals: Array
    least: Array
    full: Mask
    secondary: Indices
    primary: Indices
    other: Array
    share: Array
    opposite: Indices

    @classmethod
    def of(
        cls,
        secondary: Facets,
        nodes: SurfaceNodes,
        primary: Facets,
        primary_nodes: SurfaceNodes,
        selected: Indices,
        limit: float,
        order: SelfContact | None = None,
        may_meet: MayMeet | None = None,
    ) -> MortarIntegrals:
        """Integrate over the overlaps of facets. Not collective.

        Primary facets are projected along the normal of a secondary facet; each overlap is cut into
        triangles and integrated (Puso and Laursen 2004, Popp et al. 2010). Points hidden by a body
        are excluded, and among several layers the nearest one is integrated.

        Args:
            secondary: facets of the secondary side.
            nodes: nodes of the secondary facets.
            primary: facets of the primary side.
            primary_nodes: nodes of the primary facets.
            selected: (m,) indices of the secondary facets to integrate over; the integrals of all
                other facets are zero.
            limit: search distance, beyond which no points are paired [length].
            order: rule that decides which of two facets is secondary on a surface that touches
                itself (`primary` and `secondary` are then the same facets); None for two surfaces.
            may_meet: function that tells whether pairs of a secondary and a primary facet may be
                paired; None: all may, or `order` decides.
        """
        n, corners, k = len(secondary.points), secondary.corners, secondary.nodes.shape[1]
        pieces, others = Pieces.of(secondary), Pieces.of(primary)
        covered = np.zeros(len(pieces.facet))
        hats, values = np.zeros((n, corners, corners)), np.zeros((n, corners, k))
        sagitta, secondary_sagitta, distance = (np.zeros((n, corners)) for _ in range(3))
        normals, least = np.zeros((n, corners, 3)), np.full(n, np.inf)
        nothing: Indices = np.zeros(0, dtype=np.intp)
        none: Array = np.zeros((0, corners, primary.nodes.shape[1]))
        parts = [(nothing, nothing, none, none[:, 0, 0])]
        opposite: list[Indices] = [np.zeros((0, 2), dtype=np.intp)]
        integrate = OverlapIntegrals(
            secondary, nodes, primary, primary_nodes, pieces, others, order
        )
        whole = np.bincount(pieces.facet, integrate.piece_area, minlength=n)
        if order is not None:
            may_meet = order.may_meet
        near = order is not None
        for overlap in _overlaps(integrate, pieces, others, selected, limit, near, may_meet):
            facet, first = np.unique(overlap.secondary, return_index=True)  # they are ascending
            for total, part in (
                (hats, overlap.hats),
                (values, overlap.values),
                (sagitta, overlap.sagitta),
                (secondary_sagitta, overlap.secondary_sagitta),
                (distance, overlap.distance),
                (normals, overlap.normals),
            ):
                total[facet] += np.add.reduceat(part, first, axis=0)
            np.minimum.at(least, overlap.secondary, overlap.least)
            np.add.at(covered, overlap.piece, overlap.area)
            some = overlap.area > 0.0
            facet = overlap.secondary[some]
            share = overlap.area[some] / whole[facet]
            parts.append((facet, overlap.primary[some], overlap.other[some], share))
            both: Indices = np.column_stack([overlap.secondary, overlap.primary])
            opposite.append(both[overlap.opposite])
        missing = covered < (1.0 - COVER_ROUNDING) * integrate.piece_area
        return cls(
            FacetIntegrals(hats, values),
            sagitta,
            secondary_sagitta,
            distance,
            normals,
            least,
            np.bincount(pieces.facet, missing, minlength=n) == 0.0,
            np.concatenate([part[0] for part in parts]),
            np.concatenate([part[1] for part in parts]),
            np.concatenate([part[2] for part in parts]),
            np.concatenate([part[3] for part in parts]),
            np.concatenate(opposite),
        )


def _overlaps(
    integrate: OverlapIntegrals,
    pieces: Pieces,
    others: Pieces,
    selected: Indices,
    limit: float,
    near_first: bool,
    may_meet: MayMeet | None,
) -> Iterator[Overlap]:
    """Yield integrals over the overlaps of pieces of facets that may face each other, in blocks.

    In an assembly the normal of a facet meets facets of many bodies, one behind the other. So
    pieces of a surface that touches itself are first paired with pieces nearby. Only pieces that
    nearby pieces do not fully cover are paired with all pieces within the search distance.

    `pieces` and `others` are the pieces of secondary and primary facets; `selected`, `limit` and
    `may_meet` are arguments of `MortarIntegrals.of`; `near_first` says whether the surface touches
    itself.
    """
    balls = Balls(others.centres, others.radii)
    some = np.flatnonzero(np.isin(pieces.facet, selected))
    if near_first:
        near = np.minimum(NEAR * pieces.radii, limit)
        done = np.zeros(len(near), dtype=np.bool_)
        for first, second in _facing_pairs(balls, pieces, others, some, near, may_meet):
            overlap = integrate(first, second, near[first])
            seen = np.bincount(overlap.piece, overlap.seen, minlength=len(near))
            covered = seen >= (1.0 - COVER_ROUNDING) * integrate.piece_area
            done |= covered
            yield overlap.part(covered[overlap.piece])
        some = some[~done[some]]
    reach = np.full(len(pieces.radii), limit)
    for first, second in _facing_pairs(balls, pieces, others, some, reach, may_meet):
        yield integrate(first, second, reach[first])


def _facing_pairs(
    balls: Balls,
    pieces: Pieces,
    others: Pieces,
    mine: Indices,
    limit: Array,
    may_meet: MayMeet | None,
) -> Iterator[tuple[Indices, Indices]]:
    """Yield blocks of pairs of pieces that may face each other.

    The normals of such a pair are opposed, and the primary piece lies along the normal of the
    secondary piece. All pairs of a secondary piece are in the same block.

    Args:
        balls: balls that enclose the primary pieces, for the search.
        pieces: secondary pieces.
        others: primary pieces.
        mine: (m,) indices of the secondary pieces to pair.
        limit: (pieces,) search distance of each secondary piece [length].
        may_meet: see `MortarIntegrals.of`.
    """
    for block in blocks(len(mine)):
        some = mine[block]
        first, second = balls.on_normals(
            pieces.centres[some], pieces.normals[some], pieces.radii[some], limit[some]
        )
        first = some[first]
        cosine = np.einsum("ni,ni->n", pieces.normals[first], others.normals[second])
        opposed = cosine < -FACING_COSINE
        if may_meet is not None:
            opposed[opposed] = may_meet(pieces.facet[first[opposed]], others.facet[second[opposed]])
        yield from _blocks_of_pairs(first[opposed], second[opposed])


def _blocks_of_pairs(first: Indices, second: Indices) -> Iterator[tuple[Indices, Indices]]:
    """Yield blocks of pairs, sorted by `first`; equal entries of `first` stay in one block."""
    if len(first) == 0:
        return
    starts = np.unique(first, return_index=True)[1]
    ends = np.append(starts[1:], len(first))
    begin = 0
    for start, end in zip(starts, ends, strict=True):
        if end - begin > PAIRS_AT_ONCE and start > begin:
            yield first[begin:start], second[begin:start]
            begin = start
    yield first[begin:], second[begin:]
