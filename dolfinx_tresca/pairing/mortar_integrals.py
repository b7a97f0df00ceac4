"""Integrals over the parts of secondary facets that face another body or a rigid obstacle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

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
)
from dolfinx_tresca.pairing.pieces import AT_ONCE, Pieces
from dolfinx_tresca.pairing.visibility import SelfContact, Visibility, overlaps, weights_of_nearest
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair

#: Length of a facet, relative to its radius: the distance by which the primary side may recede over
#: a facet. What is farther behind the nearest point is another surface, and means over both would
#: be wrong for either. (With half of it, rounded bodies with facets of the size of their radius
#: would lose parts of their overlap.) On a surface that touches itself, opposite facets are sought
#: within this distance first; otherwise a wall of 2,046 bricks is paired in 71 s.
FACET_LENGTH = 2.0

#: Angle [rad] by which an obstacle's normal turns over a facet (10 degrees). Up to this angle the
#: mesh resolves the obstacle, and nodes see it; from three times the angle on, it is seen all over
#: the facets around the node (`_see_between_nodes`). With twice instead of three times, the force
#: on a cylinder with cells of a third of its radius is 9 to 18 % too large, instead of 0 to 7 %.
RESOLVED_ANGLE = math.radians(10.0)

#: Angle [rad] over a facet from which on an obstacle that enters the facet is warned of: forces of
#: cylinders are then right to a quarter, those of balls to a factor of 1.7.
COARSE_ANGLE = 3.0 * RESOLVED_ANGLE

#: Height over its nearest point up to which an obstacle is seen, relative to its height over the
#: corners of a facet whose middle it touches. With half of it a cylinder as small as the facets is
#: pressed with up to 1.5 times the force; with 1.5 times of it, with half the force.
SEEN_HEIGHT = 1.0 / 3.0

#: Degree of exactness of the quadrature over facets on which an obstacle is seen.
SEEN_DEGREE = 16

#: Part of the depth by which an obstacle enters facets, unseen, that is warned of. (With cells of
#: 4/3 of the radius of a cylinder it was 0.54, and the force right to 16 %.)
UNSEEN_PART = 0.3


@dataclass
class FacetIntegrals:
    """Integrals over the parts of secondary facets that face the primary side.

    Attributes:
        hats: (n, corners, corners) integrals of products of two secondary hat functions [length^2,
            in 2D length].
        values: (n, corners, k) integrals of secondary hat times secondary basis functions.
        means: (n, corners, 6) integrals of secondary hat functions times six quantities: the
            distance of the surfaces along the contact normal; the height of the secondary surface
            over its facets (zero if an exact surface is known), and the sum of the heights of both
            along the contact normal (zero over facets that coincide); and the contact normal.
        least: (n,) least distance of the surfaces over each facet; infinite where none is paired.
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
        may_meet: Callable[[Indices, Indices], Mask],
        order: SelfContact | None = None,
    ) -> None:
        """Integrate over the overlaps of facets.

        Facets of a surface that touches itself are first paired with facets nearby, and only those
        that these do not fully cover with all facets within the search distance. Only the
        `selected` (m,) secondary facets are integrated over. Points beyond `limit` [length], and
        facets (p,) for which `may_meet` is false, are not paired. On a surface that touches itself,
        `order` decides which facet is secondary.
        """
        facets, partners = secondary.facets, primary.facets
        self._may_meet, self._order = may_meet, order
        self._pieces, self._partners = Pieces.from_facets(facets), Pieces.from_facets(partners)
        self._surface, self._partner_surface = SmoothSurface(secondary), SmoothSurface(primary)
        body = None if order is None else order.body[self._pieces.facet]
        self._visibility = Visibility(self._pieces, self._partners, body)
        degree = 1 + facets.degree
        if not (facets.affine and partners.affine):
            degree = 2 * degree + 4  # rational integrands: error below the error of the mesh
        elif facets.has_exact_surface:
            degree = max(degree, 1 + OFFSET_DEGREE)  # the hats are linear
        elif not (self._surface.is_flat and self._partner_surface.is_flat):
            degree = max(degree, 3)  # the sagitta is quadratic, the hats and normals are linear
        degree += facets.axisymmetric  # the radius is linear
        x, w = quadrature("interval" if facets.dim == 1 else "triangle", degree)
        self._barycentric, self._weights = np.column_stack([1.0 - x.sum(axis=1), x]), w / w.sum()
        self._to_corners = np.linalg.pinv(self._barycentric).T
        self._rounding = rounding_of(self._pieces.points)
        self._area, count = self._pieces.areas, len(self._pieces.facet)

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
        arrays = zip(*self._overlaps, strict=True)
        self.pairs, self.partner, self.opposite = map(np.concatenate, arrays)
        # the integrals outlive what they were computed with, a third of the memory
        del self._overlaps, self._pieces, self._partners, self._visibility
        del self._surface, self._partner_surface

    def _facing_pairs(self, mine: Indices, limit: Array) -> Iterator[tuple[Indices, Indices]]:
        """Yield blocks of pairs of pieces that face each other and may meet.

        All pairs of a secondary piece, of `mine` (m,), ascending, are in the same block; `limit`
        (pieces,) is the search distance [length].
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
        self, mine: Indices, partners: Indices, limit: Array, *, covered_only: bool = False
    ) -> Mask:
        """Add the integrals over pairs of secondary and primary pieces (pairs,), ascending.

        All pairs of a secondary piece are given, and `limit` (pieces,) is its search distance
        [length]. With `covered_only` pieces that are not fully covered are left out. Return which
        pieces (pieces,) these pairs cover fully, whatever the roles are.
        """
        pieces, surface, partner_surface = self._pieces, self._surface, self._partner_surface
        secondary, primary, dim = surface.facets, partner_surface.facets, surface.facets.dim
        # the overlaps in the planes of the secondary pieces, cut into simplices
        simplices, areas, pair = overlaps(
            pieces.local_coordinates(mine, pieces.points[mine])[:, :, :dim],
            pieces.local_coordinates(mine, self._partners.points[partners])[:, :, :dim],
        )
        large = areas > (self._rounding * self._area)[mine][pair]
        simplices, areas, pair = simplices[large], areas[large], pair[large]

        # quadrature points, (simplices * count,), in the planes and on both facets
        count = len(self._weights)
        places = np.einsum("qc,mcd->mqd", self._barycentric, simplices).reshape(-1, dim)
        weight = (areas[:, None] * self._weights).ravel()
        facet, partner = pieces.facet[mine], self._partners.facet[partners]
        point_pair = np.repeat(pair, count)
        own_facet, their_facet, piece = facet[point_pair], partner[point_pair], mine[point_pair]
        own = pieces.local_coordinates(mine, secondary.points[facet])[point_pair]
        theirs = pieces.local_coordinates(mine, primary.points[partner])[point_pair]
        x_own = project(secondary, own[:, :, :dim], places)
        x_their = project(primary, theirs[:, :, :dim], places)
        hats = secondary.hats(x_own)
        values, partner_values = secondary.basis(x_own), primary.basis(x_their)
        start, end = dots(values, own[:, :, dim]), dots(partner_values, theirs[:, :, dim])
        apart = end - start
        to_surface, outward = surface.offsets_and_normals(own_facet, x_own)
        to_partner, their_outward = partner_surface.offsets_and_normals(their_facet, x_their)

        # weights of points that are seen in either role: not hidden, near, and turned to each other
        centres = simplices.mean(axis=1)
        low, high = (side.reshape(-1, count) @ self._weights for side in (start, end))
        hidden = self._visibility.hidden(mine[pair], centres, low, high, partners[pair])
        weight = weight * np.repeat(~hidden, count) * (np.abs(apart) <= limit[piece])
        weight = weights_of_nearest(mine, pair, simplices, areas, places, apart, weight, self._area)
        weight = weight * surface.may_touch(
            own_facet, outward, partner_surface, their_facet, their_outward
        )
        # what lies far behind the nearest point of a piece is another surface
        nearest: Array = np.full(len(limit), np.inf)
        np.minimum.at(nearest, piece, np.where(weight > 0.0, np.abs(apart), np.inf))
        weight = weight * (np.abs(apart) - nearest[piece] <= FACET_LENGTH * pieces.radii[piece])

        # weights of pairs in this role, and in terms of area elements
        seen = weight
        opposite: Mask = np.zeros(len(mine), dtype=np.bool_)
        if self._order is not None:
            is_primary = ~self._order.is_secondary(facet, partner)[point_pair]
            opposite[point_pair[is_primary & (weight > 0.0)]] = True
            weight = weight * ~is_primary
        surface_weight = weight
        if not secondary.affine:  # areas of curved facets for those in the planes of pieces
            vectors = secondary.area_vectors_at(own_facet, x_own)
            in_plane = np.abs(dots(vectors, pieces.normals[piece]))
            surface_weight = surface_weight * np.linalg.norm(vectors, axis=1) / in_plane
        if secondary.axisymmetric:
            radii = dots(values, secondary.points[own_facet, :, 0])
            surface_weight = surface_weight * 2.0 * np.pi * radii

        # normals and distances; at the rim of one side fitted surfaces differ where facets coincide
        turns = surface.turns_to_ends[own_facet], partner_surface.turns_to_ends[their_facet]
        normals = contact_normals(outward, their_outward, *turns)
        coincide = secondary.coincide(facet, primary, partner)[point_pair]
        if not secondary.has_exact_surface:
            to_partner[coincide], to_surface[coincide] = 0.0, 0.0
        without_height = coincide | secondary.has_exact_surface
        secondary_sagitta = ~without_height * surface.heights(own_facet, hats)
        sagitta = dots(to_surface - to_partner, normals)
        # a vector between the surfaces: the distance of the facets minus both heights would lose
        # accuracy for closely fitting bodies, for which heights are much larger than the distance
        between = apart[:, None] * pieces.normals[piece]
        distance = dots(between + to_partner - to_surface, normals)
        # least distance of each simplex: of the linear function that fits the distances best
        least = (distance.reshape(-1, count) @ self._to_corners).min(axis=1)
        least[~(weight.reshape(-1, count) > 0.0).any(axis=1)] = np.inf

        # sums over the simplices of each pair that counts, and over the pairs of facets and pieces
        kept, simplex_starts = np.unique(pair, return_index=True)

        def products(right: Array) -> Array:
            """Integrate hats times functions over overlaps: (pairs, hats, functions)."""
            left = (surface_weight[:, None] * hats).reshape(-1, count, hats.shape[1])
            blocks = left.transpose(0, 2, 1) @ right.reshape(-1, count, right.shape[1])
            return np.asarray(np.add.reduceat(blocks, simplex_starts, axis=0))

        piece_of_pair, seen_of_pair = mine[kept], np.add.reduceat(seen, simplex_starts * count)
        seen_of_piece = np.bincount(piece_of_pair, seen_of_pair, minlength=len(limit))
        covered: Mask = seen_of_piece >= (1.0 - MISMATCH) * self._area
        add = covered[piece_of_pair] if covered_only else np.ones(len(kept), dtype=np.bool_)
        added_to = facet[kept][add]
        means = np.column_stack([distance, secondary_sagitta, sagitta, normals])
        for total, integrand in ((self.hats, hats), (self.values, values), (self.means, means)):
            np.add.at(total, added_to, products(integrand)[add])
        np.minimum.at(self.least, added_to, np.minimum.reduceat(least, simplex_starts)[add])
        area_of_pair = np.add.reduceat(weight, simplex_starts * count)
        np.add.at(self._covered, piece_of_pair[add], area_of_pair[add])
        both: Indices = np.column_stack([facet, partner])[kept]
        paired = add & (area_of_pair > 0.0)
        self._overlaps.append(
            (both[paired], products(partner_values)[paired], both[add & opposite[kept]])
        )
        return covered


def obstacle_integrals(
    comm: MPI.Comm, pair: ContactPair, obstacle: RigidObstacle, nodes: SurfaceNodes, displaced: bool
) -> tuple[SurfaceNodes, FacetIntegrals, Mask]:
    """Integrate over the facets of a surface that face a rigid obstacle. Collective.

    The signed distance is interpolated like a displacement and averaged with the dual basis; with
    degree 1, gap and jump are then the nodal values. With degree 2 the distance at nodes on
    straight edges is measured from the smooth curved surface (`SmoothSurface`), since a body of
    degree 2 can take the shape of the obstacle. Where the mesh does not resolve the obstacle, it is
    also seen between the nodes (`_see_between_nodes`). A warning tells how far an undeformed body
    is entered unseen, unless it is `displaced`.

    Returns:
        the nodes, with the facets of all patches at one entry of each node, since the patches share
        the normal of the obstacle; the integrals; and whether a facet faces the obstacle at its
        corners (n, corners).
    """
    facets = nodes.facets
    entry = np.searchsorted(nodes.numbers, nodes.numbers, side="right") - 1
    with errors_on_all_ranks(comm):
        surface = SmoothSurface(nodes)
        nodes = replace(nodes, facet_nodes=entry[nodes.facet_nodes])
        every, middle = np.arange(len(facets.points)), quadrature(facets.cell, 1)[0]
        centres = facets.points_at(middle)[:, 0]
        at_corners = obstacle.at(nodes.points)[1][nodes.facet_nodes]
        _, at_centres = obstacle.at(centres)
        # A facet faces the obstacle at a corner if the normals of both are opposed at this corner
        # and at the centre of the facet. So, if an edge of the body lies in a corner between walls
        # of the obstacle, only the facets in front of the nearest wall count at the edge's nodes.
        corner_normals = unit(facets.area_vectors(facets.lagrange_points(1)))
        faces: Mask = dots(corner_normals, at_corners) < -FACING_COSINE
        faces &= (dots(facets.mean_normals, at_centres) < -FACING_COSINE)[:, None]
        facing = np.asarray(faces.any(axis=1))
        turns = turned_angles(dots(at_corners, at_centres[:, None])) * facing
        at_node = nodes.reduced(np.maximum, turns[:, None], 0.0)[nodes.facet_nodes]
        own_turns = surface.turns[:, None]
        mean_normals = contact_normals(surface.corner_normals, at_corners, own_turns, at_node)
        unresolved = np.clip(at_node / RESOLVED_ANGLE - 1.0, 0.0, 1.0)[:, :, None]
        normals = unresolved * mean_normals - (1.0 - unresolved) * at_corners
        # nodes see a hollow obstacle, such as a corner between walls, before all other points do
        spread = facets.points[:, : facets.corners] - centres[:, None]
        turns *= dots(spread, at_corners - at_centres[:, None]).sum(axis=1) > 0.0

        x = facets.lagrange_points(facets.degree)
        distance, _ = _at(obstacle, surface.points(every, x))
        height = _at(obstacle, facets.points)[0] - distance
        x, w = quadrature(facets.cell, 4 * facets.degree + 2)
        weighted = (facets.area_elements(x) * w * facing[:, None])[:, None] * facets.hats(x).T
        hats, values = weighted @ facets.hats(x), weighted @ facets.basis(x)
        at_nodes = np.stack([distance, height, height], axis=2)
        means = np.concatenate([values @ at_nodes, hats @ normals], axis=2)
        least, full = np.zeros(len(hats)), np.ones(len(hats), dtype=np.bool_)
        pairs = np.column_stack([every, np.zeros_like(every)])
        integrals = FacetIntegrals(hats, values, means, least, full, pairs, hats)
        near = _see_between_nodes(obstacle, nodes, surface, turns, integrals)
        seen = distance.min(axis=1, initial=np.inf)
        gaps = nodes.reduced(np.add, integrals.means[near, :, 0], 0.0, near)
        areas = nodes.reduced(np.add, integrals.hats[near].sum(axis=2), 0.0, near)
        corners = nodes.facet_nodes[near]
        seen[near] = (gaps[corners] / areas[corners]).min(axis=1, initial=np.inf)
    if not displaced:
        front = np.flatnonzero(facing)
        with errors_on_all_ranks(comm):
            points = surface.points(front, facets.lagrange_points(OFFSET_DEGREE))
            depth = -_at(obstacle, points)[0].min(axis=1, initial=0.0)
        extent = np.abs(points).max(initial=0.0)
        _warn_of_unseen(comm, pair, depth, np.maximum(-seen[front], 0.0), turns[front], extent)
    return nodes, integrals, faces


def _warn_of_unseen(
    comm: MPI.Comm, pair: ContactPair, depth: Array, seen: Array, turns: Array, extent: float
) -> None:
    """Warn if an obstacle enters facets (n,) farther than the mesh sees. Collective.

    From the depth by which it enters, the part of it that nodes, or means between nodes, see, and
    the angle by which its normal turns [rad]; `extent` is the largest coordinate [length].
    """
    greatest = [array.max(initial=0.0) for array in (depth, depth - seen, turns * (depth > 0.0))]
    deepest, unseen, angle, extent = reduce_array(comm, [*greatest, extent], MPI.MAX)
    rounding = ROUNDING * extent
    is_coarse = angle > COARSE_ANGLE and deepest > rounding
    if is_coarse or unseen > max(UNSEEN_PART * deepest, rounding):
        warn(
            comm,
            "contact pair %s: the obstacle enters facets by up to %.3g, and the mesh does not "
            "see %.3g of it; its normal turns by %.0f degrees over a facet: forces are "
            "inaccurate, and may be zero. Use facets a third as large as the radius of the "
            "obstacle.",
            *(pair, deepest, unseen, math.degrees(angle)),
            about=str(pair),
        )


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
    these facets. So the force acts where the obstacle touches, and moments are balanced. The height
    is a part (`SEEN_HEIGHT`) of the height of the obstacle over the corners of a facet whose middle
    it touches: with the nearest point alone, bodies are too stiff.

    `turns` (n,) is the angle by which the obstacle's normal turns over each facet [rad], zero for
    facets that do not face it. The integrals change in place over the facets (m,) that are
    returned; there, hat functions count as dual.
    """
    facets = nodes.facets
    around = nodes.reduced(np.maximum, turns[:, None], 0.0)[nodes.facet_nodes]
    share = np.clip(0.5 * (around / RESOLVED_ANGLE - 1.0), 0.0, 1.0)
    near = np.flatnonzero(integrals.hats.any(axis=(1, 2)) & share.any(axis=1))
    close = facets.selected(near)
    corners, turns, share = nodes.facet_nodes[near], turns[near], share[near, :, None]
    x, w = quadrature(facets.cell, SEEN_DEGREE)
    hats, basis = facets.hats(x), facets.basis(x)
    points = surface.points(near, x)
    distance, outward = _at(obstacle, points)
    own = unit(hats @ surface.corner_normals[near])
    normals = contact_normals(own, outward, surface.turns[near, None], turns[:, None])
    above = dots(close.points_at(x) - points, outward)
    seen = np.dstack([distance, above, above, normals])

    widths = (np.linalg.norm(close.area_vectors(x), axis=2) @ w) ** (1.0 / facets.dim)
    own_height = SEEN_HEIGHT / 8.0 * facets.dim * turns * widths
    height = nodes.reduced(np.maximum, own_height[:, None], 0.0, near)
    least = nodes.reduced(np.minimum, distance.min(axis=1)[:, None], np.inf, near)
    heights = np.where(share > 0.0, height[corners][:, :, None], 1.0)
    excess = (distance[:, None] - least[corners][:, :, None]) / heights
    weights = np.exp(-excess) * hats.T * (close.area_elements(x) * w)[:, None]
    areas = integrals.hats[near].sum(axis=2)
    total = nodes.reduced(np.add, weights.sum(axis=2), 0.0, near)[corners]
    weights *= (nodes.reduced(np.add, areas, 0.0, near)[corners] / total)[:, :, None]
    dual = areas[:, :, None] * np.linalg.inv(integrals.hats[near])
    values, means = dual @ integrals.values[near], dual @ integrals.means[near]
    # the normal at a node half a facet away is wrong by more than the distance there
    shares = share * [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    integrals.values[near] = values + share * (weights @ basis - values)
    integrals.means[near] = means + np.minimum(shares, 1.0) * (weights @ seen - means)
    integrals.hats[near] = areas[:, :, None] * np.eye(facets.corners)
    return near
