"""Which secondary nodes carry multipliers; their jumps, gaps, normals and friction directions."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array, csr_array

from dolfinx_tresca._base.arrays import ROUNDING, Array, GlobalNumbers, Indices, Mask, dots, unit
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array, warn
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pairing.contact_normal import CANCELLED, OPPOSED_ANGLE
from dolfinx_tresca.pairing.facets import (
    FACING_COSINE,
    MISMATCH,
    NEGLIGIBLE,
    Facets,
    SurfaceNodes,
    free_normals,
    tangents,
)
from dolfinx_tresca.pairing.mortar_integrals import FacetIntegrals
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pieces import owners_flags, owns
from dolfinx_tresca.pairing.undeformed import Undeformed
from dolfinx_tresca.scene.friction import Bonded, Frictionless
from dolfinx_tresca.scene.pair import ContactPair

#: Least mean of a node's hat function over the covered parts of its facets, relative to the mean
#: over whole facets, with which the node carries a multiplier: 1 on the rim of the overlap, and
#: 1 - d at the distance of d facets beyond it. With 0.76, nodes just beyond a block's edge would
#: have up to 1.5 times the pressure on the edge; with 0.94, nodes of a circle of 16 segments none.
LEAST_MEAN = 0.88
#: The limit in place of `LEAST_MEAN` if no facet within two facets of the node is fully covered: on
#: an overlap as wide as one or two facets `LEAST_MEAN` would leave a line of nodes, about which a
#: body could rotate. With half of it, nodes with a twentieth of their area covered would count.
LEAST_MEAN_OF_FEW = 0.45
#: Least covered part of a node's area with which the node carries a multiplier: no round number,
#: since rounding would decide for overlaps by a round part of a cell, such as 0.1 or 0.01.
LEAST_AREA_PART = 3e-4
#: Penetration below which a fit is warned of, relative to the sagitta, whose error is 1 to 5 %.
CLOSE_FIT = 0.5
#: Part of the nodes that must penetrate for a press fit: errors of the sagitta bring in only a few.
FITTED_PART = 0.25
#: An entry of a matrix of means counts as rounding if it is at most this factor times the relative
#: rounding of the coordinates times the sum of the row's absolute entries.
ENTRY_ROUNDING = 8.0
#: Difference of the means of two patches of a node over the primary side, relative to the means, up
#: to which they face the same place. (With 0.5 friction is a sixth too small under a bolt's head.)
SAME_MEANS = 1e-3


def corners_that_carry(
    V: Any, nodes: SurfaceNodes, integrals: FacetIntegrals, shared: Mask
) -> Mask:
    """Return the mask (facets, corners) of corners with functions of the dual basis. Collective.

    Nodes beyond the rim of the overlap have none, and no multiplier: with the nodal force of a
    whole facet on the covered part of their area, their pressure would be far too large. Neighbours
    take over this part. If no corner of a covered facet is left, that with the largest covered part
    is. Prescribed nodes, and `shared` (n,) ones (on both sides or redundant), keep functions and
    areas, but get no multiplier in `nodes_with_multipliers`. All ranks decide alike.
    """
    corners, weights = nodes.facet_nodes, integrals.hats.sum(axis=2)
    is_covered = weights.sum(axis=1) > 0.0
    agreed = partial(owners_flags, V, nodes.numbers)
    # the integral of a node's hat function over the covered parts of its facets, and what it would
    # be if the function had the same mean on these parts as on whole facets
    covered = nodes.reduced(np.add, weights, 0.0)
    whole = nodes.reduced(np.add, weights.mean(axis=1, keepdims=True), 0.0)
    # nodes with a single covered patch; on a sharp edge, several covered patches keep multipliers
    _, number = np.unique(nodes.numbers, return_inverse=True)
    single: Mask = np.bincount(number, covered > 0.0)[number] == 1

    def corners_of(facets: Mask) -> Mask:
        """Return the mask (n,) of the nodes of facets in a mask."""
        return np.asarray(nodes.reduced(np.maximum, facets[:, None], False))

    partly = ~integrals.full & is_covered
    at_rim = corners_of(partly)
    without = agreed(at_rim & (covered < LEAST_MEAN * whole))
    # `LEAST_MEAN` decides at nodes that are `near` a fully covered facet, else `LEAST_MEAN_OF_FEW`.
    # `near` in three steps: nodes at the rim of fully covered facets; in addition, their neighbours
    # at the rim; last, all corners of partly covered facets where one of these has a multiplier
    near = agreed(at_rim & corners_of(integrals.full))
    beside = corners_of(partly & near[corners].any(axis=1))
    near = agreed(at_rim & (near | beside))
    keeps = near & ~without
    near = corners_of(partly & keeps[corners].any(axis=1))
    without &= near | (covered < LEAST_MEAN_OF_FEW * whole)
    without = agreed((covered > 0.0) & without & single)
    # if no corner of a covered facet has a multiplier, the corners with the largest covered part do
    carries = ~without & ~shared & nodes.free.any(axis=1)
    no_carrier = is_covered & ~carries[corners].any(axis=1)
    largest = weights >= (1.0 - MISMATCH) * weights.max(axis=1, keepdims=True)
    without[corners[no_carrier[:, None] & largest]] = False
    return np.asarray(~agreed(without)[corners])


def nodes_with_multipliers(
    V: Any, pair: ContactPair, nodes: SurfaceNodes, unpaired: Mask, shared: Mask
) -> Indices:
    """Return the indices in `nodes` of this rank's nodes that carry multipliers. Collective.

    `unpaired` (n,) nodes, valid on their owner, do not face the primary side. `shared` (n,) nodes
    are on both sides, or redundant. The log has the counts. If no rank has a node that carries, a
    PairingError is raised, except for finite sliding if nodes may carry in other positions.
    """
    comm, own = V.mesh.comm, owns(V, nodes.numbers)
    fixed, facing = ~nodes.free.any(axis=1), own & ~unpaired
    carries = facing & ~fixed & ~shared
    # this rank's nodes whose numbers are, in turn: total, paired, eligible, prescribed, common to
    # both sides or redundant, carrying multipliers, and carrying but prescribed in part
    masks = [own, facing, own & ~fixed & ~shared, facing & fixed, facing & ~fixed & shared, carries]
    masks.append(carries & ~nodes.free.all(axis=1))
    # a node on a sharp edge has an entry for each smooth patch, and counts once if any of them does
    counts = [len(np.unique(nodes.numbers[mask])) for mask in masks]
    total, paired, eligible, prescribed, common, carrying, partly = reduce_array(comm, counts)
    if carrying > 0:
        log(
            comm,
            "pairing: %s: %d of %d secondary nodes carry multipliers, %d of them prescribed in "
            "part; of the others %d face nothing, %d are prescribed and %d are on both sides",
            *(pair, carrying, total, partly, total - paired, prescribed, common),
        )
        return np.flatnonzero(carries)

    hint = ""
    if pair.obstacle is not None:  # whose normals may point into the body by mistake
        with errors_on_all_ranks(comm):
            _, normals = pair.obstacle.at(nodes.points[own])
        inwards = dots(normals, nodes.normals[own]) > 0.0
        count = comm.allreduce(len(np.unique(nodes.numbers[own][inwards])))
        if count:
            hint = (
                f" At {count} nodes the obstacle's normal is along the outward normal of the body, "
                "and so points into the body: it must point out of the obstacle, towards the "
                "surface that may touch it. Reverse it if the tag is right and the body has not "
                "passed the obstacle."
            )
    if eligible > 0 and pair.sliding == "finite":
        log(
            comm,
            "pairing: %s: no node that could carry a multiplier faces the other.%s",
            *(pair, hint),
            level=logging.WARNING if hint else logging.INFO,
            about=str(pair),
        )
        return np.flatnonzero(carries)

    # small sliding, or no node could carry a multiplier in any position: say why
    secondary, primary = pair.side("secondary"), pair.side("primary")
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


def couple(
    V: Any,
    undeformed: Undeformed,
    nodes: SurfaceNodes,
    primary: Facets | None,
    integrals: FacetIntegrals,
    carries: Mask,
    shared: Mask,
    displaced: bool,
) -> PairOperators:
    """Return N, T and the gap at the nodes of all pairs of a group. Collective.

    The jump at a node is the difference of the means over both sides, weighted with the node's
    function of the dual basis. The gap, 0 where bonded, is the mean distance along the contact
    normal of exact surfaces where they are known, else of facets with heights of fitted ones.

    `primary` are the facets of the primary side, None for an obstacle. `carries` (facets, corners)
    is from `corners_that_carry` or `obstacle_integrals`, and `shared` (n,) as there. If surfaces
    are `displaced`, penetration is an error of the displacement: no close fit is warned of.
    """
    group, facets, comm, dim = undeformed.group, nodes.facets, V.mesh.comm, V.mesh.geometry.dim
    pair, index_map = group.surfaces, V.dofmap.index_map
    width = index_map.size_global
    with errors_on_all_ranks(comm):
        spread = redistribution(carries)
        weights, own, opposite, means = _dual_means(nodes, primary, integrals, spread, width)

    # contact normals: the mean with dual functions, or, where this is far off since they are
    # negative in part, that with hat functions. Nodes that face nothing, and those whose contact
    # normals cancel, keep their own normals
    vectors = nodes.reduced(np.add, spread @ integrals.means[:, :, 3:], 0.0)
    dual_vectors = means[:, 3:6]
    lengths = np.linalg.norm(vectors, axis=1)
    dual_lengths = np.linalg.norm(dual_vectors, axis=1)
    near = dots(vectors, dual_vectors) > np.cos(OPPOSED_ANGLE) * lengths * dual_lengths
    cancel = lengths <= CANCELLED * weights
    vectors[near] = dual_vectors[near]
    vectors[cancel] = nodes.normals[cancel]
    normals = free_normals(vectors, nodes.free)
    if primary is None:  # measured along the mean normal, also where a component is prescribed
        means[:, :3] /= np.maximum(dots(unit(vectors), normals), FACING_COSINE)[:, None]
    gap, secondary_sagitta, sagitta = means[:, :3].T  # views of the means, (n,) each
    unpaired: Mask = weights <= LEAST_AREA_PART * nodes.weights
    if primary is None:
        unpaired |= np.abs(gap) > pair.search_limit
    kept = nodes_with_multipliers(V, pair, nodes, unpaired, shared)
    if primary is not None:
        # functions of the dual basis are negative in part: a mean may be less than all distances
        gap[:] = np.maximum(gap, nodes.reduced(np.minimum, integrals.least[:, None], np.inf))
        if not (displaced or facets.has_exact_surface):
            _warn_of_close_fit(comm, str(pair), gap[kept], sagitta[kept])

    # the share of each pair of the group in a node's area, from the areas of overlaps
    facet, partner = integrals.pairs.T
    column = partner if primary is None else primary.tag_index[partner]
    pair_index = group.pair_of_tags[facets.tag_index[facet], column]
    shares: Array = np.zeros((len(nodes.numbers), len(group.pairs)))
    areas = np.einsum("nij,njk->ni", spread[facet], integrals.partner)
    np.add.at(shares, (nodes.facet_nodes[facet], pair_index[:, None]), areas)

    # rows of the nodes with multipliers alone
    weights, shares = weights[kept], shares[kept]
    shares *= (weights / shares.sum(axis=1))[:, None]
    # the law at each node is that of the pair that has its multiplier
    owner = group.owners(shares)
    laws = [single.friction for single in group.pairs]
    bonded = np.array([isinstance(law, Bonded) for law in laws])[owner]
    frictionless = np.array([isinstance(law, Frictionless) for law in laws])[owner]
    normals, free, numbers = normals[kept, :dim], nodes.free[kept], nodes.numbers[kept]
    prescribed = np.linalg.norm(normals * free, axis=1) <= FACING_COSINE
    jump, opposite = (own - opposite)[kept], opposite[kept]
    # axes along which friction may act: where either side is free, if bonded the secondary side
    mobile = free
    if primary is not None:
        mobile = free | _primary_is_free(opposite, primary) & ~bonded[:, None]
    has_row, along, tangent_node = _rows_of_patches(numbers, opposite, normals, mobile, ~prescribed)
    rubs = ~frictionless[tangent_node]
    # distances within rounding of the coordinates are zero
    extent = reduce_array(comm, np.abs(facets.points).max(initial=0.0), MPI.MAX)
    is_zero = bonded | (np.abs(gap[kept]) <= ROUNDING * extent)
    distance = np.where(is_zero, 0.0, gap[kept])
    return PairOperators(
        bonded=False,
        nodes=(numbers - index_map.local_range[0]).astype(np.int32),
        weights=weights,
        shares=shares,
        areas=nodes.weights[kept],
        places=means[kept, 6 : 6 + dim],
        normals=normals,
        distance=distance,
        added_gap=np.zeros_like(distance),
        # only displacements of degree 2 can bend facets and so make up for the sagitta
        secondary_sagitta=secondary_sagitta[kept] * (facets.degree > 1),
        jump=jump,
        primary=opposite,
        prescribed=prescribed,
        has_normal_row=has_row,
        tangents=along[rubs],
        tangent_node=tangent_node[rubs].astype(np.int32),
        semi_axes=np.ones(rubs.sum()),
        undeformed=undeformed,
    )


def _dual_means(
    nodes: SurfaceNodes,
    primary: Facets | None,
    integrals: FacetIntegrals,
    spread: Array,
    width: int,
) -> tuple[Array, Any, Any, Array]:
    """Return means at secondary nodes, weighted with functions of the dual basis.

    The matrices `spread` (facets, corners, corners) are those of `redistribution`.

    Returns:
        the integrals (n,) of the functions, by which these are divided: the covered areas. Sparse
        matrices (n, `width`) of the means of a displacement over the secondary side and over the
        primary side, empty for an obstacle; `width` is the number of nodes of V. The means (n, 9)
        of the six quantities of `FacetIntegrals.means` and of the coordinates.
    """
    facets, corners = nodes.facets, nodes.facet_nodes
    weights = nodes.reduced(np.add, np.einsum("nij,njk->ni", spread, integrals.hats), 0.0)
    scale = 1.0 / np.where(weights > 0.0, weights, 1.0)
    # coefficients (facets, corners, corners) of hat functions in the functions with integral 1
    dual = dual_coefficients(integrals.hats, spread) * scale[corners][:, :, None]
    own_rows = dual @ integrals.values  # (facets, corners, k)
    own = assemble_rows(nodes, corners, facets.nodes, own_rows, width)
    opposite = csr_array(own.shape)
    if primary is not None:
        facet, partner = integrals.pairs.T
        rows = dual[facet] @ integrals.partner
        opposite = assemble_rows(nodes, corners[facet], primary.nodes[partner], rows, width)
    means = np.concatenate([dual @ integrals.means, own_rows @ facets.points], axis=2)
    return weights, own, opposite, nodes.reduced(np.add, means, 0.0)


def _warn_of_close_fit(comm: MPI.Comm, pair: str, gap: Array, sagitta: Array) -> None:
    """Warn if nodes (n,) overlap so little that errors of `sagitta` (n,) matter. Collective."""
    greatest = [(-gap).max(initial=0.0), np.abs(sagitta).max(initial=0.0)]
    depth, height = reduce_array(comm, greatest, MPI.MAX)
    # a press fit has many nodes inside; errors of the sagitta bring in only a few
    inside, count = reduce_array(comm, [int((gap < 0.0).sum()), len(gap)])
    if 0.0 < depth < CLOSE_FIT * height and inside >= FITTED_PART * count:
        warn(
            comm,
            "contact pair %s: bodies overlap by up to %.3g, but curved surfaces are up to %.3g off "
            "their facets, a height that nodes determine to some percent only: the error of "
            "pressures may be 10 %% or more. Give ContactPair(geometry=...), or use finer facets.",
            *(pair, depth, height),
            about=pair,
        )


def dual_coefficients(hats: Array, spread: Array) -> Array:
    """Return the coefficients (n, corners, corners) of hat functions in the dual basis functions.

    The basis psi is biorthogonal to the hat functions phi on the covered part of each facet
    (Wohlmuth 2000; Cichosz and Bischoff 2011): the integral of psi_i phi_j is that of phi_i for i =
    j, else zero. So a nodal pressure is the nodal force divided by the covered area. The hat
    functions of corners without multipliers are first added to the others, by the `spread` of
    `redistribution`; a facet without multipliers has no basis. The basis sums to 1: constant
    pressures are transferred exactly. `hats` (n, corners, corners) are integrals of phi_i phi_j.
    """
    every = np.eye(hats.shape[1])
    masses = spread @ hats @ spread.transpose(0, 2, 1)
    weights = masses.sum(axis=2)[:, :, None]
    # a mass matrix M of a strip is nearly singular; the coefficients (1 + t) D (M + t D)^-1, with
    # the row sums D of M, keep the sum of the basis for any t
    shifted = masses + ROUNDING * weights * every
    # corners without a function have zero rows: 1 on the diagonal makes the matrix regular
    shifted += np.logical_not(masses.any(axis=2))[:, :, None] * every
    return np.asarray((1.0 + ROUNDING) * weights * np.linalg.inv(shifted) @ spread)


def redistribution(receives: Mask) -> Array:
    """Return matrices (n, corners, corners) that distribute values at the corners of facets.

    The values of corners that do not receive are added in equal parts to those of the others, so
    that the sum over a facet does not change. If no corner receives, the matrix is zero.
    """
    # column j of a matrix distributes the value at corner j: a corner that receives keeps its value
    count = np.maximum(receives.sum(axis=1), 1)[:, None, None]
    shares = np.where(receives[:, None], np.eye(receives.shape[1]), 1.0 / count)
    return np.asarray(shares * receives[:, :, None])


def assemble_rows(
    nodes: SurfaceNodes, rows: Indices, columns: GlobalNumbers, values: Array, width: int
) -> Any:
    """Assemble blocks (n, corners, k) of facets, or of overlaps, into a matrix (nodes, width).

    The rows (n, corners) are indices in `nodes`, the columns (n, k) are global. Entries that are
    rounding errors (`ENTRY_ROUNDING`) are left out.
    """
    row, column = np.repeat(rows, values.shape[2], axis=1), np.tile(columns, values.shape[1])
    entries = values.ravel(), (row.ravel(), column.ravel())
    result = coo_array(entries, shape=(len(nodes.numbers), width)).tocsr()
    # the largest entry (n,) of each row that counts as rounding
    rounding = nodes.reduced(np.maximum, nodes.facets.rounding[:, None], 0.0)
    rounding *= ENTRY_ROUNDING * abs(result).sum(axis=1)
    least = np.repeat(rounding, np.diff(result.indptr))  # for each entry
    result.data[np.abs(result.data) <= least] = 0.0
    result.eliminate_zeros()
    return result


def _primary_is_free(primary: Any, facets: Facets) -> Mask:
    """Return along which axes (n, dim of space) all primary nodes opposite a node are free.

    `primary` (n, nodes of V) are the means over the primary side: only corners whose entries are
    not `NEGLIGIBLE` count. A node opposite to none is free along no axis.
    """
    entries = np.diff(primary.indptr)  # their number in each row
    row = np.repeat(np.arange(len(entries)), entries)
    counts = np.abs(primary.data) > NEGLIGIBLE
    result = np.repeat((entries > 0)[:, None], facets.free.shape[2], axis=1)
    for axis in range(facets.free.shape[2]):
        prescribed = facets.nodes[:, : facets.corners][~facets.free[:, :, axis]]
        result[row[counts & np.isin(primary.indices, prescribed)], axis] = False
    return result


def _rows_of_patches(
    numbers: GlobalNumbers, means: Any, normals: Array, free: Mask, moves: Mask
) -> tuple[Mask, Array, Indices]:
    """Return which patches (n,) have rows of N; and the tangents of rows of T, with their patch.

    The tangents (n_tangential, d) are directions along which friction may act.

    Patches of a node that face the same place, such as an edge in a groove with matching nodes,
    have the same jump: each has a row of N as long as these are linearly independent, and friction
    acts only along the edge, on the patch with the largest weight. Other patches, such as those of
    a bolt's head and its shank in a hole with clearance, are independent of each other.

    Patches are given as in `SurfaceNodes`, by `numbers` (n,) of nodes; with sparse `means` over the
    primary side (n, nodes of V); normals (n, d); `free` (n, d), axes along which friction may act;
    and `moves` (n,), whether the displacement is free along the normal, for patches that are alone.
    """
    has_row = moves.copy()
    # projections (n, d, d) onto the directions along which friction may act, the room for it
    room = free[:, :, None] * np.eye(free.shape[1])
    # which patches face the same place as the next: those of the same node, with the same means
    together = numbers[1:] == numbers[:-1]
    if together.any():
        lighter, heavier = means[:-1][together], means[1:][together]
        squares = (lighter.power(2) + heavier.power(2)).sum(axis=1)
        together[together] = (lighter - heavier).power(2).sum(axis=1) <= SAME_MEANS**2 * squares
    # runs of such patches; most nodes have a single patch. From the patch with the largest weight
    # on, the last, the normal of each takes its direction away from the room that is left
    limits = np.flatnonzero(np.diff(together, prepend=False, append=False))
    starts, ends = limits.reshape(-1, 2).T
    for start, end in zip(starts, ends, strict=True):
        left = room[end].copy()
        for i in range(end, start - 1, -1):
            own = left @ normals[i]
            length = np.linalg.norm(own)
            has_row[i] = length > FACING_COSINE
            if has_row[i]:
                left -= np.outer(own, own) / length**2
            room[i] = 0.0
        room[end] = left

    along = tangents(normals)
    keep = np.ones(along.shape[:2], dtype=np.bool_)
    # where not all directions are available, rotate the tangents to eigenvectors of the projection
    limited = np.flatnonzero((room != np.eye(normals.shape[1])).any(axis=(1, 2)))
    mobility = np.einsum("nai,nij,nbj->nab", along[limited], room[limited], along[limited])
    values, vectors = np.linalg.eigh(mobility)
    along[limited] = np.einsum("nba,nbi->nai", vectors, along[limited])
    keep[limited] = values > FACING_COSINE
    return has_row, along[keep], np.nonzero(keep)[0]
