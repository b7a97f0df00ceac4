"""Mortar pairing: jumps weighed over the facets, for surfaces whose meshes do not match."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array, diags_array

from dolfinx_tresca._parallel import errors_on_all_ranks
from dolfinx_tresca.pair import ContactPair
from dolfinx_tresca.pairing.coupling import Coupling, carriers, owned
from dolfinx_tresca.pairing.dual_basis import (
    FacetIntegrals,
    dual_coefficients,
    rows,
    without_rounding,
)
from dolfinx_tresca.surface.clipping import overlaps
from dolfinx_tresca.surface.curvature import Sag
from dolfinx_tresca.surface.facets import Facets, FloatArray, quadrature
from dolfinx_tresca.surface.nearest import nearest_layer
from dolfinx_tresca.surface.nodes import SurfaceNodes
from dolfinx_tresca.surface.pieces import Pieces
from dolfinx_tresca.surface.projection import project
from dolfinx_tresca.surface.search import Indices, facing

#: Least cosine between the normals of facets that face each other, one reversed.
FACING = 0.1

#: Part of a facet that may be missing where it counts as covered: rounding.
COVERED = 1e-8

#: Part of a node's area that must be in contact for it to carry a multiplier.
SHARE = 3e-4

#: Pairs of facets that are treated at once, to bound the memory.
CHUNK = 30_000


def couple(
    V: Any,
    pair: ContactPair,
    facets: Facets,
    nodes: SurfaceNodes,
    others: Facets,
    other_nodes: SurfaceNodes,
    limit: float,
    reason: str,
) -> Coupling:
    """Couple by integrals over the overlap of two surfaces. Collective.

    The gap is the jump of the positions, as if they were displacements, less what the curvature of
    both sides takes from it.

    Raises:
        PairingError: no node can carry a multiplier.
    """
    with errors_on_all_ranks(V.mesh.comm):
        selected = np.flatnonzero(owned(V, nodes)[nodes.facet_nodes].any(axis=1))
        columns = V.dofmap.index_map.size_global
        found = mortar_rows(facets, nodes, others, other_nodes, selected, limit, columns)
    beyond = found.weights <= SHARE * nodes.weights
    shared = np.isin(nodes.numbers, others.nodes)
    position = carriers(V, pair, nodes, beyond, shared, "mortar", reason)
    weights = found.weights[position]
    jump = (diags_array(1.0 / weights) @ found.jump[position]).tocsr()
    rise = (found.rise[position] / weights)[:, None] * nodes.normals[position]
    way = -_of_positions(jump, [facets, others]) - rise
    return Coupling("mortar", position, weights, nodes.normals[position], jump, way)


def _of_positions(jump: Any, sides: list[Facets]) -> FloatArray:
    """Return what a jump (n, nodes of V) makes of the nodes' positions, (n, 3)."""
    numbers, first = np.unique(
        np.concatenate([side.nodes.ravel() for side in sides]), return_index=True
    )
    points = np.concatenate([side.points.reshape(-1, 3) for side in sides])[first]
    columns = np.searchsorted(numbers, jump.indices)
    compact = csr_array((jump.data, columns, jump.indptr), shape=(jump.shape[0], len(numbers)))
    # from their middle: differences of large coordinates lose digits
    return np.asarray(compact @ (points - points.mean(axis=0)))


@dataclass(frozen=True)
class MortarRows:
    """Jumps at the nodes of the secondary side, for those that the selected facets reach.

    Attributes:
        weights: (n,) area of each node that is in contact [length^2], 0 for others.
        jump: (n, nodes of V) sparse; secondary minus primary, times weight.
        rise: (n,) what the curvature of both sides takes from the gap, times weight.
    """

    weights: FloatArray
    jump: Any
    rise: FloatArray


@dataclass(frozen=True)
class _Overlap:
    """Overlaps of a chunk of pairs: sums over their quadrature points."""

    secondary: Indices
    primary: Indices
    hats: FloatArray
    values: FloatArray
    other: FloatArray
    rise: FloatArray
    piece: Indices
    area: FloatArray


