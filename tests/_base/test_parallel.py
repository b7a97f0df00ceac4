"""Collective helpers."""

from __future__ import annotations

import logging

from mpi4py import MPI

import pytest

from dolfinx_tresca import InputError
from dolfinx_tresca._base.parallel import (
    each_warning_once,
    errors_on_all_ranks,
    log,
)
from dolfinx_tresca._base.petsc import PetscOwner

pytestmark = pytest.mark.parallel


def test_error_of_one_rank_is_raised_on_all_ranks(comm):
    last = comm.size - 1
    with pytest.raises(InputError, match=f"^rank {last} failed$"), errors_on_all_ranks(comm):
        if comm.rank == last:
            raise InputError(f"rank {last} failed")
    assert comm.allreduce(1) == comm.size


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_interrupt_of_one_rank_is_raised_on_all_ranks(comm, kind):
    with pytest.raises(kind), errors_on_all_ranks(comm):
        if comm.rank == comm.size - 1:
            raise kind


class Two(Exception):
    """An exception with two arguments and one message, which pickle cannot restore."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(f"{one} and {other}")


def test_errors_that_cannot_be_pickled(comm):
    """The other ranks raise a RuntimeError with the same message."""

    class Local(Exception):
        """Pickle cannot find local classes."""

    for error in (Local("one and two"), Two("one", "two")):
        raised = comm.rank == comm.size - 1
        kind = type(error) if raised else RuntimeError
        with pytest.raises(kind, match=r"one and two$") as found, errors_on_all_ranks(comm):
            if raised:
                raise error
        assert raised or type(error).__name__ in str(found.value)


class Waiting(PetscOwner):
    """An owner with a collective `destroy()`."""

    comm = MPI.COMM_WORLD

    def destroy(self):
        """Collective."""
        self.comm.barrier()


def test_exception_of_one_rank_does_not_wait_for_the_others(comm):
    """The exception would never be seen if the rank called `destroy()`."""
    if comm.rank == comm.size - 1:
        with pytest.raises(ZeroDivisionError), Waiting():
            raise ZeroDivisionError
    comm.barrier()


def test_contact_error_destroys_the_owner(comm):
    freed = []
    with pytest.raises(InputError), Waiting() as owner:
        owner.destroy = lambda: freed.append(owner)
        raise InputError("on all ranks")
    assert freed == [owner]


def test_each_warning_once(comm, caplog):
    """In a block a warning is logged once for each subject, whatever its numbers."""

    def warn(number, about):
        log(comm, "%d too many", number, level=logging.WARNING, about=about)

    for _ in range(2):
        with each_warning_once():
            for number in range(2):
                warn(number, "first subject")
                warn(number, "second subject")
    warn(7, "first subject")
    warn(8, "first subject")
    given = ["0 too many", "0 too many"] * 2 + ["7 too many", "8 too many"]
    assert caplog.messages == given * (comm.rank == 0)
