"""Which cells are refined."""

from __future__ import annotations

from itertools import combinations

from mpi4py import MPI

import numpy as np
import pytest
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


@pytest.mark.parallel
def test_the_same_on_any_number_of_ranks(comm):
    squares = np.random.default_rng(3).lognormal(0.0, 4.0, 500)
    squares[::7] = squares[0]  # ties
    squares[1::50] = 0.0
    mine = np.arange(len(squares)) % comm.size == comm.rank
    for fraction in (0.1, 0.5, 0.999, 1.0):
        alone = largest_part(MPI.COMM_SELF, squares, fraction)
        assert (largest_part(comm, squares[mine], fraction) == alone[mine]).all()


@pytest.mark.parallel
def test_a_rank_without_cells(comm):
    squares = np.arange(1.0, 5.0) if comm.rank == 0 else np.zeros(0)
    marked = largest_part(comm, squares, 0.6)
    assert marked.tolist() == ([False, False, True, True] if comm.rank == 0 else [])


def test_sizes_of_any_magnitude(comm):
    """Squares are no more than 1; the least ones may be as small as numbers are."""
    squares = np.array([1.0, 1e-160, 1e-300, 0.0])
    assert largest_part(comm, squares, 0.5).tolist() == [True, False, False, False]
    assert largest_part(comm, np.full(3, 1e-300), 0.5).all()
