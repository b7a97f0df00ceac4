"""The compliance of the bodies near the contact: a cheap approximation of A."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx import la

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.petsc import PetscOwner
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.stiffness.solver import StiffnessSolver, cholesky

#: Number of layers of cells around the contact whose nodes may move. `LAYERS` is for a direct
#: solver for K. `LAYERS_BEFORE_COARSE` is for multigrid, whose coarse level represents the rest of
#: the bodies. (On two bricks with a direct solver, a load step takes up to 10 products with one
#: layer, 8 with two layers, and more without layers. With multigrid, a solve takes 33 Krylov
#: iterations with one layer, and 30 with two layers, which cost twice as much.)
LAYERS, LAYERS_BEFORE_COARSE = 2, 1


#: Largest number of unknowns of the level. A factorisation takes a hundredth of a second, a solve a
#: millisecond. (On two bricks with N = 16, a contact solve takes 63 Krylov iterations with 42
#: unknowns, 58 with 306 unknowns, and 54 with 2244 unknowns.)
MOST_UNKNOWNS = 3000


def coarse_level(pc: PETSc.PC) -> tuple[list[PETSc.Mat], StiffnessSolver] | None:
    """Return the factors of P'KP for the largest multigrid level that is small enough.

    The columns of P are the basis displacements of the level (`MOST_UNKNOWNS`): they move bodies as
    a whole. The caller owns the result. Collective.

    Args:
        pc: a preconditioner, whose multigrid levels are searched.

    Returns:
        the interpolations whose product is P, the finest first, and the factors; None if the
        preconditioner is not multigrid, if no level is small enough, or if it cannot be factored.
    """
    interpolations: list[PETSc.Mat] = []
    while pc.getType() in (PETSc.PC.Type.GAMG, PETSc.PC.Type.MG):
        for level in range(pc.getMGLevels() - 1, 0, -1):
            interpolations.append(pc.getMGInterpolation(level))
            matrix = pc.getMGSmoother(level - 1).getOperators()[0]
            if matrix.getSize()[0] <= MOST_UNKNOWNS:
                matrix = matrix.convert("aij", PETSc.Mat())
                matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
                try:
                    return interpolations, cholesky(matrix, {}, None)
                except StiffnessError:  # multigrid may work with a singular level
                    return None
        pc = pc.getMGSmoother(0).getPC()
    return None


class NearField(PetscOwner):
    """The approximation D = B S B' <= A, where S <= K^-1 approximates K^-1 near the contact.

    Effects of tractions that oscillate between nodes decay within a few cells: nodes further away
    may be clamped. (Of FETI's preconditioners, which approximate A^-1, the lumped preconditioner
    clamps all nodes except interface nodes, and the Dirichlet preconditioner clamps none: Farhat,
    Mandel and Roux 1994.) Further away, the effect of tractions is smooth: with multigrid, a coarse
    level in S represents most of this effect, and a few products with A represent the rest; without
    multigrid, products with A represent all of this effect. On two bricks (N = 10), 0.02 A <= D
    without the coarse level, and 0.4 A <= D with it; without it, contact solves of two bricks take
    1.3 to 1.8 times the Krylov iterations.

    S solves a local system, with K on the degrees of freedom near the contact while all others are
    clamped, twice. Between the two solves, a system on a coarse level of multigrid is solved. The
    right-hand side of each solve is the remaining residual. With the projections P_1 and P_0 onto
    the local and the coarse space, which are orthogonal in the energy inner product,
    K^-1 - S = (1 - P_1)(1 - P_0)(1 - P_1) K^-1. This is symmetric and positive semidefinite
    (Schwarz's method: Toselli and Widlund 2005, chapter 2). If the solver for K has no coarse
    level, the local system is solved once, and K^-1 - S = (1 - P_1) K^-1.

    Owns PETSc objects: call `destroy()`. The caller keeps B and the solver for K.
    """

    def __init__(self, jump: JumpOperator, solver: StiffnessSolver) -> None:
        """Find the nodes near the contact, and factor K there and on the coarse level. Collective.

        Args:
            jump: B.
            solver: solver for K.

        Raises:
            StiffnessError: the factorisation failed.
        """
        self._jump, K = jump, solver.matrix
        self.comm = jump.comm
        layers = LAYERS if solver.exact else LAYERS_BEFORE_COARSE
        near = np.repeat(_near(jump, layers), jump.system.V.dofmap.index_map_bs)
        self._dofs = np.flatnonzero(near & ~jump.system.prescribed)
        numbers = (K.getOwnershipRange()[0] + self._dofs).astype(PETSc.IntType)
        rows = PETSc.IS().createGeneral(numbers, comm=K.comm)
        K_local = K.createSubMatrix(rows, rows)
        K_local.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._local = cholesky(K_local, {}, None)
        self._local_u, self._local_f = K_local.createVecs()
        self._u = jump.work
        self._coarse = coarse_level(solver.preconditioner)
        if self._coarse is not None:
            coarser = (P.createVecRight() for P in self._coarse[0])
            self._residuals = [K.createVecLeft(), *coarser]
            self._corrections = [residual.duplicate() for residual in self._residuals]
            # the rows of K that couple the local degrees of freedom with all degrees of freedom
            self._rows = K.createSubMatrix(rows, None)

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._local.destroy()
        if self._coarse is not None:
            # on several ranks, an interpolation is never freed if Python drops its reference after
            # the hierarchy, which refers to it as well
            for owned in (*self._coarse[0], self._coarse[1]):
                owned.destroy()

    def apply(self, x: Array) -> Array:
        """Return D x, (size,). Collective."""
        force = self._jump.contact_force(x)
        self._local_f.array = force.array[self._dofs]
        self._local.solve(self._local_f, self._local_u)
        self._u.set(0.0)
        self._u.array[self._dofs] = self._local_u.array
        if self._coarse is not None:
            interpolations, factors = self._coarse
            residuals, corrections = self._residuals, self._corrections
            self._rows.multTranspose(self._local_u, residuals[0])
            residuals[0].aypx(-1.0, force)
            for level, P in enumerate(interpolations):
                P.multTranspose(residuals[level], residuals[level + 1])
            factors.solve(residuals[-1], corrections[-1])
            for level, P in reversed(list(enumerate(interpolations))):
                P.mult(corrections[level + 1], corrections[level])
            self._u.axpy(1.0, corrections[0])
            self._rows.mult(self._u, self._local_f)
            self._local_f.array = force.array[self._dofs] - self._local_f.array
            self._local.solve(self._local_f, self._local_u)
            self._u.array[self._dofs] += self._local_u.array
        self._u.array[self._jump.system.prescribed] = 0.0
        return self._jump.of_unknowns(self._u)


def _near(jump: JumpOperator, layers: int) -> Mask:
    """Return a mask of the owned nodes within some layers of cells from the contact. Collective."""
    V, B = jump.system.V, jump.matrix
    nodes, cells = V.dofmap.index_map, V.dofmap.list
    touched, (_, columns, values) = B.createVecRight(), B.getValuesCSR()
    touched.setValues(columns, np.abs(values), PETSc.InsertMode.ADD)
    touched.assemble()
    of_nodes = touched.array.reshape(nodes.size_local, V.dofmap.index_map_bs)  # maybe no nodes
    near = la.vector(nodes, 1, np.float64)
    near.array[: nodes.size_local] = of_nodes.any(axis=1)
    for _ in range(layers):
        near.scatter_forward()
        around = cells[(near.array[cells] > 0.0).any(axis=1)]
        near.array[around] = 1.0
        near.scatter_reverse(la.InsertMode.add)
    return np.asarray(near.array[: nodes.size_local] > 0.0)
