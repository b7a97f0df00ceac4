"""The number of factorisations that PETSc counts."""

from __future__ import annotations

from petsc4py import PETSc


class Factorisations:
    """Counts factorisations in a `with` block.

    The block is a new stage of PETSc's log, since PETSc does not count further in a stage in which
    an error has occurred.
    """

    def __enter__(self) -> Factorisations:
        PETSc.Log.begin()  # no effect if PETSc counts already
        self._stage = PETSc.Log.Stage("factorisations")
        self._events = [PETSc.Log.Event(name) for name in ("MatCholFctrNum", "MatLUFactorNum")]
        self._stage.push()
        self._before = self._all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stage.pop()

    @property
    def count(self) -> int:
        """Number of factorisations since the block began."""
        return self._all() - self._before

    def _all(self) -> int:
        return sum(int(event.getPerfInfo()["count"]) for event in self._events)
