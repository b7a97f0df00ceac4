"""Mortar pairing: jumps of two surfaces, averaged by the dual basis."""

from __future__ import annotations

import logging
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask, scaled_rows
from dolfinx_tresca._base.parallel import errors_on_all_ranks, gather_rows, log, reduce_array
from dolfinx_tresca.pairing.contact_normal import nodal_contact_normals
from dolfinx_tresca.pairing.coupling import (
    Coupling,
    assemble_rows,
    drop_rounding,
    dual_coefficients,
    nodes_with_multipliers,
    owned_nodes,
    redistributed,
)
from dolfinx_tresca.pairing.group import PairGroup
from dolfinx_tresca.pairing.mortar_integrals import COVER_ROUNDING, MortarIntegrals
from dolfinx_tresca.pairing.search.facets import Facets
from dolfinx_tresca.pairing.search.nodes import FREE_PART, SurfaceNodes, node_sums
from dolfinx_tresca.pairing.search.tagged import any_known_surface
from dolfinx_tresca.scene.friction import DryFriction, Friction
from dolfinx_tresca.scene.pair import ContactPair

#: Least covered part of a node's area with which the node carries a multiplier. (At the limit
#: rounding would decide, so the limit is not a round number: no overlap by a round part of a cell,
#: such as 0.1 or 0.01, covers exactly this part of an area.)
LEAST_AREA_PART = 3e-4

#: A warning is logged if the penetration of bodies is less than this part of the sagitta (the
#: height of their curved surfaces over the facets). The error of the sagitta, 1 to 5 % of the
#: sagitta, may then be more than a tenth of the penetration.
CLOSE_FIT = 0.5

#: Bodies count as press-fitted if at least this part of the nodes penetrate. Bodies that only touch
#: may penetrate at a few nodes, by errors of the sagitta.
FITTED_PART = 0.25

#: Least mean of a node's hat function over the covered parts of its facets, relative to the mean
#: over whole facets, with which the node carries a multiplier. At nodes on the rim of the overlap,
#: corners included, this ratio is 1. At nodes beyond a straight rim it is 1 - d, where d is the
#: distance from the rim divided by the size of the facet: the limit admits d up to 0.12. If it were
#: 0.76 (twice this d), nodes just beyond a block's edge would have up to 1.5 times the pressure of
#: the nodes on the edge. If it were 0.94 (half this d), nodes of a circle of 16 segments would lose
#: their multipliers if they lie outside the chords of the other body's mesh.
LEAST_MEAN = 0.88

#: The limit in place of `LEAST_MEAN` if no facet within two facets of the node is fully covered. On
#: an overlap with a width of one or two facets `LEAST_MEAN` would leave a single line of nodes,
#: about which a body could rotate (tests/validation/test_random_floating.py, scene 3). With half
#: of this limit, nodes with a twentieth of their area covered would carry multipliers.
LEAST_MEAN_OF_FEW = 0.45

#: Relative difference of the diameters of two facets up to which they count as equally large.
SIZE_ROUNDING = 1e-6


def couple(
    V: Any,
    group: PairGroup,
    nodes: SurfaceNodes,
    other_nodes: SurfaceNodes,
    integrals: MortarIntegrals,
    shared: Mask,
    moved: bool,
) -> Coupling:
    """Find the jumps at secondary nodes by integrals over the overlap. Collective.

    The gap is the mean distance of the smooth surfaces along the contact normal: of the exact
    surfaces where they are known, else of the facets with the heights of fitted surfaces over them.

    Args:
        V: the space of the displacement.
        group: the contact pairs.
        nodes: nodes of the secondary side.
        other_nodes: nodes of the primary side.
        integrals: the integrals over the overlap.
        shared: (n,) whether a node belongs to both sides, and so has no multiplier.
        moved: whether the surfaces are displaced. There is then no warning of a close fit, since
            penetration is an error of the displacement.

    Raises:
        PairingError: no node can carry a multiplier.
    """
    pair, facets, others = group.surfaces, nodes.facets, other_nodes.facets
    without = nodes_without_multiplier(V, nodes, others, integrals, shared, pair.friction)
    with errors_on_all_ranks(V.mesh.comm):
        columns = V.dofmap.index_map.size_global
        rows = mortar_rows(nodes, others, integrals, columns, without)
    unpaired = rows.weights <= LEAST_AREA_PART * nodes.weights
    position = nodes_with_multipliers(V, pair, nodes, unpaired, shared)
    weights = rows.weights[position]
    facet, other = integrals.pairs.T
    corner = nodes.facet_nodes[facet]
    covered = redistributed(integrals.other.sum(axis=2)[:, :, None], ~without[corner])[:, :, 0]
    member = group.pair_of_tags[facets.tag_index[facet], others.tag_index[other]]
    areas = np.zeros((len(nodes.numbers), len(group.pairs)))
    np.add.at(areas, (corner, member[:, None]), covered)
    shares = areas[position]
    scale: Array = np.reciprocal(weights)
    jump, primary = (scaled_rows(matrix[position], scale) for matrix in (rows.jump, rows.primary))
    means = rows.means / np.where(rows.weights > 0.0, rows.weights, 1.0)[:, None]
    normals = nodal_contact_normals(means[:, 3:6], nodes)[position]
    means = means[position]
    gap, secondary_sagitta, sagitta = means[:, :3].T
    if not moved:
        # Functions of the dual basis are negative in part: a mean may be less than all distances
        # around the node. (The gap of moved surfaces must change as N says, or the positions of
        # finite sliding do not converge.)
        least: Array = np.full(len(nodes.numbers), np.inf)
        np.minimum.at(least, nodes.facet_nodes, integrals.least[:, None])
        gap = np.maximum(gap, least[position])
        if not any_known_surface(facets, others):
            _warn_of_close_fit(V.mesh.comm, pair, gap, sagitta)
    # only displacements of degree 2 can bend facets and so make up for the sagitta
    secondary_sagitta = secondary_sagitta * (facets.degree > 1)
    shares *= (weights / shares.sum(axis=1))[:, None]
    place = means[:, 6:]
    return Coupling(
        position, weights, shares, normals, jump, primary, gap, place, secondary_sagitta
    )


