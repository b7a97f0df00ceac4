"""The norm of displacements and pressures, in which Newton's method measures its corrections."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.petsc import PetscOwner
from dolfinx_tresca.dual.jump import entrywise
from dolfinx_tresca.problem.tangent_system import TangentSystem
from dolfinx_tresca.stiffness.component import Component


class MixedNorm(PetscOwner):
    """|(u, p)| = sqrt(u'A u + p'S p) with S = C + diag(B diag(A)^-1 B'), of K = (A, B'; B, -C).

    A, B and C are here the blocks of K, the tangent of the undeformed bodies. The energy of a later
    tangent is not a norm: the block A of a body under pressure is positive definite only for
    displacements that keep the volume, and a Newton step changes the volume. A and S are the blocks
    of the usual preconditioner for K (Murphy, Golub and Wathen 2000, SIAM J. Sci. Comput. 21), but
    S is reduced to its diagonal. Without this reduction, S is approximately C plus the mass matrix
    of the pressures divided by the shear modulus.

    Owns PETSc objects: call `destroy()`.
    """

    def __init__(self, tangent: TangentSystem, component: Component) -> None:
        """Assemble A and S at the present u. Collective.

        The K of `tangent` is then without Dirichlet conditions, and must be assembled again.

        Args:
            tangent: the system with K.
            component: the displacement in its mixed space.
        """
        self._component = component
        self.comm = self._component.comm
        tangent.update_material()
        tangent.assemble_form()
        K = tangent.K
        self._A = component.block(K)
        squares, diagonal = entrywise(K, np.square), K.getDiagonal()
        compliance, self._S = diagonal.duplicate(), diagonal.duplicate()
        # a displacement without stiffness couples to no pressure, unless K is singular
        stiff = component.mask & (diagonal.array > 0.0)
        compliance.array = np.divide(1.0, diagonal.array, out=np.zeros(len(stiff)), where=stiff)
        squares.mult(compliance, self._S)
        self._S.array = np.where(component.mask, 0.0, self._S.array - diagonal.array)
        self._product: PETSc.Vec = self._A.createVecLeft()
        for owned in (squares, diagonal, compliance):
            owned.destroy()

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        for owned in (self._A, self._S, self._product):
            owned.destroy()

    def of_function(self, w: fem.Function) -> float:
        """Return the norm of a Function on the mixed space, whose ghosts are up to date.

        Collective.
        """
        u = self._component.extract(w)  # owns the memory of its vector
        self._A.mult(u.x.petsc_vec, self._product)
        square = float(u.x.petsc_vec.dot(self._product))
        weighted = self._S.duplicate()
        weighted.pointwiseMult(self._S, w.x.petsc_vec)
        square += float(weighted.dot(w.x.petsc_vec))
        weighted.destroy()
        return float(np.sqrt(max(square, 0.0)))
