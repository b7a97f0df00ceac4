"""Mortar pairing: jumps weighed over the facets, for surfaces whose meshes do not match."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import csr_array, diags_array

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array
from dolfinx_tresca.pairing.coupling import Coupling, nodes_with_multipliers
from dolfinx_tresca.pairing.dual_basis import (
    assembled_rows,
    dual_coefficients,
    moved_to,
    places,
    without_rounding,
)
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.rim import nodes_without_multiplier
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import SurfaceNodes
from dolfinx_tresca.surface.offsets import any_known_surface

#: Part of a node's area that must be in contact for it to carry a multiplier. (Overlaps by a tenth
#: of a cell, or a tenth of that, are not at this limit, where rounding would decide.)
LEAST_AREA_PART = 3e-4

#: Overlap of bodies over the height of their surfaces over facets, up to which errors of the height
#: are a tenth of the overlap and more: 1 to 5 % of it were seen.
CLOSE_FIT = 0.5

#: Part of the nodes that overlap, from which on bodies are fitted: those that touch do so at a few,
#: by errors of the height.
FITTED = 0.25


def couple(
    V: Any,
    pair: ContactPair,
    facets: Facets,
    nodes: SurfaceNodes,
    others: Facets,
    integrals: MortarIntegrals,
    reason: str,
) -> Coupling:
    """Couple by integrals over the overlap of two surfaces. Collective.

    The gap is the distance of the surfaces that facets stand for, where the pair knows one of them.
    Else it is the jump of the positions, as if they were displacements, less what the curvature of
    both sides takes from it.

    Raises:
        PairingError: no node can carry a multiplier.
    """
    shared = np.isin(nodes.numbers, others.nodes)
    without = nodes_without_multiplier(V, facets, nodes, others, integrals, shared, pair.friction)
    with errors_on_all_ranks(V.mesh.comm):
        columns = V.dofmap.index_map.size_global
        found = mortar_rows(facets, nodes, others, integrals, columns, without)
    unpaired = found.weights <= LEAST_AREA_PART * nodes.weights
    position = nodes_with_multipliers(V, pair, nodes, unpaired, shared, "mortar", reason)
    weights = found.weights[position]
    scale = diags_array(1.0 / weights)
    jump = (scale @ found.jump[position]).tocsr()
    primary = (scale @ found.primary[position]).tocsr()
    place = found.places[position] / weights[:, None]
    normals = nodes.normals[position]
    along = normals / weights[:, None]
    if any_known_surface(facets, others):
        gap_vector = found.distance[position][:, None] * along
    else:
        gap_vector = -_of_positions(jump, [facets, others])
        gap_vector -= found.sagitta[position][:, None] * along
        if pair.sliding == "small":  # else the bodies may be in any configuration
            gap = np.einsum("ni,ni->n", gap_vector, normals)
            _warn_of_close_fit(V.mesh.comm, pair, gap, found.sagitta[position] / weights)
    # of degree 1 no displacement bends facets: there the height is all that tells of bending
    raised = found.raised[position] / weights * (facets.degree > 1)
    return Coupling("mortar", position, weights, normals, jump, primary, gap_vector, place, raised)


def _warn_of_close_fit(comm: MPI.Comm, pair: ContactPair, gap: Array, sagitta: Array) -> None:
    """Log where bodies overlap by less than what curved facets hide of it. Collective."""
    depth, height = reduce_array(
        comm, [(-gap).max(initial=0.0), np.abs(sagitta).max(initial=0.0)], MPI.MAX
    )
    inside, number = reduce_array(comm, [int((gap < 0.0).sum()), len(gap)])
    if 0.0 < depth < CLOSE_FIT * height and inside >= FITTED * number:
        log(
            comm,
            "contact pair %s: bodies overlap by up to %.3g, but curved surfaces are up to %.3g off "
            "their facets, which nodes tell to some hundredths only: pressures may be wrong by a "
            "tenth and more. Give ContactPair(geometry=...), or take finer facets.",
            *(pair, depth, height),
            level=logging.WARNING,
            about=str(pair),
        )


def _of_positions(jump: Any, sides: list[Facets]) -> Array:
    """Return what a jump (n, nodes of V) makes of the nodes' positions, (n, 3)."""
    numbers, first = np.unique(
        np.concatenate([side.nodes.ravel() for side in sides]), return_index=True
    )
    points = np.concatenate([side.points.reshape(-1, 3) for side in sides])[first]
    columns = np.searchsorted(numbers, jump.indices)
    compact = csr_array((jump.data, columns, jump.indptr), shape=(jump.shape[0], len(numbers)))
    # from their middle: differences of large coordinates lose digits
    return np.asarray(compact @ (points - points.sum(axis=0) / max(len(points), 1)))


@dataclass(frozen=True)
class MortarRows:
    """Jumps at the nodes of the secondary side, for those that the treated facets reach.

    Attributes:
        weights: (n,) area of each node that is in contact [length^2], 0 for others.
        jump: (n, nodes of V) sparse; secondary minus primary, times weight.
        primary: (n, nodes of V) sparse; what is subtracted there, times weight.
        sagitta: (n,) heights of both curved surfaces over their facets, times weight.
        raised: (n,) the part of that which the secondary surface has.
        distance: (n,) of the surfaces, times weight, where one is known.
        places: (n, 3) where forces on the secondary side act, times weight.
    """

    weights: Array
    jump: Any
    primary: Any
    sagitta: Array
    raised: Array
    distance: Array
    places: Array


def mortar_rows(
    secondary: Facets,
    nodes: SurfaceNodes,
    primary: Facets,
    integrals: MortarIntegrals,
    columns: int,
    without: Mask | None = None,
) -> MortarRows:
    """Return the integrals of psi_i times the jump, for the multiplier basis psi. Not collective.

    Args:
        secondary: facets of that side.
        nodes: their nodes.
        primary: facets of the other side.
        integrals: over their overlap.
        columns: number of nodes of V.
        without: (n,) nodes without a multiplier, whose part in the overlap the other nodes of
            their facets take; see `rim.nodes_without_multiplier`. None: no node.
    """
    carries = None if without is None else ~without[nodes.facet_nodes]
    dual = dual_coefficients(integrals.own, integrals.full, carries)
    weights = integrals.own.weights
    if carries is not None:
        weights = moved_to(weights[:, :, None], carries)[:, :, 0]

    def summed(values: Array) -> Array:
        sums = np.bincount(nodes.facet_nodes.ravel(), values.ravel(), minlength=len(nodes.numbers))
        return sums.astype(np.float64)

    weights = summed(weights)
    own = dual @ integrals.own.values
    jump = assembled_rows(nodes, nodes.facet_nodes, secondary.nodes, own, columns)
    facet, other = integrals.secondary, integrals.primary
    block = dual[facet] @ integrals.other
    across = assembled_rows(nodes, nodes.facet_nodes[facet], primary.nodes[other], block, columns)
    jump = without_rounding((jump - across).tocsr(), weights)
    heights, raised, distance = (
        summed(np.einsum("nab,nb->na", dual, of_hats))
        for of_hats in (integrals.sagitta, integrals.raised, integrals.distance)
    )
    acting = places(nodes, nodes.facet_nodes, secondary.points, own)
    return MortarRows(
        weights, jump, without_rounding(across, weights), heights, raised, distance, acting
    )
