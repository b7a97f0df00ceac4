"""Which cells are refined."""

from __future__ import annotations

from itertools import combinations

from mpi4py import MPI

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dolfinx_tresca.adapt.refinement import NEARLY, largest_part


@given(
    st.lists(st.integers(0, 50), min_size=1, max_size=9).filter(any),
    st.sampled_from([0.01, 0.3, 0.5, 0.9, 1.0]),
)
def test_the_fewest_that_have_the_part(values, fraction):
    """Against all subsets; the cells with nearly as large errors may be there too."""
    squares = np.array(values, dtype=float)
    marked = largest_part(MPI.COMM_SELF, squares, fraction)
    assert (marked == (squares >= squares[marked].min())).all()
    wanted = fraction * squares.sum() * (1 - 1e-12)
    fewest = next(
        k
        for k in range(1, len(squares) + 1)
        if any(sum(some) >= wanted for some in combinations(values, k))
    )
    least = np.sort(squares)[-fewest]
    assert (squares >= least).sum() <= marked.sum() <= (squares >= NEARLY * least).sum()


def test_small_errors_of_errors_change_nothing():
    """The marked cells end in a gap: with estimates that differ by 1e-4 they are the same."""
    rng = np.random.default_rng(5)
    squares = rng.lognormal(0.0, 2.0, 3000)
    changed = squares * (1.0 + 1e-4 * rng.uniform(-1.0, 1.0, (20, 3000)))
    marked = largest_part(MPI.COMM_SELF, squares, 0.5)
    same = [np.array_equal(largest_part(MPI.COMM_SELF, row, 0.5), marked) for row in changed]
    assert sum(same) >= 18
