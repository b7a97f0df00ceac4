"""Approximation of K^-1 by small solves: on some degrees of freedom, and on a coarse level."""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.petsc import PetscOwner
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.stiffness.choice import cholesky
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: Largest number of unknowns of the level. A factorisation takes a hundredth of a second, a solve a
#: millisecond. (On two bricks with N = 16, a contact solve takes 63 Krylov iterations with 42
#: unknowns, 58 with 306 unknowns, and 54 with 2244 unknowns.)
MOST_UNKNOWNS = 3000


class CoarseSpace(PetscOwner):
    """The approximation P (P'KP)^-1 P' of K^-1 by a multigrid level with few unknowns.

    The columns of P are the basis displacements of the level: they move bodies as a whole.

    Owns PETSc objects: call `destroy()`. The multigrid hierarchy keeps its own objects.
    """

    def __init__(self, interpolations: list[PETSc.Mat], K: PETSc.Mat) -> None:
        """Factor the matrix of the level. Collective.

        Args:
            interpolations: interpolation from each level to the finer one, the finest first.
            K: matrix P'KP of the level.

        Raises:
            StiffnessError: the matrix is not positive definite.
        """
        self._interpolations = interpolations
        matrix = K.convert("aij", PETSc.Mat())
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        try:
            self._solver = cholesky(matrix, {}, None)
        finally:
            matrix.destroy()
        self._levels = [P.createVecRight() for P in interpolations]
        self._coarsest = self._levels[-1].duplicate()
        self.comm = self._coarsest.comm

    @classmethod
    def from_preconditioner(cls, pc: PETSc.PC) -> CoarseSpace | None:
        """Return the largest level that is small enough (`MOST_UNKNOWNS`). Collective.

        Args:
            pc: a preconditioner, whose multigrid levels are searched.

        Returns:
            the level; None if the preconditioner is not multigrid, if no level is small enough, or
            if the level cannot be factored.
        """
        interpolations: list[PETSc.Mat] = []
        while pc.getType() in (PETSc.PC.Type.GAMG, PETSc.PC.Type.MG):
            for level in range(pc.getMGLevels() - 1, 0, -1):
                interpolations.append(pc.getMGInterpolation(level))
                K = pc.getMGSmoother(level - 1).getOperators()[0]
                if K.getSize()[0] <= MOST_UNKNOWNS:
                    try:
                        return cls(interpolations, K)
                    except StiffnessError:  # multigrid may work with a singular level
                        return None
            pc = pc.getMGSmoother(0).getPC()
        return None

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        # the hierarchy refers to the interpolations as well; on several ranks, an interpolation is
        # never freed if Python drops its reference after the hierarchy is destroyed
        for owned in (self._solver, self._coarsest, *self._levels, *self._interpolations):
            owned.destroy()

    def correct(self, residual: PETSc.Vec, u: PETSc.Vec) -> None:
        """Add P (P'KP)^-1 P' residual to u. Collective."""
        above = residual
        for P, level in zip(self._interpolations, self._levels, strict=True):
            P.multTranspose(above, level)
            above = level
        self._solver.solve(above, self._coarsest)
        below = self._coarsest
        for P, level in zip(self._interpolations[:0:-1], self._levels[-2::-1], strict=True):
            P.mult(below, level)
            below = level
        self._interpolations[0].multAdd(below, u, u)


class Schwarz(PetscOwner):
    """An approximation S <= K^-1 for forces on some degrees of freedom, by small solves.

    A local system, with K on these degrees of freedom while all others are clamped, is solved
    twice. Between the two solves, a system on a coarse level of multigrid is solved. The right-hand
    side of each solve is the remaining residual. With the projections P_1 and P_0 onto the local
    and the coarse space, which are orthogonal in the energy inner product,
    K^-1 - S = (1 - P_1)(1 - P_0)(1 - P_1) K^-1. This is symmetric and positive semidefinite
    (Schwarz's method: Toselli and Widlund 2005, chapter 2). If the solver for K has no coarse
    level, the local system is solved once, and K^-1 - S = (1 - P_1) K^-1.

    Owns PETSc objects: call `destroy()`. The caller keeps the solver for K.
    """

    def __init__(self, solver: StiffnessSolver, dofs: Indices) -> None:
        """Factor the matrices of the local and of the coarse system. Collective.

        Args:
            solver: solver for K.
            dofs: (n,) owned degrees of freedom that may move in the local system.

        Raises:
            StiffnessError: a factorisation failed.
        """
        K, self._dofs = solver.matrix, dofs
        start = K.getOwnershipRange()[0]
        rows = PETSc.IS().createGeneral((start + dofs).astype(PETSc.IntType), comm=K.comm)
        K_local = K.createSubMatrix(rows, rows)
        K_local.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        try:
            self._local = cholesky(K_local, {}, None)
            self._local_u, self._local_f = K_local.createVecs()
        finally:
            K_local.destroy()
        self._u, self._left = K.createVecs()
        self.comm = self._u.comm
        self._coarse = CoarseSpace.from_preconditioner(solver.preconditioner)
        # the rows of K that couple the local degrees of freedom with all degrees of freedom
        self._rows = K.createSubMatrix(rows, None) if self._coarse is not None else PETSc.Mat()
        rows.destroy()

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._local.destroy()
        if self._coarse is not None:
            self._coarse.destroy()

    def solve(self, force: PETSc.Vec) -> Array:
        """Return S force, (owned degrees of freedom,). Collective.

        Args:
            force: forces, zero on degrees of freedom outside of the local system.
        """
        self._local_f.array = force.array[self._dofs]
        self._local.solve(self._local_f, self._local_u)
        self._u.set(0.0)
        self._u.array[self._dofs] = self._local_u.array
        if self._coarse is not None:
            self._rows.multTranspose(self._local_u, self._left)
            self._left.aypx(-1.0, force)
            self._coarse.correct(self._left, self._u)
            self._rows.mult(self._u, self._local_f)
            self._local_f.array = force.array[self._dofs] - self._local_f.array
            self._local.solve(self._local_f, self._local_u)
            self._u.array[self._dofs] += self._local_u.array
        displacement: Array = self._u.array.copy()
        return displacement
