"""A bound of the error that needs no further solve with K."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.owner import PetscOwner
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.local_stiffness import nodal_compliance
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.optimise.feasible_set import FeasibleSet
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: Below any stiffness or length that means something.
TINY = 1e-300

#: Relative defect of a lift from which on the rows of B count as dependent.
DEPENDENT_ROWS = 1e-6


class EnergyBound(PetscOwner):
    """Bounds |u - u*|_K for u = K^-1 (f - B'lambda), lambda in Lambda (NUMERICS section 6).

    Weak duality: with the primal energy J, the dual energy D, and any v that does not penetrate,

        1/2 |u - u*|_K^2 + 1/2 |v - u*|_K^2 <= J(v) - D(lambda)
            = lambda_nu'(d - N v) + sum of (g |T v| - lambda_tau.T v) + 1/2 |v - u|_K^2,

    a sum of terms that are not negative: nothing cancels. In load steps T v stands for T v - s, the
    slip since the last one, here and below. Here v = u + w, where w moves contact
    nodes alone, weighted by the diagonal of K, such that the jump at every node takes the value
    that is best for that node by itself. That closes, and lets stick, what should.

    Owns PETSc objects: call `destroy()`.
    """

    def __init__(self, jump: JumpOperator, local_stiffness: Array) -> None:
        """Factor B diag(K)^-1 B', a small sparse matrix. Collective.

        Args:
            jump: B, and the system with K.
            local_stiffness: (size,) the inverse of that matrix's diagonal.
        """
        system, B = jump.system, jump.matrix
        self._system, self._B = system, B
        self._local_stiffness = local_stiffness
        self._compliance = nodal_compliance(system)
        self._jump, self._force = B.createVecs("left"), B.createVecs("right")
        self._w, self._Kw = self._force.duplicate(), self._force.duplicate()
        weighted = B.copy()
        weighted.diagonalScale(R=self._compliance)
        transposed = B.copy().transpose()
        local = weighted.matMult(transposed)
        local.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._solver: StiffnessSolver | None
        try:
            self._solver = cholesky(local, {}, None)
        except StiffnessError:  # dependent rows
            self._solver = None
        for owned in (weighted, transposed, local):
            owned.destroy()

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self._system.comm

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        if self._solver is not None:
            self._solver.destroy()
        for owned in (self._compliance, self._jump, self._force, self._w, self._Kw):
            owned.destroy()

    def at(self, feasible_set: FeasibleSet, x: Array, r: Array, error: float) -> float:
        """Return a bound of the error in the energy norm [energy^(1/2)]. Collective.

        Args:
            feasible_set: Lambda.
            x: (size,) multipliers in Lambda.
            r: (size,) the gradient there: d - N u and -T u, for the displacement in question.
            error: a bound of |u - K^-1 (f - B'x)|_K.

        Returns:
            the bound of |u - u*|_K; infinite where constraints are dependent.
        """
        rest, gap = self._best_nodes(feasible_set, x, r)
        total = float(reduce_array(self._system.comm, gap))
        lift = self._lift(r - rest)
        return float(np.sqrt(2.0 * total + (lift + error) ** 2)) + error

    def _best_nodes(self, feasible_set: FeasibleSet, x: Array, r: Array) -> tuple[Array, float]:
        """Return d - N v and -T v for the best v, and this rank's part of its gap but the lift's.

        Each node takes the jump that is cheapest if its neighbours do not move.
        """
        local, lam = self._local_stiffness, feasible_set
        rest = np.zeros_like(r)  # what bonded nodes keep
        rest[lam.normal] = np.maximum(r[lam.normal] - x[lam.normal] / local[lam.normal], 0.0)
        # one stiffness for all directions of a disc
        stiffness = lam.disc_means(local)
        stiffness[stiffness == 0.0] = 1.0  # nodes without tangential rows
        slip = np.zeros_like(r)
        slip[lam.tangential] = x[lam.tangential] / stiffness[lam.node] - r[lam.tangential]
        length = lam.norms(slip)
        factor = np.maximum(1.0 - lam.radius / (stiffness * np.maximum(length, TINY)), 0.0)
        slip[lam.tangential] *= factor[lam.node]
        rest[lam.tangential] = -slip[lam.tangential]
        friction = lam.dissipation(slip) - float(x[lam.tangential] @ slip[lam.tangential])
        return rest, float(x[lam.normal] @ rest[lam.normal]) + max(friction, 0.0)

    def _lift(self, jump: Array) -> float:
        """Return |w|_K for the w with B w = jump that is cheapest by the diagonal of K."""
        if self._solver is None:
            return np.inf
        self._jump.array = jump
        force = self._jump.duplicate()
        self._solver.solve(self._jump, force)
        self._B.multTranspose(force, self._force)
        self._w.pointwiseMult(self._compliance, self._force)
        self._B.mult(self._w, force)
        force.axpy(-1.0, self._jump)
        dependent = force.norm() > DEPENDENT_ROWS * self._jump.norm()
        force.destroy()
        if dependent:
            return np.inf
        self._system.K.mult(self._w, self._Kw)
        return float(np.sqrt(max(self._w.dot(self._Kw), 0.0)))
