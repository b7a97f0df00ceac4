"""Which nodes of the secondary side carry multipliers, and what to do if none does."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, gather_rows, log, reduce_array
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pairing.mortar_integrals import FacetIntegrals
from dolfinx_tresca.pairing.search.facets import MISMATCH, SurfaceNodes, node_sums
from dolfinx_tresca.scene.pair import ContactPair

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


def nodes_without_multiplier(
    V: Any, nodes: SurfaceNodes, integrals: FacetIntegrals, shared: Mask
) -> Mask:
    """Return the nodes that give their part of the overlap to their neighbours. Collective.

    These are nodes beyond the rim of the overlap. A part of the area of such a node may be covered,
    but the node itself does not face the primary side. If it had a multiplier, the primary side
    would seem to extend up to the node: the nodal force would be as large as for a whole facet, and
    the pressure, this force divided by the covered area, would be far too large.

    If no corner of a facet would have a multiplier, the corner with the largest covered part keeps
    its multiplier.

    Args:
        V: the space of the displacement.
        nodes: nodes of the secondary side.
        integrals: the integrals over the overlap.
        shared: (n,) whether a node also belongs to the primary side.

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

    def owners_flags(flags: Mask) -> Mask:
        """Return for each node the flag (n,) on its owner, which has all facets at the node."""
        return np.isin(nodes.numbers, gather_rows(V.mesh.comm, nodes.numbers[flags & own]))

    partial = ~integrals.full & (weights.sum(axis=1) > 0.0)
    at_rim = _corners_of(corners, partial, count)
    without = owners_flags(at_rim & (covered < LEAST_MEAN * whole))
    # `near` in three steps. First, the nodes at the rim that belong to fully covered facets. Then,
    # in addition, their neighbours at the rim. Last, all corners of each partly covered facet on
    # which one of these nodes has a multiplier
    near = owners_flags(at_rim & _corners_of(corners, integrals.full, count))
    near = owners_flags(
        at_rim & (near | _corners_of(corners, partial & near[corners].any(axis=1), count))
    )
    near = _corners_of(corners, partial & (near & ~without)[corners].any(axis=1), count)
    without &= near | (covered < LEAST_MEAN_OF_FEW * whole)
    without = owners_flags((covered > 0.0) & without & single)
    carries = ~without & ~shared & nodes.free.any(axis=1)
    no_carrier = (weights.sum(axis=1) > 0.0) & ~carries[corners].any(axis=1)
    largest = weights >= (1.0 - MISMATCH) * weights.max(axis=1, keepdims=True)
    without[corners[no_carrier[:, None] & largest]] = False
    return owners_flags(without)


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


def owned_nodes(V: Any, nodes: SurfaceNodes) -> Mask:
    """Return whether this rank owns each of the nodes, (n,). Not collective."""
    low, high = V.dofmap.index_map.local_range
    return np.asarray((nodes.numbers >= low) & (nodes.numbers < high))


def nodes_with_multipliers(
    V: Any, pair: ContactPair, nodes: SurfaceNodes, unpaired: Mask, shared: Mask
) -> Indices:
    """Return the indices of this rank's nodes that carry multipliers; log the counts. Collective.

    Args:
        V: the space of the displacement.
        pair: the contact pair.
        nodes: the secondary nodes.
        unpaired: (n,) whether a node does not face the primary side; valid for owned nodes.
        shared: (n,) whether a node also belongs to the primary side, and so has no multiplier; for
            a surface that touches itself, see `redundant_nodes`.

    Raises:
        PairingError: no node of any rank carries a multiplier. With finite sliding this is not an
            error if nodes could carry multipliers in other positions of the bodies.
    """
    comm, own = V.mesh.comm, owned_nodes(V, nodes)
    fixed, facing = ~nodes.free.any(axis=1), own & ~unpaired
    carries = facing & ~fixed & ~shared
    masks = [own, facing, own & ~fixed & ~shared, facing & fixed, facing & ~fixed & shared, carries]
    masks.append(carries & ~nodes.free.all(axis=1))
    # a node on a sharp edge has an entry for each smooth patch; it is paired if any entry is paired
    counts = [len(np.unique(nodes.numbers[mask])) for mask in masks]
    total, paired, eligible, prescribed, common, number, partly = reduce_array(comm, counts)
    position = np.flatnonzero(carries)
    if number > 0:
        log(
            comm,
            "pairing: %s: %d of %d secondary nodes carry multipliers, %d of them prescribed in "
            "part; of the others %d face nothing, %d are prescribed and %d are on both sides",
            *(pair, number, total, partly, total - paired, prescribed, common),
        )
        return position
    hint, secondary, primary = "", pair.side("secondary"), pair.side("primary")
    if pair.obstacle is not None:
        with errors_on_all_ranks(comm):
            _, normals = pair.obstacle.at(nodes.points[own])
        along = np.einsum("ni,ni->n", normals, nodes.normals[own]) > 0.0
        reversed_nodes = comm.allreduce(len(np.unique(nodes.numbers[own][along])))
        if reversed_nodes:
            hint = (
                f" At {reversed_nodes} nodes the obstacle's normal is along the outward normal of "
                "the body, and so points into the body: it must point out of the obstacle, towards "
                "the surface that may touch it. Reverse it if the tag is right."
            )
    if eligible > 0 and pair.sliding == "finite":
        log(
            comm,
            "pairing: %s: no node that could carry a multiplier faces the other.%s",
            *(pair, hint),
            level=logging.WARNING if hint else logging.INFO,
            about=str(pair),
        )
        return position
    if paired > 0:
        raise PairingError(
            f"no node of the secondary side ({secondary}) can carry a multiplier: of its {total} "
            f"nodes {total - paired} do not face the primary side ({primary}), {prescribed} are "
            f"prescribed and {common} shared with it. Check the tags and the Dirichlet conditions."
        )
    limited = pair.search_distance is not None
    within = f" within {pair.search_distance:g}" if limited else ""
    limits = " and the search distance" if limited else ""
    if pair.touches_itself:
        raise PairingError(
            f"no part of the surface ({secondary}) can touch another one: from none of its "
            f"{total} nodes the outward normal leads to the surface of another body, or to "
            f"another part of the same body{within}. Check the tag{limits}; for parts that "
            'meet only when the body has moved take sliding="finite".'
        )
    raise PairingError(
        f"the surfaces do not face each other: from none of the {total} nodes of the secondary "
        f"side ({secondary}) the outward normal leads to the primary side "
        f"({primary}){within}. Check the tags{limits}.{hint}"
    )
