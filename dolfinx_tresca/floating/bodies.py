"""Which bodies can move: rigid body modes that K resists little or not at all."""

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
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.floating.numbering import body_bounds, label_bodies
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes

#: Stiffness against a rigid body mode, over the largest on the diagonal of K, that is rounding.
NOTHING_RESISTS = 1e-13

#: Stiffness against a rigid body mode, over that of the body itself, below which one that nothing
#: clamps is held softly.
SOFT_STIFFNESS = 0.03

#: Stiffness against a rigid body mode, over that of the body itself, that is less than none by more
#: than rounding.
NEGATIVE_STIFFNESS = 1e-8

#: Part of the largest eigenvalue of a Gram matrix up to which vectors count as dependent.
DEPENDENT_MODES = 1e-10


@dataclass(frozen=True)
class Bodies:
    """The bodies of a mesh.

    Attributes:
        number: number of bodies.
        label: (owned nodes of V,) the body of each, in 0, ..., number - 1.
        mean_nodes: nodes of V in the body that one is in, in the mean over all nodes.
        rigid_modes: rigid body modes that K resists little or not at all.
    """

    number: int
    label: npt.NDArray[np.int64]
    mean_nodes: float
    rigid_modes: RigidBodyModes

    def __str__(self) -> str:
        modes = self.rigid_modes
        floating = {body for body, floats in zip(modes.body, modes.floats, strict=True) if floats}
        soft = set(modes.body) - floating
        return (
            f"{self.number}"
            + f", {len(floating)} of them held by contact alone" * bool(floating)
            + f", {len(soft)} of them held softly" * bool(soft)
        )


def find_bodies(system: Any) -> Bodies:
    """Find the bodies, and how they can move where supports and K resist little. Collective.

    Args:
        system: a `LinearSystem` with K assembled.

    Raises:
        StiffnessError: K has a negative diagonal, or a negative stiffness against a rigid motion;
            names the body, and where it is.
    """
    with system.displacement_stiffness() as K:
        return _find(system.V, K, system.prescribed_displacements)


def _find(V: Any, K: PETSc.Mat, prescribed: Mask) -> Bodies:
    """Find the bodies of a space, from K and what is prescribed on this rank. Collective."""
    comm = V.mesh.comm
    dim = V.mesh.geometry.dim
    body = label_bodies(V)
    number = comm.allreduce(int(body.max(initial=-1)), op=MPI.MAX) + 1
    bounds = body_bounds(V, body, number)
    owned = V.dofmap.index_map.size_local
    centre = 0.5 * (bounds[:, :3] + bounds[:, 3:])
    size = np.linalg.norm(bounds[:, 3:] - bounds[:, :3], axis=1)
    arm = ((V.tabulate_dof_coordinates() - centre[body]) / size[body, None])[:owned]
    body = body[:owned]
    modes = _rigid_body_modes(arm, dim)

    diagonal = K.getDiagonal()
    entries = np.where(prescribed, np.nan, diagonal.array).reshape(-1, dim)
    diagonal.destroy()
    least, stiffest = np.full(number, np.inf), np.zeros(number)
    np.fmin.at(least, body, np.fmin.reduce(entries, axis=1))
    np.fmax.at(stiffest, body, np.fmax.reduce(entries, axis=1))
    least, stiffest = reduce_array(comm, least, MPI.MIN), reduce_array(comm, stiffest, MPI.MAX)

    def where(index: int) -> str:
        box, length = bounds[index], size[index]
        return (
            f"body {index + 1} of {number}, between {_point(box[:3], length)} and "
            f"{_point(box[3:], length)}"
        )

    if least.min() < 0.0:
        raise StiffnessError(
            f"K is not positive definite: its diagonal is negative, down to {least.min():.3g}, in "
            f"{where(int(least.argmin()))}. Check Young's moduli, Poisson ratios (below 0.5) and "
            "signs."
        )
    stiffest[stiffest == 0.0] = 1.0  # wholly prescribed, or without any stiffness
    # rows of prescribed degrees of freedom have a 1 on the diagonal: give them others' weight
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
    nodes = reduce_array(comm, np.bincount(body, minlength=number))
    held = reduce_array(
        comm, np.bincount(body, prescribed.reshape(-1, dim).any(axis=1), minlength=number)
    )
    # E h^(dim-2) is the size of K's diagonal, (L/h)^dim the number of nodes: that of the body
    stiffness = stiffest / nodes ** (2.0 / dim)
    nothing = NOTHING_RESISTS * stiffest
    # a body that is clamped somewhere, and slender, gives way to rotations, but not as a whole
    limit = np.where(held > 0.0, nothing, np.maximum(SOFT_STIFFNESS * stiffness, nothing))
    weak: list[_WeakModes] = comm.bcast(_weak_modes(square, energy, limit))

    for found in weak:
        if found.resistance.min() < -NEGATIVE_STIFFNESS * stiffness[found.body]:
            raise StiffnessError(
                "K is not positive definite: it gives way to a rigid motion more than not at all, "
                f"of {where(found.body)}. Check the signs in the form a; the tangent of a body "
                "under pressure is like that where only contact holds it."
            )

    ascending = np.argsort(body, kind="stable")
    none: Indices = np.zeros(0, dtype=np.intp)
    rows, columns, values = [none], [none], [np.zeros(0)]
    first = 0
    for found in weak:
        low, high = np.searchsorted(body, [found.body, found.body + 1], sorter=ascending)
        own = ascending[low:high]
        dense = np.einsum("knd,kj->ndj", free[:, own], found.parts)
        node, component, mode = np.nonzero(dense)
        rows.append(own[node] * dim + component)
        columns.append(first + mode)
        values.append(dense[node, component, mode])
        first += len(found.resistance)
    places = (np.concatenate(rows), np.concatenate(columns))
    index = [found.body for found in weak for _ in found.resistance]
    resistance = np.concatenate([np.zeros(0), *(found.resistance for found in weak)])
    return Bodies(
        int(number),
        body,
        float(nodes @ nodes / nodes.sum()),
        RigidBodyModes(
            comm=comm,
            basis=csr_array((np.concatenate(values), places), shape=(owned * dim, first)),
            stiffness=stiffness[index],
            floats=resistance <= nothing[index],
            body=[where(one) for one in index],
            parts=np.concatenate([np.zeros((0, len(modes))), *(found.parts.T for found in weak)]),
        ),
    )


