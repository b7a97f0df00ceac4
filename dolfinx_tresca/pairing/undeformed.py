"""The undeformed surfaces of a pair, which are displaced for each pairing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.pairing.group import PairGroup
from dolfinx_tresca.pairing.search.facets import Facets, joined
from dolfinx_tresca.pairing.search.self_contact import FINER, facet_origins
from dolfinx_tresca.pairing.search.tagged import displaced, tagged_facets, with_offsets
from dolfinx_tresca.scene.pair import SIDES


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
    def of(
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
            origins, bodies = facet_origins(V, facets)
            sides = {pair.secondary: replace(facets, origins=origins)}
            if bodies > 1:
                log(
                    V.mesh.comm,
                    "pairing: %s, %d bodies: of two, the one with finer facets (by a factor of "
                    "%.2f) is secondary, else the first one by its least x, y, z",
                    *(pair, bodies, 1.0 / FINER),
                )
        return cls(group, sides)

    def displaced(self, V: Any, u: Array) -> dict[int, Facets]:
        """Return tag -> displaced facets of each side that this rank owns. Collective.

        Args:
            V: the space of the displacement.
            u: (nodes, dim of space) displacement of this rank's nodes [length].

        Raises:
            PairingError: displaced facets have no area.
        """
        return {
            tag: displaced(V, facets, u, self.group.surfaces.side(name), name)
            for (tag, facets), name in zip(self.sides.items(), SIDES, strict=False)
        }
