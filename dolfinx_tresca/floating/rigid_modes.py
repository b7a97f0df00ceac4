"""Rigid body modes that supports and K resist little or not at all, and springs that fix them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array, diags_array

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, Mask, splitmix64
from dolfinx_tresca._base.bodies import Bodies, couples_bodies
from dolfinx_tresca._base.parallel import RankReductions, reduce_array
from dolfinx_tresca._base.petsc import product, sparse_matrix
from dolfinx_tresca.solvers.constraints import eigenpairs
from dolfinx_tresca.stiffness.solver import StiffnessSolver, indefinite_error

#: An error message mentions translations and rotations whose share in a motion exceeds this number,
#: and counts bodies that move more than this part of the largest motion.
NAMED_PART = 0.1


@dataclass(frozen=True)
class RigidBodyModes:
    """The k rigid body modes R, orthonormal in the degrees of freedom, that K hardly resists.

    Attributes:
        basis: R (owned degrees of freedom, k), sparse; zero where u is prescribed.
        stiffness: (k,) approximate stiffness of the mode's body, not against the mode, but against
            deformations of length 1 in the degrees of freedom.
        floats: (k,) True: K does not resist the mode at all; False: soft springs resist it.
        body: (k,) the body of each mode, ascending; if K couples bodies, one of these.
        mode_components: (3 or 6 for each body, k) components of each mode in `Bodies.rigid_modes`:
            translations, and rotations with lever arms divided by the body's size; sparse.
    """

    comm: Any
    bodies: Bodies
    basis: csr_array
    stiffness: Array
    floats: Mask
    body: Indices
    mode_components: csr_array

    def __len__(self) -> int:
        return len(self.floats)

    @property
    def dim(self) -> int:
        """The dimension of space."""
        return 3 if self.mode_components.shape[0] == 6 * self.bodies.count else 2

    def describe(self, components: Array) -> str:
        """Return a text on a body that moves, its motion, and further bodies that move. Collective.

        The body is the first that moves by 0.9 of the largest motion. Further bodies are those that
        move by more than `NAMED_PART` of it. Components in the modes are (k,) or (k, columns).
        """
        # (bodies, 3 or 6, columns): translations and rotations of each body
        motions = self.mode_components @ components.reshape(len(self), -1)
        motions = motions.reshape(self.bodies.count, -1, motions.shape[1])
        lengths = np.linalg.norm(motions, axis=(1, 2))
        moving = np.flatnonzero(lengths > NAMED_PART * lengths.max())
        # with half the fraction, a body may be described that turns little while another one falls
        chosen = int(np.argmax(lengths > 0.9 * lengths.max()))
        # the share of a translation or rotation is its squared part in the span of the motions
        axes, extents, _ = np.linalg.svd(motions[chosen], full_matrices=False)
        shares = np.square(axes[:, extents > 1e-3 * extents[0]]).sum(axis=1)
        names = [f"translation along {axis}" for axis in "xyz"[: self.dim]]
        names += ["rotation"] if self.dim == 2 else [f"rotation about {axis}" for axis in "xyz"]
        free = [name for name, share in zip(names, shares, strict=True) if share > NAMED_PART]
        text = self.bodies.describe(chosen, moving[moving != chosen].tolist())
        # ranks may differ by rounding
        return str(self.comm.bcast(f"{text}: {', '.join(free)}"))


#: A body without prescribed displacements is held softly if the stiffness against one of its rigid
#: body modes is at most this fraction of the stiffness of the body itself.
SOFT_STIFFNESS = 0.03


def weakly_resisted_modes(system: Any, bodies: Bodies) -> RigidBodyModes:
    """Return the rigid motions that supports and the assembled K hardly resist. Collective."""
    mesh, prescribed = system.V.mesh, system.prescribed_displacements
    comm, dim, sums = mesh.comm, mesh.geometry.dim, RankReductions(mesh.comm)
    modes, label = bodies.rigid_modes(dim), np.repeat(bodies.label, dim)
    # the energy R'K R of the rigid body modes R; rows of prescribed degrees of freedom have a 1 on
    # the diagonal of K: they are weighted like other rows, and resist motions
    K = system.displacement_stiffness()
    forces, diagonal = product(K, modes), K.getDiagonal()
    largest = _largest_entries(diagonal.array.reshape(-1, dim), ~prescribed, bodies, comm)
    weight = diags_array(np.where(prescribed, largest[label], 1.0))
    energy = sums.sparse_inner(modes, csr_array(weight @ forces))
    free = csr_array(diags_array(np.where(prescribed, 0.0, 1.0)) @ modes)
    # `components` in the modes of motions that are orthonormal on free degrees of freedom; motions
    # that move no free degree of freedom are left out
    squares, vectors = eigenpairs(sums.sparse_inner(free, free))
    squares = squares.reshape(bodies.count, -1)  # of lengths, 3 or 6 for each body
    independent = squares > 1e-10 * squares.max(axis=1, keepdims=True)
    body, column = np.nonzero(independent)
    lengths = np.sqrt(squares[body, column])
    components = vectors[:, independent.ravel()] @ diags_array(1.0 / lengths)
    # the motions x of each body at which x'R'K R x is stationary, and K's resistance against them
    resistance: Array = np.empty(0)
    if len(body):
        resistance, turned = eigenpairs(csr_array(components.T @ energy @ components))
        components = csr_array(components @ turned)
    body, resistance, components = comm.bcast((body, resistance, components))

    # a body's own stiffness against motions of length 1 in its degrees of freedom: E L^(dim-2) by
    # its N = (L/h)^dim nodes, where K's diagonal is about E h^(dim-2)
    stiffness = largest / bodies.node_counts ** (2.0 / dim)
    # rounding: the product with K adds some hundred entries of each row, which cancel each other
    nothing = 8.0 * ROUNDING * largest
    held = reduce_array(comm, np.bincount(label, prescribed, minlength=bodies.count)) > 0.0
    # a slender body that is clamped somewhere yields to rotations, but does not move as a whole
    limit = np.where(held, nothing, np.maximum(SOFT_STIFFNESS * stiffness, nothing))
    negative = resistance < -1e-8 * stiffness[body]  # less is rounding
    if negative.any():
        raise indefinite_error(
            "its stiffness against a rigid motion is negative, of "
            f"{bodies.describe(int(body[negative.argmax()]))}"
        )
    weak = np.flatnonzero(resistance <= limit[body])
    basis, body = csr_array(free @ components[:, weak]), body[weak]
    basis.eliminate_zeros()
    floats = resistance[weak] <= nothing[body]
    return RigidBodyModes(comm, bodies, basis, stiffness[body], floats, body, components[:, weak])


def _largest_entries(diagonal: Array, free: Mask, bodies: Bodies, comm: Any) -> Array:
    """Return the largest free diagonal entry of K on each body; 1 if none is free. Collective.

    The `diagonal` is (nodes, dim), and `free` (nodes * dim,) excludes prescribed entries. An error
    is raised if a free entry is not positive. The result (bodies,) is the scale of stiffness.
    """
    node, component = np.nonzero(free.reshape(diagonal.shape))
    entries, label = diagonal[node, component], bodies.label[node]
    least, most = np.full(bodies.count, np.inf), np.zeros(bodies.count)
    np.fmin.at(least, label, entries)
    np.fmax.at(most, label, entries)
    smallest, largest = reduce_array(comm, least, MPI.MIN), reduce_array(comm, most, MPI.MAX)
    if smallest.min() <= 0.0:
        body, value = int(smallest.argmin()), smallest.min()
        stiffness = "zero" if value == 0.0 else f"negative, down to {value:.3g},"
        count = reduce_array(comm, len(np.unique(node[(entries <= 0.0) & (label == body)])))
        raise indefinite_error(
            f"the stiffness is {stiffness} at {count} of {bodies.node_counts[body]} nodes of "
            f"{bodies.describe(body)}"
        )
    return np.where(largest > 0.0, largest, 1.0)


#: Mean number of a body's nodes on which fixing springs act. (Too few to hold a body are drawn once
#: in 10^10 bodies.) With twice the number, the factors of small bodies get a tenth more entries;
#: with half the number, the least eigenvalue of K_p is up to half as large.
FIXING_NODES = 30


@dataclass(frozen=True)
class FixingSprings:
    """Springs with the stiffness Z Z', with which K_p = K + Z Z' is well conditioned.

    The springs act on a few nodes of each body with modes that K resists little or not at all.
    Solves use K_p in place of K. The equilibrium of the bodies (`floating/equilibrium.py`) removes
    the effect of the fixing springs again: on floating bodies, which nothing but contact holds,
    they then have no force; on softly held bodies, which soft springs of the scene hold, the
    displacements of the `response` cancel their effect. (The nodes on which springs act correspond
    to the fixing nodes of Brzobohaty et al. 2011.)
    """

    modes: RigidBodyModes

    @cached_property
    def columns(self) -> csr_array:
        """The matrix Z (owned degrees of freedom, k) of the springs, sparse. Collective.

        The springs act on about `FIXING_NODES` nodes of each body, chosen at random, since nodes at
        regular intervals might all be on one edge. They make the body about as stiff against its
        rigid modes as it is against deformation. The nodes are few, since the springs couple each
        of them with all the others; but more than the modes, since forces deform a body locally.
        """
        modes, label = self.modes, self.modes.bodies.label
        # the nodes that modes move, and a random number in [0, 1) from each node's global number
        moves = np.diff(modes.basis.indptr).reshape(-1, modes.dim).any(axis=1)
        numbers = reduce_array(modes.comm, np.bincount(label[moves], minlength=modes.bodies.count))
        start = modes.comm.scan(len(label)) - len(label)
        chance = splitmix64(np.arange(start, start + len(label), dtype=np.uint64)) / 2.0**64
        chosen = moves & (chance * numbers[label] <= FIXING_NODES)
        fixed_modes = csr_array(diags_array(np.repeat(chosen, modes.dim) * 1.0) @ modes.basis)
        fixed_modes.eliminate_zeros()
        # with F, the modes R at the chosen nodes, Z = F (F'F)^-1 D has R'Z = D, for R'F = F'F; D is
        # the diagonal of the roots of the modes' stiffness
        gram = RankReductions(modes.comm).sparse_inner(fixed_modes, fixed_modes)
        values, vectors = modes.comm.bcast(eigenpairs(gram))
        inverse = vectors @ diags_array(1.0 / values) @ vectors.T
        return csr_array(fixed_modes @ inverse @ diags_array(np.sqrt(modes.stiffness)))

    def added_to(self, K: PETSc.Mat) -> PETSc.Mat:
        """Return the well-conditioned matrix K + Z Z', which the caller owns. Collective."""
        comm, k = self.modes.comm, len(self.modes)
        Z = sparse_matrix(self.columns, (k if comm.rank == 0 else 0, k), comm)  # columns on rank 0
        springs, result = Z.matTransposeMult(Z), K.copy()
        result.axpy(1.0, springs, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
        result.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        return result

    def response(self, K: PETSc.Mat, solver: StiffnessSolver) -> tuple[csr_array, csr_array]:
        """Return displacements that forces of the springs alone cause, and stiffness. Collective.

        They are U = K_p^-1 Z Z'R, from which `Equilibrium` combines rigid displacements, and equal
        R for modes that K does not resist. The solver is that for K_p = `added_to(K)`.

        Returns:
            U (owned degrees of freedom, k), and the stiffness R'K U (k, k), which is exactly zero
            for modes that K does not resist; both sparse.
        """
        modes, k = self.modes, len(self.modes)
        if modes.floats.all():
            return modes.basis, csr_array((k, k))
        # V = R - U = K_p^-1 K R (owned degrees of freedom, k), sparse; its forces K R are of equal
        # size on all bodies, since the accuracy of a solve is relative to the whole answer
        forces = product(K, modes.basis)
        norms = np.sqrt(reduce_array(modes.comm, forces.power(2).sum(axis=0)))
        norms[norms == 0.0] = 1.0
        # one solve serves one soft mode of every body, and its answer is split into columns of V by
        # the body of each row (`on_body`), unless K couples bodies, as springs between them do
        soft, body, n = ~modes.floats, modes.body, forces.shape[0]
        label = np.repeat(modes.bodies.label, modes.dim)
        if couples_bodies(K, label):
            on_body, number_on_body = np.ones((n, k)), np.arange(k)
        else:
            on_body = csr_array((np.ones(n), label, np.arange(n + 1)), (n, modes.bodies.count))
            on_body = on_body[:, body]
            number_on_body = np.searchsorted(body, body, side="right") - np.arange(k)
        force, answer = K.createVecLeft(), K.createVecRight()
        V = csr_array(modes.basis.shape)
        for number in np.unique(number_on_body[soft]):
            chosen = np.where(soft & (number_on_body == number), 1.0, 0.0)
            force.array = forces @ (chosen / norms)
            answer.set(0.0)
            solver.improve(force, answer, rtol=1e-10, accuracy=0.0)
            V = V + csr_array(diags_array(answer.array) @ on_body @ diags_array(chosen * norms))
        # the stiffness as R'Z Z'V, since the equal R'K R - (K R)'V would be a small difference of
        # large terms; Z'R is the square root of `RigidBodyModes.stiffness`
        springs = np.where(modes.floats, 0.0, np.sqrt(modes.stiffness))
        resisted = diags_array(springs) @ RankReductions(modes.comm).sparse_inner(self.columns, V)
        return csr_array(modes.basis - V), csr_array(0.5 * (resisted + resisted.T))
