"""A displacement with given jumps that moves contact nodes alone, with nearly least energy."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import FULL_ACCURACY
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.local_stiffness import nodal_compliance
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: Largest number of rows of B for which MUMPS factors B D B' on all ranks together. The analysis of
#: MUMPS stores the pattern of all rows, and a graph of the pattern, on one rank: 1 to 2 kB per row,
#: or half a gigabyte for this number of rows.
MOST_FACTORED = 300_000

#: Limit on steps of conjugate gradients.
MOST_ITERATIONS = 1000

#: The rows of B count as linearly dependent if the ratio |B w - jump| / |jump| (Euclidean norms) of
#: a lift w exceeds this number. The ratio is of the order of 1 for a jump outside the range of B,
#: and otherwise of the order of rounding.
DEPENDENT_ROWS = 1e-6


class Lift(PetscOwner):
    """The displacement w of least D^-1 norm with B w = jump: w = D B' (B D B')^-1 jump.

    Here D is diag(K)^-1. `EnergyBound` closes gaps with w. The matrix B D B' is sparse, with a row
    for each row of B. If it has more than `MOST_FACTORED` rows, systems with it are solved by
    conjugate gradients preconditioned by a factorisation of each rank's own rows: memory and work
    of a rank depend on these rows alone. Conjugate gradients take 10 to 40 steps. If a fine, stiff
    secondary side touches a coarse primary side that is 1e6 times softer, the number of steps grows
    with the number of ranks: 288, 1124 and 2108 steps on 2, 3 and 5 ranks. The iteration stops
    after `MOST_ITERATIONS` steps; the energy norm of w counts as infinite if B w then misses the
    jump by more than `DEPENDENT_ROWS`. A factorisation of all rows has none of these limits.

    Owns PETSc objects: call `destroy()`. The caller keeps B and K.
    """

    def __init__(self, jump: JumpOperator) -> None:
        """Factor B D B', or for many rows the block of each rank's own rows. Collective.

        Args:
            jump: B, and the system with K.
        """
        self._system, self._B = jump.system, jump.matrix
        self.comm = self._system.comm
        self._compliance = nodal_compliance(jump.system)
        self._jump, self._force = self._B.createVecs("left"), self._B.createVecs("right")
        self._multipliers = self._jump.duplicate()
        self._w, self._Kw = self._force.duplicate(), self._force.duplicate()
        weighted = self._B.copy()
        weighted.diagonalScale(R=self._compliance)
        transposed = self._B.copy().transpose()
        local = weighted.matMult(transposed)
        local.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._solver: StiffnessSolver | PETSc.KSP | None
        try:
            self._solver = _solver(local)
        except StiffnessError:  # dependent rows
            self._solver = None
        for owned in (weighted, transposed, local):
            owned.destroy()

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        if self._solver is not None:
            self._solver.destroy()
        for owned in (self._compliance, self._jump, self._force, self._multipliers):
            owned.destroy()
        for owned in (self._w, self._Kw):
            owned.destroy()

    def energy_norm(self, jump: Array) -> float:
        """Return |w|_K [energy^(1/2)]; infinite if no w has this jump. Collective.

        Args:
            jump: (size,) this rank's rows of B w.
        """
        if self._solver is None:
            return np.inf
        self._jump.array = jump
        self._solver.solve(self._jump, self._multipliers)
        self._B.multTranspose(self._multipliers, self._force)
        self._w.pointwiseMult(self._compliance, self._force)
        self._B.mult(self._w, self._multipliers)
        self._multipliers.axpy(-1.0, self._jump)
        if not self._multipliers.norm() <= DEPENDENT_ROWS * self._jump.norm():  # or NaN
            return np.inf
        self._system.K.mult(self._w, self._Kw)
        return float(np.sqrt(max(self._w.dot(self._Kw), 0.0)))


def _solver(local: PETSc.Mat) -> StiffnessSolver | PETSc.KSP:
    """Return a solver for B D B', the matrix `local`. Collective.

    Raises:
        StiffnessError: the matrix is singular.
    """
    if local.getSize()[0] <= MOST_FACTORED:
        return cholesky(local, {}, None)
    ksp = PETSc.KSP().create(local.comm)
    ksp.setOperators(local)
    ksp.setType(PETSc.KSP.Type.CG)
    ksp.setNormType(PETSc.KSP.NormType.NATURAL)
    ksp.setTolerances(rtol=FULL_ACCURACY, atol=0.0, max_it=MOST_ITERATIONS)
    blocks = ksp.getPC()
    blocks.setType(PETSc.PC.Type.ASM)
    blocks.setASMOverlap(0)
    blocks.setUp()
    for block in blocks.getASMSubKSP():
        block.setType(PETSc.KSP.Type.PREONLY)
        block.getPC().setType(PETSc.PC.Type.CHOLESKY)
        block.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    return ksp
