"""How many matrices are factored, as PETSc itself counts."""

from __future__ import annotations

from petsc4py import PETSc


class Factorisations:
    """Counts within a `with` block, in a stage of its own: after an error PETSc counts no more."""

    def __enter__(self) -> Factorisations:
        PETSc.Log.begin()  # of no effect if it counts already
        self._stage = PETSc.Log.Stage("factorisations")
        self._events = [PETSc.Log.Event(name) for name in ("MatCholFctrNum", "MatLUFactorNum")]
        self._stage.push()
        self._before = self._all()
        return self

    def __exit__(self, *error: object) -> None:
        self._stage.pop()

    @property
    def count(self) -> int:
        """So far, each matrix as often as it was factored."""
        return self._all() - self._before

    def _all(self) -> int:
        return sum(int(event.getPerfInfo()["count"]) for event in self._events)
