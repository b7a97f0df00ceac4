"""Integrals over the parts of secondary facets that face another body or a rigid obstacle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

import basix

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, Mask, dots, unit
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array, warn
from dolfinx_tresca.pairing.contact_normal import SmoothSurface, contact_normals, turned_angles
from dolfinx_tresca.pairing.facets import (
    FACING_COSINE,
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
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair

#: Length of a facet, relative to its radius: the distance by which the primary side may recede over
#: a facet. What is farther behind the nearest point is another surface. (With half of it, rounded
#: bodies with facets of the size of their radius would lose parts of their overlap.) On a surface
#: that touches itself, facets are sought within this distance first, which saves much time.
FACET_LENGTH = 2.0

#: Angle [rad] by which an obstacle's normal turns over a facet, up to which the mesh resolves the
#: obstacle; from three times the angle on, it is seen all over the facets around the node. With
#: twice instead of three times, the force on a cylinder with cells of a third of its radius is 9 to
#: 18 % too large, instead of 0 to 7 %.
RESOLVED_ANGLE = math.radians(10.0)
#: Angle [rad] from which on an obstacle that enters a facet is warned of: forces of cylinders are
#: then right to a quarter, those of balls to a factor of 1.7.
COARSE_ANGLE = 3.0 * RESOLVED_ANGLE

#: Height over its nearest point up to which an obstacle is seen, relative to its height over the
#: corners of a facet whose middle it touches. With half of it a cylinder as small as the facets has
#: up to 1.5 times the force; with 1.5 times of it, half the force.
SEEN_HEIGHT = 1.0 / 3.0
#: Degree of exactness of the quadrature over facets on which an obstacle is seen.
SEEN_DEGREE = 16
#: Unseen part of the depth by which an obstacle enters facets that is warned of. (On cells of 4/3
#: of a cylinder's radius it was 0.54, and the force right to 16 %.)
UNSEEN_PART = 0.3


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


def obstacle_integrals(
    comm: MPI.Comm, pair: ContactPair, obstacle: RigidObstacle, nodes: SurfaceNodes, displaced: bool
) -> tuple[SurfaceNodes, FacetIntegrals, Mask]:
    """Integrate over the facets of a surface that face a rigid obstacle. Collective.

    The signed distance is interpolated like a displacement and averaged with the dual basis; with
    degree 1, gap and jump are then the nodal values. With degree 2 the distance at nodes on
    straight edges is measured from the smooth curved surface (`SmoothSurface`), since a body of
    degree 2 can take the shape of the obstacle. Where the mesh does not resolve the obstacle, it is
    also seen between the nodes; what undeformed bodies enter unseen is warned of.

    Returns:
        the nodes, with a single entry for all facets at a node, since its patches share the normal
        of the obstacle; the integrals; and whether facets face it at their corners (n, corners).
    """
    facets, centre = nodes.facets, quadrature(nodes.facets.cell, 1)[0]
    entry = np.searchsorted(nodes.numbers, nodes.numbers, side="right") - 1
    with errors_on_all_ranks(comm):
        surface = SmoothSurface(nodes)
        nodes = copy(nodes)
        nodes.facet_nodes = entry[nodes.facet_nodes]
        at_corners = obstacle.at(nodes.points)[1][nodes.facet_nodes]
        centres = (facets.basis(centre) @ facets.points)[:, 0]
        _, at_centres = obstacle.at(centres)

        # A facet faces the obstacle at a corner if the normals are opposed there and at the centre:
        # at an edge in a corner between two walls, the facets in front of the nearest wall do.
        corner_normals = unit(facets.area_vectors(facets.lagrange_points(1)))
        faces: Mask = dots(corner_normals, at_corners) < -FACING_COSINE
        faces &= (dots(facets.mean_normals, at_centres) < -FACING_COSINE)[:, None]
        facing = np.asarray(faces.any(axis=1))

        # nodes have the obstacle's normal if the mesh resolves its turns, else the mean of both
        turns = turned_angles(dots(at_corners, at_centres[:, None])) * facing
        at_node = nodes.reduced(np.maximum, turns[:, None], 0.0)[nodes.facet_nodes]
        own_turns = surface.turns[:, None]
        mean_normals = contact_normals(surface.corner_normals, at_corners, own_turns, at_node)
        unresolved = np.clip(at_node / RESOLVED_ANGLE - 1.0, 0.0, 1.0)[:, :, None]
        normals = unresolved * mean_normals - (1.0 - unresolved) * at_corners

        # distances are interpolated between the nodes of the displacement, normals between corners
        every = np.arange(len(facing))
        distance, _ = _at(obstacle, surface.points(every, facets.lagrange_points(facets.degree)))
        height = _at(obstacle, facets.points)[0] - distance
        at_nodes = np.stack([distance, height, height], axis=2)
        # integrals over the facets that face the obstacle, zero over the others
        x, w = quadrature(facets.cell, 4 * facets.degree + 2)
        weighted = (facets.area_elements(x) * w * facing[:, None])[:, None] * facets.hats(x).T
        hats, values = weighted @ facets.hats(x), weighted @ facets.basis(x)
        means = np.concatenate([values @ at_nodes, hats @ normals], axis=2)
        least, full = distance.min(axis=1, initial=np.inf), np.ones(len(every), dtype=np.bool_)
        pairs = np.column_stack([every, np.zeros_like(every)])
        integrals = FacetIntegrals(hats, values, means, least, full, pairs, hats)

        # nodes see a hollow obstacle, such as a corner between walls, before all other points do
        spread = facets.points[:, : facets.corners] - centres[:, None]
        turns *= dots(spread, at_corners - at_centres[:, None]).sum(axis=1) > 0.0
        near = _see_between_nodes(obstacle, nodes, surface, turns, integrals)
    if displaced:
        return nodes, integrals, faces

    # warn if the obstacle enters facets farther than the mesh sees: what it sees is the least
    # distance at nodes, or of means over the facets around them
    seen = integrals.least.copy()
    gaps = nodes.reduced(np.add, integrals.means[near, :, 0], 0.0, near)
    areas = nodes.reduced(np.add, integrals.hats[near].sum(axis=2), 0.0, near)
    corners = nodes.facet_nodes[near]
    seen[near] = (gaps[corners] / areas[corners]).min(axis=1, initial=np.inf)
    front = np.flatnonzero(facing)
    with errors_on_all_ranks(comm):
        points = surface.points(front, facets.lagrange_points(OFFSET_DEGREE))
        depth = -_at(obstacle, points)[0].min(axis=1, initial=0.0)
    unseen = depth - np.maximum(-seen[front], 0.0)
    entered_turns = turns[front] * (depth > 0.0)
    greatest = [array.max(initial=0.0) for array in (depth, unseen, entered_turns, np.abs(points))]
    deepest, most_unseen, angle, extent = reduce_array(comm, greatest, MPI.MAX)
    rounding = ROUNDING * extent
    is_coarse = angle > COARSE_ANGLE and deepest > rounding
    if is_coarse or most_unseen > max(UNSEEN_PART * deepest, rounding):
        warn(
            comm,
            "contact pair %s: the obstacle enters facets by up to %.3g, and the mesh does not "
            "see %.3g of it; its normal turns by %.0f degrees over a facet: forces are "
            "inaccurate, and may be zero. Use facets a third as large as the radius of the "
            "obstacle.",
            *(pair, deepest, most_unseen, math.degrees(angle)),
            about=str(pair),
        )
    return nodes, integrals, faces


def _at(obstacle: RigidObstacle, points: Array) -> tuple[Array, Array]:
    """Return distances (n, q) and normals (n, q, 3) of an obstacle at points (n, q, 3)."""
    distance, normals = obstacle.at(points.reshape(-1, 3))
    return distance.reshape(points.shape[:2]), normals.reshape(points.shape)


def _see_between_nodes(
    obstacle: RigidObstacle,
    nodes: SurfaceNodes,
    surface: SmoothSurface,
    turns: Array,
    integrals: FacetIntegrals,
) -> Indices:
    """Take means around the nearest points of an obstacle that the mesh does not resolve.

    An obstacle that is smaller than a facet may touch it between nodes. Gap, contact normal and
    displacement of a node are then means over the facets around it, with its hat function times
    exp(-(g - least) / height) as weight, where g is the distance and `least` its least value on
    these facets. So the force acts where the obstacle touches. The height is a part (`SEEN_HEIGHT`)
    of the height of the obstacle over the corners of a facet whose middle it touches.

    The obstacle's normal turns by `turns` (n,) over facets [rad], zero where they do not face it.
    The integrals change in place over the facets (m,) that are returned; `hats` become diagonal.
    """
    facets = nodes.facets
    # share (m, corners, 1) of the new means, which take over gradually as the angle grows
    around = nodes.reduced(np.maximum, turns[:, None], 0.0)[nodes.facet_nodes]
    share = np.clip(0.5 * (around / RESOLVED_ANGLE - 1.0), 0.0, 1.0)
    near = np.flatnonzero(integrals.hats.any(axis=(1, 2)) & share.any(axis=1))
    close, corners, share = facets.selected(near), nodes.facet_nodes[near], share[near, :, None]
    turns = turns[near]
    # the six quantities of `FacetIntegrals.means` at points all over the facets
    x, w = quadrature(facets.cell, SEEN_DEGREE)
    hats, points = facets.hats(x), surface.points(near, x)
    distance, outward = _at(obstacle, points)
    own = unit(hats @ surface.corner_normals[near])
    normals = contact_normals(own, outward, surface.turns[near, None], turns[:, None])
    above = dots(facets.basis(x) @ close.points - points, outward)
    seen = np.dstack([distance, above, above, normals])
    # weights (m, corners, points): the hat function times the exponential function, scaled such
    # that a node keeps its area. An arc over a chord of length l has the height turn l / 8
    sizes = (np.linalg.norm(close.area_vectors(x), axis=2) @ w) ** (1.0 / facets.dim)
    own_height = SEEN_HEIGHT / 8.0 * facets.dim * turns * sizes
    height = nodes.reduced(np.maximum, own_height[:, None], 0.0, near)
    least = nodes.reduced(np.minimum, distance.min(axis=1)[:, None], np.inf, near)
    heights = np.where(share > 0.0, height[corners][:, :, None], 1.0)
    excess = (distance[:, None] - least[corners][:, :, None]) / heights
    weights = np.exp(-excess) * hats.T * (close.area_elements(x) * w)[:, None]
    areas = integrals.hats[near].sum(axis=2)
    total = nodes.reduced(np.add, weights.sum(axis=2), 0.0, near)[corners]
    weights *= (nodes.reduced(np.add, areas, 0.0, near)[corners] / total)[:, :, None]
    # the integrals so far get dual functions; diagonal `hats` tell `couple` to keep these
    dual = areas[:, :, None] * np.linalg.inv(integrals.hats[near])
    values, means = dual @ integrals.values[near], dual @ integrals.means[near]
    # the normal at a node half a facet away is wrong by more than the distance there
    shares = share * [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    integrals.values[near] = values + share * (weights @ facets.basis(x) - values)
    integrals.means[near] = means + np.minimum(shares, 1.0) * (weights @ seen - means)
    integrals.hats[near] = areas[:, :, None] * np.eye(facets.corners)
    return near
