"""Nodes of a surface that touches itself: the bodies opposite to them, and their roles."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Indices, Mask
from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes
from dolfinx_tresca.pairing.search.self_contact import SelfContact


def redundant_nodes(nodes: SurfaceNodes, integrals: MortarIntegrals) -> Mask:
    """Return the nodes whose jump another node already constrains. Not collective.

    `SelfContact` decides which of two facets is the secondary one. Where its choice changes from
    facet to facet, two opposite nodes may each be secondary on one facet and primary on the next.
    Both nodes would have the same jump: only the node that comes first in the mesh file has a
    multiplier, and the second node is returned. A node that is opposite to itself, such as the tip
    of a crack, has no jump, and is returned.

    Returns:
        (n,) whether the node has no multiplier for this reason; valid for nodes whose facets are
        all on this rank.
    """
    count, in_file = nodes.facets.corners, nodes.facets.file_numbers

    def rows(pairs: Indices) -> Indices:
        """Return rows (node, its number in the mesh file, this number of an opposite node).

        There is a row for each corner of the first facet of a pair, with each corner of the second.
        """
        own, theirs = pairs.T
        columns = (
            np.repeat(nodes.facet_nodes[own], count, axis=1),
            np.repeat(in_file[own], count, axis=1),
            np.tile(in_file[theirs], count),
        )
        found: Indices = np.column_stack([column.ravel() for column in columns])
        return np.unique(found, axis=0)

    both = np.column_stack([integrals.secondary, integrals.primary])
    together = np.concatenate([rows(both), rows(integrals.opposite)])
    found, times = np.unique(together, axis=0, return_counts=True)
    own, theirs = found[:, 1], found[:, 2]
    second = found[(own == theirs) | (times > 1) & (own > theirs), 0]
    result = np.zeros(len(nodes.numbers), dtype=np.bool_)
    result[second] = True
    return result


def opposite_bodies(nodes: SurfaceNodes, integrals: MortarIntegrals, order: SelfContact) -> Indices:
    """Return the body that is opposite to each node. Not collective.

    Returns:
        (n,) the number of the body, the least number if there are several bodies; -1 for nodes
        without an opposite facet.
    """
    none = np.iinfo(np.intp).max
    result = np.full(len(nodes.numbers), none)
    corners = nodes.facet_nodes[integrals.secondary]
    np.minimum.at(result, corners, order.body[integrals.primary][:, None])
    return np.where(result == none, -1, result)
