"""A multigrid level that is small enough to be factored: displacements of bodies as a whole."""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.stiffness.cholesky import cholesky

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
