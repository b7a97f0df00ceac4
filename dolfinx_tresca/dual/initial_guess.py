"""First guesses for iterative solves with K, from displacements that were computed already."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.dual.jump import JumpOperator

#: Number of multipliers whose displacements are kept: those at the start of the steps of the
#: iteration, and at the ends of the last two steps.
KEPT = 3


class InitialGuess(PetscOwner):
    """First guesses of u = K^-1 (f - B'x) from displacements at a few multipliers x, called points.

    The displacement without contact (x = 0) is kept, too. Since u is affine in x, u is known at
    affine combinations of the points, up to the errors of the kept displacements. These
    combinations include all x along a step if the iteration gives the start of the step
    (`begin_at`). PETSc's `KSPGuess` (Fischer 1998) would project onto earlier right-hand sides
    instead, which costs a product with K for each right-hand side; here the multipliers are
    projected.

    Owns PETSc objects: call `destroy()`.

    Attributes:
        load: u at x = 0.
    """

    def __init__(self, jump: JumpOperator) -> None:
        """Begin without load: u = 0 at x = 0. Collective."""
        self.load = jump.matrix.createVecRight()
        self.comm = self.load.comm
        self._inner, self._agreed = jump.reductions.inner, jump.reductions.from_first_rank
        self._points: list[tuple[Array, PETSc.Vec]] = []

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self.forget()
        self.load.destroy()

    def forget(self) -> None:
        """Forget all points but the displacement without contact. Collective."""
        self._keep(0)

    def _drop(self, index: int) -> None:
        """Forget a point."""
        self._points.pop(index)[1].destroy()

    def _keep(self, count: int) -> None:
        """Forget all but the newest points."""
        while len(self._points) > count:
            self._drop(0)

    def set_load(self, load: PETSc.Vec) -> None:
        """Set the displacement without contact, for a new load. Collective.

        Of the other points, only the newest is kept. Its multipliers stay the same, and the change
        of the displacement without contact is added to its displacement.

        Args:
            load: the new u at x = 0.
        """
        self._keep(1)
        for _, u in self._points:
            u.axpy(1.0, load)
            u.axpy(-1.0, self.load)
        load.copy(self.load)

    def begin_at(self, x: Array) -> None:
        """Compute u at multipliers x, and keep it as the start of later steps. Collective."""
        if self._points and self._square(self._points[0][0] - x) == 0.0:
            return
        u = self.near(x)
        self._keep(1)
        self._points.insert(0, (x.copy(), u))

    def add(self, x: Array, u: PETSc.Vec) -> None:
        """Keep the displacement u at x; it replaces an earlier displacement at x. Collective.

        The object owns u from now on. It keeps the oldest displacement and the newest two, and
        frees the others. The oldest displacement is at the start of the steps if `begin_at` gave
        this start.
        """
        for index, (multipliers, before) in enumerate(self._points):
            if self._square(multipliers - x) == 0.0:
                before.destroy()
                self._points[index] = (x.copy(), u)
                return
        self._points.append((x.copy(), u))
        if len(self._points) > KEPT:
            self._drop(1)

    def near(self, x: Array) -> PETSc.Vec:
        """Return u at the affine combination of the points that is nearest to x. Collective.

        The caller owns the vector. At x = 0 the result is the displacement without contact.
        """
        if not self._points or self._square(x) == 0.0:
            return self.load.copy()
        points = list(self._points)
        if len(points) < 2:
            points.insert(0, (np.zeros_like(x), self.load))
        newest, u_last = points.pop()
        along = np.column_stack([multipliers - newest for multipliers, _ in points])
        gram, right = self._inner(along, along), self._inner(along, x - newest)
        length = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
        scaled = np.linalg.lstsq(gram / np.outer(length, length), right / length, rcond=None)[0]
        factors = self._agreed(np.asarray(scaled / length, dtype=np.float64))
        u = u_last.copy()
        u.scale(1.0 - float(factors.sum()))
        for factor, (_, displacement) in zip(factors, points, strict=True):
            u.axpy(float(factor), displacement)
        return u

    def _square(self, x: Array) -> float:
        return float(self._inner(x, x))
