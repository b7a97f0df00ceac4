"""The undeformed surfaces of contact pairs: groups of pairs, and the facets with their tags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain, combinations
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

import basix
import dolfinx
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices, LocalNumbers, Mask, dots, real
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.compat import geometry_degree
from dolfinx_tresca._base.functions import numbers_in_file, vertex_count, with_owned_values
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array, row_of_least, warn
from dolfinx_tresca.errors import InputError, MeshError, PairingError, shown_place
from dolfinx_tresca.pairing.facets import (
    MESH_ROUNDING,
    NEGLIGIBLE,
    OFFSET_DEGREE,
    Facets,
    quadrature,
    tabulate,
)
from dolfinx_tresca.pairing.visibility import facet_origins
from dolfinx_tresca.scene.friction import Bonded, DryFriction, Friction
from dolfinx_tresca.scene.geometry import (
    ON_SURFACE,
    ExactSurface,
    GmshGeometry,
    Projection,
    open_geometry,
    project_points,
)
from dolfinx_tresca.scene.pair import SIDES, ContactPair, SideName

#: Arguments of `ContactPair` that the pairs of a group must have in common.
COMMON = ("sliding", "search_distance", "pairing", "geometry")

#: Distance of a corner from its surface, relative to the size of the facet, beyond which a geometry
#: that the user gives must be wrong. Nodes that could not be snapped to the surface are nearer.
FAR_CORNER = 0.5


class PairGroup:
    """Pairs that are paired as one pair of surfaces, so that a node has one multiplier.

    Attributes:
        pairs, numbers: the pairs, and the position of each in the list of the problem.
        surfaces: a single pair with the tags of all pairs, and the law of the first, for pairing.
        pair_of_tags: (secondary tags, primary tags) index in `pairs` of the pair between two tags
            of `surfaces`; -1 if there is none, so that facets with these tags are not paired.
        rank: (pairs,) rank of the laws, equal for pairs with the same law and the same added gap.
            Of the pairs that meet at a node, those with the largest rank determine its law; the
            first pair of the group with this rank has the multiplier.
    """

    def __init__(self, pairs: Sequence[ContactPair], numbers: Sequence[int] = (0,)) -> None:
        """Join pairs, which must have equal `facet_tags` and equal arguments in `COMMON`."""
        self.pairs, self.numbers, pattern = tuple(pairs), tuple(numbers), pairs[0]
        given_tags, _ = pattern.given_tags("secondary")
        for pair in pairs[1:]:
            differ = [name for name in COMMON if getattr(pair, name) != getattr(pattern, name)]
            if pair.given_tags("secondary")[0]._cpp_object is not given_tags._cpp_object:
                differ.append("facet_tags")
            if differ:
                raise InputError(
                    f"contact pairs {pattern} and {pair} are parts of the same surfaces, whose "
                    f"nodes they share, but differ in {' and '.join(differ)}: give both the same."
                )
        own_tags = [pair.given_tags("secondary")[1] for pair in pairs]
        opposite_tags = [pair.given_tags("primary")[1] for pair in pairs]
        # each tag of a side once; an obstacle has no tags, but a column in `pair_of_tags`
        secondary = list(dict.fromkeys(chain.from_iterable(own_tags)))
        primary = list(dict.fromkeys(chain.from_iterable(opposite_tags)))
        self.pair_of_tags: Indices = np.full((len(secondary), max(len(primary), 1)), -1)
        for k in range(len(pairs)):
            rows = [secondary.index(tag) for tag in own_tags[k]]
            columns = [primary.index(tag) for tag in opposite_tags[k]] or [0]
            self.pair_of_tags[np.ix_(rows, columns)] = k
        # pairs rank like the first pair with the same law; of equally strong laws the earlier wins
        alike = [next(k for k, second in enumerate(pairs) if _same(pair, second)) for pair in pairs]
        strengths = [(*_strength(pairs[k].friction), -k) for k in alike]
        self.rank: Indices = np.unique(strengths, axis=0, return_inverse=True)[1].ravel()
        self.surfaces = pattern
        if len(pairs) > 1:
            self.surfaces = replace(
                pattern,
                facet_tags=given_tags,
                secondary=secondary,
                primary=primary or pattern.primary,
                gap=None,
                name="; ".join(map(str, pairs)),
            )

    def owners(self, shares: Array) -> Indices:
        """Return which pair (n,) has each node's multiplier, from the areas (n, pairs) of pairs."""
        belongs = shares > NEGLIGIBLE * shares.sum(axis=1, keepdims=True)
        strongest = np.where(belongs, self.rank, -1).max(axis=1, keepdims=True)
        return np.asarray(np.argmax(self.rank == strongest, axis=1))

    def say_laws(self, comm: MPI.Comm, shares: Array) -> None:
        """Warn which law acts at nodes of pairs with different laws or gaps. Collective."""
        belongs = shares > NEGLIGIBLE * shares.sum(axis=1, keepdims=True)
        for i, j in combinations(range(len(self.pairs)), 2):
            if self.rank[i] == self.rank[j]:
                continue
            count = comm.allreduce(int((belongs[:, i] & belongs[:, j]).sum()))
            if count:
                stronger = self.pairs[i if self.rank[i] > self.rank[j] else j]
                warn(
                    comm,
                    "pairing: %d nodes belong to %s and to %s: they follow the law of %s, %s",
                    *(count, self.pairs[i], self.pairs[j], stronger, stronger.friction),
                    about=f"{self.pairs[i]}, {self.pairs[j]}",
                )


