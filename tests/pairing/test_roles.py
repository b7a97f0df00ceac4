"""Roles of the nodes of a surface that touches itself."""

from __future__ import annotations

import dataclasses

import numpy as np
from sheets import joined, nodes_of, sheet

from dolfinx_tresca.pairing.mortar_integrals import MortarIntegrals
from dolfinx_tresca.pairing.search.self_contact import SelfContact, opposite_bodies, redundant_nodes

#: Facets of each of two sheets that face each other, the first one's before the second one's.
NUMBER = 6


class Alternating(SelfContact):
    """The roles of the sheets are exchanged from facet to facet."""

    def may_meet(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """All facets may."""
        return np.ones(len(first), dtype=bool)

    def is_secondary(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """In even places the lower facet is."""
        return (first < NUMBER) == (first % NUMBER % 2 == 0)


def test_of_two_nodes_that_are_secondary_and_primary_one_is_redundant():
    """All but those at the ends are both; bodies opposite are those that a node is secondary to."""
    lower = sheet("interval", NUMBER)
    upper = sheet("interval", NUMBER, height=0.1, up=False, first=NUMBER + 1)
    bodies = np.repeat([0, 1], NUMBER)
    origins = np.column_stack([bodies, np.zeros((2 * NUMBER, 11))])
    facets = dataclasses.replace(joined(lower, upper), origins=origins)
    nodes, order = nodes_of(facets), Alternating(facets)
    everything = np.arange(len(bodies))
    integrals = MortarIntegrals(nodes, nodes, everything, np.inf, order)

    x, is_upper = nodes.points[:, 0], nodes.points[:, 1] > 0.05
    inner = (x > 0.0) & (x < 1.0)
    assert np.array_equal(
        redundant_nodes(nodes, integrals.pairs, integrals.opposite), inner & is_upper
    )
    only_primary = np.where(is_upper, x == 0.0, x == 1.0)
    expected = np.where(only_primary, -1, np.where(is_upper, 0, 1))
    assert np.array_equal(opposite_bodies(nodes, integrals.pairs, order), expected)
