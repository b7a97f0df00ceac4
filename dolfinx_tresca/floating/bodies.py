"""Bodies: the connected parts of a mesh, and their rigid body modes that K hardly resists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from dolfinx import la

from dolfinx_tresca._base.arrays import Indices
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import gather_rows, reduce_array
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.floating.rigid_modes import RigidBodyModes

#: Stiffness against a rigid body mode, over the largest on the diagonal of K, that is rounding.
NOTHING_RESISTS = 1e-13

#: Stiffness against a rigid body mode, over that of the body itself, below which one that nothing
#: clamps is held softly.
SOFT = 0.03

#: Difference of coordinates, over the largest of the mesh, that is rounding.
ONE_PLACE = 1e-10

#: Part of the largest eigenvalue of a Gram matrix up to which vectors count as dependent.
DEPENDENT_MODES = 1e-10


@dataclass(frozen=True)
class Bodies:
    """The bodies of a mesh.

    Attributes:
        number: how many there are.
        label: (owned nodes of V,) the body of each, in 0, ..., number - 1.
        rigid_modes: those of their rigid body modes that K resists little or not at all.
    """

    number: int
    label: npt.NDArray[np.int64]
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


def label_bodies(V: Any) -> npt.NDArray[np.int64]:
    """Return the body, 0, 1, ..., of each node of V on this rank, ghosts included. Collective.

    Nodes of one cell are in one body. The numbers are the same for any number of ranks: bodies are
    sorted by their least x, then y, then z, and those that share all that as the mesh file has it.
    """
    comm = V.mesh.comm
    nodes = V.dofmap.index_map
    local = _connected_nodes(V.dofmap.list, nodes.size_local + nodes.num_ghosts)

    # Parts of two ranks belong together where a node of one is a ghost of the other.
    sizes = comm.allgather(int(local.max(initial=-1)) + 1)
    local = local + sum(sizes[: comm.rank])
    label = la.vector(nodes, 1, np.float64)
    label.array[:] = local
    label.scatter_forward()
    links = gather_rows(comm, np.unique(np.column_stack([local, label.array.astype(int)]), axis=0))
    total = sum(sizes)
    graph = csr_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(total, total))
    _, merged = connected_components(graph, directed=False)
    body = merged[local]

    order = _reading_order(V, body, int(merged.max(initial=-1)) + 1)
    rank_of = np.empty(len(order), dtype=np.int64)
    rank_of[order] = np.arange(len(order))
    numbered: npt.NDArray[np.int64] = rank_of[body]
    return numbered


def _connected_nodes(cells: npt.NDArray[np.int32], count: int) -> npt.NDArray[np.int32]:
    """Return a number for each of `count` nodes, the same for those that cells connect.

    Args:
        cells: (m, k) the nodes of each.
        count: of the nodes; one without cells has a number of its own.
    """
    # a graph of nodes and cells: that of nodes alone has many times its edges
    cell = np.repeat(np.arange(count, count + len(cells)), cells.shape[1])
    size = count + len(cells)
    graph = coo_array((np.ones(cells.size, np.int8), (cells.ravel(), cell)), shape=(size, size))
    labels: npt.NDArray[np.int32] = connected_components(graph, directed=False)[1][:count]
    return labels


def _reading_order(V: Any, body: npt.NDArray[Any], number: int) -> npt.NDArray[np.int64]:
    """Return the bodies (number,) by their lowest corners, then by the mesh file. Collective.

    Neither the partition nor the processor changes it: corners that differ by rounding are one.
    """
    corners = _body_corners(V, body, number)
    rounding = ONE_PLACE * np.abs(corners).max(initial=0.0)
    places = np.empty(corners.shape, dtype=np.int64)
    for place, values in zip(places.T, corners.T, strict=True):
        ascending = np.argsort(values)
        steps = np.diff(values[ascending], prepend=values[ascending[:1]])
        place[ascending] = np.cumsum(steps > rounding)
    mesh = V.mesh
    nodes = geometry_dofmap(mesh)
    first = np.full(number, np.iinfo(np.int64).max)
    numbers = np.asarray(mesh.geometry.input_global_indices, dtype=np.int64)[nodes]
    np.minimum.at(
        first, body[V.dofmap.list[: len(nodes), 0]], numbers.min(axis=1, initial=first[0])
    )
    in_file = reduce_array(mesh.comm, first, MPI.MIN)
    order: npt.NDArray[np.int64] = np.lexsort([in_file, *places.T[::-1]])
    return order


def _body_corners(V: Any, body: npt.NDArray[Any], number: int) -> npt.NDArray[np.float64]:
    """Return the bounds (number, 6) of the bodies: least x, y, z, then largest. Collective."""
    points = V.tabulate_dof_coordinates()
    bounds: npt.NDArray[np.float64] = np.full((number, 6), np.inf)
    np.minimum.at(bounds, body, np.hstack([points, -points]))
    bounds = reduce_array(V.mesh.comm, bounds, MPI.MIN)
    bounds[:, 3:] *= -1.0
    return bounds


def find_bodies(system: Any) -> Bodies:
    """Find the bodies, and how they can move where supports and K resist little. Collective.

    Args:
        system: a `LinearSystem` with K assembled.

    Raises:
        StiffnessError: K has a negative diagonal; names the body, and where it is.
    """
    V, comm = system.V, system.comm
    dim = V.mesh.geometry.dim
    body = label_bodies(V)
    number = comm.allreduce(int(body.max(initial=-1)), op=MPI.MAX) + 1
    bounds = _body_corners(V, body, number)
    owned = V.dofmap.index_map.size_local
    centre = 0.5 * (bounds[:, :3] + bounds[:, 3:])
    size = np.linalg.norm(bounds[:, 3:] - bounds[:, :3], axis=1)
    arm = ((V.tabulate_dof_coordinates() - centre[body]) / size[body, None])[:owned]
    body = body[:owned]
    modes = _rigid_body_modes(arm, dim)

    diagonal = system.K.getDiagonal()
    entries = np.where(system.prescribed, np.nan, diagonal.array).reshape(-1, dim)
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
    weight = np.where(system.prescribed, np.repeat(stiffest[body], dim), 1.0)
    forces = np.empty_like(modes)
    motion, force = system.K.createVecRight(), system.K.createVecLeft()
    for k in range(len(modes)):
        motion.array = modes[k].ravel()
        system.K.mult(motion, force)
        forces[k] = (weight * force.array).reshape(-1, dim)
    motion.destroy()
    force.destroy()

    free = modes * ~system.prescribed.reshape(-1, dim)
    energy, square = (
        reduce_array(comm, _products(modes, other, body, number)) for other in (forces, free)
    )
    nodes = reduce_array(comm, np.bincount(body, minlength=number))
    held = reduce_array(
        comm, np.bincount(body, system.prescribed.reshape(-1, dim).any(axis=1), minlength=number)
    )
    # E h^(dim-2) is the size of K's diagonal, (L/h)^dim the number of nodes: that of the body
    stiffness = stiffest / nodes ** (2.0 / dim)
    nothing = NOTHING_RESISTS * stiffest
    # a body that is clamped somewhere, and slender, gives way to rotations, but not as a whole
    limit = np.where(held > 0.0, nothing, np.maximum(SOFT * stiffness, nothing))
    weak: list[_WeakModes] = comm.bcast(_weak_modes(square, energy, limit))

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
    """What hardly resists the rigid body modes of a body.

    Attributes:
        body: which one.
        parts: (3 or 6, k) modes that are orthonormal in the degrees of freedom.
        resistance: (k,) what K does to them.
    """

    body: int
    parts: npt.NDArray[np.float64]
    resistance: npt.NDArray[np.float64]


def _weak_modes(
    square: npt.NDArray[np.float64],
    energy: npt.NDArray[np.float64],
    limit: npt.NDArray[np.float64],
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
    modes: npt.NDArray[np.float64],
    others: npt.NDArray[np.float64],
    body: npt.NDArray[np.int64],
    number: int,
) -> npt.NDArray[np.float64]:
    """Return the inner products (number, k, k) of fields (k, n, dim), for each body."""
    result = np.empty((number, len(modes), len(others)))
    for j, mode in enumerate(modes):
        for k, other in enumerate(others):
            density = np.einsum("ni,ni->n", mode, other)
            result[:, j, k] = np.bincount(body, weights=density, minlength=number)
    return result


def _rigid_body_modes(arm: npt.NDArray[np.float64], dim: int) -> npt.NDArray[np.float64]:
    """Return rigid body modes (3 or 6, n, dim) at points (n, 3), seen from their centre."""
    translations = np.broadcast_to(np.eye(dim)[:, None], (dim, len(arm), dim))
    axes = np.eye(3)[2:] if dim == 2 else np.eye(3)
    rotations = np.cross(axes[:, None], arm[None])[:, :, :dim]
    return np.concatenate([translations, rotations])


def _point(x: npt.NDArray[np.float64], size: float) -> str:
    """Return coordinates as text, with what is rounding for a body of a size shown as zero."""
    shown = np.where(np.abs(x) > 1e-12 * size, x, 0.0)
    return "(" + ", ".join(f"{value:.3g}" for value in shown) + ")"
