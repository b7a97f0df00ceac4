"""Springs that fix floating bodies while K is factored, and what they are taken away with again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array, csr_array, eye_array, hstack, kron

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices
from dolfinx_tresca._base.mixing import splitmix64
from dolfinx_tresca._base.parallel import broadcast_array, reduce_array
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: Nodes of a body that springs act on, about.
FIXING_NODES = 20

#: Relative accuracy, in the energy norm, of what iterative solvers find for soft springs.
RESPONSE_ACCURACY = 1e-10

#: Resultant over the sum of the loads' sizes that is rounding.
RESULTANT_ROUNDING = 64 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class FixingSprings:
    """Springs Z on a few nodes of each floating body: K_p = K + Z Z' is well conditioned.

    K_p stands in for K. What is due to the springs is taken away again by the equilibrium of the
    bodies (`floating/equilibrium.py`): for bodies that float no spring feels a force then;
    otherwise `response` says what they do. (Fixing nodes, as in Brzobohaty et al. 2011, but with
    springs.)

    Attributes:
        modes: the rigid body modes R that the springs resist.
    """

    modes: RigidBodyModes

    @cached_property
    def columns(self) -> csr_array:
        """Z (owned degrees of freedom, k), sparse. Collective.

        The springs act on a few nodes of each body, spread over it, and make it about as stiff
        against its modes as it is in itself: few, since these nodes are all coupled then; but not
        on one node for each mode, which would give way.
        """
        modes = self.modes
        dim = modes.dim
        bodies = _consecutive(modes.body)
        entries = []
        grams: Array = np.zeros((len(modes), modes.parts.shape[1]))
        for body, nodes in zip(bodies, self._fixed_nodes(bodies), strict=True):
            rows = (nodes[:, None] * dim + np.arange(dim)).ravel()
            entries.append((rows, modes.basis[rows][:, body].toarray()))
            grams[body, : body.stop - body.start] = entries[-1][1].T @ entries[-1][1]
        grams = reduce_array(modes.comm, grams)
        weights: Array = np.zeros_like(grams)
        for body in bodies:
            k = body.stop - body.start
            springs = np.diag(np.sqrt(modes.stiffness[body]))
            weights[body, :k] = np.linalg.solve(grams[body, :k], springs)
        weights = broadcast_array(modes.comm, weights)
        places, values = [np.zeros((0, 2), dtype=np.intp)], [np.zeros(0)]
        for body, (rows, part) in zip(bodies, entries, strict=True):
            block = part @ weights[body, : body.stop - body.start]
            row, column = np.nonzero(block)
            places.append(np.column_stack([rows[row], body.start + column]))
            values.append(block[row, column])
        where = np.concatenate(places)
        return csr_array(
            (np.concatenate(values), (where[:, 0], where[:, 1])), shape=modes.basis.shape
        )

    def _fixed_nodes(self, bodies: Sequence[slice]) -> list[Indices]:
        """Return the nodes of each body on this rank that springs act on. Collective.

        Those with the least of numbers without a pattern: every so many nodes might be those of one
        edge.

        Args:
            bodies: their modes.
        """
        modes, basis = self.modes, csc_array(self.modes.basis)
        count = basis.shape[0] // modes.dim
        first = modes.comm.scan(count) - count
        nodes, keys = [], []
        least = np.full((len(bodies), FIXING_NODES), np.iinfo(np.uint64).max, dtype=np.uint64)
        for body, row in zip(bodies, least, strict=True):
            entries = slice(basis.indptr[body.start], basis.indptr[body.stop])
            nodes.append(np.unique(basis.indices[entries] // modes.dim))
            keys.append(_scattered(first + nodes[-1]))
            some = np.sort(keys[-1])[:FIXING_NODES]
            row[: len(some)] = some
        least = modes.comm.allreduce(least, op=_least)
        return [some[key <= row[-1]] for some, key, row in zip(nodes, keys, least, strict=True)]

    def added_to(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return K + Z Z', well conditioned; the caller's. Collective."""
        (rows, _), comm = K.getSizes(), K.comm
        first, _ = K.getOwnershipRange()
        k = self.columns.shape[1]
        mine = k if comm.rank == 0 else 0
        Z = PETSc.Mat().createAIJ((rows, (mine, k)), comm=comm)
        Z.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        Z.setUp()
        entries = self.columns.tocoo()
        for row, column, value in zip(entries.row, entries.col, entries.data, strict=True):
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

    def energy(self, u: PETSc.Vec) -> float:
        """Return twice the energy [energy] of the springs under a displacement. Collective."""
        stretch = reduce_array(self.modes.comm, self.columns.T @ u.array)
        return float(stretch @ stretch)

    def response(self, K: PETSc.Mat, solver: StiffnessSolver) -> SpringResponse:
        """Return the displacements caused by forces of the springs alone. Collective.

        Args:
            K: without these springs.
            solver: solver for `added_to(K)`.

        Raises:
            StiffnessError: a solve failed.
        """
        modes = self.modes
        k = len(modes)
        soft = np.flatnonzero(~modes.floats)
        if len(soft) == 0:
            return SpringResponse(modes, modes.basis, np.zeros((k, k)))
        mode, force, answer = K.createVecRight(), K.createVecLeft(), K.createVecRight()
        answers = []
        for j in soft:
            mode.array = modes.basis[:, [j]].toarray().ravel()
            K.mult(mode, force)
            answer.set(0.0)
            solver.improve(force, answer, rtol=RESPONSE_ACCURACY, accuracy=0.0)
            answers.append(csr_array(answer.array[:, None]))
        for owned in (mode, force, answer):
            owned.destroy()
        V = hstack(answers, format="csr")
        # R'ZZ'V, where R'KR - (KR)'V would be a small difference
        of_modes, of_answers = (
            reduce_array(modes.comm, (self.columns.T @ other).toarray())
            for other in (modes.basis[:, soft], V)
        )
        resisted = of_modes.T @ of_answers
        stiffness = np.zeros((k, k))
        resisted = broadcast_array(modes.comm, 0.5 * (resisted + resisted.T))
        stiffness[np.ix_(soft, soft)] = resisted
        select = csr_array((np.ones(len(soft)), (np.arange(len(soft)), soft)), (len(soft), k))
        changes = V @ select
        return SpringResponse(modes, csr_array(modes.basis - changes), stiffness)