def mortar_rows(
    secondary: Facets,
    nodes: SurfaceNodes,
    primary: Facets,
    primary_nodes: SurfaceNodes,
    selected: Indices,
    limit: float,
    columns: int,
) -> MortarRows:
    """Return the integrals of psi_i times the jump, for the multiplier basis psi.

    Each overlap of a secondary with a primary facet, both seen along the normal of the secondary
    one, is cut into triangles and integrated (Puso and Laursen 2004, Popp et al. 2010). Where the
    primary side has several layers the nearest one counts.

    Not collective.

    Args:
        secondary: facets of that side.
        nodes: their nodes.
        primary: facets of that side.
        primary_nodes: their nodes.
        selected: secondary facets to treat.
        limit: distance [length] beyond which nothing is in contact.
        columns: number of nodes of V.
    """
    n, corners, k = len(secondary.points), secondary.corners, secondary.nodes.shape[1]
    pieces, others = Pieces.of(secondary), Pieces.of(primary)
    covered = np.zeros(len(pieces.facet))
    hats, values = np.zeros((n, corners, corners)), np.zeros((n, corners, k))
    rise = np.zeros((n, corners))
    parts = []
    chunks = _chunks(pieces, others, selected, limit)
    integrate = _Integrator(secondary, nodes, primary, primary_nodes, pieces, others, limit)
    for first, second in chunks:
        overlap = integrate(first, second)
        np.add.at(hats, overlap.secondary, overlap.hats)
        np.add.at(values, overlap.secondary, overlap.values)
        np.add.at(rise, overlap.secondary, overlap.rise)
        np.add.at(covered, overlap.piece, overlap.area)
        parts.append((overlap.secondary, overlap.primary, overlap.other))

    missing = covered < (1.0 - COVERED) * integrate.piece_area
    full = np.bincount(pieces.facet, missing, minlength=n) == 0.0
    integrals = FacetIntegrals(hats, values)
    dual = dual_coefficients(integrals, full)
    weights = np.zeros(len(nodes.numbers))
    np.add.at(weights, nodes.facet_nodes, integrals.weights)
    heights = np.zeros(len(nodes.numbers))
    np.add.at(heights, nodes.facet_nodes, np.einsum("nab,nb->na", dual, rise))
    jump = rows(nodes, nodes.facet_nodes, secondary.nodes, dual @ values, columns)
    if parts:
        facet, other = (np.concatenate([part[i] for part in parts]) for i in range(2))
        block = dual[facet] @ np.concatenate([part[2] for part in parts])
        jump = jump - rows(nodes, nodes.facet_nodes[facet], primary.nodes[other], block, columns)
    return MortarRows(weights, without_rounding(jump.tocsr(), weights), heights)


def _chunks(
    pieces: Pieces, others: Pieces, selected: Indices, limit: float
) -> Iterator[tuple[Indices, Indices]]:
    """Yield pairs of pieces that may face each other; all pairs of one piece come together."""
    mine = np.flatnonzero(np.isin(pieces.facet, selected))
    if len(mine) == 0:
        return
    first, second = facing(
        pieces.centres[mine], pieces.normals[mine], pieces.radii[mine],
        others.centres, others.radii, limit,
    )  # fmt: skip
    first = mine[first]
    opposed = np.einsum("ni,ni->n", pieces.normals[first], others.normals[second]) < -FACING
    first, second = first[opposed], second[opposed]
    if len(first) == 0:
        return
    starts = np.unique(first, return_index=True)[1]
    ends = np.append(starts[1:], len(first))
    begin = 0
    for start, end in zip(starts, ends, strict=True):
        if end - begin > CHUNK and start > begin:
            yield first[begin:start], second[begin:start]
            begin = start
    yield first[begin:], second[begin:]


