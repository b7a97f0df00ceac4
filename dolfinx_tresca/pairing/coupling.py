"""The jump of the displacement at secondary nodes, the common result of all kinds of pairing."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair


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
    if pair.touches_itself and outside == total:
        within = "" if pair.search_distance is None else f" within {pair.search_distance:g}"
        raise PairingError(
            f"no part of the surface ({secondary}) can touch another one: from none of its {total} "
            f"nodes the outward normal leads to the surface of another body, or to another part of "
            f"the same body{within}. Check the tag{' and the search distance' if within else ''}; "
            'for parts that meet only when the body has moved take sliding="finite".'
        )
    if outside == total:
        within = "" if pair.search_distance is None else f" within {pair.search_distance:g}"
        raise PairingError(
            f"the surfaces do not face each other: from none of the {total} nodes of the secondary "
            f"side ({secondary}) the outward normal leads to the primary side "
            f"({primary}){within}. Check the tags{' and the search distance' if within else ''}."
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