def _warn_of_close_fit(comm: MPI.Comm, pair: ContactPair, gap: Array, sagitta: Array) -> None:
    """Warn if nodes (n,) penetrate so little that errors of `sagitta` (n,) matter. Collective."""
    depth, height = reduce_array(
        comm, [(-gap).max(initial=0.0), np.abs(sagitta).max(initial=0.0)], MPI.MAX
    )
    inside, number = reduce_array(comm, [int((gap < 0.0).sum()), len(gap)])
    if 0.0 < depth < CLOSE_FIT * height and inside >= FITTED_PART * number:
        log(
            comm,
            "contact pair %s: bodies overlap by up to %.3g, but curved surfaces are up to %.3g off "
            "their facets, a height that nodes determine to some percent only: the error of "
            "pressures may be 10 %% or more. Give ContactPair(geometry=...), or use finer facets.",
            *(pair, depth, height),
            level=logging.WARNING,
            about=str(pair),
        )


class MortarRows(NamedTuple):
    """Weighted jumps at the nodes of the secondary side.

    Attributes:
        weights: (n,) covered area of each node [length^2, in 2D length].
        jump: (n, nodes of V) sparse matrix of the jump, secondary minus primary, times weight.
        primary: (n, nodes of V) sparse matrix of the primary part of the jump, times weight.
        means: (n, 9) six quantities of `MortarIntegrals.means` and the three coordinates of the
            point of application of the nodal forces, times weight.
    """

    weights: Array
    jump: Any
    primary: Any
    means: Array


def mortar_rows(
    nodes: SurfaceNodes,
    primary: Facets,
    integrals: MortarIntegrals,
    columns: int,
    without: Mask | None = None,
) -> MortarRows:
    """Integrate psi_i times the jump, for each function psi_i of the dual basis. Not collective.

    Args:
        nodes: nodes of the secondary side.
        primary: facets of the primary side.
        integrals: the integrals over the overlap.
        columns: number of nodes of V on all ranks.
        without: (n,) whether a node has no multiplier, so that its part of the overlap is
            distributed over the other nodes of its facets (`nodes_without_multiplier`); None if all
            nodes have multipliers.
    """
    corners, count = nodes.facet_nodes, len(nodes.numbers)
    carries = None if without is None else ~without[corners]
    dual = dual_coefficients(integrals.hats, integrals.full, carries)
    weights = integrals.hats.sum(axis=2)
    if carries is not None:
        weights = redistributed(weights[:, :, None], carries)[:, :, 0]
    weights = node_sums(corners, weights, count)
    own = dual @ integrals.values
    facet, other = integrals.pairs.T
    across = assemble_rows(
        nodes, corners[facet], primary.nodes[other], dual[facet] @ integrals.other, columns
    )
    jump = assemble_rows(nodes, corners, nodes.facets.nodes, own, columns) - across
    means = np.concatenate([dual @ integrals.means, own @ nodes.facets.points], axis=2)
    jump, across = (drop_rounding(matrix, nodes, corners, weights) for matrix in (jump, across))
    return MortarRows(weights, jump, across, node_sums(corners, means, count))


