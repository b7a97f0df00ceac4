"""Springs that fix floating bodies while K is factored, and the removal of their effect."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, diags_array, eye_array, kron

from dolfinx_tresca._base.arrays import ROUNDING, Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca._base.matrices import sparse_matrix
from dolfinx_tresca._base.mixing import splitmix64
from dolfinx_tresca._base.parallel import RankReductions, broadcast_array, reduce_array
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes
from dolfinx_tresca.stiffness.solver import StiffnessSolver

#: Approximate number of a body's nodes on which springs act.
FIXING_NODES = 20

#: Relative accuracy, in the energy norm, to which iterative solvers compute a `SpringResponse`.
RESPONSE_ACCURACY = 1e-10


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

        The springs act on a few nodes of each body, spread over the body, and make the body about
        as stiff against its rigid modes as it is against deformation. There are few such nodes,
        since the springs couple each of these nodes with all the others; but there are more nodes
        than modes, since the body would be deformed locally around a single node.
        """
        modes = self.modes
        dim = modes.dim
        _, index, numbers = np.unique(modes.body, return_inverse=True, return_counts=True)
        place = np.arange(len(modes)) - (np.cumsum(numbers) - numbers)[index]
        fixed = np.repeat(self._is_fixed(index, len(numbers)), dim)
        part = diags_array(fixed.astype(float), format="csr") @ modes.basis
        part.eliminate_zeros()
        # a small matrix for each body, padded with the unit matrix
        most = modes.parts.shape[1]
        grams: Array = np.zeros((len(numbers), most, most))
        products = (part.T @ part).tocoo()
        row, column = products.row, products.col
        grams[index[row], place[row], place[column]] = products.data
        grams = reduce_array(modes.comm, grams)
        body, beyond = np.nonzero(np.arange(most) >= numbers[:, None])
        grams[body, beyond, beyond] = 1.0
        springs = np.zeros_like(grams)
        springs[index, place, place] = np.sqrt(modes.stiffness)
        weights = broadcast_array(modes.comm, np.linalg.solve(grams, springs))
        mode, other = np.nonzero(np.arange(most) < numbers[index, None])
        values = weights[index[mode], place[mode], other]
        blocks = csr_array((values, (mode, mode - place[mode] + other)), shape=2 * (len(modes),))
        return csr_array(part @ blocks)

    def _is_fixed(self, index: Indices, bodies: int) -> Mask:
        """Choose `FIXING_NODES` nodes of each body at random, and mark them (n,). Collective.

        Each node has a pseudorandom number, and the nodes of a body with the smallest numbers are
        chosen: nodes at regular intervals might all be on one edge.

        Args:
            index: (k,) number of the body that each rigid mode moves, in 0, ..., bodies - 1.
            bodies: number of bodies.
        """
        modes, entries = self.modes, self.modes.basis.tocoo()
        count = entries.shape[0] // modes.dim
        body = np.full(count, bodies)
        body[entries.row // modes.dim] = index[entries.col]
        key = _scattered(modes.comm.scan(count) - count + np.arange(count))
        order = np.lexsort([key, body])
        first = np.searchsorted(body, np.arange(bodies + 1), sorter=order)
        order = order[: first[-1]]  # other nodes have no mode
        rank = np.arange(len(order)) - first[body[order]]
        some = order[rank < FIXING_NODES]
        least = np.full((bodies, FIXING_NODES), np.iinfo(np.uint64).max, dtype=np.uint64)
        least[body[some], rank[rank < FIXING_NODES]] = key[some]
        least = modes.comm.allreduce(least, op=_least)
        result = np.zeros(count, dtype=np.bool_)
        result[order] = key[order] <= least[body[order], -1]
        return result

    def added_to(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return the well-conditioned matrix K + Z Z', which the caller owns. Collective."""
        comm, k = self.modes.comm, len(self.modes)
        Z = sparse_matrix(self.columns, (k if comm.rank == 0 else 0, k), comm)
        springs, result = Z.matTransposeMult(Z), K.copy()
        result.axpy(1.0, springs, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        result.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        Z.destroy()
        springs.destroy()
        return result

    def energy(self, u: PETSc.Vec) -> float:
        """Return twice the energy [energy] of the springs under a displacement. Collective."""
        stretch = reduce_array(self.modes.comm, self.columns.T @ u.array)
        return float(stretch @ stretch)

    def response(self, K: PETSc.Mat, solver: StiffnessSolver) -> SpringResponse:
        """Return the displacements caused by forces of the springs alone. Collective.

        Args:
            K: K without these springs.
            solver: solver for `added_to(K)`.

        Raises:
            StiffnessError: a solve failed.
        """
        modes = self.modes
        k = len(modes)
        soft = np.flatnonzero(~modes.floats)
        if len(soft) == 0:
            return SpringResponse(modes, modes.basis, csr_array((k, k)))
        # K couples no two bodies, so that one solve serves one mode of every body
        body = modes.body[soft]
        place = np.arange(len(soft)) - np.searchsorted(body, body)
        answers = []
        mode, force, answer = K.createVecRight(), K.createVecLeft(), K.createVecRight()
        for number in range(int(place.max()) + 1):
            some = soft[place == number]
            mode.array = modes.basis[:, some].sum(axis=1)
            K.mult(mode, force)
            # forces of equal size on all bodies, since the accuracy is relative to the whole answer
            forces = modes.split(force.array, some)
            sizes = np.sqrt(reduce_array(modes.comm, forces.power(2).sum(axis=0)))
            sizes[sizes == 0.0] = 1.0
            force.array = forces @ (1.0 / sizes)
            answer.set(0.0)
            solver.improve(force, answer, rtol=RESPONSE_ACCURACY, accuracy=0.0)
            answers.append(modes.split(answer.array, some) * sizes)
        for owned in (mode, force, answer):
            owned.destroy()
        V = csr_array(sum(answers[1:], start=answers[0]))
        # the stiffness as R'ZZ'V, where V = R - U, since the equal R'KR - (KR)'V would be a small
        # difference of large terms
        sums = RankReductions(modes.comm)
        of_modes, of_answers = (
            sums.sparse_inner(self.columns, one) for one in (modes.basis * ~modes.floats, V)
        )
        resisted = csr_array(of_modes.T @ of_answers)
        stiffness = csr_array(0.5 * (resisted + resisted.T))
        return SpringResponse(modes, csr_array(modes.basis - V), stiffness)


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
        first = modes.name(int(modes.body[modes.floats.argmax()]))
        raise InputError(
            "bodies that contact alone holds need the form a of the displacement alone, but it is "
            f"that of a mixed space, and nothing holds {first}. "
            "Hold it by Dirichlet conditions, or by springs in a, of 1e-6 of its stiffness."
        )
    return None


def _scattered(numbers: GlobalNumbers) -> npt.NDArray[np.uint64]:
    """Return pseudorandom integers (n,) for integers (n,), equal only for equal integers."""
    return splitmix64(numbers.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15))


def _least(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the k least values in each row of two arrays (n, k) together, ascending."""
    return np.sort(np.concatenate([a, b], axis=1), axis=1)[:, : a.shape[1]]


@dataclass(frozen=True)
class SpringResponse:
    """The displacements U = K_p^-1 Z Z'R, where K_p = K + Z Z' has the fixing springs.

    In a system with the matrix K_p, forces Z Z'R of the fixing springs alone cause U. `Equilibrium`
    combines these displacements such that the springs have no effect. U equals R for modes that K
    does not resist.

    Attributes:
        modes: the rigid body modes R.
        displacements: U (owned degrees of freedom, k), sparse.
        stiffness: (k, k) stiffness of K against U, sparse.
    """

    modes: RigidBodyModes
    displacements: csr_array
    stiffness: csr_array

    def resultants(self, f: Array) -> tuple[Array, Array]:
        """Return the resultants U'f (k,) of this rank's loads f, and sizes (k,). Collective.

        The size of a resultant is the sum of |U| |f| over the nodes, where |.| is the length of a
        vector at a node, which does not depend on the axes. A resultant that is rounding relative
        to its size is set to zero.
        """
        U, dim = self.displacements, self.modes.dim
        nodes = kron(eye_array(len(f) // dim), np.ones((1, dim)), format="csr")
        lengths = (nodes @ U.power(2)).sqrt()
        loads = np.sqrt(nodes @ np.square(f))
        sizes: Array = reduce_array(self.modes.comm, lengths.T @ loads)
        result: Array = reduce_array(self.modes.comm, U.T @ f)
        result[np.abs(result) <= ROUNDING * sizes] = 0.0
        return result, sizes
