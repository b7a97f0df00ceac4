"""The displacement of least energy with given jumps, for bodies that cannot change their volume."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca.dual.bounds.lift import DEPENDENT_ROWS, Lift
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.stiffness.cholesky import saddle_cholesky
from dolfinx_tresca.stiffness.solver import StiffnessSolver


class SaddleLift(PetscOwner):
    """The displacement of least energy with a given jump, and its pressure.

    Both are in w, which satisfies K w + B'y = 0 and B w = jump with multipliers y.

    `Lift` moves contact nodes only. In a body that cannot change its volume, moving contact nodes
    alone costs infinite, or nearly infinite, energy. This lift has the least energy of all lifts,
    and needs a factorisation as large as the factorisation of K.

    Owns PETSc objects: call `destroy()`. The caller keeps B and K.
    """

    def __init__(self, jump: JumpOperator) -> None:
        """Factor (K, B'; B, 0). Collective.

        If the factorisation fails because rows of B are linearly dependent, `energy_norm` returns
        inf for any jump.

        Args:
            jump: B, and the system with K.

        Raises:
            StiffnessError: rows of B are linearly independent of each other, but not of the rows of
                incompressibility in K: the contact closes in a body that cannot change its volume.
        """
        system = jump.system
        K, self.comm = system.K, system.comm
        free, zero = jump.matrix.createVecs()
        zero.set(0.0)
        free.array = system.moves
        B = jump.matrix.copy()
        B.diagonalScale(R=free)
        transposed = B.copy().transpose()
        nothing = PETSc.Mat().createAIJ((B.getSizes()[0], B.getSizes()[0]), nnz=1, comm=K.comm)
        nothing.setDiagonal(zero)
        nothing.assemble()
        nest = PETSc.Mat().createNest([[K, transposed], [B, nothing]], comm=K.comm)
        whole = nest.copy()
        whole.convert(PETSc.Mat.Type.AIJ)
        whole.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._right, self._solution = whole.createVecs()
        self._product = self._right.duplicate()
        self._w_size = K.getLocalSize()[0]
        self._solver: StiffnessSolver | None
        try:
            self._solver = saddle_cholesky(whole, {}, None, None)
        except StiffnessError:  # dependent rows
            self._solver = None
        self._matrix = whole
        for owned in (free, zero, B, transposed, nothing, nest):
            owned.destroy()
        if self._solver is None and _independent(jump):
            self.destroy()
            raise StiffnessError(
                "the contact and the conditions close in a body that cannot change its volume: its "
                "pressure is not determined where it touches everywhere, and gaps of another "
                "volume cannot be closed. Let it change its volume a little (Poisson's ratio "
                "0.4999, say), or leave a part of its boundary free."
            )

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        if self._solver is not None:
            self._solver.destroy()
        for owned in (self._right, self._solution, self._product, self._matrix):
            owned.destroy()

    def energy_norm(self, jump: Array) -> float:
        """Return |w|_K [energy^(1/2)]; infinite if no w has this jump. Collective.

        Args:
            jump: (size,) this rank's rows of B w.
        """
        if self._solver is None:
            return np.inf
        right, solution = self._right, self._solution
        right.set(0.0)
        right.array[self._w_size :] = jump
        size = right.norm()
        self._solver.solve(right, solution)
        energy = -float(right.dot(solution))  # w'K w = -y'B w
        self._matrix.mult(solution, self._product)
        self._product.axpy(-1.0, right)
        if not self._product.norm() <= DEPENDENT_ROWS * size:  # or NaN
            return np.inf
        return float(np.sqrt(max(energy, 0.0)))


def _independent(jump: JumpOperator) -> bool:
    """Return whether the rows of B are linearly independent. Collective."""
    rough = np.cos(12.9898 * np.arange(1.0, len(jump.stress_scale) + 1.0))
    with Lift(jump) as alone:
        return bool(np.isfinite(alone.energy_norm(rough)))
