"""Collective helpers."""

from __future__ import annotations

from mpi4py import MPI

import pytest

from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca._base.petsc import PetscOwner

pytestmark = pytest.mark.parallel


@pytest.mark.parametrize("kind", [KeyboardInterrupt, SystemExit])
def test_interrupt_of_one_rank_is_raised_on_all_ranks(comm, kind):
    with pytest.raises(kind), errors_on_all_ranks(comm):
        if comm.rank == comm.size - 1:
            raise kind


def test_errors_that_cannot_be_pickled(comm):
    """The other ranks raise a RuntimeError with the same message."""

    class Local(Exception):
        """Pickle cannot find it, nor make it from its message, as it has two arguments."""

        def __init__(self, first_word: str, second_word: str) -> None:
            super().__init__(f"{first_word} and {second_word}")

    raised = comm.rank == comm.size - 1
    kind = Local if raised else RuntimeError
    with pytest.raises(kind, match=r"one and two$") as caught, errors_on_all_ranks(comm):
        if raised:
            raise Local("one", "two")
    assert raised or "Local" in str(caught.value)


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
