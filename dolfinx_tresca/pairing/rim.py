"""Secondary nodes beyond the edge of the other side, of whose facets hardly anything is covered."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.parallel import gather_rows
from dolfinx_tresca.pairing.coupling import owned
from dolfinx_tresca.pairing.mortar_integrals import COVER_ROUNDING, MortarIntegrals
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: Part of a node's area that must be in contact for a multiplier of its own, where others of its
#: facets have one. (A node in the corner of a square body on a regular mesh has a quarter.)
OWN_MULTIPLIER = 0.1


def barely_covered(V: Any, nodes: SurfaceNodes, integrals: MortarIntegrals, shared: Mask) -> Mask:
    """Return which nodes leave their part in the contact to others of their facets. Collective.

    A stiff body on a softer, larger one presses hardest along its edges. A node of the larger one
    just beyond would get the pressure that a straight line through those on the edge has there: a
    thousand times the largest one of the contact, and more the smaller the covered part.

    Args:
        V: the space.
        nodes: of the secondary side.
        integrals: over the overlap.
        shared: (n,) nodes that belong to the primary side as well.
    """
    corners, weights = nodes.facet_nodes, integrals.own.weights
    covered = np.bincount(corners.ravel(), weights.ravel(), minlength=len(nodes.numbers))
    # at a sharp edge a node is several; where both sides of it are covered they stay as they are
    _, number = np.unique(nodes.numbers, return_inverse=True)
    single = np.bincount(number, covered > 0.0)[number] == 1
    own = owned(V, nodes)

    def told(some: Mask) -> Mask:
        """Return what owners say of nodes: they have all facets round them."""
        return np.isin(nodes.numbers, gather_rows(V.mesh.comm, nodes.numbers[some & own]))

    few = told((covered > 0.0) & (covered < OWN_MULTIPLIER * nodes.weights) & single)
    takes = ~few & ~shared & nodes.free.any(axis=1)
    alone = (weights.sum(axis=1) > 0.0) & ~takes[corners].any(axis=1)
    # there the corner next to what is covered keeps it, or those that are as near but for rounding
    nearest = weights >= (1.0 - COVER_ROUNDING) * weights.max(axis=1, keepdims=True)
    few[corners[alone[:, None] & nearest]] = False
    return told(few)