@dataclass(frozen=True)
class _WeakModes:
    """The weak resistance of a body to its rigid body modes.

    Attributes:
        body: which one.
        parts: (3 or 6, k) modes that are orthonormal in the degrees of freedom.
        resistance: (k,) what K does to them.
    """

    body: int
    parts: Array
    resistance: Array


def _weak_modes(
    square: Array,
    energy: Array,
    limit: Array,
) -> list[_WeakModes]:
    """Return the rigid body modes that K resists no more than a limit, of bodies that have any.

    Args:
        square: (bodies, k, k) products of the modes with each other where u is free.
        energy: (bodies, k, k) what K makes of them.
        limit: (bodies,) resistance of modes of length 1.
    """
    result = []
    for body, (values, vectors) in enumerate(zip(*np.linalg.eigh(square), strict=True)):
        kept = values > DEPENDENT_MODES * values[-1]
        unit = vectors[:, kept] / np.sqrt(values[kept])
        resistance, turned = np.linalg.eigh(unit.T @ energy[body] @ unit)
        weak = resistance <= limit[body]
        if weak.any():
            result.append(_WeakModes(body, unit @ turned[:, weak], resistance[weak]))
    return result


def _products(
    modes: Array,
    others: Array,
    body: npt.NDArray[np.int64],
    number: int,
) -> Array:
    """Return the inner products (number, k, k) of fields (k, n, dim), for each body."""
    result = np.empty((number, len(modes), len(others)))
    for j, mode in enumerate(modes):
        for k, other in enumerate(others):
            density = np.einsum("ni,ni->n", mode, other)
            result[:, j, k] = np.bincount(body, weights=density, minlength=number)
    return result


def _rigid_body_modes(arm: Array, dim: int) -> Array:
    """Return rigid body modes (3 or 6, n, dim) at points (n, 3), seen from their centre."""
    translations = np.broadcast_to(np.eye(dim)[:, None], (dim, len(arm), dim))
    axes = np.eye(3)[2:] if dim == 2 else np.eye(3)
    rotations = np.cross(axes[:, None], arm[None])[:, :, :dim]
    return np.concatenate([translations, rotations])


def _point(x: Array, size: float) -> str:
    """Return coordinates as text, with what is rounding for a body of a size shown as zero."""
    shown = np.where(np.abs(x) > 1e-12 * size, x, 0.0)
    return "(" + ", ".join(f"{value:.3g}" for value in shown) + ")"
