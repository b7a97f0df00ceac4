"""Which nodes cells connect."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.bodies import _connected_nodes


def test_nodes_are_connected_by_cells():
    """Chains of cells in any order, and a node without cells."""
    chain = np.array([[0, 1, 2], [2, 3, 4], [9, 5, 6], [6, 7, 8]], dtype=np.int32)
    labels = _connected_nodes(np.random.default_rng(0).permutation(chain), 11)
    assert len(set(labels[:5])) == len(set(labels[5:10])) == 1
    assert sorted({labels[0], labels[5], labels[10]}) == [0, 1, 2]
    assert _connected_nodes(np.zeros((0, 4), dtype=np.int32), 2).tolist() == [0, 1]