def fixing_springs(modes: RigidBodyModes, system: Any) -> FixingSprings | None:
    """Return springs that fix floating bodies, or None if no body floats. Not collective.

    Args:
        modes: rigid body modes that K resists little or not at all.
        system: the `LinearSystem`. Where it has more unknowns than displacements K is factored with
            pivots of any sign, and needs no springs for bodies that are held softly.

    Raises:
        InputError: a body of a mixed space floats.
    """
    if system.component is None or not modes:
        return FixingSprings(modes) if modes else None
    if modes.floats.any():
        raise InputError(
            "bodies that contact alone holds need the form a of the displacement alone, but it is "
            f"that of a mixed space, and nothing holds {modes.body[int(modes.floats.argmax())]}. "
            "Hold it by Dirichlet conditions, or by springs in a, of 1e-6 of its stiffness."
        )
    return None


def _consecutive(names: Sequence[str]) -> list[slice]:
    """Return where each name stands, of names that stand together."""
    ends = np.cumsum([len(list(group)) for _, group in groupby(names)], dtype=int)
    return [slice(*ends) for ends in zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True)]


def _scattered(numbers: GlobalNumbers) -> npt.NDArray[np.uint64]:
    """Return integers without a pattern, each different, for integers (n,), also for zero."""
    return splitmix64(numbers.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15))


def _least(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the k least values of each row of two arrays (n, k), ascending."""
    return np.sort(np.concatenate([a, b], axis=1), axis=1)[:, : a.shape[1]]


@dataclass(frozen=True)
class SpringResponse:
    """The displacements U = K_p^-1 Z Z'R, where K_p = K + Z Z' has the fixing springs.

    K_p needs forces of the springs for them, and nothing else; where K does not resist, U is R.

    Attributes:
        modes: R.
        displacements: U (owned degrees of freedom, k), sparse.
        stiffness: (k, k) what K resists them with.
    """

    modes: RigidBodyModes
    displacements: csr_array
    stiffness: Array

    def resultants(self, f: Array) -> tuple[Array, Array]:
        """Return U'f (k,) of loads f on this rank, and sizes (k,) of its terms. Collective.

        The latter are sums of |U| |f| over the nodes, which do not depend on the axes. What is
        rounding beside them is zero.
        """
        U, dim = self.displacements, self.modes.dim
        nodes = kron(eye_array(len(f) // dim), np.ones((1, dim)), format="csr")
        lengths = (nodes @ U.power(2)).sqrt()
        loads = np.sqrt(nodes @ np.square(f))
        sizes: Array = reduce_array(self.modes.comm, lengths.T @ loads)
        result: Array = reduce_array(self.modes.comm, U.T @ f)
        result[np.abs(result) <= RESULTANT_ROUNDING * sizes] = 0.0
        return result, sizes
