"""The dual operator A = B K^-1 B' on distributed vectors."""

from __future__ import annotations

from petsc4py import PETSc

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.petsc import PetscOwner, dense_matrix
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.stiffness.solver import StiffnessSolver


class DualOperator(PetscOwner):
    """A of (38.4), for one K: each product is one solve with K.

    If bodies float, K stands for K_p, which is K with springs that fix these bodies
    (`floating/fixing.py`).

    Owns PETSc objects: call `destroy()`. The caller keeps B and the solver.

    Attributes:
        jump: B.
        solver: solver for K.
        exact: whether products are exact to rounding (a direct solver for K).
        products: number of products with A.
    """

    def __init__(self, jump: JumpOperator, solver: StiffnessSolver) -> None:
        """Prepare products, without computing any. Collective."""
        self.jump, self.solver = jump, solver
        self.comm = self.jump.comm
        self.exact = solver.exact
        self.products = 0
        self._u = jump.matrix.createVecRight()

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._u.destroy()

    def apply(self, x: Array) -> Array:
        """Return A x to the accuracy in the solver's options; counted in `products`. Collective.

        Args:
            x: (size,) multipliers.
        """
        return self.product(x)[0]

    def product(self, x: Array) -> tuple[Array, float]:
        """Return A x and its error; counted in `products`. Collective.

        Args:
            x: (size,) multipliers.

        Returns:
            the product (size,), and the norm sqrt(e'A^-1 e) of its error e, as estimated by the
            solver for K: larger than requested if the solver missed it, 0 for a direct solver.
        """
        self.products += 1
        error = self.solver.solve(self.jump.contact_force(x), self._u)
        self._u.array[self.jump.system.prescribed] = 0.0
        return self.jump.of_unknowns(self._u), error

    def apply_to_all(self, X: Array, B: PETSc.Mat | None = None) -> Array:
        """Return A X for X (size, k), with a direct solver for all columns together. Collective.

        This costs far less than k single products. Each column is counted in `products`.

        Args:
            X: (size, k) multipliers.
            B: matrix that replaces the matrix of jumps in A = B K^-1 B'; None: it is not replaced.
        """
        B = B or self.jump.matrix
        self.products += X.shape[1]
        multipliers = dense_matrix(X, self.comm)
        forces = B.transposeMatMult(multipliers)
        forces.getDenseArray()[self.jump.system.prescribed] = 0.0
        displacements = forces.duplicate()
        self.solver.solve_several(forces, displacements)
        displacements.getDenseArray()[self.jump.system.prescribed] = 0.0
        jumps = B.matMult(displacements)
        product: Array = jumps.getDenseArray().copy()
        for owned in (multipliers, forces, displacements, jumps):
            owned.destroy()
        return product
