"""Rigid motions of bodies that K resists little or not at all: contact has to hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, hstack

from dolfinx_tresca._parallel import reduce_array
from dolfinx_tresca.stiffness.solver import StiffnessSolver

FloatArray = npt.NDArray[np.float64]

#: Part of a motion that must be free for it to be named, and that is free at all.
CLEAR, SMALL = 0.25, 1e-3

#: Rigid motions by the dimension of space.
MOTIONS = {
    2: ("translation along x", "translation along y", "rotation"),
    3: ("translation along x", "translation along y", "translation along z",
        "rotation about x", "rotation about y", "rotation about z"),
}  # fmt: skip


#: Relative accuracy, in the energy norm, of what iterative solvers find for soft springs.
EXACT = 1e-10

#: Resultant over the sum of the loads' sizes that is rounding.
ROUNDING = 64 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class LooseMotions:
    """Rigid motions R of bodies, orthonormal in the degrees of freedom.

    Attributes:
        comm: of the mesh.
        basis: R (owned degrees of freedom, k), sparse; zero where u is prescribed.
        floats: (k,) bool: K does not resist the motion at all; else a little, as soft springs do.
        body: (k,) which body moves, in words.
        parts: (k, 3 or 6) what each motion has of each of `MOTIONS`, for the body's size.
    """

    comm: Any
    basis: csr_array
    floats: npt.NDArray[np.bool_]
    body: Sequence[str]
    parts: FloatArray

    def __len__(self) -> int:
        return len(self.floats)

    @cached_property
    def supports(self) -> npt.NDArray[np.int32]:
        """Degrees of freedom of this rank that hold every motion when they are fixed. Collective.

        As many as there are motions, over all ranks: in turn that which moves most while those
        before it stay (the pivots of a QR decomposition).
        """
        found = []
        for body in dict.fromkeys(self.body):
            part = self.basis[:, [other == body for other in self.body]]
            dofs = np.flatnonzero(np.diff(part.indptr))
            rows = part[dofs].toarray()
            for _ in range(rows.shape[1]):
                sizes = np.square(rows).sum(axis=1)
                best = int(sizes.argmax()) if len(sizes) else -1
                size, rank = self.comm.allreduce(
                    (float(sizes.max(initial=-1.0)), -self.comm.rank), op=MPI.MAX
                )
                mine = self.comm.rank == -rank
                pivot = self.comm.bcast(rows[best] if mine else None, root=-rank)
                if mine:
                    found.append(dofs[best])
                rows = rows - np.outer(rows @ pivot, pivot) / size
        return np.array(found, dtype=np.int32)

    def supported(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return K with a spring on each support, well conditioned; the caller's. Collective."""
        result = K.copy()
        diagonal = K.getDiagonal()
        diagonal.array[self.supports] *= 2.0
        result.setDiagonal(diagonal)
        result.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        diagonal.destroy()
        return result

    def support_energy(self, K: PETSc.Mat, u: PETSc.Vec) -> float:
        """Return twice the energy of the supports' springs under a displacement. Collective."""
        diagonal = K.getDiagonal()
        square = diagonal.array[self.supports] @ np.square(u.array[self.supports])
        diagonal.destroy()
        return float(self.comm.allreduce(square))

    def response(self, K: PETSc.Mat, solver: StiffnessSolver) -> RigidResponse:
        """Return what forces on the supports alone do to the bodies. Collective.

        Args:
            K: without these springs.
            solver: for `supported(K)`.
        """
        k = len(self)
        soft = np.flatnonzero(~self.floats)
        if len(soft) == 0:
            return RigidResponse(self, self.basis, np.zeros((k, k)))
        diagonal = K.getDiagonal()
        springs = diagonal.array[self.supports]
        diagonal.destroy()
        motion, force, answer = K.createVecRight(), K.createVecLeft(), K.createVecRight()
        answers, at_supports = [], np.zeros((len(self.supports), len(soft)))
        for column, j in enumerate(soft):
            motion.array = self.basis[:, [j]].toarray().ravel()
            K.mult(motion, force)
            answer.set(0.0)
            solver.improve(force, answer, rtol=EXACT, accuracy=0.0)
            answers.append(csr_array(answer.array[:, None]))
            at_supports[:, column] = answer.array[self.supports]
        for owned in (motion, force, answer):
            owned.destroy()
        # R'ZZ'V, where R'KR - (KR)'V would be a small difference
        resisted = (springs * self.basis[self.supports][:, soft].T) @ at_supports
        resisted = reduce_array(self.comm, resisted)
        stiffness = np.zeros((k, k))
        stiffness[np.ix_(soft, soft)] = 0.5 * (resisted + resisted.T)
        select = csr_array((np.ones(len(soft)), (np.arange(len(soft)), soft)), (len(soft), k))
        changes = hstack(answers, format="csr") @ select
        return RigidResponse(self, csr_array(self.basis - changes), stiffness)

    def describe(self, components: FloatArray) -> str:
        """Return in words what moves how, of the body that moves most.

        Args:
            components: (k,) of a motion, or (k, columns) of several.
        """
        names = MOTIONS[3 if self.parts.shape[1] == 6 else 2]
        parts = {}
        for body in dict.fromkeys(self.body):
            mine = [other == body for other in self.body]
            parts[body] = self.parts[mine].T @ components[mine].reshape(sum(mine), -1)
        body = max(parts, key=lambda one: float(np.linalg.norm(parts[one])))
        axes, sizes, _ = np.linalg.svd(parts[body], full_matrices=False)
        share = np.square(axes[:, sizes > SMALL * sizes[0]]).sum(axis=1)
        free = [name for name, part in zip(names, share, strict=True) if part > CLEAR]
        return f"{body}: {', '.join(free or [names[int(share.argmax())]])}"


@dataclass(frozen=True)
class RigidResponse:
    """The motions U = K_p^-1 Z Z'R, where K_p = K + Z Z' has springs Z on the supports.

    K_p needs forces on the supports for them, and nothing else; where K does not resist, U is R.

    Attributes:
        loose: the motions R.
        displacements: U (owned degrees of freedom, k), sparse.
        stiffness: (k, k) what K resists them with.
    """

    loose: LooseMotions
    displacements: csr_array
    stiffness: FloatArray

    def resultants(self, f: FloatArray) -> FloatArray:
        """Return U'f of loads f on this rank; zero where that is rounding. Collective."""
        U = self.displacements
        size = reduce_array(self.loose.comm, abs(U).T @ np.abs(f))
        result: FloatArray = reduce_array(self.loose.comm, U.T @ f)
        result[np.abs(result) <= ROUNDING * size] = 0.0
        return result
