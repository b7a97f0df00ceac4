"""Rigid body modes that supports and K resist little or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.floating.bodies import Bodies
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes
from dolfinx_tresca.stiffness.solver import not_positive_definite

#: The stiffness against a rigid body mode counts as rounding if it is at most this multiple of the
#: body's largest diagonal entry of K: the product of K with the mode adds some hundred entries of
#: each row, which cancel each other.
NOTHING_RESISTS = 512.0 * float(np.finfo(float).eps)

#: A body without prescribed displacements is held softly if the stiffness against one of its rigid
#: body modes is at most this fraction of the stiffness of the body itself.
SOFT_STIFFNESS = 0.03

#: A negative stiffness against a rigid body mode counts as rounding if its absolute value is at
#: most this fraction of the stiffness of the body itself.
NEGATIVE_STIFFNESS = 1e-8

#: Vectors count as linearly dependent if an eigenvalue of their Gram matrix is at most this
#: fraction of the largest eigenvalue.
DEPENDENT_MODES = 1e-10


def weakly_resisted_modes(system: Any, bodies: Bodies) -> RigidBodyModes:
    """Find rigid motions of bodies that supports and K resist little or not at all. Collective.

    Args:
        system: a `LinearSystem` with K assembled.
        bodies: the bodies of its mesh.

    Raises:
        StiffnessError: K has a negative diagonal, or a negative stiffness against a rigid motion;
            the error names the body and its position.
    """
    mesh = system.V.mesh
    with system.displacement_stiffness() as K:
        return _find(K, system.prescribed_displacements, bodies, mesh.comm, mesh.geometry.dim)


def _find(K: PETSc.Mat, prescribed: Mask, bodies: Bodies, comm: Any, dim: int) -> RigidBodyModes:
    """Find the weakly resisted modes, from K and prescribed degrees of freedom. Collective.

    Raises:
        StiffnessError: the diagonal of K has negative entries, or K has a negative stiffness
            against a rigid motion.
    """
    body, number, where = bodies.label, bodies.number, bodies.describe
    owned = len(body)
    modes = _rigid_body_modes(bodies.arm, dim)

    diagonal = K.getDiagonal()
    entries = np.where(prescribed, np.nan, diagonal.array).reshape(-1, dim)
    diagonal.destroy()
    least, largest = np.full(number, np.inf), np.zeros(number)
    np.fmin.at(least, body, np.fmin.reduce(entries, axis=1))
    np.fmax.at(largest, body, np.fmax.reduce(entries, axis=1))
    softest, stiffest = reduce_array(comm, least, MPI.MIN), reduce_array(comm, largest, MPI.MAX)

    if softest.min() < 0.0:
        raise not_positive_definite(
            f"its diagonal is negative, down to {softest.min():.3g}, in "
            f"{where(int(softest.argmin()))}"
        )
    stiffest[stiffest == 0.0] = 1.0  # bodies that are wholly prescribed, or without stiffness
    # rows of prescribed degrees of freedom have a 1 on the diagonal: weigh them like other rows
    weight = np.where(prescribed, np.repeat(stiffest[body], dim), 1.0)
    forces = np.empty_like(modes)
    motion, force = K.createVecRight(), K.createVecLeft()
    for k in range(len(modes)):
        motion.array = modes[k].ravel()
        K.mult(motion, force)
        forces[k] = (weight * force.array).reshape(-1, dim)
    motion.destroy()
    force.destroy()

    free = modes * ~prescribed.reshape(-1, dim)
    energy, square = (
        reduce_array(comm, _products(modes, other, body, number)) for other in (forces, free)
    )
    held = reduce_array(
        comm, np.bincount(body, prescribed.reshape(-1, dim).any(axis=1), minlength=number)
    )
    # a body's own stiffness: K's diagonal is about E h^(dim-2), the number of nodes (L/h)^dim
    stiffness = stiffest / bodies.nodes ** (2.0 / dim)
    nothing = NOTHING_RESISTS * stiffest
    # a slender body that is clamped somewhere yields to rotations, but does not move as a whole
    limit = np.where(held > 0.0, nothing, np.maximum(SOFT_STIFFNESS * stiffness, nothing))
    weak: _WeakModes = comm.bcast(_weak_modes(square, energy, limit))

    negative = weak.resistance < -NEGATIVE_STIFFNESS * stiffness[weak.body]
    if negative.any():
        raise not_positive_definite(
            "its stiffness against a rigid motion is negative, of "
            f"{where(int(weak.body[negative.argmax()]))}"
        )

    mode, node, component = np.nonzero(free)
    shape = (owned * dim, number * len(modes))
    columns = body[node] * len(modes) + mode
    of_bodies = csr_array((free[mode, node, component], (node * dim + component, columns)), shape)
    column, mode = np.nonzero(weak.parts)
    shape = (shape[1], len(weak.body))
    parts = (weak.parts[column, mode], (weak.body[column] * len(modes) + mode, column))
    basis = csr_array(of_bodies @ csr_array(parts, shape))
    basis.eliminate_zeros()
    return RigidBodyModes(
        comm=comm,
        basis=basis,
        stiffness=stiffness[weak.body],
        floats=weak.resistance <= nothing[weak.body],
        body=weak.body,
        label=body,
        name=where,
        parts=weak.parts,
    )


@dataclass(frozen=True)
class _WeakModes:
    """Rigid body modes that are orthonormal in the degrees of freedom, and resisted weakly.

    Attributes:
        body: (k,) the body of each mode, ascending.
        parts: (k, 3 or 6) components of each mode in the rigid body modes of its body.
        resistance: (k,) stiffness of K against each mode.
    """

    body: Indices
    parts: Array
    resistance: Array


def _weak_modes(
    square: Array,
    energy: Array,
    limit: Array,
) -> _WeakModes:
    """Return the rigid body modes against which the stiffness of K is at most a limit.

    Args:
        square: (bodies, k, k) inner products of the modes on free degrees of freedom.
        energy: (bodies, k, k) products R'K R with the modes R.
        limit: (bodies,) stiffness against a mode of length 1 up to which the mode is returned.
    """
    values, vectors = np.linalg.eigh(square)
    independent = (values > DEPENDENT_MODES * values[:, -1:]).sum(axis=1)  # the last eigenvalues
    bodies, parts, resistances = [], [], []
    for count in np.unique(independent[independent > 0]):
        some = np.flatnonzero(independent == count)
        unit = vectors[some, :, -count:] / np.sqrt(values[some, None, -count:])
        resistance, turned = np.linalg.eigh(unit.transpose(0, 2, 1) @ energy[some] @ unit)
        body, mode = np.nonzero(resistance <= limit[some, None])
        bodies.append(some[body])
        parts.append((unit @ turned)[body, :, mode])
        resistances.append(resistance[body, mode])
    body = np.concatenate([np.zeros(0, dtype=np.intp), *bodies])
    order = np.argsort(body, kind="stable")
    return _WeakModes(
        body[order],
        np.concatenate([np.zeros((0, square.shape[1])), *parts])[order],
        np.concatenate([np.zeros(0), *resistances])[order],
    )


def _products(
    modes: Array,
    others: Array,
    body: npt.NDArray[np.int64],
    number: int,
) -> Array:
    """Return the inner products (number, k, k) of two sets of fields (k, n, dim), for each body.

    Args:
        modes: first set of fields.
        others: second set of fields.
        body: (n,) body of each node.
        number: number of bodies.
    """
    result = np.empty((number, len(modes), len(others)))
    for j, mode in enumerate(modes):
        for k, other in enumerate(others):
            density = np.einsum("ni,ni->n", mode, other)
            result[:, j, k] = np.bincount(body, weights=density, minlength=number)
    return result


def _rigid_body_modes(arm: Array, dim: int) -> Array:
    """Return rigid body modes (3 or 6, n, dim) at points (n, 3) relative to a body's centre."""
    translations = np.broadcast_to(np.eye(dim)[:, None], (dim, len(arm), dim))
    axes = np.eye(3)[2:] if dim == 2 else np.eye(3)
    rotations = np.cross(axes[:, None], arm[None])[:, :, :dim]
    return np.concatenate([translations, rotations])