def _same(pair: ContactPair, second: ContactPair) -> bool:
    """Return whether two pairs have the same kind of law, with equal arguments, and equal gaps."""
    law, second_law = pair.friction, second.friction
    if type(law) is not type(second_law):
        return False
    arguments = zip(vars(law).values(), vars(second_law).values(), strict=False)
    compared = [(pair.gap, second.gap), *arguments]
    return all(bool(np.all(a == b)) for a, b in compared)


def _strength(law: Friction) -> tuple[int, float, float]:
    """Return what orders laws by strength: kind, coefficient of friction and constant bound.

    Kinds are 2 if bonded, 1 with friction or 0. Of two bounds the larger counts, a function as 0.
    """
    if not isinstance(law, DryFriction):
        return (2 if isinstance(law, Bonded) else 0), 0.0, 0.0
    values = []
    for bound in (law.terms.coefficient, law.terms.constant):
        entries = bound if isinstance(bound, tuple) else (bound,)
        # a `fem.Constant` has a value, a function counts as 0
        values.append(max(real(getattr(entry, "value", entry)) or 0.0 for entry in entries))
    return 1, values[0], values[1]


def groups_of(V: Any, pairs: Sequence[ContactPair]) -> list[PairGroup]:
    """Return the pairs in groups that share secondary nodes and a primary body. Collective.

    An obstacle counts like a primary body. Surfaces that touch themselves are groups of their own.
    """
    single = [not pair.touches_itself for pair in pairs]
    deformable = np.array([pair.obstacle is None for pair in pairs])
    obstacles = [id(pair.obstacle) for pair in pairs]
    # (pairs, pairs) whether two pairs may belong to one group
    linked = np.outer(single, single) & np.equal.outer(obstacles, obstacles)
    np.fill_diagonal(linked, False)
    if linked.any():
        linked &= _shared(V, pairs, linked.any(axis=0), "secondary", None)
    compared = linked.any(axis=0) & deformable
    if compared.any():
        linked &= ~deformable | _shared(V, pairs, compared, "primary", label_bodies(V))
    count, group_of_pair = connected_components(csr_array(linked), directed=False)
    members = [[k for k in range(len(pairs)) if group_of_pair[k] == g] for g in range(count)]
    return [PairGroup([pairs[k] for k in numbers], numbers) for numbers in members]


