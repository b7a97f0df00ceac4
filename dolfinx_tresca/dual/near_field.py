"""The compliance of what is near the contact: a stand-in for A that costs little."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx import la

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.local_stiffness import entrywise
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: Layers of cells around the nodes in contact that may move. With one a step of the two bricks
#: takes up to 10 products instead of 8, with none (a lumped preconditioner) more.
LAYERS = 2


class NearField(PetscOwner):
    """D = B K_n^-1 B', where K_n is K of the cells near the contact, clamped where these end.

    D <= A. Rough tractions are felt nearby only: for these both are the same, and what tractions do
    further away is smooth, so that few products with A know it. The nodes in contact alone would
    give the inverse of FETI's lumped preconditioner, all nodes that of its Dirichlet preconditioner
    (Farhat, Mandel and Roux 1994).

    Owns PETSc objects: call `destroy()`. B and K stay the caller's.

    Attributes:
        share: of all degrees of freedom that are not prescribed, so many may move.
    """

    def __init__(self, jump: JumpOperator, K: PETSc.Mat) -> None:
        """Find what is near; K_n is factored when it is needed. Collective.

        Args:
            jump: B.
            K: positive definite.
        """
        self._jump, self._K = jump, K
        free = ~jump.system.prescribed
        near = np.repeat(_near(jump), jump.system.V.dofmap.index_map_bs) & free
        self._dofs = np.flatnonzero(near)
        self._whole = np.zeros(len(near))
        counts = reduce_array(jump.comm, np.array([near.sum(), free.sum()], dtype=np.float64))
        self.share = float(counts[0] / max(counts[1], 1.0))
        self._factored: tuple[StiffnessSolver, PETSc.Vec, PETSc.Vec] | None = None

    def _factor(self) -> tuple[StiffnessSolver, PETSc.Vec, PETSc.Vec]:
        """Return a solver for K_n, and vectors u and f for it. Collective.

        Raises:
            StiffnessError: the factorisation failed.
        """
        K, first = self._K, self._K.getOwnershipRange()[0]
        rows = PETSc.IS().createGeneral((first + self._dofs).astype(PETSc.IntType), comm=K.comm)
        K_near = K.createSubMatrix(rows, rows)
        K_near.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        vectors = K_near.createVecs()
        solver = cholesky(K_near, {}, None)
        for used in (rows, K_near):
            used.destroy()
        return solver, *vectors

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self._jump.comm

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        for owned in self._factored or ():
            owned.destroy()

    def apply(self, x: Array) -> Array:
        """Return D x, (size,). Collective.

        Raises:
            StiffnessError: the factorisation of K_n failed, which the first call needs.
        """
        if self._factored is None:
            self._factored = self._factor()
        solver, u, f = self._factored
        f.array = self._jump.contact_force(x).array[self._dofs]
        solver.solve(f, u)
        self._whole[self._dofs] = u.array
        return self._jump.of_values(self._whole)


def _near(jump: JumpOperator) -> Mask:
    """Return which of this rank's nodes are in contact, or a few cells away. Collective."""
    V = jump.system.V
    nodes, cells = V.dofmap.index_map, V.dofmap.list
    near = la.vector(nodes, 1, np.float64)
    touched = _touched(jump).reshape(nodes.size_local, V.dofmap.index_map_bs)  # maybe no nodes
    near.array[: nodes.size_local] = touched.any(axis=1)
    for _ in range(LAYERS):
        near.scatter_forward()
        around = cells[(near.array[cells] > 0.0).any(axis=1)]
        near.array[around] = 1.0
        near.scatter_reverse(la.InsertMode.add)
    result: Mask = near.array[: nodes.size_local] > 0.0
    return result


def _touched(jump: JumpOperator) -> Mask:
    """Return which of this rank's degrees of freedom are in a row of B. Collective."""
    sizes = entrywise(jump.matrix, np.abs)
    u, ones = sizes.createVecs()
    ones.set(1.0)
    sizes.multTranspose(ones, u)
    touched: Mask = u.array > 0.0
    for used in (sizes, u, ones):
        used.destroy()
    return touched
