"""The jump at secondary nodes: the dual basis, gaps, normals and directions of friction."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array, csr_array

from dolfinx_tresca._base.arrays import (
    ROUNDING,
    Array,
    GlobalNumbers,
    Indices,
    LocalNumbers,
    Mask,
    scaled_rows,
)
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array, warn
from dolfinx_tresca.pairing.contact_normal import CANCELLED
from dolfinx_tresca.pairing.group import Undeformed
from dolfinx_tresca.pairing.mortar_integrals import FacetIntegrals
from dolfinx_tresca.pairing.multipliers import nodes_with_multipliers
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.search.facets import (
    FACING_COSINE,
    NEGLIGIBLE,
    Facets,
    SurfaceNodes,
    free_normals,
    node_sums,
    tangents,
)
from dolfinx_tresca.pairing.search.tagged import any_known_surface
from dolfinx_tresca.scene.friction import Bonded, Frictionless

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

#: Difference of the means of two patches of a node over the primary side, relative to the means,
#: up to which the patches face the same place. (With 0.5 the rim of a hole has no friction in its
#: radial direction under the head of a bolt, whose friction is a sixth too small.)
SAME_MEANS = 1e-3


def couple(
    V: Any,
    undeformed: Undeformed,
    nodes: SurfaceNodes,
    primary: Facets | None,
    integrals: FacetIntegrals,
    carries: Mask,
    shared: Mask,
    moved: bool,
    bodies: Indices | None = None,
) -> PairOperators:
    """Find the jumps at secondary nodes by integrals over facets that face the other side.

    The gap is the mean distance of the smooth surfaces along the contact normal: of the exact
    surfaces where they are known, else of the facets with the heights of fitted surfaces over them.
    Directions in which the displacement is prescribed have no rows; for exceptions see
    `PairOperators`. The result has the nodes of all pairs of the group. Collective.

    Args:
        V: the space of the displacement.
        undeformed: the undeformed surfaces, with the pairs and their laws.
        nodes: nodes of the secondary side.
        primary: facets of the primary side; None for an obstacle.
        integrals: the integrals over the facets.
        carries: (facets, corners) whether a corner has a multiplier; the part of other corners is
            distributed over the facet's corners that have.
        shared: (n,) whether a node belongs to both sides, and so has no multiplier.
        moved: whether the surfaces are displaced. There is then no warning of a close fit, since
            penetration is an error of the displacement.
        bodies: (n,) number of the body that a node faces; None if all face the same body. Smooth
            patches of a node on a sharp edge (`SurfaceNodes`) that face different bodies are
            treated like different nodes.

    Raises:
        PairingError: no node can carry a multiplier.
    """
    group, facets, count = undeformed.group, nodes.facets, len(nodes.numbers)
    pair, comm, dim = group.surfaces, V.mesh.comm, V.mesh.geometry.dim
    with errors_on_all_ranks(comm):
        columns = V.dofmap.index_map.size_global
        weights, jump, across, means = mortar_rows(nodes, primary, integrals, columns, carries)
    scale: Array = 1.0 / np.where(weights > 0.0, weights, 1.0)
    means *= scale[:, None]
    # nodes that face nothing, and those whose contact normals cancel, keep their own normals
    length = np.linalg.norm(means[:, 3:6], axis=1)
    vectors = np.where((length <= CANCELLED)[:, None], nodes.normals, means[:, 3:6])
    normals = free_normals(vectors, nodes.free)
    if primary is None:  # measured along the mean normal, also where a component is prescribed
        cosine = np.einsum("ni,ni->n", vectors, normals) / np.linalg.norm(vectors, axis=1)
        means[:, :3] /= np.maximum(cosine, FACING_COSINE)[:, None]
    gap, secondary_sagitta, sagitta = means[:, :3].T
    unpaired: Mask = weights <= LEAST_AREA_PART * nodes.weights
    if primary is None:
        unpaired |= np.abs(gap) > pair.search_limit
    position = nodes_with_multipliers(V, pair, nodes, unpaired, shared)
    facet, partner = integrals.pairs.T
    column = partner if primary is None else primary.tag_index[partner]
    sizes = integrals.partner.sum(axis=2)
    sizes = redistributed(sizes[:, :, None], carries[facet])[:, :, 0]
    shares: Array = np.zeros((count, len(group.pairs)))
    member = group.pair_of_tags[facets.tag_index[facet], column]
    np.add.at(shares, (nodes.facet_nodes[facet], member[:, None]), sizes)
    weights, shares = weights[position], shares[position]
    shares *= (weights / shares.sum(axis=1))[:, None]
    if not moved and primary is not None:
        # Functions of the dual basis are negative in part: a mean may be less than all distances
        # around the node. (The gap of moved surfaces must change as N says, or the positions of
        # finite sliding do not converge.)
        least: Array = np.full(count, np.inf)
        np.minimum.at(least, nodes.facet_nodes, integrals.least[:, None])
        gap[:] = np.maximum(gap, least)
        if not any_known_surface(facets, primary):
            _warn_of_close_fit(comm, str(pair), gap[position], sagitta[position])
    owner = group.owners(shares)
    laws = [single.friction for single in group.pairs]
    bonded = np.array([isinstance(law, Bonded) for law in laws])[owner]
    smooth = np.array([isinstance(law, Frictionless) for law in laws])[owner]
    normals, free, numbers = normals[position, :dim], nodes.free[position], nodes.numbers[position]
    moves = np.linalg.norm(normals * free, axis=1) > FACING_COSINE
    prescribed = ~moves
    across = scaled_rows(across[position], scale[position])
    friction_acts, means_across = free, None
    if primary is not None:
        friction_acts = free | _primary_is_free(across, primary) & ~bonded[:, None]
        means_across = across
    patches = numbers if bodies is None else numbers * columns + bodies[position]
    room = _tangential_projections(patches, means_across, normals, friction_acts, moves)
    along, tangent_node = _free_tangents(normals, room)
    rubs = ~smooth[tangent_node]
    extent = reduce_array(comm, np.abs(facets.points).max(initial=0.0), MPI.MAX)
    distance = np.where(bonded | (np.abs(gap[position]) <= ROUNDING * extent), 0.0, gap[position])
    return PairOperators(
        bonded=False,
        nodes=(numbers - V.dofmap.index_map.local_range[0]).astype(np.int32),
        weights=weights,
        shares=shares,
        areas=nodes.weights[position],
        places=means[position, 6 : 6 + dim],
        normals=normals,
        distance=distance,
        added_gap=np.zeros_like(distance),
        # only displacements of degree 2 can bend facets and so make up for the sagitta
        secondary_sagitta=secondary_sagitta[position] * (facets.degree > 1),
        jump=scaled_rows(jump[position], scale[position]),
        primary=across,
        prescribed=prescribed,
        normal_node=np.flatnonzero(moves).astype(np.int32),
        tangents=along[rubs],
        tangent_node=tangent_node[rubs],
        semi_axes=np.ones(rubs.sum()),
        undeformed=undeformed,
    )


def _warn_of_close_fit(comm: MPI.Comm, pair: str, gap: Array, sagitta: Array) -> None:
    """Warn if nodes (n,) penetrate so little that errors of `sagitta` (n,) matter. Collective."""
    depth, height = reduce_array(
        comm, [(-gap).max(initial=0.0), np.abs(sagitta).max(initial=0.0)], MPI.MAX
    )
    inside, number = reduce_array(comm, [int((gap < 0.0).sum()), len(gap)])
    if 0.0 < depth < CLOSE_FIT * height and inside >= FITTED_PART * number:
        warn(
            comm,
            "contact pair %s: bodies overlap by up to %.3g, but curved surfaces are up to %.3g off "
            "their facets, a height that nodes determine to some percent only: the error of "
            "pressures may be 10 %% or more. Give ContactPair(geometry=...), or use finer facets.",
            *(pair, depth, height),
            about=pair,
        )


def mortar_rows(
    nodes: SurfaceNodes,
    primary: Facets | None,
    integrals: FacetIntegrals,
    columns: int,
    carries: Mask,
) -> tuple[Array, Any, Any, Array]:
    """Integrate psi_i times the jump, for each function psi_i of the dual basis. Not collective.

    Args:
        nodes: nodes of the secondary side.
        primary: facets of the primary side; None for an obstacle.
        integrals: the integrals over the facets.
        columns: number of nodes of V on all ranks.
        carries: (facets, corners) whether a corner has a multiplier, see `couple`.

    Returns:
        For each of the nodes (n,) the covered area w [length^2, in 2D length]; times w, the sparse
        matrix (n, nodes of V) of the jump, secondary minus primary, and the one of its primary
        part; and (n, 9) the six quantities of `FacetIntegrals.means` and the three coordinates of
        the point of application of the nodal force, times w.
    """
    corners, count = nodes.facet_nodes, len(nodes.numbers)
    dual = dual_coefficients(integrals.hats, carries)
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
    return weights, jump, across, node_sums(corners, means, count)


def dual_coefficients(hats: Array, carries: Mask) -> Array:
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
        carries: (n, corners) whether a corner carries a multiplier. A facet without such corners
            has no basis functions.
    """
    every = np.eye(hats.shape[1])
    sums = redistributed(np.broadcast_to(every, hats.shape), carries)
    masses = sums @ hats @ sums.transpose(0, 2, 1)
    weights = masses.sum(axis=2)[:, :, None]
    # a mass matrix M of a strip is nearly singular; the coefficients (1 + t) D (M + t D)^-1, with
    # the row sums D of M, keep the sum of the basis for any t
    shifted = masses + ROUNDING * weights * every
    shifted += np.logical_not(masses.any(axis=2))[:, :, None] * every
    return np.asarray((1.0 + ROUNDING) * weights * np.linalg.inv(shifted) @ sums)


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


