"""First guesses for iterative solves with K, from displacements that were computed already."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.dual.jump import JumpOperator


class InitialGuess(PetscOwner):
    """The displacement u = K^-1 (f - B'x) without contact, x = 0, and at up to two other points.

    u is affine in x: on the line through the newest two points it is known, but for their errors.
    PETSc's `KSPGuess` (Fischer 1998) would project onto earlier right-hand sides instead, which
    costs a product with K for each; here the multipliers say where on the line to look.

    Owns PETSc objects: call `destroy()`.

    Attributes:
        load: u at x = 0.
    """

    def __init__(self, jump: JumpOperator) -> None:
        """Begin with the displacement without contact, for no load: zero. Collective."""
        self.load = jump.matrix.createVecRight()
        self._inner = jump.reductions.inner
        self._points: list[tuple[Array, PETSc.Vec]] = []

    @property
    def comm(self) -> Any:
        """The communicator of the vectors."""
        return self.load.comm

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self.forget()
        self.load.destroy()

    def forget(self) -> None:
        """Forget all points but the displacement without contact. Collective."""
        self._keep(0)

    def _keep(self, count: int) -> None:
        """Forget all but the newest points."""
        while len(self._points) > count:
            _, u = self._points.pop(0)
            u.destroy()

    def set_load(self, load: PETSc.Vec) -> None:
        """Set the displacement without contact, for a new load. Collective.

        At the newest point u changes by as much: its multipliers stay what they are.
        """
        self._keep(1)
        for _, u in self._points:
            u.axpy(1.0, load)
            u.axpy(-1.0, self.load)
        load.copy(self.load)

    def add(self, x: Array, u: PETSc.Vec) -> None:
        """Keep u at x, which this object owns from now on; all but the newest two go."""
        self._points.append((x.copy(), u))
        self._keep(2)

    def near(self, x: Array) -> PETSc.Vec:
        """Return u at x, or a guess; the caller's. Collective."""
        if float(self._inner(x, x)) == 0.0:
            return self.load.copy()
        points = [(np.zeros_like(x), self.load), *self._points][-2:]
        (first, u_first), (last, u_last) = points[0], points[-1]
        u = u_last.copy()
        along = first - last
        length = float(self._inner(along, along))
        if length > 0.0:
            part = float(self._inner(along, x - last)) / length
            u.axpby(part, 1.0 - part, u_first)
        return u
