"""Springs that fix floating bodies while K is factored, and the removal of their effect."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array, diags_array

from dolfinx_tresca._base.arrays import splitmix64
from dolfinx_tresca._base.parallel import RankReductions, reduce_array
from dolfinx_tresca._base.petsc import product, sparse_matrix
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes
from dolfinx_tresca.solvers.constraints import eigenpairs
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: Mean number of a body's nodes on which springs act. (Too few nodes to hold a body are drawn once
#: in 10^10 bodies.) With twice the number, the factors of small bodies get a tenth more entries;
#: with half the number, the least eigenvalue of K_p is up to half as large.
FIXING_NODES = 30


@dataclass(frozen=True)
class FixingSprings:
    """Springs with the stiffness Z Z', with which K_p = K + Z Z' is well conditioned.

    The springs act on a few nodes of each body with modes that K resists little or not at all.
    Solves use K_p in place of K. The equilibrium of the bodies (`floating/equilibrium.py`) removes
    the effect of the fixing springs again. On floating bodies the fixing springs then have no
    force. On softly held bodies, which soft springs of the scene hold, the displacements of the
    `response` cancel the effect of the fixing springs. (The nodes on which springs act correspond
    to the fixing nodes of Brzobohaty et al. 2011.)

    Attributes:
        modes: the rigid body modes R that the springs resist.
    """

    modes: RigidBodyModes

    @cached_property
    def columns(self) -> csr_array:
        """The matrix Z (owned degrees of freedom, k) of the springs, sparse. Collective.

        The springs act on about `FIXING_NODES` nodes of each body, chosen at random, since nodes at
        regular intervals might all be on one edge. They make the body about as stiff against its
        rigid modes as it is against deformation. There are few such nodes, since the springs couple
        each of these nodes with all the others; but there are more nodes than modes, since the body
        would be deformed locally around a single node.
        """
        modes, label = self.modes, self.modes.bodies.label
        moves = np.diff(modes.basis.indptr).reshape(-1, modes.dim).any(axis=1)
        numbers = reduce_array(modes.comm, np.bincount(label[moves], minlength=modes.bodies.number))
        start = modes.comm.scan(len(label)) - len(label)
        chance = splitmix64(np.arange(start, start + len(label), dtype=np.uint64)) / 2.0**64
        chosen = moves & (chance * numbers[label] <= FIXING_NODES)
        fixed_modes = csr_array(diags_array(np.repeat(chosen, modes.dim) * 1.0) @ modes.basis)
        fixed_modes.eliminate_zeros()
        gram = RankReductions(modes.comm).sparse_inner(fixed_modes, fixed_modes)
        values, vectors = modes.comm.bcast(eigenpairs(gram))
        inverse = vectors @ diags_array(1.0 / values) @ vectors.T
        return csr_array(fixed_modes @ inverse @ diags_array(np.sqrt(modes.stiffness)))

    def added_to(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return the well-conditioned matrix K + Z Z', which the caller owns. Collective."""
        comm, k = self.modes.comm, len(self.modes)
        Z = sparse_matrix(self.columns, (k if comm.rank == 0 else 0, k), comm)
        springs, result = Z.matTransposeMult(Z), K.copy()
        result.axpy(1.0, springs, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        result.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return result

    def energy(self, u: PETSc.Vec) -> float:
        """Return twice the energy [energy] of the springs under a displacement. Collective."""
        stretch = reduce_array(self.modes.comm, self.columns.T @ u.array)
        return float(stretch @ stretch)

    def response(self, K: PETSc.Mat, solver: StiffnessSolver) -> tuple[csr_array, csr_array]:
        """Return the displacements caused by forces of the springs alone. Collective.

        In a system with the matrix K_p, forces Z Z'R of the fixing springs alone cause
        U = K_p^-1 Z Z'R. U equals R for modes that K does not resist.

        Args:
            K: K without these springs.
            solver: solver for `added_to(K)`.

        Returns:
            U (owned degrees of freedom, k), and the stiffness (k, k) of K against U; both sparse.

        Raises:
            StiffnessError: a solve failed.
        """
        modes, k = self.modes, len(self.modes)
        if modes.floats.all():
            return modes.basis, csr_array((k, k))
        # forces of equal size on all bodies, since the accuracy is relative to the whole answer
        forces = product(K, modes.basis)
        sizes = np.sqrt(reduce_array(modes.comm, forces.power(2).sum(axis=0)))
        sizes[sizes == 0.0] = 1.0
        # K couples no two bodies, so that one solve serves one soft mode of every body
        soft, body, n = ~modes.floats, modes.body, forces.shape[0]
        place = np.searchsorted(body, body, side="right") - np.arange(k)
        label = np.repeat(modes.bodies.label, modes.dim)
        moves = csr_array((np.ones(n), label, np.arange(n + 1)), (n, modes.bodies.number))[:, body]
        force, answer = K.createVecLeft(), K.createVecRight()
        V = csr_array(modes.basis.shape)
        for number in np.unique(place[soft]):
            chosen = np.where(soft & (place == number), 1.0, 0.0)
            force.array = forces @ (chosen / sizes)
            answer.set(0.0)
            solver.improve(force, answer, rtol=1e-10, accuracy=0.0)
            V = V + diags_array(answer.array) @ moves @ diags_array(chosen * sizes)
        # the stiffness as R'ZZ'V, where V = R - U, since the equal R'KR - (KR)'V would be a small
        # difference of large terms; Z'R is the square root of `RigidBodyModes.stiffness`
        springs = np.where(modes.floats, 0.0, np.sqrt(modes.stiffness))
        resisted = diags_array(springs) @ RankReductions(modes.comm).sparse_inner(self.columns, V)
        stiffness = csr_array(0.5 * (resisted + resisted.T))
        return csr_array(modes.basis - V), stiffness


def fixing_springs(modes: RigidBodyModes, system: Any) -> FixingSprings | None:
    """Return springs that fix floating and softly held bodies; None if no body needs springs.

    Not collective.

    Args:
        modes: rigid body modes that K resists little or not at all.
        system: the `LinearSystem`. In a mixed space softly held bodies get no springs, since the
            factorisation of K does not need positive pivots there.

    Raises:
        InputError: the space is mixed and a body floats.
    """
    if system.component is None or not modes:
        return FixingSprings(modes) if modes else None
    if modes.floats.any():
        body = modes.bodies.describe(int(modes.body[modes.floats.argmax()]))
        raise InputError(
            "bodies that contact alone holds need the form a of the displacement alone, but it is "
            f"that of a mixed space, and nothing holds {body}. "
            "Hold it by Dirichlet conditions, or by springs in a, of 1e-6 of its stiffness."
        )
    return None
