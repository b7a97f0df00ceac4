"""Integrals over the overlaps of pairs of secondary and primary facets."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.pairing.contact_normal import contact_normals
from dolfinx_tresca.pairing.search.clipping import overlaps
from dolfinx_tresca.pairing.search.facets import Facets, quadrature, rounding_of
from dolfinx_tresca.pairing.search.matching import facets_coincide
from dolfinx_tresca.pairing.search.nearest import nearest_layer_weights
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.pairing.search.offsets import OFFSET_DEGREE, any_known_surface
from dolfinx_tresca.pairing.search.pieces import Pieces
from dolfinx_tresca.pairing.search.projection import project
from dolfinx_tresca.pairing.search.self_contact import SelfContact
from dolfinx_tresca.pairing.search.smooth_surface import SmoothSurface
from dolfinx_tresca.pairing.search.visibility import Visibility


@dataclass(frozen=True)
class Overlap:
    """Integrals over the overlaps of pairs of pieces of facets (`Pieces`).

    Attributes:
        secondary: (n,) secondary facet of each pair.
        primary: (n,) primary facet of each pair.
        hats: (n, corners, corners) integrals of products of two secondary hat functions.
        values: (n, corners, k) integrals of secondary hat times secondary basis functions.
        other: (n, corners, k) integrals of secondary hat times primary basis functions.
        sagitta: (n, corners) integrals of secondary hat functions times the heights of both curved
            surfaces over their facets; zero if the facets coincide, or if an exact surface is
            known.
        secondary_sagitta: (n, corners) the part of `sagitta` that comes from the secondary side.
        distance: (n, corners) integrals of secondary hat functions times the distance of the
            surfaces along the contact normal.
        normals: (n, corners, 3) integrals of secondary hat functions times the contact normal.
        least: (n,) least distance of the surfaces along the contact normal [length].
        piece: (n,) secondary piece of each pair.
        area: (n,) area of the overlap in the plane of the piece [length^2, in 2D length].
        opposite: (n,) whether the facets see each other, but with exchanged roles, on a surface
            that touches itself; the integrals are zero then.
        seen: (n,) area of the overlap in the plane of the piece, whatever the roles are.
    """

    secondary: Indices
    primary: Indices
    hats: Array
    values: Array
    other: Array
    sagitta: Array
    secondary_sagitta: Array
    distance: Array
    normals: Array
    least: Array
    piece: Indices
    area: Array
    opposite: Mask
    seen: Array

    def part(self, keep: Mask) -> Overlap:
        """Return the integrals of the pairs in a mask (n,)."""
        return Overlap(*(getattr(self, one.name)[keep] for one in fields(self)))


class OverlapIntegrals:
    """Integrates over the visible and nearest parts of the overlaps of pairs of pieces.

    The arguments are those of `MortarIntegrals.of`; `pieces` and `others` are the pieces of the
    secondary and the primary facets.
    """

    def __init__(
        self,
        secondary: Facets,
        nodes: SurfaceNodes,
        primary: Facets,
        primary_nodes: SurfaceNodes,
        pieces: Pieces,
        others: Pieces,
        order: SelfContact | None,
    ) -> None:
        self._order = order
        self._secondary, self._primary = secondary, primary
        self._pieces, self._others = pieces, others
        self._frames = pieces.frames()
        self._surface = SmoothSurface(secondary, nodes)
        self._primary_surface = SmoothSurface(primary, primary_nodes)
        self._turns = self._surface.turns_to_ends
        self._primary_turns = self._primary_surface.turns_to_ends
        self._known = any_known_surface(secondary, primary)
        self._visibility = Visibility(
            pieces, others, None if order is None else order.body[pieces.facet]
        )
        degree = 1 + secondary.degree
        self._polynomial = secondary.affine and primary.affine and not self._known
        if not (secondary.affine and primary.affine):
            degree = 2 * degree + 4  # rational integrands: error below the error of the mesh
        elif self._known:
            degree = max(degree, 1 + OFFSET_DEGREE)  # the hats are linear
        elif self._surface.turning or self._primary_surface.turning:
            degree = max(degree, 3)  # the sagitta is quadratic, the hats and normals are linear
        degree += secondary.axisymmetric  # the radius is linear
        self._rule = quadrature("interval" if secondary.dim == 1 else "triangle", degree)
        x, _ = self._rule
        self._to_corners = np.linalg.pinv(np.column_stack([1.0 - x.sum(axis=1), x])).T
        whole = pieces.points - pieces.centres[:, None]
        flat = np.einsum("nci,ndi->ncd", whole, self._frames[:, :-1])
        _, size, piece = overlaps(flat, flat)
        self._rounding = rounding_of(pieces.points)
        #: (pieces,) areas of the secondary pieces in their planes [length^2, in 2D length]
        self.piece_area = np.bincount(piece, size, minlength=len(whole)).astype(np.float64)

    def __call__(self, first: Indices, second: Indices, limit: Array) -> Overlap:
        """Integrate over pairs of secondary and primary pieces.

        Args:
            first: (pairs,) secondary pieces, ascending.
            second: (pairs,) primary pieces.
            limit: (pairs,) distance beyond which points are not paired [length].
        """
        secondary, primary, dim = self._secondary, self._primary, self._secondary.dim
        pieces, frames = self._pieces, self._frames
        simplices, size, pair = overlaps(
            pieces.local_coordinates(frames, first, pieces.points[first])[:, :, :dim],
            pieces.local_coordinates(frames, first, self._others.points[second])[:, :, :dim],
            centred=not self._polynomial,
        )
        large = size > (self._rounding * self.piece_area)[first][pair]
        simplices, size, pair = simplices[large], size[large], pair[large]
        # quadrature points in the planes, (simplices, q, dim), and their weights
        x, w = self._rule
        barycentric = np.column_stack([1.0 - x.sum(axis=1), x])
        places = np.einsum("qc,mcd->mqd", barycentric, simplices)
        weight = size[:, None] * (w / w.sum())
        count = len(x)
        point_pair = np.repeat(pair, count)
        places = places.reshape(-1, dim)
        facet, other = pieces.facet[first], self._others.facet[second]

        own = pieces.local_coordinates(frames, first, secondary.points[facet])[point_pair]
        theirs = pieces.local_coordinates(frames, first, primary.points[other])[point_pair]
        x_own = project(secondary, own[:, :, :dim], places)
        x_their = project(primary, theirs[:, :, :dim], places)
        hats = secondary.hats(x_own)
        values, others = secondary.basis(x_own), primary.basis(x_their)
        end = np.einsum("nk,nk->n", others, theirs[:, :, dim])
        start = np.einsum("nk,nk->n", values, own[:, :, dim])
        apart = end - start
        middle = w / w.sum()
        visible = ~self._visibility.hidden(
            first[pair],
            simplices.mean(axis=1),
            start.reshape(-1, count) @ middle,
            end.reshape(-1, count) @ middle,
            second[pair],
        )
        weight = weight.ravel() * np.repeat(visible, count)
        weight = weight * (np.abs(apart) <= limit[point_pair])
        weight = nearest_layer_weights(
            first, pair, simplices, size, places, apart, weight, self.piece_area
        )
        own_facet, their_facet = facet[point_pair], other[point_pair]
        to_surface, outward = self._surface.at(own_facet, x_own)
        to_other_surface, their_outward = self._primary_surface.at(their_facet, x_their)
        normals, opposed = contact_normals(
            *(outward, their_outward),
            *(self._turns[own_facet], self._primary_turns[their_facet]),
        )
        weight = weight * opposed
        seen = weight
        opposite: Mask = np.zeros(len(first), dtype=np.bool_)
        if self._order is not None:
            is_primary = ~self._order.is_secondary(facet, other)[point_pair]
            opposite[point_pair[is_primary & (weight > 0.0)]] = True
            weight = weight * ~is_primary
        area = weight
        if not secondary.plane:
            area = weight * self._stretch(facet[point_pair], x_own, first[point_pair])
        if secondary.axisymmetric:
            radii = np.einsum("nk,nk->n", values, secondary.points[facet[point_pair], :, 0])
            area = area * secondary.circumferences(radii)

        def summed(integrand: Array) -> Array:
            """Sum over the quadrature points of each pair: (overlapping pairs, ...)."""
            return np.asarray(np.add.reduceat(integrand, starts, axis=0))

        def products(right: Array) -> Array:
            """Integrate hats times functions over overlaps: (pairs, hats, functions)."""
            left = (area[:, None] * hats).reshape(-1, count, hats.shape[1])
            blocks = left.transpose(0, 2, 1) @ right.reshape(-1, count, right.shape[1])
            return np.asarray(np.add.reduceat(blocks, simplex_starts, axis=0))

        kept, simplex_starts = np.unique(pair, return_index=True)
        starts = simplex_starts * count
        sagitta: Array = np.zeros(len(area))
        secondary_sagitta: Array = sagitta
        if not self._known:
            # at the rim of one side the fitted surfaces differ, though the facets coincide
            differ = ~facets_coincide(secondary, facet, primary, other)[point_pair]
            secondary_sagitta = differ * self._surface.heights(own_facet, hats)
            heights = self._primary_surface.heights(their_facet, primary.hats(x_their))
            sagitta = secondary_sagitta + differ * heights
            to_other_surface[~differ], to_surface[~differ] = 0.0, 0.0
        # a vector between the surfaces: the distance of the facets minus both heights would lose
        # accuracy for closely fitting bodies, for which heights are much larger than the distance
        between = apart[:, None] * pieces.normals[first][point_pair]
        distance = np.einsum("ni,ni->n", between + to_other_surface - to_surface, normals)
        # at the corners of the simplices: of the linear function that fits the distances best
        least = (distance.reshape(-1, count) @ self._to_corners).min(axis=1)
        least[~(weight.reshape(-1, count) > 0.0).any(axis=1)] = np.inf
        return Overlap(
            secondary=facet[kept],
            primary=other[kept],
            hats=products(hats),
            values=products(values),
            other=products(others),
            sagitta=summed((area * sagitta)[:, None] * hats),
            secondary_sagitta=summed((area * secondary_sagitta)[:, None] * hats),
            distance=summed((area * distance)[:, None] * hats),
            normals=products(normals),
            least=np.minimum.reduceat(least, simplex_starts),
            piece=first[kept],
            area=summed(weight),
            opposite=opposite[kept],
            seen=summed(seen),
        )

    def _stretch(self, facet: Indices, x: Array, piece: Indices) -> Array:
        """Return ratios (n,) of areas on curved facets to areas in the planes of their pieces."""
        vectors = self._secondary.area_vectors_at(facet, x)
        height = np.abs(np.einsum("ni,ni->n", vectors, self._pieces.normals[piece]))
        return np.asarray(np.linalg.norm(vectors, axis=1) / height)
