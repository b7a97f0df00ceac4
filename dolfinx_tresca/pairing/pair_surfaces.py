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
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals, obstacle_integrals
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pieces import at_own_nodes, halos, owners_flags, owns, with_neighbours
from dolfinx_tresca.pairing.undeformed import PairGroup, Undeformed, groups_of
from dolfinx_tresca.pairing.visibility import SelfContact, redundant_nodes
from dolfinx_tresca.scene.friction import Bonded
from dolfinx_tresca.scene.pair import ContactPair, SideName


def pair_surfaces(
    V: Any, prescribed: Mask, pair: ContactPair, *, axisymmetric: bool = False
) -> PairOperators:
    """Compute N, T and the gap of a single pair; see `pair_group`. Collective."""
    return pair_group(V, prescribed, PairGroup([pair]), axisymmetric=axisymmetric)[0]


def pair_all_surfaces(
    V: Any, prescribed: Mask, pairs: Sequence[ContactPair], *, axisymmetric: bool
) -> list[PairOperators]:
    """Compute N, T and the gap of each pair, group by group; see `pair_group`. Collective."""
    result: dict[int, PairOperators] = {}
    for group in groups_of(V, pairs):
        operators = pair_group(V, prescribed, group, axisymmetric=axisymmetric)
        result.update(zip(group.numbers, operators, strict=True))
    return [result[number] for number in range(len(pairs))]


def pair_group(
    V: Any, prescribed: Mask, group: PairGroup, *, axisymmetric: bool = False
) -> list[PairOperators]:
    """Compute N, T and the gap of pairs, for the present positions of the mesh's nodes. Collective.

    V is a space of vectors of degree 1 or 2; `prescribed` (owned dofs,) tells which degrees of
    freedom a Dirichlet condition prescribes. If `axisymmetric`, integrals are over rings about the
    axis x = 0.
    """
    undeformed = Undeformed.from_mesh(V, prescribed, group, axisymmetric=axisymmetric)
    return _pair(V, undeformed, undeformed.sides, displaced=False)


def pair_displaced_surfaces(V: Any, undeformed: Undeformed, u: Array) -> list[PairOperators]:
    """Compute N, T and the gap of pairs in the configuration displaced by u. Collective.

    The gap is the distance between the displaced surfaces; the gap for displacements from the
    undeformed surfaces is this gap plus N u, with the N in the result. `u` (nodes, dim of space) is
    the displacement of this rank's nodes [length], from `straightened`.
    """
    return _pair(V, undeformed, undeformed.displaced(V, u), displaced=True)


def _pair(
    V: Any, undeformed: Undeformed, sides: Sequence[Facets], *, displaced: bool
) -> list[PairOperators]:
    """Compute N, T and the gap of pairs from their facets, see `pair_group`. Collective."""
    group, comm = undeformed.group, V.mesh.comm
    pair = group.surfaces
    owned, partners, primary = sides[0], sides[-1], None
    if pair.obstacle is not None:
        nodes = _surface_nodes(V, pair, "secondary", with_neighbours(V, owned), displaced)
        nodes, integrals, carries = obstacle_integrals(comm, pair, pair.obstacle, nodes, displaced)
        shared: Mask = np.zeros(len(nodes.numbers), dtype=np.bool_)
    else:
        around, across = halos(V, owned, partners, pair.search_limit)
        if pair.touches_itself:
            nodes = primary_nodes = _surface_nodes(V, pair, "secondary", across, displaced)
        else:
            nodes = _surface_nodes(V, pair, "secondary", around, displaced)
            primary_nodes = _surface_nodes(V, pair, "primary", across, displaced)
        facets, primary = nodes.facets, primary_nodes.facets

        def may_meet(facet: Indices, partner: Indices) -> Mask:
            tags = facets.tag_index[facet], primary.tag_index[partner]
            return np.asarray(group.pair_of_tags[tags] >= 0)

        with errors_on_all_ranks(comm):
            selected, limit = at_own_nodes(V, facets), pair.search_limit
            order = SelfContact(facets) if pair.touches_itself else None
            rule = may_meet if order is None else order.may_meet
            overlap = MortarIntegrals(nodes, primary_nodes, selected, limit, rule, order)
            integrals, shared = overlap, np.isin(nodes.numbers, primary.nodes)
            if order is not None:
                shared = redundant_nodes(nodes, overlap.pairs, overlap.opposite)
        if order is not None:
            shared = owners_flags(V, nodes.numbers, shared)
        carries = corners_that_carry(V, nodes, integrals, shared)
    group_operators = couple(V, undeformed, nodes, primary, integrals, carries, shared, displaced)
    if pair.pairing == "nodes" and primary is not None and not displaced:
        _check_meshes_match(V, pair, group_operators, nodes)
    if not displaced and len(group.pairs) > 1:
        areas = reduce_array(comm, group_operators.shares.sum(axis=0))
        for single, area in zip(group.pairs, areas, strict=True):
            if area == 0.0 and single.sliding == "small":
                raise PairingError(
                    f"the surfaces of contact pair {single} do not face each other. Check the tags"
                    f"{'' if single.search_distance is None else ' and the search distance'}."
                )
        group.say_laws(comm, group_operators.shares)
    owner = group.owners(group_operators.shares)
    return [
        replace(group_operators.at_nodes(owner == k), bonded=isinstance(single.friction, Bonded))
        for k, single in enumerate(group.pairs)
    ]


def _check_meshes_match(
    V: Any, pair: ContactPair, operators: PairOperators, nodes: SurfaceNodes
) -> None:
    """Check that the means over both sides have equal weights, as on matching meshes. Collective.

    They are over one node on each side then, and over equal nodes with degree 2. The difference of
    the sums of their squares is one to two times the distance of the nodes along the surface,
    relative to the size of a facet.
    """
    differ = np.abs((operators.secondary.power(2) - operators.primary.power(2)).sum(axis=1))
    apart = differ > 2.0 * MISMATCH + 100.0 * nodes.facets.rounding.max(initial=0.0)
    away = operators.nodes[apart]
    count = V.mesh.comm.allreduce(len(np.unique(away)))
    if count > 0:
        place = row_of_least(V.mesh.comm, -differ[apart], V.tabulate_dof_coordinates()[away])
        raise PairingError(
            f'the meshes of contact pair {pair} do not match, as pairing="nodes" demands: {count} '
            f"nodes of the secondary side ({pair.side('secondary')}) face the primary side "
            f"({pair.side('primary')}) away from its nodes, most of all at "
            f"{shown_place(place)}. Mesh both surfaces alike, or leave out the argument: mortar "
            "pairing needs no matching meshes."
        )


def _surface_nodes(
    V: Any, pair: ContactPair, side: SideName, halo: Facets, displaced: bool
) -> SurfaceNodes:
    """Return the nodes of the facets on a side that this rank pairs. Collective.

    The log has a warning if nodes of an undeformed surface coincide, since the surface is torn
    there. They are sent to the same rank, which counts them. Nodes that also belong to facets with
    other tags, such as corners of adjacent bricks, and surfaces that touch themselves are left out.
    """
    comm = V.mesh.comm
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
    diameters = np.linalg.norm(np.ptp(halo.points, axis=1), axis=1)
    smallest = reduce_array(comm, diameters.min(initial=np.inf), MPI.MIN)
    tags = pair.facet_tags
    outside = tags.indices[tags.values != getattr(pair, side)]
    outside = fem.locate_dofs_topological(V, tags.dim, outside)
    numbers, entry = np.unique(nodes.numbers[own], return_index=True)
    entry = entry[~np.isin(numbers, V.dofmap.index_map.local_to_global(outside))]
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
