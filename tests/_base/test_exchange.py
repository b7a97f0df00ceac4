"""Exchange of array rows between ranks."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca._base.parallel import exchange, row_of_least


@pytest.mark.parallel
def test_rows_arrive_in_the_order_of_their_ranks(comm):
    """Each rank sends k + 1 rows to rank k, in any order, as records or as numbers."""
    ranks = np.random.default_rng(comm.rank).permutation(
        np.repeat(np.arange(comm.size), np.arange(comm.size) + 1)
    )
    kind = [("place", np.float64, (3,)), ("from", np.int64), ("free", np.bool_, (2,))]
    rows = np.zeros(len(ranks), dtype=kind)
    rows["place"][:, 0], rows["from"], rows["free"] = np.arange(len(ranks)), comm.rank, [1, 0]
    received, source = exchange(comm, rows, ranks)
    assert np.array_equal(source, np.repeat(np.arange(comm.size), comm.rank + 1))
    assert np.array_equal(received["from"], source)
    assert (received["free"] == [True, False]).all()
    assert (np.diff(received["place"][:, 0])[np.diff(source) == 0] > 0).all()
    plain, _ = exchange(comm, rows["place"][:0], ranks[:0])
    assert plain.shape == (0, 3)


@pytest.mark.parallel
def test_row_of_least(comm):
    keys = np.array([5, 3]) + (comm.rank + 1) % comm.size if comm.rank % 2 == 0 else np.zeros(0)
    row = row_of_least(comm, keys, np.column_stack([keys, np.full(len(keys), comm.rank)]))
    first = {1: (3, 0), 2: (4, 0), 3: (3, 2)}[comm.size]
    assert tuple(row) == first
    assert row_of_least(comm, np.zeros(0), np.zeros((0, 2))) is None
