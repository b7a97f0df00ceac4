"""The jump at secondary nodes: the dual basis, and which nodes carry multipliers."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pairing.search.facets import Facets, quadrature
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair

#: An entry of a weighted jump counts as rounding if it is at most this factor times the relative
#: rounding of the coordinates times the node's area. (Integrals over overlaps are sums of
#: differences of coordinates.)
ENTRY_ROUNDING = 8.0

EPSILON = float(np.finfo(np.float64).eps)

#: Least eigenvalue of the scaled mass matrix of a covered part. If an eigenvalue is smaller, the
#: inverse of the matrix would amplify rounding, and a shift raises the eigenvalue to this value
#: (`_regularised_dual`). This occurs only if the covered part is a strip or a corner of some
#: thousandths of the facet.
LEAST_EIGENVALUE = 1e-6


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


def owned_nodes(V: Any, nodes: SurfaceNodes) -> Mask:
    """Return whether this rank owns each of the nodes, (n,). Not collective."""
    low, high = V.dofmap.index_map.local_range
    return np.asarray((nodes.numbers >= low) & (nodes.numbers < high))


def _about_obstacle_normals(
    comm: MPI.Comm, pair: ContactPair, nodes: SurfaceNodes, own: Mask
) -> str:
    """Say at how many nodes an obstacle's normal is along the outward normal. Collective.

    The result is empty if there is no such node, or the primary side is no obstacle.
    """
    if not isinstance(pair.primary, RigidObstacle):
        return ""
    with errors_on_all_ranks(comm):
        _, normals = pair.primary.at(nodes.points[own])
    along = np.einsum("ni,ni->n", normals, nodes.normals[own]) > 0.0
    number = comm.allreduce(len(np.unique(nodes.numbers[own][along])))
    if number == 0:
        return ""
    return (
        f" At {number} nodes the obstacle's normal is along the outward normal of the body, and so "
        "points into the body: it must point out of the obstacle, towards the surface that may "
        "touch it. Reverse it if the tag is right."
    )


def nodes_with_multipliers(
    V: Any,
    pair: ContactPair,
    nodes: SurfaceNodes,
    unpaired: Mask,
    shared: Mask,
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
    own = owned_nodes(V, nodes)
    fixed = ~nodes.free.any(axis=1)
    carries = own & ~unpaired & ~fixed & ~shared
    # a node on a sharp edge has an entry for each smooth patch; it is paired if any entry is paired
    facing_nodes = np.unique(nodes.numbers[own & ~unpaired])
    partly_free = carries & ~nodes.free.all(axis=1)
    parts = (own & ~unpaired & fixed, own & ~unpaired & ~fixed & shared, carries, partly_free)
    counts = [len(np.unique(nodes.numbers[part])) for part in (own, own & ~fixed & ~shared, *parts)]
    facing, total, eligible, prescribed, common, number, some = reduce_array(
        V.mesh.comm, [len(facing_nodes), *counts]
    )
    outside = total - facing
    secondary, primary = pair.side("secondary"), pair.side("primary")
    if number == 0 < eligible and pair.sliding == "finite":
        along = _about_obstacle_normals(V.mesh.comm, pair, nodes, own)
        log(
            V.mesh.comm,
            "pairing: %s: no node that could carry a multiplier faces the other.%s",
            *(pair, along),
            level=logging.WARNING if along else logging.INFO,
            about=str(pair),
        )
        return np.flatnonzero(carries)
    if outside == total:
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
            f"({primary}){within}. Check the tags{limits}."
            f"{_about_obstacle_normals(V.mesh.comm, pair, nodes, own)}"
        )
    if number == 0:
        raise PairingError(
            f"no node of the secondary side ({secondary}) can carry a multiplier: of its {total} "
            f"nodes {outside} do not face the primary side ({primary}), {prescribed} are "
            f"prescribed and {common} shared with it. Check the tags and the Dirichlet conditions."
        )
    excluded = {
        "face nothing or are primary"
        if pair.touches_itself
        else "do not face the primary side": outside,
        "are prescribed": prescribed,
        "are in both roles" if pair.touches_itself else "are shared": common,
    }
    excluded_text = "".join(f", {count} {cause}" for cause, count in excluded.items() if count)
    partly_fixed = f", {some} of them prescribed in part" if some else ""
    log(
        V.mesh.comm,
        "pairing: %s: %d of %d secondary nodes carry multipliers%s%s",
        pair,
        number,
        total,
        partly_fixed,
        excluded_text,
    )
    return np.flatnonzero(carries)


def whole_facet_integrals(facets: Facets) -> tuple[Array, Array]:
    """Return integrals as if every facet were covered completely. Not collective.

    Returns:
        (n, corners, corners) integrals of the products of two hat functions, and (n, corners, k)
        integrals of hat functions times basis functions of the displacement.
    """
    x, w = quadrature(facets.cell, 4 * facets.degree + 2)
    area = facets.area_elements(x) * w
    hats, basis = facets.hats(x), facets.basis(x)
    return (
        np.einsum("nq,qa,qb->nab", area, hats, hats, optimize=True),
        np.einsum("nq,qa,qk->nak", area, hats, basis, optimize=True),
    )


def dual_coefficients(hats: Array, full: Mask, carries: Mask | None = None) -> Array:
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
        carries: (n, corners) whether a corner carries a multiplier; None: all do. A facet without
            such corners has no basis functions.
    """
    weights, corners = hats.sum(axis=2), hats.shape[1]
    if carries is None:
        carries = np.ones(hats.shape[:2], dtype=np.bool_)
    result = np.zeros_like(hats)
    plain = full & carries.all(axis=1)
    result[plain] = weights[plain][:, :, None] * np.linalg.inv(hats[plain])
    rest = ~plain & (weights.sum(axis=1) > 0.0)
    sums = redistributed(np.broadcast_to(np.eye(corners), hats[rest].shape), carries[rest])
    result[rest] = _regularised_dual(sums @ hats[rest] @ sums.transpose(0, 2, 1)) @ sums
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
    weights = np.maximum(weights, EPSILON * weights.sum(axis=1, keepdims=True))
    root = np.sqrt(np.where(absent, 1.0, weights))
    scaled = masses / (root[:, :, None] * root[:, None, :])
    scaled += absent[:, :, None] * np.eye(masses.shape[2])
    least = np.linalg.eigvalsh(scaled)[:, :1, None]
    shift = np.maximum(LEAST_EIGENVALUE - least, 0.0)
    inverse = np.linalg.inv(scaled + shift * np.eye(masses.shape[2]))
    return np.asarray((1.0 + shift) * root[:, :, None] * inverse / root[:, None, :])


