"""Rigid motions of bodies that K resists little or not at all: contact has to hold them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, eye_array, hstack, kron

from dolfinx_tresca._parallel import broadcast_array, reduce_array
from dolfinx_tresca.stiffness.solver import StiffnessSolver

FloatArray = npt.NDArray[np.float64]

#: Part of a motion that must be free for it to be named, and that is free at all.
CLEAR, SMALL = 0.1, 1e-3

#: Rigid motions by the dimension of space.
MOTIONS = {
    2: ("translation along x", "translation along y", "rotation"),
    3: ("translation along x", "translation along y", "translation along z",
        "rotation about x", "rotation about y", "rotation about z"),
}  # fmt: skip

#: Nodes of a body that springs act on, about.
SUPPORTS = 20

#: Relative accuracy, in the energy norm, of what iterative solvers find for soft springs.
EXACT = 1e-10

#: Resultant over the sum of the loads' sizes that is rounding.
ROUNDING = 64 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class LooseMotions:
    """Rigid motions R of bodies, orthonormal in the degrees of freedom, that K hardly resists.

    K_p = K + Z Z', with springs Z on the supports, is well conditioned and stands in for K. What is
    due to the springs is taken away again where loads are balanced (`dual/balanced_set.py`): for
    bodies that float no spring feels a force then; otherwise `response` says what they do.

    Attributes:
        comm: of the mesh.
        basis: R (owned degrees of freedom, k), sparse; zero where u is prescribed.
        stiffness: (k,) of the body itself, about, for motions of length 1.
        floats: (k,) bool: K does not resist the motion at all; else a little, as soft springs do.
        body: (k,) which body moves, in words.
        parts: (k, 3 or 6) what each motion has of each of `MOTIONS`, for the body's size.
    """

    comm: Any
    basis: csr_array
    stiffness: FloatArray
    floats: npt.NDArray[np.bool_]
    body: Sequence[str]
    parts: FloatArray

    def __len__(self) -> int:
        return len(self.floats)

    @property
    def dim(self) -> int:
        """Of space."""
        return 3 if self.parts.shape[1] == 6 else 2

    @cached_property
    def supports(self) -> csr_array:
        """Z (owned degrees of freedom, k), sparse: springs that resist the motions. Collective.

        They act on a few nodes of each body, spread over it, and make it about as stiff against
        its motions as it is in itself: few, since these nodes are all coupled then; but not on one
        node for each motion, which would give way.
        """
        columns = []
        for body in dict.fromkeys(self.body):
            mine = [other == body for other in self.body]
            part = csr_array(self.basis[:, mine])
            dim = self.dim
            nodes = np.flatnonzero(np.diff(part.indptr).reshape(-1, dim).any(axis=1))
            counts = self.comm.allgather(len(nodes))
            first, total = sum(counts[: self.comm.rank]), sum(counts)
            chosen = np.zeros((part.shape[0] // dim, dim))
            # without a pattern: every so many nodes might be those of one edge
            picked = np.random.default_rng(0).permutation(total)[:SUPPORTS] - first
            chosen[nodes[picked[(picked >= 0) & (picked < len(nodes))]]] = 1.0
            rows = csr_array(part * chosen.reshape(-1, 1))
            gram = reduce_array(self.comm, (rows.T @ rows).toarray())
            stiffness = np.sqrt(self.stiffness[mine])
            weights = broadcast_array(self.comm, np.linalg.solve(gram, np.diag(stiffness)))
            columns.append(csr_array(rows @ weights))
        return csr_array(hstack(columns, format="csr"))

    def supported(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return K + Z Z', well conditioned; the caller's. Collective."""
        (rows, _), comm = K.getSizes(), K.comm
        supports = self.supports
        first, _ = K.getOwnershipRange()
        k = supports.shape[1]
        mine = k if comm.rank == 0 else 0
        Z = PETSc.Mat().createAIJ((rows, (mine, k)), comm=comm)
        Z.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        Z.setUp()
        coordinates = supports.tocoo()
        for row, column, value in zip(
            coordinates.row, coordinates.col, coordinates.data, strict=True
        ):
            Z.setValue(first + row, column, value)
        Z.assemble()
        transposed = Z.copy().transpose()
        springs = Z.matMult(transposed)
        result = K.copy()
        result.axpy(1.0, springs, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        result.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        for owned in (Z, transposed, springs):
            owned.destroy()
        return result

    def support_energy(self, u: PETSc.Vec) -> float:
        """Return twice the energy of the springs under a displacement. Collective."""
        stretch = reduce_array(self.comm, self.supports.T @ u.array)
        return float(stretch @ stretch)

    def response(self, K: PETSc.Mat, solver: StiffnessSolver) -> RigidResponse:
        """Return what forces on the supports alone do to the bodies. Collective.

        Args:
            K: without these springs.
            solver: for `supported(K)`.

        Raises:
            StiffnessError: a solve failed.
        """
        k = len(self)
        soft = np.flatnonzero(~self.floats)
        if len(soft) == 0:
            return RigidResponse(self, self.basis, np.zeros((k, k)))
        motion, force, answer = K.createVecRight(), K.createVecLeft(), K.createVecRight()
        answers = []
        for j in soft:
            motion.array = self.basis[:, [j]].toarray().ravel()
            K.mult(motion, force)
            answer.set(0.0)
            solver.improve(force, answer, rtol=EXACT, accuracy=0.0)
            answers.append(csr_array(answer.array[:, None]))
        for owned in (motion, force, answer):
            owned.destroy()
        V = hstack(answers, format="csr")
        # R'ZZ'V, where R'KR - (KR)'V would be a small difference
        of_motions, of_answers = (
            reduce_array(self.comm, (self.supports.T @ other).toarray())
            for other in (self.basis[:, soft], V)
        )
        resisted = of_motions.T @ of_answers
        stiffness = np.zeros((k, k))
        resisted = broadcast_array(self.comm, 0.5 * (resisted + resisted.T))
        stiffness[np.ix_(soft, soft)] = resisted
        select = csr_array((np.ones(len(soft)), (np.arange(len(soft)), soft)), (len(soft), k))
        changes = V @ select
        return RigidResponse(self, csr_array(self.basis - changes), stiffness)

    def describe(self, components: FloatArray) -> str:
        """Return in words what moves how, of the body that moves most. Collective.

        Args:
            components: (k,) of a motion, or (k, columns) of several.
        """
        names = MOTIONS[self.dim]
        parts = {}
        for body in dict.fromkeys(self.body):
            mine = [other == body for other in self.body]
            parts[body] = self.parts[mine].T @ components[mine].reshape(sum(mine), -1)
        body = max(parts, key=lambda one: float(np.linalg.norm(parts[one])))
        axes, sizes = (
            broadcast_array(self.comm, one)
            for one in np.linalg.svd(parts[body], full_matrices=False)[:2]
        )
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

    def resultants(self, f: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return U'f (k,) of loads f on this rank, and sizes (k,) of its terms. Collective.

        The latter are sums of |U| |f| over the nodes, which do not depend on the axes. What is
        rounding beside them is zero.
        """
        U, dim = self.displacements, self.loose.dim
        nodes = kron(eye_array(len(f) // dim), np.ones((1, dim)), format="csr")
        lengths = (nodes @ U.power(2)).sqrt()
        loads = np.sqrt(nodes @ np.square(f))
        sizes: FloatArray = reduce_array(self.loose.comm, lengths.T @ loads)
        result: FloatArray = reduce_array(self.loose.comm, U.T @ f)
        result[np.abs(result) <= ROUNDING * sizes] = 0.0
        return result, sizes
