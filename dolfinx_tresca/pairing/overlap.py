"""Integrals over the overlaps of secondary and primary facets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.surface.clipping import overlaps
from dolfinx_tresca.surface.curvature import Sagitta
from dolfinx_tresca.surface.facets import Facets, quadrature
from dolfinx_tresca.surface.nearest import nearest_layer_weights
from dolfinx_tresca.surface.nodes import SurfaceNodes
from dolfinx_tresca.surface.offsets import OFFSET_DEGREE, any_known_surface, normals_at, offsets_at
from dolfinx_tresca.surface.pieces import Pieces
from dolfinx_tresca.surface.projection import project
from dolfinx_tresca.surface.visibility import Visibility


@dataclass(frozen=True)
class Overlap:
    """Integrals over the overlaps of pairs of pieces, in the numbers of their facets.

    Attributes:
        secondary: (n,) facet of that side.
        primary: (n,) facet of the other side.
        hats: (n, corners, corners) of products of the secondary hat functions.
        values: (n, corners, k) of these times the secondary basis functions.
        other: (n, corners, k) of these times the primary basis functions.
        sagitta: (n, corners) of the secondary hat functions times the heights of both curved
            surfaces over their facets, which the gap is less by; zero where a surface is known.
        raised: (n, corners) the part of that which the secondary surface has.
        distance: (n, corners) of these times the distance of the surfaces, then.
        piece: (n,) the secondary piece.
        area: (n,) the overlap in its plane.
    """

    secondary: Indices
    primary: Indices
    hats: Array
    values: Array
    other: Array
    sagitta: Array
    raised: Array
    distance: Array
    piece: Indices
    area: Array


class OverlapIntegrals:
    """Integrates over the overlaps of pairs of pieces: of what is visible, the nearest."""

    def __init__(
        self,
        secondary: Facets,
        nodes: SurfaceNodes,
        primary: Facets,
        primary_nodes: SurfaceNodes,
        pieces: Pieces,
        others: Pieces,
        limit: float,
    ) -> None:
        self._secondary, self._primary = secondary, primary
        self._pieces, self._others = pieces, others
        self._limit = limit
        self._frames = pieces.frames()
        self._sagitta = Sagitta(secondary, nodes)
        self._primary_sagitta = Sagitta(primary, primary_nodes)
        self._known = any_known_surface(secondary, primary)
        self._visibility = Visibility(pieces, others)
        degree = 1 + secondary.degree
        self._polynomial = secondary.affine and primary.affine and not self._known
        if not (secondary.affine and primary.affine):
            degree = 2 * degree + 4  # integrands are rational: beyond the mesh's error
        elif self._known:
            degree = max(degree, 1 + OFFSET_DEGREE)  # the hats are linear
        elif self._sagitta.nonzero or self._primary_sagitta.nonzero:
            degree = max(degree, 3)  # the sagitta is quadratic, the hats are linear
        self._rule = quadrature("interval" if secondary.dim == 1 else "triangle", degree)
        whole = pieces.points - pieces.centres[:, None]
        flat = np.einsum("nci,ndi->ncd", whole, self._frames[:, :-1])
        _, size, piece = overlaps(flat, flat)
        #: (pieces,) their sizes in their planes
        self.piece_area = np.bincount(piece, size, minlength=len(whole)).astype(np.float64)

    def __call__(self, first: Indices, second: Indices) -> Overlap:
        """Integrate over pairs of pieces, sorted by the first."""
        secondary, primary, dim = self._secondary, self._primary, self._secondary.dim
        pieces, frames = self._pieces, self._frames
        simplices, size, pair = overlaps(
            pieces.local_coordinates(frames, first, pieces.points[first])[:, :, :dim],
            pieces.local_coordinates(frames, first, self._others.points[second])[:, :, :dim],
            centred=not self._polynomial,
        )
        large = size > 1e-14 * self.piece_area[first][pair]
        simplices, size, pair = simplices[large], size[large], pair[large]
        # points in the planes, (simplices, q, dim), and their weights
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
        )
        weight = weight.ravel() * np.repeat(visible, count)
        weight = weight * (np.abs(apart) <= self._limit)
        weight = nearest_layer_weights(
            first, pair, simplices, size, places, apart, weight, self.piece_area
        )
        area = weight
        if not secondary.plane:
            area = weight * self._stretch(facet[point_pair], x_own, first[point_pair])

        def summed(integrand: Array) -> Array:
            """Sum over the points of each pair, (pairs that overlap, ...)."""
            return np.asarray(np.add.reduceat(integrand, starts, axis=0))

        def products(right: Array) -> Array:
            """Sum area times hats times other functions over the points of each pair."""
            left = (area[:, None] * hats).reshape(-1, count, hats.shape[1])
            blocks = left.transpose(0, 2, 1) @ right.reshape(-1, count, right.shape[1])
            return np.asarray(np.add.reduceat(blocks, simplex_starts, axis=0))

        kept, simplex_starts = np.unique(pair, return_index=True)
        starts = simplex_starts * count
        sagitta: Array = np.zeros(len(area))
        raised: Array = np.zeros(len(area))
        distance: Array = np.zeros(len(area))
        if self._known:
            between = apart[:, None] * pieces.normals[first][point_pair]
            distance = self._distance(facet[point_pair], x_own, other[point_pair], x_their, between)
        else:
            if self._sagitta.nonzero:
                raised = self._sagitta.heights(facet[point_pair], hats)
                sagitta += raised
            if self._primary_sagitta.nonzero:
                sagitta += self._primary_sagitta.heights(other[point_pair], primary.hats(x_their))
        return Overlap(
            secondary=facet[kept],
            primary=other[kept],
            hats=products(hats),
            values=products(values),
            other=products(others),
            sagitta=summed((area * sagitta)[:, None] * hats),
            raised=summed((area * raised)[:, None] * hats),
            distance=summed((area * distance)[:, None] * hats),
            piece=first[kept],
            area=summed(weight),
        )

    def _distance(
        self, facet: Indices, x: Array, other: Indices, y: Array, between: Array
    ) -> Array:
        """Return the distances (n,) of surfaces along the normals of the secondary one [length].

        Not those of facets less the heights over them: where bodies fit closely these are much
        larger than the distance, and so would be the parts that a facet's own normal has too
        little.

        Args:
            facet: (n,) secondary facets.
            x: (n, dim) reference points there.
            other: (n,) primary facets.
            y: (n, dim) reference points there.
            between: (n, 3) from the one to the other [length].
        """
        own, along = _surface_at(self._secondary, self._sagitta, facet, x)
        theirs, _ = _surface_at(self._primary, self._primary_sagitta, other, y)
        return np.asarray(np.einsum("ni,ni->n", between + theirs - own, along))

    def _stretch(self, facet: Indices, x: Array, piece: Indices) -> Array:
        """Return the area (n,) of curved facets over that in the plane, at reference points."""
        vectors = self._secondary.area_vectors_at(facet, x)
        height = np.abs(np.einsum("ni,ni->n", vectors, self._pieces.normals[piece]))
        return np.asarray(np.linalg.norm(vectors, axis=1) / height)


def _surface_at(facets: Facets, sagitta: Sagitta, facet: Indices, x: Array) -> tuple[Array, Array]:
    """Return the vectors (n, 3) from facets to their surface [length], and its normals (n, 3)."""
    if facets.offsets.shape[1]:
        return offsets_at(facets, facet, x), normals_at(facets, facet, x)
    hats = facets.hats(x)
    normals = sagitta.normals(facet, hats)
    heights = sagitta.heights(facet, hats) if sagitta.nonzero else np.zeros(len(facet))
    return heights[:, None] * normals, normals
