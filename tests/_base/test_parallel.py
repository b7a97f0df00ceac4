"""The collective helpers."""

from __future__ import annotations

import logging

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import InputError
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca._base.parallel import (
    each_warning_once,
    errors_on_all_ranks,
    gather_rows,
    log,
    reduce_array,
)

pytestmark = pytest.mark.parallel


def test_sums_keep_the_shape(comm):
    """A scalar stays one: NumPy will refuse float() of arrays of one entry."""
    for shape in ((), (1,), (3,), (2, 2), (0,)):
        total = reduce_array(comm, np.ones(shape))
        assert total.shape == shape
        assert (total == comm.size).all()


def test_sums_take_any_layout(comm):
    values = np.asfortranarray(np.arange(6.0).reshape(2, 3)).T
    assert np.array_equal(reduce_array(comm, values), comm.size * values)


def test_an_error_of_one_rank_is_raised_on_all(comm):
    last = comm.size - 1
    with pytest.raises(InputError, match=f"^rank {last} failed$"), errors_on_all_ranks(comm):
        if comm.rank == last:
            raise InputError(f"rank {last} failed")
    assert comm.allreduce(1) == comm.size


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_one_rank_that_is_told_to_end_ends_all(comm, kind):
    with pytest.raises(kind), errors_on_all_ranks(comm):
        if comm.rank == comm.size - 1:
            raise kind


class Two(Exception):
    """Made of two arguments: what pickle keeps, the message, does not make it again."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(f"{one} and {other}")


def test_errors_that_cannot_be_sent(comm):
    """The others have the words."""

    class Local(Exception):
        """Pickle finds classes of modules only."""

    for error in (Local("one and two"), Two("one", "two")):
        raised = comm.rank == comm.size - 1
        kind = type(error) if raised else RuntimeError
        with pytest.raises(kind, match=r"one and two$") as found, errors_on_all_ranks(comm):
            if raised:
                raise error
        assert raised or type(error).__name__ in str(found.value)


def test_without_an_error_nothing_is_raised(comm):
    with errors_on_all_ranks(comm):
        pass


class Waiting(PetscOwner):
    """An owner whose `destroy()` waits for all ranks."""

    comm = MPI.COMM_WORLD

    def destroy(self):
        """Collective."""
        self.comm.barrier()


def test_an_exception_of_one_rank_alone_leaves_a_block_at_once(comm):
    """It would never be seen if that rank waited for the others first."""
    if comm.rank == comm.size - 1:
        with pytest.raises(ZeroDivisionError), Waiting():
            raise ZeroDivisionError
    comm.barrier()


def test_an_error_of_this_package_frees_what_a_block_owns(comm):
    freed = []
    with pytest.raises(InputError), Waiting() as owner:
        owner.destroy = lambda: freed.append(owner)
        raise InputError("on all ranks")
    assert freed == [owner]


def test_rows_are_gathered_in_rank_order(comm):
    rows = gather_rows(comm, np.full((comm.rank, 2), comm.rank))
    expected = np.concatenate([np.full((rank, 2), rank) for rank in range(comm.size)])
    assert np.array_equal(rows, expected)


def test_a_warning_is_given_once_in_a_block_of_what_it_is_about(comm, caplog):
    """Whatever its numbers; outside of the block, and in the next one, it is given again."""

    def warn(number, about):
        log(comm, "%d too many", number, level=logging.WARNING, about=about)

    for _ in range(2):
        with each_warning_once():
            for number in range(2):
                warn(number, "this")
                warn(number, "that")
    warn(7, "this")
    warn(8, "this")
    given = ["0 too many", "0 too many"] * 2 + ["7 too many", "8 too many"]
    assert caplog.messages == given * (comm.rank == 0)
