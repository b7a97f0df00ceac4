"""One side of a contact pair on this rank."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, GlobalNumbers
from dolfinx_tresca._base.exchange import exchange
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pairing.coupling import owned_nodes
from dolfinx_tresca.pairing.search.halo import Halo
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.pairing.search.whole import WholeSurface
from dolfinx_tresca.scene.pair import ContactPair, SideName

#: Distance, relative to the diameter of the smallest facet, up to which two nodes coincide.
SAME_PLACE = 1e-6

#: Large primes of a spatial hash, the sum of primes times integer coordinates (Teschner et al.
#: 2003, Optimized spatial hashing for collision detection of deformable objects).
HASH_FACTORS = np.array([73856093, 19349663, 83492791])


@dataclass(frozen=True)
class Side:
    """The facets of one side of a pair.

    Attributes:
        pair: the contact pair.
        name: "secondary" or "primary".
        halo: this rank's facets, and copies of facets of other ranks.
    """

    pair: ContactPair
    name: SideName
    halo: Halo

    @cached_property
    def whole(self) -> WholeSurface:
        """Properties of the whole surface, the same on all ranks. Collective."""
        return WholeSurface.of(self.halo.comm, self.halo.owned)

    def nodes_on_this_rank(self, V: Any, moved: bool) -> SurfaceNodes:
        """Return the nodes of this rank's facets. Collective.

        The log has a warning if nodes of an undeformed surface coincide, since the surface is torn
        there. Nodes that also belong to facets with other tags, and surfaces that touch themselves,
        are not checked.

        Args:
            V: the space of the displacement.
            moved: whether the surface is displaced.

        Raises:
            PairingError: an owned node has no normal.
        """
        comm = V.mesh.comm
        with errors_on_all_ranks(comm):
            nodes = SurfaceNodes.of(self.halo.facets)
            own = owned_nodes(V, nodes)
            has_no_normal = own & nodes.has_no_normal
            if has_no_normal.any():
                raise PairingError(
                    f"the surface {self.pair.side(self.name)} ({self.name} side) has no normal at "
                    f"{nodes.points[has_no_normal][0]}: the normals of the facets around that node "
                    "cancel. Repair the mesh there."
                )
        # no warning: nodes of two bodies that touch coincide
        if moved or self.halo.facets.origins.shape[1]:
            return nodes
        numbers, first = np.unique(nodes.numbers[own], return_index=True)
        # coincident corners of adjacent bricks also belong to their ends, which have other tags
        single = ~np.isin(numbers, self._nodes_with_other_tags(V))
        coincident = _coincident(comm, nodes.points[own][first][single], self.whole)
        if coincident:
            log(
                comm,
                "the surface %s (%s side) has %d nodes at the place of another one: it is "
                "torn there. Merge duplicated nodes of the mesh, unless these are edges of two "
                "bodies.",
                *(self.pair.side(self.name), self.name, coincident),
                level=logging.WARNING,
                about=self.pair.side(self.name),
            )
        return nodes

    def _nodes_with_other_tags(self, V: Any) -> GlobalNumbers:
        """Return all owned nodes, and some ghosts, of facets with other tags. Collective."""
        tags = self.pair.facet_tags
        others = tags.indices[tags.values != getattr(self.pair, self.name)]
        found = fem.locate_dofs_topological(V, tags.dim, others)
        numbers: GlobalNumbers = V.dofmap.index_map.local_to_global(found)
        return numbers


def _coincident(comm: MPI.Comm, points: Array, whole: WholeSurface) -> int:
    """Return how many of the points (n, 3) of all ranks coincide with another point. Collective.

    Coincident points have the same hash and are sent to the same rank, which counts them.
    """
    places = np.round(
        (points - whole.reference_points[0]) / (SAME_PLACE * whole.smallest_facet)
    ).astype(np.int64)
    places, _ = exchange(comm, places, (places @ HASH_FACTORS) % comm.size)
    return int(comm.allreduce(len(places) - len(np.unique(places, axis=0))))
