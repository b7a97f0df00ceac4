"""Secondary nodes beyond the rim of the overlap, which carry no multiplier of their own."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.parallel import gather_rows
from dolfinx_tresca.pairing.coupling import owned
from dolfinx_tresca.pairing.mortar_integrals import COVER_ROUNDING, MortarIntegrals
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: Mean of a node's hat function over the covered parts of its facets, relative to the mean over
#: whole facets, from which on the node carries a multiplier. On the rim of the overlap, corners
#: included, it is 1; beyond a straight rim it is 1 less the distance over the facet's size. Twice
#: as far out (0.76) the nodes just beyond a block's edge show up to 1.5 times the pressure of the
#: nodes on that edge; half as far (0.94) nodes on a circle of 16 segments lose their multipliers,
#: as the chords of another mesh pass them by.
LEAST_MEAN = 0.88


def nodes_beyond_rim(
    V: Any, nodes: SurfaceNodes, integrals: MortarIntegrals, shared: Mask
) -> Mask:
    """Return the nodes whose part in the overlap goes to other nodes of their facets. Collective.

    A node that does not face the other side itself has a part of its area in contact, perhaps, but
    no place there. With a multiplier of its own the other side would seem to extend as far as the
    node: its force would be that of a whole facet, and its pressure larger the smaller its part.
    Where no corner of a facet faces the other side, the nearest one keeps its multiplier.

    Args:
        V: the space.
        nodes: of the secondary side.
        integrals: over the overlap.
        shared: (n,) nodes that belong to the primary side as well.

    Returns:
        (n,) the same for a node on all ranks.
    """
    corners, weights = nodes.facet_nodes, integrals.own.weights
    count = len(nodes.numbers)
    covered = np.bincount(corners.ravel(), weights.ravel(), minlength=count)
    whole = np.broadcast_to(weights.mean(axis=1, keepdims=True), weights.shape)
    whole = np.bincount(corners.ravel(), whole.ravel(), minlength=count)
    # at a sharp edge a node is several; where both sides of it are covered they stay as they are
    _, number = np.unique(nodes.numbers, return_inverse=True)
    single = np.bincount(number, covered > 0.0)[number] == 1
    own = owned(V, nodes)

    def as_owners_say(some: Mask) -> Mask:
        """Return nodal flags as computed by the owners, which know all facets of their nodes."""
        return np.isin(nodes.numbers, gather_rows(V.mesh.comm, nodes.numbers[some & own]))

    beyond = as_owners_say((covered > 0.0) & (covered < LEAST_MEAN * whole) & single)
    takes = ~beyond & ~shared & nodes.free.any(axis=1)
    alone = (weights.sum(axis=1) > 0.0) & ~takes[corners].any(axis=1)
    nearest = weights >= (1.0 - COVER_ROUNDING) * weights.max(axis=1, keepdims=True)
    beyond[corners[alone[:, None] & nearest]] = False
    return as_owners_say(beyond)