def redistributed(values: Array, some: Mask) -> Array:
    """Distribute the values of corners that are not in `some` over the corners in `some`.

    The sum over the corners of a facet does not change, so that a facet transfers a constant
    pressure even if some of its corners have no multiplier.

    Args:
        values: (n, corners, k) values at the corners of facets.
        some: (n, corners) whether a corner receives values of the other corners, in equal parts.

    Returns:
        The new values (n, corners, k), zero at corners that are not in `some`.
    """
    number = np.maximum(some.sum(axis=1), 1)[:, None, None]
    lost = np.where(some[:, :, None], 0.0, values).sum(axis=1, keepdims=True)
    return np.where(some[:, :, None], values + lost / number, 0.0)


def assemble_rows(
    nodes: SurfaceNodes, rows: Indices, columns: GlobalNumbers, values: Array, width: int
) -> Any:
    """Assemble dense blocks, one for each facet, into a sparse matrix (nodes, width).

    Args:
        nodes: the secondary nodes, one row for each.
        rows: (n, corners) indices in `nodes` of the rows of each block.
        columns: (n, k) global numbers of the columns of each block.
        values: (n, corners, k) the blocks.
        width: number of columns of the matrix.
    """
    places = np.repeat(rows, values.shape[2], axis=1), np.tile(columns, values.shape[1])
    entries = values.ravel(), (places[0].ravel(), places[1].ravel())
    return coo_array(entries, shape=(len(nodes.numbers), width)).tocsr()


def drop_rounding(matrix: Any, nodes: SurfaceNodes, rows: Indices, areas: Array) -> Any:
    """Remove entries that are rounding errors from a csr matrix of `assemble_rows`.

    Args:
        matrix: (nodes, columns) integrals over the facets.
        nodes: the secondary nodes.
        rows: (n, corners) indices in `nodes` of the rows of each facet.
        areas: (nodes,) covered area of each node [length^2, in 2D length].
    """
    rounding = np.zeros(matrix.shape[0])
    np.maximum.at(rounding, rows, nodes.facets.rounding[:, None])
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    matrix.data[np.abs(matrix.data) <= ENTRY_ROUNDING * (rounding * areas)[row]] = 0.0
    matrix.eliminate_zeros()
    return matrix
