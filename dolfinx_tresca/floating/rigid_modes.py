"""Rigid body modes of bodies that supports and K resist little or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import csr_array, diags_array

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, Mask
from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.parallel import RankReductions, reduce_array
from dolfinx_tresca._base.petsc import product
from dolfinx_tresca.solvers.constraints import eigenpairs
from dolfinx_tresca.stiffness.solver import not_positive_definite

#: An error message mentions translations and rotations whose share in a motion exceeds this number,
#: and counts bodies that move more than this part of the largest motion.
NAMED_PART = 0.1


@dataclass(frozen=True)
class RigidBodyModes:
    """Rigid body modes R, orthonormal in the degrees of freedom, that K hardly resists.

    Attributes:
        comm: communicator of the mesh.
        bodies: the bodies of the mesh.
        basis: R (owned degrees of freedom, k), sparse; zero where u is prescribed.
        stiffness: (k,) approximate stiffness against deformation of the body that the mode moves,
            for a displacement vector of length 1.
        floats: (k,) True: K does not resist the mode at all; False: K resists it a little, by soft
            springs.
        body: (k,) the body of each mode, ascending.
        mode_components: (3 or 6 for each body, k) components of each mode in `Bodies.rigid_modes`,
            sparse. Lever arms of rotations are divided by the body's size.
    """

    comm: Any
    bodies: Bodies
    basis: csr_array
    stiffness: Array
    floats: Mask
    body: Indices
    mode_components: csr_array

    @classmethod
    def none(cls, V: Any, bodies: Bodies) -> RigidBodyModes:
        """Return no modes: K holds the bodies. Not collective."""
        components, none = bodies.rigid_modes(V.mesh.geometry.dim).T[:, :0], np.empty(0)
        body, floats = none.astype(np.intp), none.astype(np.bool_)
        return cls(V.mesh.comm, bodies, csr_array((0, 0)), none, floats, body, components)

    def __len__(self) -> int:
        return len(self.floats)

    @property
    def summary(self) -> str:
        """The numbers of floating and of softly held bodies, as the end of a sentence."""
        floating = np.unique(self.body[self.floats])
        soft = np.setdiff1d(self.body, floating)
        return f", {len(floating)} of them held by contact alone" * (
            len(floating) > 0
        ) + f", {len(soft)} of them held softly" * (len(soft) > 0)

    @property
    def dim(self) -> int:
        """The dimension of space."""
        return 3 if self.mode_components.shape[0] == 6 * self.bodies.number else 2

    def describe(self, components: Array) -> str:
        """Return in words a body that moves, its motion, and the bodies that also move. Collective.

        The body is the first of those that move most. Bodies count as moving if they move by more
        than `NAMED_PART` of the largest motion.

        Args:
            components: (k,) or (k, columns) components of one or of several motions.
        """
        moved = self.mode_components @ components.reshape(len(self), -1)
        moved = moved.reshape(self.bodies.number, -1, moved.shape[1])
        lengths = np.linalg.norm(moved, axis=(1, 2))
        moving = np.flatnonzero(lengths > NAMED_PART * lengths.max())
        # with half the fraction, a body may be described that turns little while another one falls
        chosen = int(np.argmax(lengths > 0.9 * lengths.max()))
        axes, sizes, _ = np.linalg.svd(moved[chosen], full_matrices=False)
        share = np.square(axes[:, sizes > 1e-3 * sizes[0]]).sum(axis=1)
        turns = ["rotation"] if self.dim == 2 else [f"rotation about {axis}" for axis in "xyz"]
        names = (*(f"translation along {axis}" for axis in "xyz"[: self.dim]), *turns)
        free = [name for name, size in zip(names, share, strict=True) if size > NAMED_PART]
        text = self.bodies.describe(chosen, moving[moving != chosen].tolist())
        # ranks may differ by rounding
        return str(self.comm.bcast(f"{text}: {', '.join(free)}"))


#: A body without prescribed displacements is held softly if the stiffness against one of its rigid
#: body modes is at most this fraction of the stiffness of the body itself.
SOFT_STIFFNESS = 0.03


def weakly_resisted_modes(system: Any, bodies: Bodies) -> RigidBodyModes:
    """Find rigid motions of bodies that supports and K resist little or not at all. Collective.

    Args:
        system: a `LinearSystem` with K assembled.
        bodies: the bodies of its mesh.

    Raises:
        StiffnessError: K has zeros or negative numbers on the diagonal, or a negative stiffness
            against a rigid motion; the error names the body and its position.
    """
    mesh, prescribed = system.V.mesh, system.prescribed_displacements
    comm, dim, sums = mesh.comm, mesh.geometry.dim, RankReductions(mesh.comm)
    modes, label = bodies.rigid_modes(dim), np.repeat(bodies.label, dim)
    K = system.displacement_stiffness()
    forces, diagonal = product(K, modes), K.getDiagonal()
    largest = _largest_entries(diagonal.array.reshape(-1, dim), ~prescribed, bodies, comm)
    # rows of prescribed degrees of freedom have a 1 on the diagonal: weigh them like other rows
    weight = diags_array(np.where(prescribed, largest[label], 1.0))
    energy = sums.sparse_inner(modes, csr_array(weight @ forces))
    free = csr_array(diags_array(np.where(prescribed, 0.0, 1.0)) @ modes)
    gram = sums.sparse_inner(free, free)
    body, resistance, components = comm.bcast(_stationary(gram, energy, bodies.number))

    # a body's own stiffness: K's diagonal is about E h^(dim-2), the number of nodes (L/h)^dim
    stiffness = largest / bodies.nodes ** (2.0 / dim)
    # rounding: the product with K adds some hundred entries of each row, which cancel each other
    nothing = 8.0 * ROUNDING * largest
    held = reduce_array(comm, np.bincount(label, prescribed, minlength=bodies.number)) > 0.0
    # a slender body that is clamped somewhere yields to rotations, but does not move as a whole
    limit = np.where(held, nothing, np.maximum(SOFT_STIFFNESS * stiffness, nothing))
    negative = resistance < -1e-8 * stiffness[body]  # less is rounding
    if negative.any():
        raise not_positive_definite(
            "its stiffness against a rigid motion is negative, of "
            f"{bodies.describe(int(body[negative.argmax()]))}"
        )
    weak = np.flatnonzero(resistance <= limit[body])
    basis, body = csr_array(free @ components[:, weak]), body[weak]
    basis.eliminate_zeros()
    floats = resistance[weak] <= nothing[body]
    return RigidBodyModes(comm, bodies, basis, stiffness[body], floats, body, components[:, weak])


def _largest_entries(diagonal: Array, free: Mask, bodies: Bodies, comm: Any) -> Array:
    """Return the largest diagonal entry of K on each body, 1 if all are prescribed. Collective.

    Args:
        diagonal: (nodes, dim) the diagonal of K at this rank's nodes.
        free: (nodes * dim,) whether each degree of freedom is not prescribed.
        bodies: the bodies.
        comm: the communicator.

    Raises:
        StiffnessError: entries are zero or negative.
    """
    node, component = np.nonzero(free.reshape(diagonal.shape))
    entries, label = diagonal[node, component], bodies.label[node]
    least, most = np.full(bodies.number, np.inf), np.zeros(bodies.number)
    np.fmin.at(least, label, entries)
    np.fmax.at(most, label, entries)
    smallest, largest = reduce_array(comm, least, MPI.MIN), reduce_array(comm, most, MPI.MAX)
    if smallest.min() <= 0.0:
        body, value = int(smallest.argmin()), smallest.min()
        stiffness = "zero" if value == 0.0 else f"negative, down to {value:.3g},"
        number = reduce_array(comm, len(np.unique(node[(entries <= 0.0) & (label == body)])))
        raise not_positive_definite(
            f"the stiffness is {stiffness} at {number} of {bodies.nodes[body]} nodes of "
            f"{bodies.describe(body)}"
        )
    return np.where(largest > 0.0, largest, 1.0)


def _stationary(
    gram: csr_array, energy: csr_array, number: int
) -> tuple[Indices, Array, csr_array]:
    """Return the rigid motions of each body against which the stiffness of K is stationary.

    Args:
        gram: (m, m) inner products of the rigid body modes on free degrees of freedom.
        energy: (m, m) products R'K R with the modes R.
        number: number of bodies, whose modes follow one another.

    Returns:
        the body (k,) of each motion, ascending; the stiffness (k,) against it; and the components
        (m, k) of the motions in the modes. Motions that move no free degree of freedom are left
        out; the other motions are orthonormal on free degrees of freedom.
    """
    values, vectors = eigenpairs(gram)
    of_bodies = values.reshape(number, -1)
    independent = of_bodies > 1e-10 * of_bodies.max(axis=1, keepdims=True)
    body, column = np.nonzero(independent)
    unit = vectors[:, independent.ravel()] @ diags_array(1.0 / np.sqrt(of_bodies[body, column]))
    if len(body) == 0:
        return body, np.empty(0), unit
    stiffness, turned = eigenpairs(csr_array(unit.T @ energy @ unit))
    return body, stiffness, csr_array(unit @ turned)
