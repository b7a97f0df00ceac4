"""Pairing of two surfaces, or of a surface and a rigid obstacle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.exchange import row_of_least
from dolfinx_tresca._base.parallel import errors_on_all_ranks, gather_rows, reduce_array
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pairing import mortar, obstacle
from dolfinx_tresca.pairing.coupling import Coupling, owned_nodes
from dolfinx_tresca.pairing.group import PairGroup
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.roles import opposite_bodies, redundant_nodes
from dolfinx_tresca.pairing.search.facets import Facets
from dolfinx_tresca.pairing.search.halo import Halo, extend_halos
from dolfinx_tresca.pairing.search.matching import MATCHING_DISTANCE, RIM_PART, corner_distances
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.pairing.search.self_contact import SelfContact
from dolfinx_tresca.pairing.side import Side
from dolfinx_tresca.pairing.undeformed import Undeformed
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair


def pair_surfaces(
    V: Any, prescribed: Mask, pair: ContactPair, *, axisymmetric: bool = False
) -> PairOperators:
    """Compute N, T and the gap of a single pair; see `pair_group`. Collective."""
    return pair_group(V, prescribed, PairGroup.of([pair]), axisymmetric=axisymmetric)[0]


def pair_group(
    V: Any, prescribed: Mask, group: PairGroup, *, axisymmetric: bool = False
) -> list[PairOperators]:
    """Compute N, T and the gap of pairs, for the present positions of the mesh's nodes.

    Collective.

    Args:
        V: vector space of degree 1 or 2.
        prescribed: (owned dofs,) whether a Dirichlet condition prescribes the degree of freedom.
        group: the contact pairs.
        axisymmetric: whether integrals are over rings about the axis x = 0.

    Raises:
        InputError: tags, obstacle or geometry are wrong.
        PairingError: the surfaces cannot be paired in the requested way or do not face each other,
            or all secondary nodes are prescribed.
    """
    undeformed = Undeformed.of(V, prescribed, group, axisymmetric=axisymmetric)
    return _pair(V, undeformed, undeformed.sides, moved=False)


def pair_displaced_surfaces(V: Any, undeformed: Undeformed, u: Array) -> list[PairOperators]:
    """Compute N, T and the gap of pairs in the configuration displaced by u. Collective.

    The gap in the result is the distance between the displaced surfaces. The gap for displacements
    from the undeformed surfaces is this gap plus N u, with the N in the result.

    Args:
        V: the space of the displacement.
        undeformed: the undeformed surfaces of a group of pairs.
        u: (nodes, dim of space) displacement of this rank's nodes [length], from `straightened`.

    Raises:
        InputError: the signed distance of the obstacle is wrong.
        PairingError: the displaced surfaces cannot be paired.
    """
    return _pair(V, undeformed, undeformed.displaced(V, u), moved=True)


def _pair(
    V: Any, undeformed: Undeformed, sides: Mapping[int, Facets], *, moved: bool
) -> list[PairOperators]:
    """Compute N, T and the gap of pairs from the facets of their sides. Collective."""
    group = undeformed.group
    pair = group.surfaces
    secondary = Side(pair, "secondary", Halo(V, sides[pair.secondary]))
    others, bodies = None, None
    if isinstance(pair.primary, RigidObstacle):
        halo = secondary.halo
        if halo.comm.size > 1:  # `SmoothSurface` depends on two rings of neighbours
            halo.add_neighbours(halo.numbers[halo.facets_at_own_nodes()])
        nodes = secondary.nodes_on_this_rank(V, moved)
        coupling = obstacle.couple(V, group, pair.primary, secondary.halo.facets, nodes, moved)
    else:
        primary = secondary
        if not pair.touches_itself:
            primary = Side(pair, "primary", Halo(V, sides[pair.primary]))
        extend_halos(secondary.halo, primary.halo, pair.search_limit)
        nodes = secondary.nodes_on_this_rank(V, moved)
        other_nodes = nodes if pair.touches_itself else primary.nodes_on_this_rank(V, moved)
        coupling, bodies = _couple_surfaces(V, group, secondary, nodes, primary, other_nodes, moved)
        others = primary.halo.facets
    if not moved and len(group.pairs) > 1:
        _check_pairs_face(V, group, coupling.shares)
        group.say_laws(V.mesh.comm, coupling.shares)
    return PairOperators.of(V, coupling, nodes, secondary.whole, undeformed, others, bodies)


def _check_pairs_face(V: Any, group: PairGroup, shares: Array) -> None:
    """Check that each pair of a group with small sliding has a share of a node. Collective.

    Raises:
        PairingError: no node of a pair faces its primary side.
    """
    for pair, area in zip(group.pairs, reduce_array(V.mesh.comm, shares.sum(axis=0)), strict=True):
        if area == 0.0 and pair.sliding == "small":
            raise PairingError(
                f"the surfaces of contact pair {pair} do not face each other. Check the tags"
                f"{'' if pair.search_distance is None else ' and the search distance'}."
            )


def _couple_surfaces(
    V: Any,
    group: PairGroup,
    secondary: Side,
    nodes: SurfaceNodes,
    primary: Side,
    other_nodes: SurfaceNodes,
    moved: bool,
) -> tuple[Coupling, Indices | None]:
    """Find the jumps at secondary nodes by mortar integrals. Collective.

    Returns:
        The coupling, and the number of the body opposite to each node (`opposite_bodies`), which is
        None unless the surface touches itself.

    Raises:
        PairingError: `pair.pairing` is "nodes", but the undeformed meshes do not match; or no node
            can carry a multiplier.
    """
    pair, facets, others = group.surfaces, secondary.halo.facets, primary.halo.facets
    bodies = None

    def may_meet(first: Indices, second: Indices) -> Mask:
        tags = facets.tag_index[first], others.tag_index[second]
        return np.asarray(group.pair_of_tags[tags] >= 0)

    with errors_on_all_ranks(V.mesh.comm):
        around = secondary.halo.facets_at_own_nodes()
        limit = pair.search_limit
        order = SelfContact.of(facets) if pair.touches_itself else None
        integrals = MortarIntegrals.of(
            facets, nodes, others, other_nodes, around, limit, order, may_meet
        )
        shared: Mask
        if order is None:
            shared = np.isin(nodes.numbers, others.nodes)
        else:
            shared = redundant_nodes(facets, nodes, integrals)
            bodies = opposite_bodies(nodes, integrals, order)
    if pair.touches_itself:
        own = owned_nodes(V, nodes)
        shared = np.isin(nodes.numbers, gather_rows(V.mesh.comm, nodes.numbers[shared & own]))
    if pair.pairing == "nodes" and not moved:
        _check_meshes_match(V, pair, facets, nodes, others, integrals)
    return mortar.couple(V, group, facets, nodes, others, integrals, shared, moved), bodies


def _check_meshes_match(
    V: Any,
    pair: ContactPair,
    secondary: Facets,
    nodes: SurfaceNodes,
    primary: Facets,
    integrals: MortarIntegrals,
) -> None:
    """Check that each facet matches the facet that covers most of it. Collective.

    Args:
        V: the space of the displacement.
        pair: the contact pair.
        secondary: facets of the secondary side.
        nodes: nodes of the secondary facets.
        primary: facets of the primary side.
        integrals: the integrals over the overlap.

    Raises:
        PairingError: secondary nodes face the primary side away from its nodes.
    """
    ascending = np.argsort(integrals.share)
    ascending = ascending[integrals.share[ascending] > RIM_PART]
    largest_share = np.full(len(secondary.points), -1)
    largest_share[integrals.secondary[ascending]] = ascending
    facet = np.flatnonzero(largest_share >= 0)
    other = integrals.primary[largest_share[facet]]
    distance, allowed = corner_distances(secondary, facet, primary, other)
    corner = nodes.facet_nodes[facet]
    apart = (distance > allowed[:, None]) & owned_nodes(V, nodes)[corner]
    number = V.mesh.comm.allreduce(len(np.unique(nodes.numbers[corner[apart]])))
    if number > 0:
        rows = np.column_stack([distance[apart], nodes.points[corner[apart]]])
        largest, *place = row_of_least(V.mesh.comm, -distance[apart], rows)
        raise PairingError(
            f'the meshes of contact pair {pair} do not match, as pairing="nodes" demands: {number} '
            f"nodes of the secondary side ({pair.side('secondary')}) face the primary side "
            f"({pair.side('primary')}) away from its nodes, by up to {largest:.2g} at "
            f"{tuple(round(float(x), 6) for x in place)} (allowed: {MATCHING_DISTANCE:g} of a "
            "facet). Mesh both surfaces alike, or leave out the argument: mortar pairing needs no "
            "matching meshes."
        )
