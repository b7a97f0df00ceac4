"""The jump at secondary nodes: who carries multipliers, the dual basis, gaps and normals."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array, csr_array

from dolfinx_tresca._base.arrays import ROUNDING, Array, GlobalNumbers, Indices, Mask, scaled_rows
from dolfinx_tresca._base.parallel import errors_on_all_ranks, gather_rows, log, reduce_array
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pairing.contact_normal import CANCELLED
from dolfinx_tresca.pairing.group import PairGroup
from dolfinx_tresca.pairing.mortar_integrals import FacetIntegrals
from dolfinx_tresca.pairing.search.facets import (
    FACING_COSINE,
    Facets,
    SurfaceNodes,
    free_normals,
    node_sums,
)
from dolfinx_tresca.pairing.search.tagged import any_known_surface
from dolfinx_tresca.pairing.search.visibility import COVER_ROUNDING
from dolfinx_tresca.scene.obstacle import RigidObstacle
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

#: An entry of a weighted jump counts as rounding if it is at most this factor times the relative
#: rounding of the coordinates times the sum of the row. (Integrals over overlaps are sums of
#: differences of coordinates.)
ENTRY_ROUNDING = 8.0

#: Least eigenvalue of the scaled mass matrix of a covered part. If an eigenvalue is smaller, the
#: inverse of the matrix would amplify rounding, and a shift raises the eigenvalue to this value
#: (`_regularised_dual`). This occurs only if the covered part is a strip or a corner of some
#: thousandths of the facet.
LEAST_EIGENVALUE = 1e-6


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


@dataclass(frozen=True)
class Coupling:
    """The jump of the displacement at secondary nodes of this rank.

    The rows of `jump` apply to each component of the displacement. `PairOperators` combines the
    components along normals and tangents, which gives N and T.

    Attributes:
        position: (n,) indices of the nodes in the secondary side's `SurfaceNodes`, which may have
            several entries for a node on a sharp edge.
        weights: (n,) covered area of each node: the part that faces the primary side [length^2, in
            2D length].
        shares: (n, pairs) part of each node's weight that belongs to each pair of the group.
        normals: (n, 3) contact normals, which point out of the secondary side.
        jump: (n, nodes of V) sparse matrix of the jump, secondary minus primary, with global column
            numbers.
        primary: (n, nodes of V) sparse matrix of the primary part, which is subtracted in `jump`.
            Rows sum to 1, or are empty for an obstacle.
        gap: (n,) distance of the sides along the contact normal, positive if open [length].
        place: (n, 3) points of application of the resultant nodal forces on the secondary side
            [length].
        secondary_sagitta: (n,) height of the curved secondary surface over its straight facets,
            which reduces the gap [length]; zero for degree 1.
    """

    position: Indices
    weights: Array
    shares: Array
    normals: Array
    jump: Any
    primary: Any
    gap: Array
    place: Array
    secondary_sagitta: Array


def couple(
    V: Any,
    group: PairGroup,
    nodes: SurfaceNodes,
    primary: Facets | None,
    integrals: FacetIntegrals,
    carries: Mask,
    shared: Mask,
    moved: bool,
    measured: Array | None = None,
) -> Coupling:
    """Find the jumps at secondary nodes by integrals over facets that face the other side.

    The gap is the mean distance of the smooth surfaces along the contact normal: of the exact
    surfaces where they are known, else of the facets with the heights of fitted surfaces over them.
    Collective.

    Args:
        V: the space of the displacement.
        group: the contact pairs.
        nodes: nodes of the secondary side.
        primary: facets of the primary side; None for an obstacle.
        integrals: the integrals over the facets.
        carries: (facets, corners) whether a corner has a multiplier; the part of other corners is
            distributed over the facet's corners that have.
        shared: (n,) whether a node belongs to both sides, and so has no multiplier.
        moved: whether the surfaces are displaced. There is then no warning of a close fit, since
            penetration is an error of the displacement.
        measured: (n, 3) unit vectors along which the distances in `integrals` are measured; None:
            along the contact normals.

    Raises:
        PairingError: no node can carry a multiplier.
    """
    pair, facets, count = group.surfaces, nodes.facets, len(nodes.numbers)
    with errors_on_all_ranks(V.mesh.comm):
        columns = V.dofmap.index_map.size_global
        rows = mortar_rows(nodes, primary, integrals, columns, carries)
    scale: Array = 1.0 / np.where(rows.weights > 0.0, rows.weights, 1.0)
    means = scale[:, None] * rows.means
    # nodes that face nothing, and those whose contact normals cancel, keep their own normals
    kept = np.linalg.norm(means[:, 3:6], axis=1) <= CANCELLED
    normals = free_normals(np.where(kept[:, None], nodes.normals, means[:, 3:6]), nodes.free)
    if measured is not None:
        cosine = np.maximum(np.einsum("ni,ni->n", measured, normals), FACING_COSINE)
        means[:, :3] /= cosine[:, None]
    gap, secondary_sagitta, sagitta = means[:, :3].T
    unpaired: Mask = rows.weights <= LEAST_AREA_PART * nodes.weights
    if primary is None:
        unpaired |= np.abs(gap) > pair.search_limit
    position = nodes_with_multipliers(V, pair, nodes, unpaired, shared)
    if primary is None:
        facet, column = np.arange(len(facets.points)), np.zeros(1, dtype=np.intp)
        sizes = integrals.hats.sum(axis=2)
    else:
        facet, partner = integrals.pairs.T
        column, sizes = primary.tag_index[partner], integrals.partner.sum(axis=2)
    sizes = redistributed(sizes[:, :, None], carries[facet])[:, :, 0]
    shares: Array = np.zeros((count, len(group.pairs)))
    member = group.pair_of_tags[facets.tag_index[facet], column]
    np.add.at(shares, (nodes.facet_nodes[facet], member[:, None]), sizes)
    weights, shares = rows.weights[position], shares[position]
    shares *= (weights / shares.sum(axis=1))[:, None]
    if not moved and primary is not None:
        # Functions of the dual basis are negative in part: a mean may be less than all distances
        # around the node. (The gap of moved surfaces must change as N says, or the positions of
        # finite sliding do not converge.)
        least: Array = np.full(count, np.inf)
        np.minimum.at(least, nodes.facet_nodes, integrals.least[:, None])
        gap[:] = np.maximum(gap, least)
        if not any_known_surface(facets, primary):
            _warn_of_close_fit(V.mesh.comm, str(pair), gap[position], sagitta[position])
    return Coupling(
        position,
        weights,
        shares,
        normals[position],
        scaled_rows(rows.jump[position], scale[position]),
        scaled_rows(rows.primary[position], scale[position]),
        gap[position],
        means[position, 6:],
        # only displacements of degree 2 can bend facets and so make up for the sagitta
        secondary_sagitta[position] * (facets.degree > 1),
    )


def _warn_of_close_fit(comm: MPI.Comm, pair: str, gap: Array, sagitta: Array) -> None:
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
            about=pair,
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
    primary: Facets | None,
    integrals: FacetIntegrals,
    columns: int,
    carries: Mask,
) -> MortarRows:
    """Integrate psi_i times the jump, for each function psi_i of the dual basis. Not collective.

    Args:
        nodes: nodes of the secondary side.
        primary: facets of the primary side; None for an obstacle.
        integrals: the integrals over the facets.
        columns: number of nodes of V on all ranks.
        carries: (facets, corners) whether a corner has a multiplier, see `couple`.
    """
    corners, count = nodes.facet_nodes, len(nodes.numbers)
    dual = dual_coefficients(integrals.hats, integrals.full, carries)
    weights = redistributed(integrals.hats.sum(axis=2)[:, :, None], carries)[:, :, 0]
    weights = node_sums(corners, weights, count)
    own = dual @ integrals.values
    jump = assemble_rows(nodes, corners, nodes.facets.nodes, own, columns)
    across = csr_array(jump.shape)
    if primary is not None:
        facet, partner = integrals.pairs.T
        blocks = dual[facet] @ integrals.partner
        across = assemble_rows(nodes, corners[facet], primary.nodes[partner], blocks, columns)
        jump = jump - across
    means = np.concatenate([dual @ integrals.means, own @ nodes.facets.points], axis=2)
    return MortarRows(weights, jump, across, node_sums(corners, means, count))


def dual_coefficients(hats: Array, full: Mask, carries: Mask) -> Array:
    """Return the coefficients (n, corners, corners) of hat functions in the dual basis functions.

    The basis psi is biorthogonal to the hat functions phi on the covered part of each facet
    (Wohlmuth 2000; Cichosz and Bischoff 2011): the integral of psi_i phi_j is the integral of phi_i
    for i = j, and zero otherwise. So a nodal pressure is the nodal force divided by the node's
    covered area. If corners have no multiplier, their hat functions are first added, in equal
    parts, to the hat functions of the other corners of the facet, and the basis is biorthogonal to
    these sums. In both cases the basis functions sum to 1, so that constant pressures are
    transferred exactly.

    Args:
        hats: (n, corners, corners) integrals of the products of two hat functions over the covered
            parts of facets.
        full: (n,) whether the whole facet is covered, so that no regularisation is needed.
        carries: (n, corners) whether a corner carries a multiplier. A facet without such corners
            has no basis functions.
    """
    weights, corners = hats.sum(axis=2), hats.shape[1]
    result = np.zeros_like(hats)
    plain = full & carries.all(axis=1)
    result[plain] = weights[plain][:, :, None] * np.linalg.inv(hats[plain])
    partial = ~plain & (weights.sum(axis=1) > 0.0)
    sums = redistributed(np.broadcast_to(np.eye(corners), hats[partial].shape), carries[partial])
    result[partial] = _regularised_dual(sums @ hats[partial] @ sums.transpose(0, 2, 1)) @ sums
    return result


def _regularised_dual(masses: Array) -> Array:
    """Return the coefficients (n, k, k) of each facet's dual basis, whose k functions sum to 1.

    With the mass matrix M, the diagonal matrix D of its row sums and S = D^-1/2 M D^-1/2, the
    coefficients are D M^-1. If the covered part is a narrow strip, M is nearly singular, and the
    coefficients are (1 + t) D (M + t D)^-1 with the least t for which the eigenvalues of S + t I
    are at least `LEAST_EIGENVALUE`. Since M 1 = D 1, the basis sums to 1 for any t; it is
    biorthogonal for t = 0 only.

    Args:
        masses: (n, k, k) mass matrices of the functions from which the bases are formed, which sum
            to 1; a zero row stands for a missing function.
    """
    weights: Array = masses.sum(axis=2)
    absent: Mask = np.logical_not(masses.any(axis=2))
    # on a sliver at the opposite corner, rounding may make the integral of a hat function negative
    weights = np.maximum(weights, ROUNDING * weights.sum(axis=1, keepdims=True))
    root = np.sqrt(np.where(absent, 1.0, weights))
    scaled = masses / (root[:, :, None] * root[:, None, :])
    scaled += absent[:, :, None] * np.eye(masses.shape[2])
    least = np.linalg.eigvalsh(scaled)[:, :1, None]
    shift = np.maximum(LEAST_EIGENVALUE - least, 0.0)
    inverse = np.linalg.inv(scaled + shift * np.eye(masses.shape[2]))
    return np.asarray((1.0 + shift) * root[:, :, None] * inverse / root[:, None, :])


def redistributed(values: Array, receives: Mask) -> Array:
    """Distribute the values of corners that are not in `receives` over the corners in `receives`.

    The sum over the corners of a facet does not change, so that a facet transfers a constant
    pressure even if some of its corners have no multiplier.

    Args:
        values: (n, corners, k) values at the corners of facets.
        receives: (n, corners) whether a corner receives values of other corners, in equal parts.

    Returns:
        The new values (n, corners, k), zero at corners that are not in `receives`.
    """
    number = np.maximum(receives.sum(axis=1), 1)[:, None, None]
    lost = np.where(receives[:, :, None], 0.0, values).sum(axis=1, keepdims=True)
    return np.where(receives[:, :, None], values + lost / number, 0.0)


def assemble_rows(
    nodes: SurfaceNodes, rows: Indices, columns: GlobalNumbers, values: Array, width: int
) -> Any:
    """Assemble dense blocks, one for each facet, into a sparse matrix (nodes, width).

    Entries that are rounding errors (`ENTRY_ROUNDING`) are left out.

    Args:
        nodes: the secondary nodes, one row for each.
        rows: (n, corners) indices in `nodes` of the rows of each block.
        columns: (n, k) global numbers of the columns of each block.
        values: (n, corners, k) the blocks.
        width: number of columns of the matrix.
    """
    places = np.repeat(rows, values.shape[2], axis=1), np.tile(columns, values.shape[1])
    entries = values.ravel(), (places[0].ravel(), places[1].ravel())
    result = coo_array(entries, shape=(len(nodes.numbers), width)).tocsr()
    rounding = np.zeros(len(nodes.numbers))
    np.maximum.at(rounding, nodes.facet_nodes, nodes.facets.rounding[:, None])
    rounding *= ENTRY_ROUNDING * abs(result).sum(axis=1)
    result.data[np.abs(result.data) <= np.repeat(rounding, np.diff(result.indptr))] = 0.0
    result.eliminate_zeros()
    return result


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
    largest = weights >= (1.0 - COVER_ROUNDING) * weights.max(axis=1, keepdims=True)
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
    if isinstance(pair.primary, RigidObstacle):
        with errors_on_all_ranks(comm):
            _, normals = pair.primary.at(nodes.points[own])
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
