"""Pairing of two surfaces, or of a surface and a rigid obstacle: from tags to N, T and the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import (
    errors_on_all_ranks,
    exchange,
    reduce_array,
    row_of_least,
    warn,
)
from dolfinx_tresca.errors import PairingError, shown_place
from dolfinx_tresca.pairing.coupling import corners_that_carry, couple
from dolfinx_tresca.pairing.facets import MISMATCH, NEGLIGIBLE, Facets, SurfaceNodes
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.obstacle_integrals import obstacle_integrals
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pieces import halos, owners_flags, owns, with_neighbours
from dolfinx_tresca.pairing.undeformed import PairGroup, Undeformed, groups_of
from dolfinx_tresca.pairing.visibility import SelfContact, redundant_nodes
from dolfinx_tresca.scene.friction import Bonded
from dolfinx_tresca.scene.obstacle import resolved
from dolfinx_tresca.scene.pair import ContactPair, SideName


def pair_surfaces(
    V: Any, prescribed: Mask, pair: ContactPair, *, axisymmetric: bool = False
) -> PairOperators:
    """Compute N, T and the gap of a single pair, as `pair_all_surfaces` does. Collective."""
    return pair_all_surfaces(V, prescribed, [pair], axisymmetric=axisymmetric)[0]


def pair_all_surfaces(
    V: Any, prescribed: Mask, pairs: Sequence[ContactPair], *, axisymmetric: bool
) -> list[PairOperators]:
    """Compute N, T and the gap of each pair, at the positions of the mesh's nodes. Collective.

    V is a space of vectors of degree 1 or 2; `prescribed` (owned dofs,) tells which degrees of
    freedom are prescribed. If `axisymmetric`, integrals are over rings about the axis x = 0.
    """
    result: dict[int, PairOperators] = {}
    for group in groups_of(V, pairs):
        undeformed = Undeformed(V, prescribed, group, axisymmetric=axisymmetric)
        operators = _pair(V, undeformed, undeformed.sides, displaced=False)
        result.update(zip(group.numbers, operators, strict=True))
    return [result[number] for number in range(len(pairs))]


def pair_displaced_surfaces(V: Any, undeformed: Undeformed, u: Array) -> list[PairOperators]:
    """Compute N, T and the gap of each pair of a group, displaced by u. Collective.

    The gap is the distance between the displaced surfaces; `displaced_jump` adds N u, with the N of
    the result, to compare it with N times the total displacement. `u` (nodes, dim of space) is the
    displacement of this rank's nodes, ghosts included [length], from `straightened`.
    """
    return _pair(V, undeformed, undeformed.displaced(V, u), displaced=True)


def _pair(
    V: Any, undeformed: Undeformed, sides: Sequence[Facets], *, displaced: bool
) -> list[PairOperators]:
    """Compute N, T and the gap of each pair of a group from the facets of its sides. Collective.

    `sides` are as in `Undeformed`. If they are `displaced`, the mesh is not checked again.
    """
    group, comm = undeformed.group, V.mesh.comm
    pair, primary = group.surfaces, None
    if pair.obstacle is not None:
        nodes = _surface_nodes(V, pair, "secondary", with_neighbours(V, sides[0]), displaced)
        sizes = undeformed.sides[0].areas ** (1.0 / nodes.facets.dim)
        total, count = reduce_array(comm, [sizes.sum(), float(len(sizes))])
        obstacle = resolved(pair.obstacle, float(total / count))
        nodes, integrals, carries = obstacle_integrals(comm, pair, obstacle, nodes, displaced)
        shared: Mask = np.zeros(len(nodes.numbers), dtype=np.bool_)
    else:
        nodes, primary, integrals, shared = _overlap_integrals(V, group, sides, displaced)
        carries = corners_that_carry(V, nodes, integrals, shared)
    operators = couple(V, undeformed, nodes, primary, integrals, carries, shared, displaced)
    if not displaced and pair.pairing == "nodes" and primary is not None:
        # On matching meshes the mean over each side is the value of a single node, with the weight
        # 1. At a distance of t facets its weight is 1 - t: sums of squares differ by 2 t.
        squares = operators.secondary.power(2) - operators.primary.power(2)
        differ = np.abs(squares.sum(axis=1))
        apart = differ > 2.0 * MISMATCH + 100.0 * nodes.facets.rounding.max(initial=0.0)
        away = operators.nodes[apart]
        number = comm.allreduce(len(np.unique(away)))
        if number > 0:
            place = row_of_least(comm, -differ[apart], V.tabulate_dof_coordinates()[away])
            raise PairingError(
                f'the meshes of contact pair {pair} do not match, as pairing="nodes" demands: '
                f"{number} nodes of the secondary side ({pair.side('secondary')}) face the primary "
                f"side ({pair.side('primary')}) away from its nodes, most of all at "
                f"{shown_place(place)}. Mesh both surfaces alike, or leave out the argument: "
                "mortar pairing needs no matching meshes."
            )
    if not displaced and len(group.pairs) > 1:
        areas = reduce_array(comm, operators.shares.sum(axis=0))
        for single, area in zip(group.pairs, areas, strict=True):
            if area == 0.0 and single.sliding == "small":
                raise PairingError(
                    f"the surfaces of contact pair {single} do not face each other. Check the tags"
                    f"{'' if pair.search_distance is None else ' and the search distance'}."
                )
        group.say_laws(comm, operators.shares)
    owner = group.owners(operators.shares)
    return [
        replace(operators.at_nodes(owner == k), bonded=isinstance(single.friction, Bonded))
        for k, single in enumerate(group.pairs)
    ]


def _overlap_integrals(
    V: Any, group: PairGroup, sides: Sequence[Facets], displaced: bool
) -> tuple[SurfaceNodes, Facets, MortarIntegrals, Mask]:
    """Integrate over the overlaps of two surfaces, or of a surface with itself. Collective.

    Returns:
        the secondary nodes and the primary facets that this rank needs; the integrals; and a mask
        (n,) of secondary nodes that may have no multiplier: they are on both sides, or, on a
        surface that touches itself, have the jump of another node or none (`redundant_nodes`).
    """
    comm, pair = V.mesh.comm, group.surfaces
    halo, primary_halo = halos(V, sides[0], sides[-1], pair.search_limit)
    if pair.touches_itself:
        nodes = primary_nodes = _surface_nodes(V, pair, "secondary", primary_halo, displaced)
    else:
        nodes = _surface_nodes(V, pair, "secondary", halo, displaced)
        primary_nodes = _surface_nodes(V, pair, "primary", primary_halo, displaced)
    facets, primary = nodes.facets, primary_nodes.facets

    def tags_may_meet(facet: Indices, partner: Indices) -> Mask:
        """Return whether a pair of the group has the tags of both facets, (m,) each."""
        pair_of_facets = group.pair_of_tags[facets.tag_index[facet], primary.tag_index[partner]]
        return np.asarray(pair_of_facets >= 0)

    with errors_on_all_ranks(comm):
        # this rank integrates over the facets with a corner that it owns
        selected = np.flatnonzero(owns(V, facets.nodes[:, : facets.corners]).any(axis=1))
        order = SelfContact(facets) if pair.touches_itself else None
        may_meet = tags_may_meet if order is None else order.may_meet
        limit = pair.search_limit
        integrals = MortarIntegrals(nodes, primary_nodes, selected, limit, may_meet, order)
        shared = np.isin(nodes.numbers, primary.nodes)
        if order is not None:
            shared = redundant_nodes(nodes, integrals.pairs, integrals.exchanged)
    if order is not None:
        shared = owners_flags(V, nodes.numbers, shared)
    return nodes, primary, integrals, shared


def _surface_nodes(
    V: Any, pair: ContactPair, side: SideName, halo: Facets, displaced: bool
) -> SurfaceNodes:
    """Return the nodes of a side; check their normals and, undeformed, warn of tears. Collective.

    `halo` are all facets of the side that the pairing on this rank depends on. The surface is torn
    where two nodes are at one place. Nodes that facets with other tags share do not count: nodes of
    adjacent bricks may coincide.
    """
    comm, tags = V.mesh.comm, pair.facet_tags
    with errors_on_all_ranks(comm):
        nodes = SurfaceNodes(halo)
        own = owns(V, nodes.numbers)
        has_no_normal = own & nodes.has_no_normal
        if has_no_normal.any():
            raise PairingError(
                f"the surface {pair.side(side)} ({side} side) has no normal at "
                f"{shown_place(nodes.points[has_no_normal][0])}: the normals of the facets around "
                "that node cancel. Repair the mesh there."
            )
    if displaced or pair.touches_itself:
        return nodes
    outside = tags.indices[tags.values != getattr(pair, side)]
    outside = fem.locate_dofs_topological(V, tags.dim, outside)
    numbers, entry = np.unique(nodes.numbers[own], return_index=True)
    entry = entry[~np.isin(numbers, V.dofmap.index_map.local_to_global(outside))]
    # equal places, up to a small part of the smallest facet, are sent to one rank by their sum
    diameters = np.linalg.norm(np.ptp(nodes.facets.points, axis=1), axis=1)
    smallest = reduce_array(comm, diameters.min(initial=np.inf), MPI.MIN)
    places = np.round(nodes.points[own][entry] / (NEGLIGIBLE * smallest)).astype(np.int64)
    places, _ = exchange(comm, places, places.sum(axis=1) % comm.size)
    coincident = comm.allreduce(len(places) - len(np.unique(places, axis=0)))
    if coincident:
        warn(
            comm,
            "the surface %s (%s side) has %d nodes at the place of another one: it is torn there. "
            "Merge duplicated nodes of the mesh, unless these are edges of two bodies.",
            *(pair.side(side), side, coincident),
            about=pair.side(side),
        )
    return nodes
