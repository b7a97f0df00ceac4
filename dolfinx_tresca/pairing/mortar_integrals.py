"""Mortar integrals over the overlap of two surfaces, facet by facet."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.pairing.contact_normal import SmoothSurface, contact_normals
from dolfinx_tresca.pairing.search.balls import Balls, blocks
from dolfinx_tresca.pairing.search.clipping import nearest_layer_weights, overlaps
from dolfinx_tresca.pairing.search.facets import (
    Pieces,
    facets_coincide,
    project,
    quadrature,
    rounding_of,
)
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.pairing.search.self_contact import SelfContact
from dolfinx_tresca.pairing.search.tagged import OFFSET_DEGREE, any_known_surface
from dolfinx_tresca.pairing.search.visibility import FACING_COSINE, Visibility

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


@dataclass
class FacetIntegrals:
    """Integrals over the parts of secondary facets that face the primary side.

    Attributes:
        hats: (n, corners, corners) integrals of products of two secondary hat functions, for all
            secondary facets [length^2, in 2D length].
        values: (n, corners, k) integrals of secondary hat times secondary basis functions.
        means: (n, corners, 6) integrals of secondary hat functions times six quantities: the
            distance of the surfaces along the contact normal; the height of the secondary surface
            over its facets, and the sum of the heights of both (zero over facets that coincide, or
            if an exact surface is known); and the three components of the contact normal.
        least: (n,) least distance of the surfaces over each facet; infinite where none is paired.
        full: (n,) whether the whole facet is covered.
        pairs: (p, 2) secondary and primary facet of each overlap; none for an obstacle.
        partner: (p, corners, k) integrals of secondary hat functions times primary basis functions
            over each overlap.
    """

    hats: Array
    values: Array
    means: Array
    least: Array
    full: Mask
    pairs: Indices
    partner: Array


class MortarIntegrals(FacetIntegrals):
    """Integrals over the covered parts of secondary facets, which face the primary side.

    Primary facets are projected along the normal of a secondary facet; each overlap is cut into
    triangles and integrated (Puso and Laursen 2004, Popp et al. 2010). Points hidden by a body are
    excluded, and among several layers the nearest one is integrated.

    Attributes:
        opposite: (q, 2) pairs of facets that see each other, but whose roles are exchanged: the
            first facet, which was searched from, is primary, and the second one is secondary. Empty
            unless the surface touches itself.
    """

    def __init__(
        self,
        secondary: SurfaceNodes,
        primary: SurfaceNodes,
        selected: Indices,
        limit: float,
        order: SelfContact | None = None,
        may_meet: MayMeet | None = None,
    ) -> None:
        """Integrate over the overlaps of facets. Not collective.

        In an assembly the normal of a facet meets facets of many bodies, one behind the other. So
        facets of a surface that touches itself are first paired with facets nearby. Only those that
        nearby facets do not fully cover are paired with all facets within the search distance.

        Args:
            secondary: the secondary side.
            primary: the primary side.
            selected: (m,) indices of the secondary facets to integrate over; the integrals of all
                other facets are zero.
            limit: search distance, beyond which no points are paired [length].
            order: rule that decides which of two facets is secondary on a surface that touches
                itself (`primary` and `secondary` are then the same side); None for two surfaces.
            may_meet: function that tells whether pairs of a secondary and a primary facet may be
                paired; None: all may, or `order` decides.
        """
        facets, others = self._facets, self._other_facets = secondary.facets, primary.facets
        self._order = order
        self._may_meet = may_meet if order is None else order.may_meet
        self._pieces, self._others = Pieces.of(facets), Pieces.of(others)
        self._surface, self._other_surface = SmoothSurface(secondary), SmoothSurface(primary)
        self._turns = self._surface.turns_to_ends
        self._other_turns = self._other_surface.turns_to_ends
        self._known = any_known_surface(facets, others)
        body = None if order is None else order.body[self._pieces.facet]
        self._visibility = Visibility(self._pieces, self._others, body)
        degree = 1 + facets.degree
        self._polynomial = facets.affine and others.affine and not self._known
        if not (facets.affine and others.affine):
            degree = 2 * degree + 4  # rational integrands: error below the error of the mesh
        elif self._known:
            degree = max(degree, 1 + OFFSET_DEGREE)  # the hats are linear
        elif self._surface.turning or self._other_surface.turning:
            degree = max(degree, 3)  # the sagitta is quadratic, the hats and normals are linear
        degree += facets.axisymmetric  # the radius is linear
        x, w = quadrature("interval" if facets.dim == 1 else "triangle", degree)
        self._barycentric, self._weights = np.column_stack([1.0 - x.sum(axis=1), x]), w / w.sum()
        self._to_corners = np.linalg.pinv(self._barycentric).T
        whole = self._pieces.points - self._pieces.centres[:, None]
        flat = np.einsum("nci,ndi->ncd", whole, self._pieces.frames[:, :-1])
        _, size, piece = overlaps(flat, flat)
        self._rounding = rounding_of(self._pieces.points)
        self._area = np.bincount(piece, size, minlength=len(whole)).astype(np.float64)

        n, corners = secondary.facet_nodes.shape
        self.hats, self.means = np.zeros((n, corners, corners)), np.zeros((n, corners, 6))
        self.values = np.zeros((n, corners, facets.nodes.shape[1]))
        self.least = np.full(n, np.inf)
        self._covered = np.zeros(len(whole))
        self._overlaps: list[tuple[Indices, Array, Indices]] = []
        mine = np.flatnonzero(np.isin(self._pieces.facet, selected))
        balls = Balls(self._others.centres, self._others.radii)
        reach: Array = np.full(len(whole), limit)
        if order is not None:
            near = np.minimum(NEAR * self._pieces.radii, reach)
            done = np.zeros(len(whole), dtype=np.bool_)
            for block in self._facing_pairs(balls, mine, near):
                done |= self._integrate(*block, near, covered_only=True)
            mine = mine[~done[mine]]
        for block in self._facing_pairs(balls, mine, reach):
            self._integrate(*block, reach)
        missing = self._covered < (1.0 - COVER_ROUNDING) * self._area
        self.full = np.bincount(self._pieces.facet, missing, minlength=n) == 0.0
        none: Indices = np.zeros((0, 2), dtype=np.intp)
        self._overlaps.append((none, np.zeros((0, corners, others.nodes.shape[1])), none))
        self.pairs, self.partner, self.opposite = map(
            np.concatenate, zip(*self._overlaps, strict=True)
        )
        # the integrals outlive what they were computed with
        del self._overlaps, self._pieces, self._others, self._visibility
        del self._surface, self._other_surface

    def _facing_pairs(
        self, balls: Balls, mine: Indices, limit: Array
    ) -> Iterator[tuple[Indices, Indices]]:
        """Yield blocks of pairs of pieces that may face each other.

        The normals of such a pair are opposed, and the primary piece lies along the normal of the
        secondary piece. All pairs of a secondary piece are in the same block.

        Args:
            balls: balls that enclose the primary pieces, for the search.
            mine: (m,) indices of the secondary pieces to pair, ascending.
            limit: (pieces,) search distance of each secondary piece [length].
        """
        pieces, others = self._pieces, self._others
        for block in blocks(len(mine)):
            own = mine[block]
            line, other = balls.on_normals(
                pieces.centres[own], pieces.normals[own], pieces.radii[own], limit[own]
            )
            piece = own[line]
            cosine = np.einsum("ni,ni->n", pieces.normals[piece], others.normals[other])
            opposed = cosine < -FACING_COSINE
            if self._may_meet is not None:
                facets = pieces.facet[piece[opposed]], others.facet[other[opposed]]
                opposed[opposed] = self._may_meet(*facets)
            piece, other = piece[opposed], other[opposed]
            # a block ends at the first pair of a piece after each `PAIRS_AT_ONCE` pairs
            number = np.searchsorted(piece, piece) // PAIRS_AT_ONCE
            ends = np.flatnonzero(np.diff(number)) + 1
            if len(piece):
                yield from zip(np.split(piece, ends), np.split(other, ends), strict=True)

    def _integrate(
        self, first: Indices, second: Indices, limit: Array, *, covered_only: bool = False
    ) -> Mask:
        """Add the integrals over pairs of secondary and primary pieces.

        Args:
            first: (pairs,) secondary pieces, ascending; all pairs of each of them.
            second: (pairs,) primary pieces.
            limit: (pieces,) distance beyond which points are not paired [length].
            covered_only: whether to leave out secondary pieces that are not fully covered.

        Returns:
            (pieces,) whether these pairs cover a secondary piece fully, whatever the roles are.
        """
        secondary, primary, dim = self._facets, self._other_facets, self._facets.dim
        pieces = self._pieces
        simplices, size, pair = overlaps(
            pieces.local_coordinates(first, pieces.points[first])[:, :, :dim],
            pieces.local_coordinates(first, self._others.points[second])[:, :, :dim],
            centred=not self._polynomial,
        )
        large = size > (self._rounding * self._area)[first][pair]
        simplices, size, pair = simplices[large], size[large], pair[large]
        # quadrature points in the planes, (simplices * count, dim), and their weights
        count = len(self._weights)
        places = np.einsum("qc,mcd->mqd", self._barycentric, simplices).reshape(-1, dim)
        weight = (size[:, None] * self._weights).ravel()
        facet, other = pieces.facet[first], self._others.facet[second]
        point_pair = np.repeat(pair, count)
        own_facet, their_facet, piece = facet[point_pair], other[point_pair], first[point_pair]

        own = pieces.local_coordinates(first, secondary.points[facet])[point_pair]
        theirs = pieces.local_coordinates(first, primary.points[other])[point_pair]
        x_own = project(secondary, own[:, :, :dim], places)
        x_their = project(primary, theirs[:, :, :dim], places)
        hats = secondary.hats(x_own)
        values, others = secondary.basis(x_own), primary.basis(x_their)
        end = np.einsum("nk,nk->n", others, theirs[:, :, dim])
        start = np.einsum("nk,nk->n", values, own[:, :, dim])
        apart = end - start
        hidden = self._visibility.hidden(
            first[pair],
            simplices.mean(axis=1),
            start.reshape(-1, count) @ self._weights,
            end.reshape(-1, count) @ self._weights,
            second[pair],
        )
        weight = weight * np.repeat(~hidden, count) * (np.abs(apart) <= limit[piece])
        weight = nearest_layer_weights(
            first, pair, simplices, size, places, apart, weight, self._area
        )
        to_surface, outward = self._surface.at(own_facet, x_own)
        to_other_surface, their_outward = self._other_surface.at(their_facet, x_their)
        normals, opposed = contact_normals(
            *(outward, their_outward), *(self._turns[own_facet], self._other_turns[their_facet])
        )
        weight = weight * opposed
        seen = weight
        opposite: Mask = np.zeros(len(first), dtype=np.bool_)
        if self._order is not None:
            is_primary = ~self._order.is_secondary(facet, other)[point_pair]
            opposite[point_pair[is_primary & (weight > 0.0)]] = True
            weight = weight * ~is_primary
        area = weight
        if not secondary.plane:  # areas of curved facets for those in the planes of pieces
            vectors = secondary.area_vectors_at(own_facet, x_own)
            height = np.abs(np.einsum("ni,ni->n", vectors, pieces.normals[piece]))
            area = area * np.linalg.norm(vectors, axis=1) / height
        if secondary.axisymmetric:
            radii = np.einsum("nk,nk->n", values, secondary.points[own_facet, :, 0])
            area = area * secondary.circumferences(radii)

        kept, simplex_starts = np.unique(pair, return_index=True)

        def products(right: Array) -> Array:
            """Integrate hats times functions over overlaps: (pairs, hats, functions)."""
            left = (area[:, None] * hats).reshape(-1, count, hats.shape[1])
            blocks = left.transpose(0, 2, 1) @ right.reshape(-1, count, right.shape[1])
            return np.asarray(np.add.reduceat(blocks, simplex_starts, axis=0))

        sagitta: Array = np.zeros(len(area))
        secondary_sagitta: Array = sagitta
        if not self._known:
            # at the rim of one side the fitted surfaces differ, though the facets coincide
            differ = ~facets_coincide(secondary, facet, primary, other)[point_pair]
            secondary_sagitta = differ * self._surface.heights(own_facet, hats)
            heights = self._other_surface.heights(their_facet, primary.hats(x_their))
            sagitta = secondary_sagitta + differ * heights
            to_other_surface[~differ], to_surface[~differ] = 0.0, 0.0
        # a vector between the surfaces: the distance of the facets minus both heights would lose
        # accuracy for closely fitting bodies, for which heights are much larger than the distance
        between = apart[:, None] * pieces.normals[piece]
        distance = np.einsum("ni,ni->n", between + to_other_surface - to_surface, normals)
        # at the corners of the simplices: of the linear function that fits the distances best
        least = (distance.reshape(-1, count) @ self._to_corners).min(axis=1)
        least[~(weight.reshape(-1, count) > 0.0).any(axis=1)] = np.inf
        piece = first[kept]
        seen = np.add.reduceat(seen, simplex_starts * count)
        covered: Mask = np.bincount(piece, seen, minlength=len(limit)) >= (
            (1.0 - COVER_ROUNDING) * self._area
        )
        add = covered[piece] if covered_only else np.ones(len(piece), dtype=np.bool_)
        means = np.column_stack([distance, secondary_sagitta, sagitta, normals])
        for total, integrand in ((self.hats, hats), (self.values, values), (self.means, means)):
            np.add.at(total, facet[kept][add], products(integrand)[add])
        least = np.minimum.reduceat(least, simplex_starts)
        np.minimum.at(self.least, facet[kept][add], least[add])
        sizes = np.add.reduceat(weight, simplex_starts * count)
        np.add.at(self._covered, piece[add], sizes[add])
        both: Indices = np.column_stack([facet, other])[kept]
        paired = add & (sizes > 0.0)
        self._overlaps.append((both[paired], products(others)[paired], both[add & opposite[kept]]))
        return covered