def _shared(
    V: Any, pairs: Sequence[ContactPair], compared: Mask, side: SideName, label: Any | None
) -> Mask:
    """Return a mask (pairs, pairs) of pairs that share nodes, or bodies, on a side. Collective.

    Given the body of each node as `label` (nodes of V,), pairs share bodies; if it is None, nodes.
    Only pairs in the mask `compared` (pairs,), whose side must be deformable, share anything.
    """
    comm, dim = V.mesh.comm, V.mesh.topology.dim - 1
    V.mesh.topology.create_connectivity(dim, dim + 1)
    rows = [np.zeros((0, 2), dtype=np.intp)]
    for k in map(int, np.flatnonzero(compared)):
        facets = pairs[k].facet_tags.find(getattr(pairs[k], side))
        items = fem.locate_dofs_topological(V, dim, facets)  # nodes of other ranks' facets, too
        if label is not None:
            items = np.concatenate(comm.allgather(np.unique(label[items])))
        rows.append(np.column_stack([items, np.full(len(items), k)]))
    # the product counts the common items, nodes or bodies, of two pairs on this rank
    item, pair = np.concatenate(rows).T
    shape = int(item.max(initial=-1)) + 1, len(pairs)
    incidence = coo_array((np.ones(len(item)), (item, pair)), shape=shape).tocsr()
    return np.asarray(reduce_array(comm, (incidence.T @ incidence).toarray()) > 0.0)


class Undeformed:
    """The facets of a group's undeformed surfaces that this rank owns, to be displaced later.

    Attributes:
        group: the pairs between these surfaces, which are paired together.
        sides: the facets of each side, the secondary side first. An obstacle is no side, and a
            surface that touches itself is one side.
    """

    def __init__(
        self, V: Any, prescribed: Mask, group: PairGroup, *, axisymmetric: bool = False
    ) -> None:
        """Extract the surfaces of a group; for arguments see `pair_all_surfaces`. Collective."""
        self.group, pair = group, group.surfaces
        names = SIDES[:1] if pair.touches_itself or pair.obstacle is not None else SIDES
        sides = [tagged_facets(V, prescribed, pair, name) for name in names]
        sides = [replace(facets, axisymmetric=axisymmetric) for facets in sides]
        if pair.obstacle is None:
            sides = with_offsets(V, pair, sides)
        if pair.touches_itself:
            sides = [replace(sides[0], origins=facet_origins(V, sides[0]))]
        self.sides = sides

    def displaced(self, V: Any, u: Array) -> list[Facets]:
        """Return this rank's facets of each side, moved by u (nodes, dim) [length]. Collective."""
        result = []
        for facets, name in zip(self.sides, SIDES, strict=False):
            node = V.dofmap.index_map.global_to_local(facets.nodes.ravel())
            points = facets.points.copy()
            points[:, :, : u.shape[1]] += u[node.reshape(facets.nodes.shape)]
            displaced = facets.moved_to(points)
            result.append(with_checked_areas(V.mesh.comm, displaced, self.group.surfaces, name))
        return result


