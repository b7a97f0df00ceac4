"""Integrals over the parts of secondary facets that face the primary side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

import basix

from dolfinx_tresca._base.arrays import Array, Indices, Mask, dots
from dolfinx_tresca.pairing.contact_normal import SmoothSurface, contact_normals
from dolfinx_tresca.pairing.facets import (
    MISMATCH,
    OFFSET_DEGREE,
    SurfaceNodes,
    project,
    quadrature,
    rounding_of,
    tabulate,
)
from dolfinx_tresca.pairing.pieces import AT_ONCE, Pieces, flattened
from dolfinx_tresca.pairing.visibility import SelfContact, Visibility, overlaps

#: Length of a facet, relative to its radius: the distance by which the primary side may recede over
#: a facet. What is farther behind the nearest point is another surface. (With half of it, rounded
#: bodies with facets of the size of their radius would lose parts of their overlap.) On a surface
#: that touches itself, facets are sought within this distance first, which saves much time.
FACET_LENGTH = 2.0


@dataclass
class FacetIntegrals:
    """Integrals over the parts of secondary facets that face the primary side.

    Attributes:
        hats: (n, corners, corners) integrals of products of two secondary hat functions [area].
        values: (n, corners, k) integrals of secondary hat times secondary basis functions.
        means: (n, corners, 6) integrals of secondary hat functions times six quantities: the
            distance of the surfaces along the contact normal; the height of the secondary surface
            over its facets (zero if an exact surface is known); the sum of the heights of both
            along the contact normal (zero over facets that coincide); and the contact normal.
        least: (n,) least distance over each facet, infinite if unpaired; with obstacles, at nodes.
        full: (n,) whether the whole facet is covered.
        pairs: (p, 2) secondary and primary facet of each overlap; an obstacle counts as facet 0.
        partner: (p, corners, k) integrals of secondary hat times primary basis functions over each
            overlap; for an obstacle, times secondary hat functions.
    """

    hats: Array
    values: Array
    means: Array
    least: Array
    full: Mask
    pairs: Indices
    partner: Array


class _PointsOfSide:
    """Points of one side's facets, over quadrature points in the planes of secondary pieces.

    Attributes:
        facet: (n,) facet of each point.
        x: (n, dim) reference points.
        values: (n, k) basis functions of the displacement.
        height: (n,) height of the facet over the plane, along its normal [length].
        to_surface: (n, 3) vectors from the facet to the smooth surface [length].
        normals: (n, 3) outward unit normals of the smooth surface.
    """

    def __init__(self, surface: SmoothSurface, facet: Indices, nodes: Array, places: Array) -> None:
        """Find points over places (n, dim) on facets with nodes (n, k, dim + 1), in frames."""
        self.facet, self.x = facet, project(surface.facets, nodes[:, :, :-1], places)
        self.values = surface.facets.basis(self.x)
        self.height = dots(self.values, nodes[:, :, -1])
        self.to_surface, self.normals = surface.offsets_and_normals(facet, self.x)


class _CutOverlaps:
    """Overlaps of pairs of pieces, cut into m simplices with q quadrature points each.

    Attributes:
        piece: (pairs,) secondary piece of each pair, ascending; the overlap is in its plane.
        partner_piece: (pairs,) primary piece of each pair of pieces.
        facet: (pairs,) secondary facet of each pair.
        partner: (pairs,) primary facet of each pair.
        simplices: (m, dim + 1, dim) corners of the simplices in the plane [length].
        areas: (m,) areas of the simplices [length^dim].
        pair: (m,) pair of each simplex, ascending.
        pair_of_point: (m q,) pair of each quadrature point.
        places: (m q, dim) quadrature points in the plane [length].
        hats: (m q, corners) secondary hat functions.
        secondary: the points of the secondary facets over the quadrature points.
        primary: the points of the primary facets over them, opposite to these.
    """

    def __init__(self, mortar: MortarIntegrals, piece: Indices, partner_piece: Indices) -> None:
        """Cut the overlaps of pairs of pieces of both sides; drop areas that are rounding."""
        pieces, partners = mortar._pieces, mortar._partners
        surface, partner_surface = mortar._surface, mortar._partner_surface
        self.piece, self.partner_piece = piece, partner_piece
        self.facet, self.partner = pieces.facet[piece], partners.facet[partner_piece]
        simplices, areas, pair = overlaps(
            pieces.local_coordinates(piece, pieces.points[piece])[:, :, :-1],
            pieces.local_coordinates(piece, partners.points[partner_piece])[:, :, :-1],
        )
        large = areas > mortar._rounding[piece][pair]
        self.simplices, self.areas, self.pair = simplices[large], areas[large], pair[large]
        places = np.einsum("qc,mcd->mqd", mortar._barycentric, self.simplices)
        self.places = places.reshape(-1, simplices.shape[2])
        self.pair_of_point = point = np.repeat(self.pair, len(mortar._barycentric))
        # the nodes of both facets of each pair, in the frame of the secondary piece
        own = pieces.local_coordinates(piece, surface.facets.points[self.facet])[point]
        self.secondary = _PointsOfSide(surface, self.facet[point], own, self.places)
        theirs = pieces.local_coordinates(piece, partner_surface.facets.points[self.partner])[point]
        self.primary = _PointsOfSide(partner_surface, self.partner[point], theirs, self.places)
        self.hats = surface.facets.hats(self.secondary.x)


class MortarIntegrals(FacetIntegrals):
    """Integrals over the covered parts of secondary facets, which face the primary side.

    Primary facets are projected along the normal of a secondary facet; each overlap is cut into
    triangles and integrated (Puso and Laursen 2004, Popp et al. 2010). Only points of the nearest
    layer count that no body hides.

    Attributes:
        exchanged: (q, 2) facet pairs of a surface that touches itself, whose roles are exchanged:
            the first facet, which was searched from, is primary, and the second one is secondary.
    """

    def __init__(
        self,
        secondary: SurfaceNodes,
        primary: SurfaceNodes,
        selected: Indices,
        limit: float,
        may_meet: Callable[[Indices, Indices], Mask],
        order: SelfContact | None = None,
    ) -> None:
        """Integrate over the overlaps of the `selected` (m,) secondary facets with primary facets.

        Points farther apart than `limit` [length], and pairs of facets for which `may_meet` is
        false, are not paired. If the surface touches itself, `order` decides which facet of a pair
        is secondary, and a facet that facets nearby fully cover is paired with these alone.
        """
        facets, partners = secondary.facets, primary.facets
        self._may_meet, self._order = may_meet, order
        self._pieces, self._partners = Pieces(facets), Pieces(partners)
        self._surface, self._partner_surface = SmoothSurface(secondary), SmoothSurface(primary)
        body = None if order is None else order.body[self._pieces.facet]
        self._visibility = Visibility(self._pieces, self._partners, body)
        simplex = "interval" if facets.dim == 1 else "triangle"
        x, w = quadrature(simplex, self._exactness())
        # quadrature points (q, dim + 1) and their weights (q,)
        self._barycentric, self._weights = np.column_stack([1.0 - x.sum(axis=1), x]), w / w.sum()
        # the map from values at these points to those of their best quadratic fit on a grid
        grid = basix.create_lattice(basix.CellType[simplex], 4, basix.LatticeType.equispaced, True)
        degree = 2 if len(w) >= 3 * facets.dim else 1  # flat surfaces have linear distances
        fit = tabulate(simplex, degree, 0, x)[0]
        on_grid = tabulate(simplex, degree, 0, grid)[0]
        self._to_grid = np.linalg.pinv(fit).T @ on_grid.T
        self._area, count = self._pieces.areas, len(self._pieces.facet)
        self._rounding = rounding_of(self._pieces.points) * self._area

        n, corners = secondary.facet_nodes.shape
        self.hats, self.means = np.zeros((n, corners, corners)), np.zeros((n, corners, 6))
        self.values = np.zeros((n, corners, facets.nodes.shape[1]))
        self.least = np.full(n, np.inf)
        self._covered = np.zeros(count)
        none: Indices = np.zeros((0, 2), dtype=np.intp)
        empty: Array = np.zeros((0, corners, partners.nodes.shape[1]))
        self._overlaps = [(none, empty, none)]
        mine = np.flatnonzero(np.isin(self._pieces.facet, selected))
        reach: Array = np.full(count, limit)
        if order is not None:
            near = np.minimum(FACET_LENGTH * self._pieces.radii, reach)
            done = np.zeros(count, dtype=np.bool_)
            for block in self._facing_pairs(mine, near):
                done |= self._integrate(*block, near, covered_only=True)
            mine = mine[~done[mine]]
        for block in self._facing_pairs(mine, reach):
            self._integrate(*block, reach)
        missing = self._covered < (1.0 - MISMATCH) * self._area
        self.full = np.bincount(self._pieces.facet, missing, minlength=n) == 0.0
        pairs, partner, exchanged = zip(*self._overlaps, strict=True)
        self.pairs, self.partner = np.concatenate(pairs), np.concatenate(partner)
        self.exchanged = np.concatenate(exchanged)
        # the integrals are kept, but not what they were computed with, a third of the memory
        del self._overlaps, self._pieces, self._partners, self._visibility
        del self._surface, self._partner_surface

    def _exactness(self) -> int:
        """Return the degree of polynomials that the quadrature over overlaps integrates exactly."""
        facets, partners = self._surface.facets, self._partner_surface.facets
        degree = 1 + facets.degree
        if not (facets.affine and partners.affine):
            degree = 2 * degree + 4  # rational integrands: error below the error of the mesh
        elif facets.has_exact_surface:
            degree = max(degree, 1 + OFFSET_DEGREE)  # the hats are linear
        elif not (self._surface.is_flat and self._partner_surface.is_flat):
            degree = max(degree, 4)  # sagittas are quadratic, hats and normals linear
        return degree + facets.axisymmetric  # the radius is linear

    def _facing_pairs(self, mine: Indices, limit: Array) -> Iterator[tuple[Indices, Indices]]:
        """Yield blocks of pairs of pieces that face each other and may meet.

        A block has the secondary pieces, ascending, and the primary pieces; all pairs of a piece of
        `mine` (m,) are in one block. `limit` (pieces,) is the search distance [length].
        """
        for piece, partner in self._pieces.facing(mine, self._partners, limit):
            meets = self._may_meet(self._pieces.facet[piece], self._partners.facet[partner])
            piece, partner = piece[meets], partner[meets]
            # a block ends at the first pair of a piece after each 4 `AT_ONCE` pairs
            number = np.searchsorted(piece, piece) // (4 * AT_ONCE)
            ends = np.flatnonzero(np.diff(number)) + 1
            if len(piece):
                yield from zip(np.split(piece, ends), np.split(partner, ends), strict=True)

    def _integrate(
        self, secondary: Indices, primary: Indices, limit: Array, *, covered_only: bool = False
    ) -> Mask:
        """Add the integrals over the overlaps of pairs of secondary and primary pieces (pairs,).

        All pairs of a secondary piece are given, ascending, and `limit` (pieces,) is its search
        distance [length]. With `covered_only`, nothing is added on pieces that these pairs do not
        cover fully. Return which pieces (pieces,) they cover fully, exchanged pairs included.
        """
        cut = _CutOverlaps(self, secondary, primary)
        seen = self._seen_weights(cut, limit)
        # where the roles are exchanged, points cover the piece, but are not integrated over
        weight, is_exchanged = seen, np.zeros(len(primary), dtype=np.bool_)
        if self._order is not None:
            is_primary = ~self._order.is_secondary(cut.facet, cut.partner)[cut.pair_of_point]
            is_exchanged[cut.pair_of_point[is_primary & (seen > 0.0)]] = True
            weight = seen * ~is_primary
        means, q = self._quantities(cut), len(self._weights)
        # least distance over each simplex that has weight
        least = (means[:, 0].reshape(-1, q) @ self._to_grid).min(axis=1)
        least[~(weight.reshape(-1, q) > 0.0).any(axis=1)] = np.inf

        # sums over each of the pairs that overlap: its simplices follow each other from a start on
        pairs, starts = np.unique(cut.pair, return_index=True)
        piece, area = secondary[pairs], np.add.reduceat(weight, starts * q)
        seen_area = np.bincount(piece, np.add.reduceat(seen, starts * q), minlength=len(limit))
        covered: Mask = seen_area >= (1.0 - MISMATCH) * self._area
        added = covered[piece] if covered_only else np.ones(len(pairs), dtype=np.bool_)

        # the weights in the planes of pieces become weights on the facets, or on rings
        facets, own = self._surface.facets, cut.secondary
        if not facets.affine:
            vectors = facets.area_vectors_at(own.facet, own.x)
            in_plane = np.abs(dots(vectors, self._pieces.normals[cut.piece[cut.pair_of_point]]))
            weight = weight * np.linalg.norm(vectors, axis=1) / in_plane
        if facets.axisymmetric:
            weight = weight * 2.0 * np.pi * dots(own.values, facets.points[own.facet, :, 0])
        weighted_hats = weight[:, None] * cut.hats
        left = weighted_hats.reshape(-1, q, cut.hats.shape[1]).transpose(0, 2, 1)

        def products(right: Array) -> Array:
            """Integrate hats times functions (points, k) over overlaps: (pairs, corners, k)."""
            of_simplices = left @ right.reshape(-1, q, right.shape[1])
            return np.asarray(np.add.reduceat(of_simplices, starts, axis=0))

        # add the integrals over the pairs that count to those of their facets
        facet = cut.facet[pairs][added]
        np.add.at(self.hats, facet, products(cut.hats)[added])
        np.add.at(self.values, facet, products(own.values)[added])
        np.add.at(self.means, facet, products(means)[added])
        np.minimum.at(self.least, facet, np.minimum.reduceat(least, starts)[added])
        np.add.at(self._covered, piece[added], area[added])
        both: Indices = np.column_stack([cut.facet, cut.partner])[pairs]
        paired, exchanged = added & (area > 0.0), added & is_exchanged[pairs]
        self._overlaps.append((both[paired], products(cut.primary.values)[paired], both[exchanged]))
        return covered

    def _seen_weights(self, cut: _CutOverlaps, limit: Array) -> Array:
        """Return quadrature weights (points,) in the planes, 0 where the sides do not face there.

        Points face each other if they are within `limit` (pieces,) [length], nothing hides them or
        is nearer, the surfaces may touch there (`SmoothSurface.may_touch`), and the primary one is
        not far behind the nearest one that faces the piece (`FACET_LENGTH`).
        """
        secondary, primary, q = cut.secondary, cut.primary, len(self._weights)
        piece = cut.piece[cut.pair_of_point]
        apart = primary.height - secondary.height
        # a simplex is hidden as a whole, if it is at its centre, with mean heights
        low = secondary.height.reshape(-1, q) @ self._weights
        high = primary.height.reshape(-1, q) @ self._weights
        centres, partner = cut.simplices.mean(axis=1), cut.partner_piece[cut.pair]
        hidden = self._visibility.hidden(cut.piece[cut.pair], centres, low, high, partner)
        weight = (cut.areas[:, None] * self._weights).ravel()
        weight = weight * np.repeat(~hidden, q) * (np.abs(apart) <= limit[piece])
        weight = self._without_covered(cut, apart, weight)
        own, theirs = (secondary.facet, secondary.normals), (primary.facet, primary.normals)
        weight = weight * self._surface.may_touch(own, self._partner_surface, theirs)
        nearest: Array = np.full(len(limit), np.inf)
        np.minimum.at(nearest, piece, np.where(weight > 0.0, np.abs(apart), np.inf))
        behind = np.abs(apart) - nearest[piece]
        return np.asarray(weight * (behind <= FACET_LENGTH * self._pieces.radii[piece]))

    def _without_covered(self, cut: _CutOverlaps, apart: Array, weight: Array) -> Array:
        """Return weights (points,), set to 0 where a nearer simplex of another pair covers a point.

        Of two simplices that overlap, the one with the smaller mean distance counts; `apart`
        (points,) are the distances along the normal [length], negative for penetration.
        """
        q, piece = len(self._weights), cut.piece[cut.pair]
        has_weight = weight.reshape(-1, q).any(axis=1)
        # only on pieces with less area than their simplices, simplices can overlap
        area = np.bincount(piece, cut.areas * has_weight, minlength=len(self._area))
        overlaid = (area > (1.0 + MISMATCH) * self._area)[piece]
        crowded = np.flatnonzero(overlaid & has_weight)
        if len(crowded) == 0:
            return weight
        # a tree for the planes of all pieces, far apart along one more axis
        corners, dim = cut.simplices[crowded], cut.places.shape[1]
        middles = corners.mean(axis=1)
        reach = np.linalg.norm(corners - middles[:, None], axis=2).max()
        plane = 4.0 * reach * piece[crowded]
        tree = cKDTree(np.column_stack([middles, plane]))
        places = cut.places.reshape(-1, q, dim)[crowded].reshape(-1, dim)
        points = np.column_stack([places, np.repeat(plane, q)])
        point, b = flattened(tree.query_ball_point(points, reach * (1.0 + 1e-9)))
        # a point of simplex a is dropped if it lies in a nearer simplex b of another pair
        a, b, place = crowded[point // q], crowded[b], places[point]
        distance = np.abs(apart).reshape(-1, q).mean(axis=1)
        nearer = (cut.pair[a] != cut.pair[b]) & (distance[b] < distance[a])
        point, a, b, place = point[nearer], a[nearer], b[nearer], place[nearer]
        start = cut.simplices[b, 0]
        sides = np.swapaxes(cut.simplices[b, 1:] - start[:, None], 1, 2)
        reference = np.linalg.solve(sides, (place - start)[..., None])[..., 0]
        # on an edge that two nearer simplices share, the point is in both
        inside = (reference > -MISMATCH).all(axis=1) & (reference.sum(axis=1) < 1.0 + MISMATCH)
        result = weight.reshape(-1, q).copy()
        result[a[inside], point[inside] % q] = 0.0
        return result.ravel()

    def _quantities(self, cut: _CutOverlaps) -> Array:
        """Return the six quantities (points, 6) whose means are `FacetIntegrals.means`."""
        surface, partner_surface, point = self._surface, self._partner_surface, cut.pair_of_point
        facets, own, theirs = surface.facets, cut.secondary, cut.primary
        lean = own.normals + theirs.normals
        turns = surface.turns_along(own.facet, lean, to_ends=True)
        partner_turns = partner_surface.turns_along(theirs.facet, lean, to_ends=True)
        normals = contact_normals(own.normals, theirs.normals, turns, partner_turns)
        # where facets coincide, so do the surfaces: at the rim of one side the fitted ones differ
        is_fitted = not facets.has_exact_surface
        coincide = facets.coincide(cut.facet, partner_surface.facets, cut.partner)[point]
        equal = (is_fitted & coincide)[:, None]
        to_surface = np.where(equal, 0.0, own.to_surface)
        to_partner = np.where(equal, 0.0, theirs.to_surface)
        secondary_sagitta = (is_fitted & ~coincide) * surface.heights(own.facet, cut.hats)
        sagitta = dots(to_surface - to_partner, normals)
        # not the distance of the facets minus both heights: if these are much larger than the
        # distance, the difference would lose accuracy
        between = (theirs.height - own.height)[:, None] * self._pieces.normals[cut.piece[point]]
        distance = dots(between + to_partner - to_surface, normals)
        return np.column_stack([distance, secondary_sagitta, sagitta, normals])
