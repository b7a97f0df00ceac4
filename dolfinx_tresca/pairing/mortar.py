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
from dolfinx_tresca.pairing.overlap import OverlapIntegrals
from dolfinx_tresca.surface.facets import Facets, FloatArray
from dolfinx_tresca.surface.nodes import SurfaceNodes
from dolfinx_tresca.surface.pieces import Pieces
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
        found = mortar_rows(
            facets, nodes, others, other_nodes, selected, pair.search_limit, columns
        )
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
    integrate = OverlapIntegrals(secondary, nodes, primary, primary_nodes, pieces, others, limit)
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