def tagged_facets(V: Any, prescribed: Mask, pair: ContactPair, side: SideName) -> Facets:
    """Return this rank's facets of a side; check that tags have only exterior ones. Collective."""
    mesh, (facet_tags, tags) = V.mesh, pair.given_tags(side)
    comm, dim = mesh.comm, mesh.topology.dim - 1
    for entity, neighbour in ((dim, dim + 1), (dim + 1, dim)):
        mesh.topology.create_connectivity(entity, neighbour)
    chosen = facet_tags.indices < mesh.topology.index_map(dim).size_local
    chosen &= np.isin(facet_tags.values, tags)
    facets, order = facet_tags.indices[chosen], np.argsort(tags)
    tag_index = order[np.searchsorted(tags, facet_tags.values[chosen], sorter=order)]
    exterior = np.isin(facets, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    counts = [np.bincount(index, minlength=len(tags)) for index in (tag_index, tag_index[exterior])]
    for tag, count, outside in zip(tags, *reduce_array(comm, counts), strict=True):
        if count == 0:
            in_use = sorted(set().union(*comm.allgather(np.unique(facet_tags.values).tolist())))
            raise InputError(
                f"no facet has the tag {tag} of the {side} side; the tags in use are {in_use}."
            )
        if outside < count:
            raise PairingError(
                f"{count - outside} of the {count} facets with tag {tag} ({side} side) lie "
                "inside a body: contact needs two surfaces with nodes of their own. Do not merge "
                "the nodes of the bodies when meshing."
            )
    return with_checked_areas(comm, _extracted(V, prescribed, facets, tag_index), pair, side)


def _extracted(V: Any, prescribed: Mask, facets: LocalNumbers, tag_index: Indices) -> Facets:
    """Return exterior facets (n,) of the mesh, with `tag_index` (n,), as `Facets`. Collective."""
    mesh, dofmap, dim = V.mesh, V.dofmap, V.mesh.topology.dim - 1
    # the cell of each facet, the facet's number in it, and the nodes of each facet of a cell
    to_cell = mesh.topology.connectivity(dim, dim + 1)
    cells = to_cell.array[to_cell.offsets[facets]]
    kinds = basix.cell.subentity_types(V.element.basix_element.cell_type)[dim]
    cell, per_cell = kinds[0].name, len(kinds)
    of_cell = mesh.topology.connectivity(dim + 1, dim).array.reshape(-1, per_cell)
    facet_in_cell = (of_cell[cells] == facets[:, None]).argmax(axis=1)
    closures = [dofmap.dof_layout.entity_closure_dofs(dim, i) for i in range(per_cell)]
    corners = len(basix.topology(kinds[0])[0])

    x = V.tabulate_dof_coordinates()
    cell_nodes = dofmap.list[cells]
    nodes = np.take_along_axis(cell_nodes, np.array(closures)[facet_in_cell], axis=1)
    points = x[nodes]
    free = with_owned_values(V, (~prescribed).astype(np.float64)).x.array
    is_free = free.reshape(-1, dofmap.index_map_bs) > 0.5
    numbers = dofmap.index_map.local_to_global(nodes.ravel().astype(np.int32)).reshape(nodes.shape)
    result = Facets(
        cell,
        V.element.basix_element.degree,
        np.asarray(numbers, dtype=np.int64),
        points,
        is_free[nodes[:, :corners]],
        numbers_in_file(V)[nodes[:, :corners]],
        outward=np.ones(len(facets)),
        offsets=np.zeros((len(facets), 0, 3)),
        origins=np.zeros((len(facets), 0)),
        tag_index=tag_index,
        bent=False,
    ).moved_to(points)  # sets `bent`
    # the outward side of a facet is the one away from the middle of its cell
    middle = x[cell_nodes[:, : vertex_count(V)]].mean(axis=1)
    ahead = points[:, :corners].mean(axis=1) - middle
    vectors = result.area_vectors(quadrature(cell, 1)[0])[:, 0]
    result.outward[dots(vectors, ahead) < 0.0] = -1.0
    return result


def with_checked_areas(comm: MPI.Comm, facets: Facets, pair: ContactPair, side: SideName) -> Facets:
    """Return facets with `bent` of any rank; raise PairingError if one has no area. Collective."""
    diameters = np.linalg.norm(np.ptp(facets.points, axis=1), axis=1)
    largest, bent = reduce_array(comm, [diameters.max(initial=0.0), float(facets.bent)], MPI.MAX)
    # areas are compared with the facet's diameter squared; lengths (2D) with the largest diameter
    expected = diameters**2 if facets.dim == 2 else largest
    empty = facets.areas <= (MESH_ROUNDING + facets.rounding) * expected
    count, total = reduce_array(comm, np.array([empty.sum(), len(empty)]))
    if count > 0:
        where = row_of_least(comm, facets.file_numbers[empty, 0], facets.points[empty].mean(axis=1))
        raise PairingError(
            f"{count} of the {total} facets of {pair.side(side)} ({side} side) have no area; "
            f"one is at {shown_place(where)}. Repair the mesh there."
        )
    return replace(facets, bent=bool(bent))


def with_offsets(V: Any, pair: ContactPair, sides: list[Facets]) -> list[Facets]:
    """Return the sides of a pair with the offsets of the surfaces whose geometry is known.

    The geometry is `pair.geometry`, or else the one that the pair's tags know. Without one, or with
    a warning if that of the tags fails, the sides are returned unchanged. Collective.
    """
    geometry, limit = pair.geometry, FAR_CORNER
    if geometry is None:
        geometry, limit = getattr(pair.facet_tags, "geometry", None), ON_SURFACE
    curved = geometry.curved if isinstance(geometry, GmshGeometry) else geometry or {}
    tags_of_sides = [pair.given_tags(name)[1] for name in SIDES]
    if curved.keys().isdisjoint(chain.from_iterable(tags_of_sides)):
        return sides
    try:
        with errors_on_all_ranks(V.mesh.comm), open_geometry(geometry or {}) as surfaces:
            return [
                replace(facets, offsets=_offsets_of_tags(facets, tags, surfaces, limit))
                for facets, tags in zip(sides, tags_of_sides, strict=False)
            ]
    except (InputError, MeshError) as error:
        if pair.geometry is not None:
            raise
        warn(
            V.mesh.comm,
            "contact pair %s: the curved surfaces in the file from which Gmsh made the mesh are "
            "not used: %s Smooth surfaces through the nodes take their place, as with "
            "ContactPair(geometry={}).",
            *(pair, f"{error}".rstrip(".") + "."),
            about=str(pair),
        )
        return sides


def _offsets_of_tags(
    facets: Facets, tags: Sequence[int], surfaces: Mapping[int, ExactSurface], limit: float
) -> Array:
    """Return the `Facets.offsets` (n, q, 3) to the exact surfaces of tags, NaN where there is none.

    A corner farther than `limit` times the facet's size from its surface raises InputError.
    """
    result = np.full((len(facets.points), len(facets.lagrange_points(OFFSET_DEGREE)), 3), np.nan)
    for k, tag in enumerate(tags):
        if tag not in surfaces:
            continue
        index = np.flatnonzero(facets.tag_index == k)
        of_tag = facets.selected(index)
        result[index] = _offsets(of_tag, tag, surfaces[tag].projections)
        sizes = np.ptp(of_tag.points, axis=1).max(axis=1)
        away = np.linalg.norm(result[index, : facets.corners], axis=2).max(axis=1)
        relative = (away / sizes).max(initial=0.0)
        if relative > limit:
            raise InputError(
                f"facets with tag {tag} are not on their surface in `geometry`: a corner is "
                f"{away.max():.2g} away from it, {relative:.2g} times the size of its facet. Give "
                "the geometry from which the mesh was made, in its units; for a mesh that was "
                "moved, give functions of points."
            )
    return result


def _offsets(facets: Facets, tag: int, projections: Sequence[Projection]) -> Array:
    """Return the `Facets.offsets` of facets from projections onto the patches of one surface.

    A facet belongs to the patch nearest to its corners; of equally near ones, to its centre.
    """
    points = facets.basis(facets.lagrange_points(OFFSET_DEGREE)) @ facets.points
    dim_of_space = facets.free.shape[2]

    def offsets(projection: Projection, points: Array) -> Array:
        """Return vectors (..., 3) from points to projections; equal points are projected once."""
        places, index = np.unique(points.reshape(-1, 3), axis=0, return_inverse=True)
        steps = project_points(places, f"geometry[{tag}]", projection, dim_of_space) - places
        return np.asarray(steps[index.ravel()].reshape(points.shape))

    if len(projections) == 1:
        return offsets(projections[0], points)
    corners = points[:, : facets.corners]
    probes = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
    # distances (projections, facets, corners and centre)
    away = np.stack([np.linalg.norm(offsets(onto, probes), axis=2) for onto in projections])
    of_corners = away[:, :, :-1].max(axis=2)
    rounding = ON_SURFACE * np.ptp(corners, axis=1).max(axis=1)
    tied = of_corners <= of_corners.min(axis=0) + rounding
    nearest = np.where(tied, away[:, :, -1], np.inf).argmin(axis=0)
    result: Array = np.zeros_like(points)
    for k, projection in enumerate(projections):
        result[nearest == k] = offsets(projection, points[nearest == k])
    return result


def straightened(V: Any, u: Array) -> Array:
    """Return u (nodes, dim) [length] such that straight edges of the mesh remain straight.

    If V has a higher degree than the mesh, nodes between vertices get the mean displacement of the
    vertices of their edge, face or cell; `displaced_jump` says how the gap includes the bending.
    """
    element = V.element.basix_element
    if element.degree <= geometry_degree(V.mesh):
        return u
    # the mesh then has straight edges, between whose vertices u becomes linear
    cells, corners = V.dofmap.list, vertex_count(V)
    hats = tabulate(element.cell_type.name, 1, 0, element.points)[0]
    result = u.copy()
    result[cells] = hats @ u[cells[:, :corners]]
    return result
