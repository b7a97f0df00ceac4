"""Integrals over the overlap of two surfaces, facet by facet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.pairing.dual_basis import FacetIntegrals
from dolfinx_tresca.pairing.overlap import OverlapIntegrals
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import SurfaceNodes
from dolfinx_tresca.surface.pieces import Pieces
from dolfinx_tresca.surface.search import Balls, blocks
from dolfinx_tresca.surface.visibility import FACING_COSINE

#: Part of a facet's area that may be missing where it counts as covered as a whole: rounding.
COVER_ROUNDING = 1e-8

#: Pairs of facets that are treated at once, to bound the memory.
PAIRS_AT_ONCE = 8_000


@dataclass(frozen=True)
class MortarIntegrals:
    """Integrals over the parts of secondary facets that face the primary side, dA included.

    Attributes:
        own: of products of secondary functions, for all secondary facets.
        sagitta: (n, corners) of the hat functions times the heights of both curved surfaces over
            their facets, which the gap is less by.
        raised: (n, corners) the part of that which the secondary surface has.
        distance: (n, corners) of these times the distance of the surfaces, where one is known.
        full: (n,) whether a facet is covered as a whole.
        secondary: (p,) facets that overlap with
        primary: (p,) facets of the other side.
        other: (p, corners, k) of secondary hat functions times primary basis functions there.
        share: (p,) the overlap over the secondary facet's whole area.
    """

    own: FacetIntegrals
    sagitta: Array
    raised: Array
    distance: Array
    full: Mask
    secondary: Indices
    primary: Indices
    other: Array
    share: Array

    @classmethod
    def of(
        cls,
        secondary: Facets,
        nodes: SurfaceNodes,
        primary: Facets,
        primary_nodes: SurfaceNodes,
        selected: Indices,
        limit: float,
    ) -> MortarIntegrals:
        """Integrate over the overlaps of facets.

        Each overlap of a secondary with a primary facet, both seen along the normal of the
        secondary one, is cut into triangles and integrated (Puso and Laursen 2004, Popp et al.
        2010). What a body hides takes no part; of several layers the nearest one counts.

        Not collective.

        Args:
            secondary: facets of that side.
            nodes: their nodes.
            primary: facets of that side.
            primary_nodes: their nodes.
            selected: secondary facets to treat; the others get zero.
            limit: distance [length] beyond which nothing is in contact.
        """
        n, corners, k = len(secondary.points), secondary.corners, secondary.nodes.shape[1]
        pieces, others = Pieces.of(secondary), Pieces.of(primary)
        covered = np.zeros(len(pieces.facet))
        hats, values = np.zeros((n, corners, corners)), np.zeros((n, corners, k))
        sagitta, raised, distance = (np.zeros((n, corners)) for _ in range(3))
        nothing: Indices = np.zeros(0, dtype=np.intp)
        none: Array = np.zeros((0, corners, primary.nodes.shape[1]))
        parts = [(nothing, nothing, none, none[:, 0, 0])]
        integrate = OverlapIntegrals(
            secondary, nodes, primary, primary_nodes, pieces, others, limit
        )
        whole = np.bincount(pieces.facet, integrate.piece_area, minlength=n)
        for first, second in _chunks(pieces, others, selected, limit):
            overlap = integrate(first, second)
            np.add.at(hats, overlap.secondary, overlap.hats)
            np.add.at(values, overlap.secondary, overlap.values)
            np.add.at(sagitta, overlap.secondary, overlap.sagitta)
            np.add.at(raised, overlap.secondary, overlap.raised)
            np.add.at(distance, overlap.secondary, overlap.distance)
            np.add.at(covered, overlap.piece, overlap.area)
            some = overlap.area > 0.0
            facet = overlap.secondary[some]
            share = overlap.area[some] / whole[facet]
            parts.append((facet, overlap.primary[some], overlap.other[some], share))
        missing = covered < (1.0 - COVER_ROUNDING) * integrate.piece_area
        return cls(
            FacetIntegrals(hats, values),
            sagitta,
            raised,
            distance,
            np.bincount(pieces.facet, missing, minlength=n) == 0.0,
            *(np.concatenate(part) for part in zip(*parts, strict=True)),
        )


def _chunks(
    pieces: Pieces, others: Pieces, selected: Indices, limit: float
) -> Iterator[tuple[Indices, Indices]]:
    """Yield pairs of pieces that may face each other; all pairs of one piece come together."""
    mine = np.flatnonzero(np.isin(pieces.facet, selected))
    balls = Balls(others.centres, others.radii)
    for block in blocks(len(mine)):
        some = mine[block]
        first, second = balls.on_normals(
            pieces.centres[some], pieces.normals[some], pieces.radii[some], limit
        )
        first = some[first]
        cosine = np.einsum("ni,ni->n", pieces.normals[first], others.normals[second])
        opposed = cosine < -FACING_COSINE
        yield from _split(first[opposed], second[opposed])


def _split(first: Indices, second: Indices) -> Iterator[tuple[Indices, Indices]]:
    """Yield parts of pairs, sorted by the first, none of which is cut between two of them."""
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
