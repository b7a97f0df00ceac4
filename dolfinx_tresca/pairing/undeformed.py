"""Properties of a pair's undeformed surfaces, which displaced surfaces need for their pairing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import log
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.offsets import surface_offsets
from dolfinx_tresca.surface.self_contact import FINER, facet_origins
from dolfinx_tresca.surface.tagged import tagged_facets


@dataclass(frozen=True)
class Undeformed:
    """Properties of the undeformed surfaces of a pair, for the facets that this rank owns.

    Attributes:
        offsets: tag -> `Facets.offsets` of sides whose exact surface is known.
        origins: `Facets.origins` of a surface that may touch itself, else None.
    """

    offsets: Mapping[int, Array]
    origins: Array | None

    @classmethod
    def of(cls, V: Any, prescribed: Mask, pair: ContactPair) -> Undeformed:
        """Compute the properties; the mesh must not be moved. Collective.

        Raises:
            InputError: tags or geometry are wrong.
            PairingError: facets are inside a body, or have no area.
            MeshError: Gmsh cannot read the geometry file any more.
        """
        offsets = surface_offsets(V, prescribed, pair)
        if not pair.touches_itself:
            return cls(offsets, None)
        facets = tagged_facets(V, prescribed, pair.facet_tags, pair.secondary, "secondary")
        origins, bodies = facet_origins(V, facets)
        if bodies > 1:
            log(
                V.mesh.comm,
                "pairing: %s, %d bodies: of two, the one with finer facets (by a factor of %.2f) "
                "is secondary, else the first one by its least x, y, z",
                *(pair, bodies, 1.0 / FINER),
            )
        return cls(offsets, origins)
