"""Which pairs are paired together."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import ContactPair, Coulomb, Frictionless, RigidPlane, Tresca
from dolfinx_tresca.pairing.group import groups_of
from scenes.boxes import Body, boxes

FLOOR, WALL = RigidPlane((0, 0), (0, 1)), RigidPlane((0, 0), (1, 0))


@pytest.mark.parallel
def test_pairs_are_together_if_they_share_nodes_and_a_partner(comm):
    """A beam (tags 1 and 2) on two blocks (3 to 5); the last block has two tags."""
    bodies = [Body((2, 1), [(0.0, 2.0), (1.0, 2.0)])]
    bodies += [Body((2, 1), [(k, k + 1.0), (0.0, 1.0)]) for k in (0, 1)]
    made = boxes(comm, "quadrilateral", bodies)

    def at(y, low, high):
        return lambda x: (np.abs(x[:, 1] - y) < 1e-9) & (x[:, 0] > low) & (x[:, 0] < high)

    tags = made.tags(
        *((1, [0], at(1.0, 0.0, 1.0)), (2, [0], at(1.0, 1.0, 2.0)), (3, [1], at(1.0, 0.0, 1.0))),
        *((4, [2], at(1.0, 1.0, 1.5)), (5, [2], at(1.0, 1.5, 2.0))),
        *((6, [1], at(0.0, 0.0, 1.0)), (7, [2], at(0.0, 1.0, 2.0))),
    )

    def together(*sides, laws=None):
        laws = laws or [Coulomb(0.3)] * len(sides)
        pairs = [ContactPair(tags, *side, law) for side, law in zip(sides, laws, strict=True)]
        return sorted(sorted(group.numbers) for group in groups_of(made.V, pairs))

    assert together((1, 3), (2, 4), (2, 5)) == [[0], [1, 2]]  # two bodies
    assert together((1, 3), (2, [4, 5])) == [[0], [1]]
    assert together((1, [3, 4]), (2, 4)) == [[0, 1]]
    assert together((1, FLOOR), (2, FLOOR)) == [[0, 1]]
    assert together((1, FLOOR), (2, WALL), (1, 3)) == [[0], [1], [2]]
    assert together((6, FLOOR), (7, FLOOR)) == [[0], [1]]  # no common nodes
    laws = [Frictionless(), Tresca(0.1)]
    assert together((1, FLOOR), (2, FLOOR), laws=laws) == [[0, 1]]
    assert together(([1, 2], [1, 2]), (1, 3)) == [[0], [1]]