def _primary_is_free(primary: Any, facets: Facets) -> Mask:
    """Return in which directions (n, dim of space) all primary nodes opposite a node are free.

    Primary nodes whose share of the mean is at most `NEGLIGIBLE`, and nodes within edges of facets
    of degree 2, do not count. A node that faces no primary node is free in no direction.

    Args:
        primary: (n, nodes of V) sparse matrix of the means over the primary side.
        facets: facets of the primary side.
    """
    columns, row = primary.indices, np.repeat(np.arange(primary.shape[0]), np.diff(primary.indptr))
    counts = np.abs(primary.data) > NEGLIGIBLE
    result = np.repeat((np.diff(primary.indptr) > 0)[:, None], facets.free.shape[2], axis=1)
    for axis in range(facets.free.shape[2]):
        prescribed = facets.nodes[:, : facets.corners][~facets.free[:, :, axis]]
        result[row[counts & np.isin(columns, prescribed)], axis] = False
    return result


def _tangential_projections(
    owners: GlobalNumbers,
    means: Any,
    normals: Array,
    free: Mask,
    moves: Mask,
) -> Array:
    """Return projections (n, d, d) onto the directions that are available for rows of T.

    If several patches of a node on a sharp edge face the same place, such as an edge in the corner
    of a box with the same nodes, they have the same jump. Each patch has a row of N for its normal,
    as long as these rows are linearly independent; `moves` is set to False for patches without such
    a row. Friction then acts only along the edge, on the patch with the largest weight. Patches
    that face different places, such as the head of a bolt and its shank in a hole with clearance,
    are independent of each other.

    Args:
        owners: (n,) a number for each patch. Patches of one node that face the same body have the
            same number, and are sorted by ascending weight.
        means: (n, nodes of V) sparse matrix of the means over the primary side; None for an
            obstacle, which is the same place for all patches.
        normals: (n, d) unit normals.
        free: (n, d) whether friction may act along a coordinate axis.
        moves: (n,) whether the node has a row of N; changed in place.
    """
    room = free[:, :, None] * np.eye(free.shape[1])
    ascending = np.argsort(owners, kind="stable")
    together = owners[ascending[1:]] == owners[ascending[:-1]]
    if means is not None and together.any():
        lighter, heavier = means[ascending[:-1][together]], means[ascending[1:][together]]
        squares = (lighter.power(2) + heavier.power(2)).sum(axis=1)
        apart = (lighter - heavier).power(2).sum(axis=1)
        together[together] = apart <= SAME_MEANS**2 * squares
    # the pieces of consecutive patches that face the same place: of most nodes there is one patch
    starts, ends = np.flatnonzero(np.diff(together, prepend=False, append=False)).reshape(-1, 2).T
    for start, end in zip(starts, ends, strict=True):
        patches = ascending[start : end + 1]
        heaviest = patches[-1]
        left = room[heaviest].copy()
        for i in reversed(patches):
            own = left @ normals[i]
            length = np.linalg.norm(own)
            moves[i] = length > FACING_COSINE
            if moves[i]:
                left -= np.outer(own, own) / length**2
            room[i] = 0.0
        room[heaviest] = left
    return room


def _free_tangents(normals: Array, room: Array) -> tuple[Array, LocalNumbers]:
    """Return the tangents (n_tangential, d) of the rows of T, and the index of each row's node.

    Args:
        normals: (n, d) unit normals.
        room: (n, d, d) projections onto the available directions.
    """
    along = tangents(normals)
    limited = np.flatnonzero((room != np.eye(normals.shape[1])).any(axis=(1, 2)))
    keep = np.ones(along.shape[:2], dtype=np.bool_)
    # if not all directions are available, rotate the tangents to eigenvectors of the projection
    mobility = np.einsum("nai,nij,nbj->nab", along[limited], room[limited], along[limited])
    values, vectors = np.linalg.eigh(mobility)
    along[limited] = np.einsum("nba,nbi->nai", vectors, along[limited])
    keep[limited] = values > FACING_COSINE
    return along[keep], np.nonzero(keep)[0].astype(np.int32)
