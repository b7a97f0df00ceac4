"""Contact pairs whose sides are parts of the same surfaces, and so are paired together.

`Undeformed` has the facets of both surfaces, which are displaced for each later pairing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices, Mask, real
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.compat import geometry_degree
from dolfinx_tresca._base.functions import entities_per_cell
from dolfinx_tresca._base.parallel import gather_rows, reduce_array, warn
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.search.facets import NEGLIGIBLE, Facets, joined, tabulate
from dolfinx_tresca.pairing.search.self_contact import facet_origins
from dolfinx_tresca.pairing.search.tagged import checked, tagged_facets, with_offsets
from dolfinx_tresca.scene.friction import Bonded, DryFriction, Friction
from dolfinx_tresca.scene.pair import SIDES, ContactPair, SideName

#: Arguments that pairs of a group must have in common.
COMMON = ("sliding", "search_distance", "pairing", "geometry")


@dataclass(frozen=True)
class PairGroup:
    """Pairs that are paired as one pair of surfaces, so that a node has one multiplier.

    Attributes:
        numbers: the position of each pair in the list of the problem.
        pairs: the pairs.
        surfaces: the pair of surfaces with the tags of all pairs, and the law of one of them.
        pair_of_tags: (secondary tags, primary tags) index in `pairs` of the pair between two tags
            of `surfaces`; -1 if there is none, so that facets with these tags are not paired.
        rank: (pairs,) rank of the laws, equal for pairs with the same law and the same added gap.
            Of the pairs that meet at a node, those with the largest rank determine its law; the
            first pair with this rank has the multiplier.
    """

    numbers: tuple[int, ...]
    pairs: tuple[ContactPair, ...]
    surfaces: ContactPair
    pair_of_tags: Indices
    rank: Indices

    @classmethod
    def from_pairs(cls, pairs: Sequence[ContactPair], numbers: Sequence[int] = (0,)) -> PairGroup:
        """Return the group of some pairs. Not collective.

        Raises:
            InputError: the pairs differ in their `facet_tags`, or in an argument of `COMMON`.
        """
        pattern = pairs[0]
        for pair in pairs[1:]:
            differ = [name for name in COMMON if getattr(pair, name) != getattr(pattern, name)]
            given, second = (both.given_tags("secondary")[0] for both in (pattern, pair))
            if given._cpp_object is not second._cpp_object:
                differ.append("facet_tags")
            if differ:
                raise InputError(
                    f"contact pairs {pattern} and {pair} are parts of the same surfaces, whose "
                    f"nodes they share, but differ in {' and '.join(differ)}: give both the same."
                )
        own = [[pair.given_tags(side)[1] for side in SIDES] for pair in pairs]
        secondary, primary = (
            list(dict.fromkeys(tag for tags in both for tag in tags))
            for both in zip(*own, strict=True)
        )
        pair_of_tags = np.full((len(secondary), max(len(primary), 1)), -1)
        for k, (own_tags, tags) in enumerate(own):
            columns = [primary.index(tag) for tag in tags] or [0]
            pair_of_tags[np.ix_([secondary.index(tag) for tag in own_tags], columns)] = k
        alike = [next(k for k, second in enumerate(pairs) if _same(pair, second)) for pair in pairs]
        strengths = [(*_strength(pairs[k].friction), -k) for k in alike]
        _, rank = np.unique(strengths, axis=0, return_inverse=True)
        surfaces = pattern
        if len(pairs) > 1:
            surfaces = replace(
                pattern,
                facet_tags=pattern.given_tags("secondary")[0],
                secondary=secondary,
                primary=primary or pattern.primary,
                gap=None,
                name="; ".join(map(str, pairs)),
            )
        return cls(tuple(numbers), tuple(pairs), surfaces, pair_of_tags, rank.ravel())

    def owners(self, shares: Array) -> Indices:
        """Return for each node (n,) the index of the pair that has its multiplier.

        Args:
            shares: (n, pairs) parts of the nodes' areas that belong to each pair.
        """
        belongs = shares > NEGLIGIBLE * shares.sum(axis=1, keepdims=True)
        strongest = np.where(belongs, self.rank, -1).max(axis=1, keepdims=True)
        return np.asarray(np.argmax(self.rank == strongest, axis=1))

    def say_laws(self, comm: MPI.Comm, shares: Array) -> None:
        """Log which law acts at nodes of pairs with different laws or gaps. Collective."""
        belongs = shares > NEGLIGIBLE * shares.sum(axis=1, keepdims=True)
        for i, j in combinations(range(len(self.pairs)), 2):
            if self.rank[i] == self.rank[j]:
                continue
            number = comm.allreduce(int((belongs[:, i] & belongs[:, j]).sum()))
            if number:
                stronger = self.pairs[i if self.rank[i] > self.rank[j] else j]
                warn(
                    comm,
                    "pairing: %d nodes belong to %s and to %s: they follow the law of %s, %s",
                    *(number, self.pairs[i], self.pairs[j], stronger, stronger.friction),
                    about=f"{self.pairs[i]}, {self.pairs[j]}",
                )


def _same(pair: ContactPair, second: ContactPair) -> bool:
    """Return whether two pairs have the same kind of law, its same arguments, and the same gap."""
    laws = pair.friction, second.friction
    arguments = [(pair.gap, second.gap), *zip(*(vars(law).values() for law in laws), strict=False)]
    return type(laws[0]) is type(laws[1]) and all(bool(np.all(a == b)) for a, b in arguments)


def _strength(law: Friction) -> tuple[int, float, float]:
    """Return the kind of a law, its coefficient and its constant bound, in ascending order.

    A coefficient or bound that is no number and no Constant counts as 0.
    """
    if not isinstance(law, DryFriction):
        return 2 if isinstance(law, Bonded) else 0, 0.0, 0.0
    sizes = []
    for bound in (law.terms.coefficient, law.terms.constant):
        values = [
            real(entry.value.item() if isinstance(entry, fem.Constant) else entry)
            for entry in (bound if isinstance(bound, tuple) else (bound,))
        ]
        sizes.append(max(value or 0.0 for value in values))
    return 1, sizes[0], sizes[1]


def groups_of(V: Any, pairs: Sequence[ContactPair]) -> list[PairGroup]:
    """Return the pairs in groups: pairs that share secondary nodes and a primary body. Collective.

    Surfaces that touch themselves are groups of their own.

    Raises:
        InputError: pairs that must be paired together differ in an argument that must be the same.
    """
    single = [not pair.touches_itself for pair in pairs]
    deformable = np.array([pair.obstacle is None for pair in pairs])
    obstacles = [id(pair.obstacle) for pair in pairs]
    linked = np.outer(single, single) & np.equal.outer(obstacles, obstacles)
    np.fill_diagonal(linked, False)
    if linked.any():
        linked &= _shared(V, pairs, linked.any(axis=0), "secondary", None)
    compared = linked.any(axis=0) & deformable
    if compared.any():
        linked &= ~deformable | _shared(V, pairs, compared, "primary", label_bodies(V))
    count, group_of_pair = connected_components(csr_array(linked), directed=False)
    members = [[k for k in range(len(pairs)) if group_of_pair[k] == g] for g in range(count)]
    return [PairGroup.from_pairs([pairs[k] for k in numbers], numbers) for numbers in members]


def _shared(
    V: Any, pairs: Sequence[ContactPair], compared: Mask, side: SideName, label: Any | None
) -> Mask:
    """Return a mask (pairs, pairs) of pairs that share nodes, or bodies, on a side. Collective.

    Args:
        V: the space of the displacement.
        pairs: the pairs.
        compared: (pairs,) whether a pair is compared.
        side: name of the side, which is deformable.
        label: (nodes of V,) the body of each node on this rank; None: nodes are compared.
    """
    comm, dim = V.mesh.comm, V.mesh.topology.dim - 1
    V.mesh.topology.create_connectivity(dim, dim + 1)
    rows = [np.zeros((0, 2), dtype=np.intp)]
    for k in map(int, np.flatnonzero(compared)):
        facets = pairs[k].facet_tags.find(getattr(pairs[k], side))
        nodes = fem.locate_dofs_topological(V, dim, facets)  # those of facets of other ranks, too
        items = nodes if label is None else gather_rows(comm, np.unique(label[nodes]))
        rows.append(np.column_stack([items, np.full(len(items), k)]))
    item, pair = np.concatenate(rows).T
    shape = int(item.max(initial=-1)) + 1, len(pairs)
    incidence = coo_array((np.ones(len(item)), (item, pair)), shape=shape).tocsr()
    return np.asarray(reduce_array(comm, (incidence.T @ incidence).toarray()) > 0.0)


@dataclass(frozen=True)
class Undeformed:
    """The facets of a pair's undeformed surfaces that this rank owns.

    Attributes:
        group: the pairs, which are paired together.
        sides: tag -> facets of a side, the secondary side first. There is only one side if the
            primary side is a rigid obstacle, or if the surface touches itself.
    """

    group: PairGroup
    sides: dict[int, Facets]

    @classmethod
    def from_mesh(
        cls, V: Any, prescribed: Mask, group: PairGroup, *, axisymmetric: bool = False
    ) -> Undeformed:
        """Extract the surfaces from the mesh. Collective.

        Args:
            V: vector space of degree 1 or 2.
            prescribed: (owned dofs,) whether a Dirichlet condition prescribes the degree of
                freedom.
            group: the pairs.
            axisymmetric: whether integrals are over rings about the axis x = 0.

        Raises:
            InputError: tags or geometry are wrong.
            PairingError: facets are inside a body, or have no area.
            MeshError: Gmsh cannot read the geometry file any more.
        """
        pair = group.surfaces
        by_tag: dict[int, Facets] = {}
        for name in SIDES:
            facet_tags, tags = pair.given_tags(name)
            for tag in tags:
                if tag not in by_tag:
                    facets = tagged_facets(V, prescribed, facet_tags, tag, name)
                    by_tag[tag] = replace(facets, axisymmetric=axisymmetric)
        by_tag = with_offsets(V, pair, by_tag)
        sides = {
            getattr(pair, name): joined([by_tag[tag] for tag in tags])
            for name in SIDES
            if (tags := pair.given_tags(name)[1])
        }
        if pair.touches_itself:
            facets = sides[pair.secondary]
            sides = {pair.secondary: replace(facets, origins=facet_origins(V, facets))}
        return cls(group, sides)

    def displaced(self, V: Any, u: Array) -> dict[int, Facets]:
        """Return tag -> displaced facets of each side that this rank owns. Collective.

        Args:
            V: the space of the displacement.
            u: (nodes, dim of space) displacement of this rank's nodes [length].

        Raises:
            PairingError: displaced facets have no area.
        """
        result = {}
        for (tag, facets), name in zip(self.sides.items(), SIDES, strict=False):
            node = V.dofmap.index_map.global_to_local(facets.nodes.ravel())
            points = facets.points.copy()
            points[:, :, : u.shape[1]] += u[node.reshape(facets.nodes.shape)]
            moved = facets.moved_to(points)
            result[tag] = checked(V.mesh.comm, moved, self.group.surfaces.side(name), name)
        return result


def straightened(V: Any, u: Array) -> Array:
    """Return u without the part that would bend edges beyond the degree of the mesh's geometry.

    Not collective.

    If V has a higher degree than the geometry, each node that is not at a vertex is moved by the
    mean displacement of the vertices of its edge, face or cell; else the result is u.

    Args:
        V: the space of the displacement.
        u: (nodes, dim of space) displacement of this rank's nodes [length].
    """
    element = V.element.basix_element
    if element.degree <= geometry_degree(V.mesh):
        return u
    cells, corners = V.dofmap.list, entities_per_cell(V, 0)
    hats = tabulate(element.cell_type.name, 1, 0, element.points)[0]
    result = u.copy()
    result[cells] = hats @ u[cells[:, :corners]]
    return result