def nodes_without_multiplier(
    V: Any,
    nodes: SurfaceNodes,
    others: Facets,
    integrals: MortarIntegrals,
    shared: Mask,
    friction: Friction,
) -> Mask:
    """Return the nodes that give their part of the overlap to their neighbours. Collective.

    These are nodes beyond the rim of the overlap. A part of the area of such a node may be covered,
    but the node itself does not face the primary side. If it had a multiplier, the primary side
    would seem to extend up to the node: the nodal force would be as large as for a whole facet, and
    the pressure, this force divided by the covered area, would be far too large. With friction,
    nodes that are prescribed tangentially and face a coarser mesh are returned, too
    (`prescribed_before_coarser_facets`).

    If no corner of a facet would have a multiplier, the corner with the largest covered part keeps
    its multiplier.

    Args:
        V: the space of the displacement.
        nodes: nodes of the secondary side.
        others: facets of the primary side.
        integrals: the integrals over the overlap.
        shared: (n,) whether a node also belongs to the primary side.
        friction: the law of friction.

    Returns:
        (n,) whether the node has no multiplier; the same on all ranks that have the node.
    """
    corners, weights = nodes.facet_nodes, integrals.hats.sum(axis=2)
    count = len(nodes.numbers)
    covered = node_sums(corners, weights, count)
    whole = node_sums(corners, weights.mean(axis=1, keepdims=True), count)
    # if several patches of a node on a sharp edge are covered, all of them keep their multipliers
    _, number = np.unique(nodes.numbers, return_inverse=True)
    single: Mask = np.bincount(number, covered > 0.0)[number] == 1
    own = owned_nodes(V, nodes)

    def owners_flags(some: Mask) -> Mask:
        """Return for each node the flag (n,) on its owner, which has all facets at the node."""
        return np.isin(nodes.numbers, gather_rows(V.mesh.comm, nodes.numbers[some & own]))

    part = ~integrals.full & (weights.sum(axis=1) > 0.0)
    at_rim = _corners_of(corners, part, count)
    without = owners_flags(at_rim & (covered < LEAST_MEAN * whole))
    # `near` in three steps. First, the nodes at the rim that belong to fully covered facets. Then,
    # in addition, their neighbours at the rim. Last, all corners of each partly covered facet on
    # which one of these nodes has a multiplier
    near = owners_flags(at_rim & _corners_of(corners, integrals.full, count))
    near = owners_flags(
        at_rim & (near | _corners_of(corners, part & np.asarray(near)[corners].any(axis=1), count))
    )
    near = _corners_of(corners, part & (near & ~without)[corners].any(axis=1), count)
    without &= near | (covered < LEAST_MEAN_OF_FEW * whole)
    if isinstance(friction, DryFriction):
        without |= prescribed_before_coarser_facets(nodes, others, integrals)
    without = owners_flags((covered > 0.0) & without & single)
    carries = ~without & ~shared & nodes.free.any(axis=1)
    no_carrier = (weights.sum(axis=1) > 0.0) & ~carries[corners].any(axis=1)
    largest = weights >= (1.0 - COVER_ROUNDING) * weights.max(axis=1, keepdims=True)
    without[corners[no_carrier[:, None] & largest]] = False
    return owners_flags(without)


def prescribed_before_coarser_facets(
    nodes: SurfaceNodes, others: Facets, integrals: MortarIntegrals
) -> Mask:
    """Mark the nodes (n,) whose rows of T would be linearly dependent. Not collective.

    If the displacement of a node is prescribed along a tangent, friction acts on the primary body
    alone (`PairOperators`). In 3D the rows of T of such nodes along an edge are linearly dependent
    if the primary mesh is coarser. These nodes give their part of the overlap to their neighbours.

    The result is valid for nodes whose adjacent facets are all on this rank.

    Args:
        nodes: nodes of the secondary side.
        others: facets of the primary side.
        integrals: the integrals over the overlap.
    """
    facets, result = nodes.facets, np.zeros(len(nodes.numbers), dtype=np.bool_)
    if facets.dim == 1:
        return result
    movable = np.linalg.norm(nodes.normals[:, : nodes.free.shape[1]] * nodes.free, axis=1)
    primary_free = np.ones_like(nodes.free)
    facet, primary = integrals.pairs.T
    corner = nodes.facet_nodes[facet]
    node = corner.ravel()
    free: Mask = np.asarray(others.free.all(axis=1))
    free = free[primary]
    np.logical_and.at(primary_free, node, np.repeat(free, corner.shape[1], axis=0))
    finer = _diameters(facets)[facet] < (1.0 - SIZE_ROUNDING) * _diameters(others)[primary]
    np.logical_or.at(result, node, np.repeat(finer, corner.shape[1]))
    acts_on_primary = (~nodes.free & primary_free).any(axis=1)
    return np.asarray(result & (movable > FREE_PART) & acts_on_primary)


def _corners_of(corners: Indices, facets: Mask, count: int) -> Mask:
    """Return the mask (count,) of the nodes that are corners of facets in a mask.

    Args:
        corners: (n, k) corner nodes of each facet.
        facets: (n,) mask of facets.
        count: number of nodes.
    """
    result = np.zeros(count, dtype=np.bool_)
    result[corners[facets]] = True
    return result


def _diameters(facets: Facets) -> Array:
    """Return the largest distance (n,) of two corners of each facet [length]."""
    corners = facets.points[:, : facets.corners]
    squares = np.square(corners[:, :, None] - corners[:, None]).sum(axis=3)
    return np.asarray(np.sqrt(squares.max(axis=(1, 2))))
