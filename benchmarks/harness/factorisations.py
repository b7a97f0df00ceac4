"""How many matrices are factored, as PETSc itself counts."""

from __future__ import annotations

from petsc4py import PETSc


class Factorisations:
    """Counts from when it is made."""

    def __init__(self) -> None:
        PETSc.Log.begin()  # of no effect if it counts already
        self._events = [PETSc.Log.Event(name) for name in ("MatCholFctrNum", "MatLUFactorNum")]
        self._before = self._all()

    @property
    def count(self) -> int:
        """So far, each matrix as often as it was factored."""
        return self._all() - self._before

    def _all(self) -> int:
        return sum(int(event.getPerfInfo()["count"]) for event in self._events)
