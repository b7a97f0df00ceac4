"""The compliance of the bodies near the contact: a cheap approximation of A."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx import la

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.petsc import PetscOwner
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.stiffness.schwarz import Schwarz
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: Number of layers of cells around the contact whose nodes may move. `LAYERS` is for a direct
#: solver for K. `LAYERS_BEFORE_COARSE` is for multigrid, whose coarse level represents the rest of
#: the bodies. (On two bricks with a direct solver, a load step takes up to 10 products with one
#: layer, 8 with two layers, and more without layers. With multigrid, a solve takes 33 Krylov
#: iterations with one layer, and 30 with two layers, which cost twice as much.)
LAYERS, LAYERS_BEFORE_COARSE = 2, 1


class NearField(PetscOwner):
    """The approximation D = B S B' <= A, where S approximates K^-1 near the contact.

    Effects of tractions that oscillate between nodes decay within a few cells: nodes further away
    may be clamped. (Of FETI's preconditioners, which approximate A^-1, the lumped preconditioner
    clamps all nodes except interface nodes, and the Dirichlet preconditioner clamps none: Farhat,
    Mandel and Roux 1994.) Further away, the effect of tractions is smooth: with multigrid, a coarse
    level in S represents most of this effect, and a few products with A represent the rest; without
    multigrid, products with A represent all of this effect. On two bricks (N = 10), 0.02 A <= D
    without the coarse level, and 0.4 A <= D with it.

    Owns PETSc objects: call `destroy()`. The caller keeps B and the solver for K.
    """

    def __init__(self, jump: JumpOperator, solver: StiffnessSolver) -> None:
        """Find the nodes near the contact, and factor K there. Collective.

        Args:
            jump: B.
            solver: solver for K.

        Raises:
            StiffnessError: the factorisation failed.
        """
        self._jump = jump
        self.comm = self._jump.comm
        free = ~jump.system.prescribed
        layers = LAYERS if solver.exact else LAYERS_BEFORE_COARSE
        near = np.repeat(_near(jump, layers), jump.system.V.dofmap.index_map_bs) & free
        self._dofs = np.flatnonzero(near)
        self._inverse = Schwarz(solver, self._dofs)

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._inverse.destroy()

    def apply(self, x: Array) -> Array:
        """Return D x, (size,). Collective."""
        u = self._inverse.solve(self._jump.contact_force(x))
        self._jump.work.array = np.where(self._jump.system.prescribed, 0.0, u)
        return self._jump.of_unknowns(self._jump.work)


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
    touched.destroy()
    for _ in range(layers):
        near.scatter_forward()
        around = cells[(near.array[cells] > 0.0).any(axis=1)]
        near.array[around] = 1.0
        near.scatter_reverse(la.InsertMode.add)
    return np.asarray(near.array[: nodes.size_local] > 0.0)