class _Integrator:
    """Integrates over the overlaps of pairs of pieces."""

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
        self._sag, self._primary_sag = Sag(secondary, nodes), Sag(primary, primary_nodes)
        degree = 1 + secondary.degree
        self._polynomial = secondary.affine and primary.affine
        if not self._polynomial:
            degree = 2 * degree + 4  # of a quotient: as many digits as matter
        self._rule = quadrature("interval" if secondary.dim == 1 else "triangle", degree)
        whole = pieces.points - pieces.centres[:, None]
        flat = np.einsum("nci,ndi->ncd", whole, self._frames[:, :-1])
        _, size, piece = overlaps(flat, flat)
        #: (pieces,) their sizes in their planes
        self.piece_area = np.bincount(piece, size, minlength=len(whole)).astype(np.float64)

    def _seen(self, piece: Indices, points: FloatArray) -> FloatArray:
        """Return points (n, k, 3) in the frames of pieces: along them, then their heights."""
        relative = points - self._pieces.centres[piece][:, None]
        return np.asarray(np.einsum("nki,ndi->nkd", relative, self._frames[piece]))

    def __call__(self, first: Indices, second: Indices) -> _Overlap:
        """Integrate over pairs of pieces, sorted by the first."""
        secondary, primary, dim = self._secondary, self._primary, self._secondary.dim
        simplices, size, pair = overlaps(
            self._seen(first, self._pieces.points[first])[:, :, :dim],
            self._seen(first, self._others.points[second])[:, :, :dim],
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
        facet, other = self._pieces.facet[first], self._others.facet[second]

        own = self._seen(first, secondary.points[facet])[point_pair]
        theirs = self._seen(first, primary.points[other])[point_pair]
        x_own = project(secondary, own[:, :, :dim], places)
        x_their = project(primary, theirs[:, :, :dim], places)
        hats = secondary.hats(x_own)
        values, others = secondary.basis(x_own), primary.basis(x_their)
        apart = np.einsum("nk,nk->n", others, theirs[:, :, dim]) - np.einsum(
            "nk,nk->n", values, own[:, :, dim]
        )
        weight = weight.ravel()
        weight = weight * (np.abs(apart) <= self._limit)
        weight = nearest_layer(first, pair, simplices, size, places, apart, weight, self.piece_area)
        area = weight
        if not secondary.plane:
            area = weight * self._stretch(facet[point_pair], x_own, first[point_pair])

        def summed(integrand: FloatArray) -> FloatArray:
            """Sum over the points of each pair, (pairs that overlap, ...)."""
            return np.asarray(np.add.reduceat(integrand, starts, axis=0))

        def products(right: FloatArray) -> FloatArray:
            """Sum area times hats times other functions over the points of each pair."""
            left = (area[:, None] * hats).reshape(-1, count, hats.shape[1])
            blocks = left.transpose(0, 2, 1) @ right.reshape(-1, count, right.shape[1])
            return np.asarray(np.add.reduceat(blocks, simplex_starts, axis=0))

        kept, simplex_starts = np.unique(pair, return_index=True)
        starts = simplex_starts * count
        rise = np.zeros(len(area))
        if self._sag.any:
            rise += self._sag.at(facet[point_pair], hats)
        if self._primary_sag.any:
            rise += self._primary_sag.at(other[point_pair], primary.hats(x_their))
        return _Overlap(
            secondary=facet[kept],
            primary=other[kept],
            hats=products(hats),
            values=products(values),
            other=products(others),
            rise=summed((area * rise)[:, None] * hats),
            piece=first[kept],
            area=summed(weight),
        )

    def _stretch(self, facet: Indices, x: FloatArray, piece: Indices) -> FloatArray:
        """Return the area (n,) of curved facets over that in the plane, at reference points."""
        vectors = self._secondary.area_vectors_at(facet, x)
        height = np.abs(np.einsum("ni,ni->n", vectors, self._pieces.normals[piece]))
        return np.asarray(np.linalg.norm(vectors, axis=1) / height)
