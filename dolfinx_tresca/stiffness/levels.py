"""Multigrid levels below a space: degree 1 below degree 2, and the meshes before refinement."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

import dolfinx.fem.petsc
from dolfinx import fem

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import reduce_array

#: Least ratio of the numbers of nodes of a level and of the next coarser level. A mesh that is
#: refined where errors are large has 1.4 times as many nodes as the previous mesh: smoothing on all
#: of these meshes would cost three times as much as smoothing on the finest mesh.
COARSENING = 3.0


@dataclass(frozen=True)
class Bisection:
    """The refinement by which a mesh was made from a coarser mesh.

    Nodes have the numbers that they got when their mesh was made; no partition changes them.

    Attributes:
        coarse: the coarser mesh, with straight edges.
        first_node: number of the node of the finer mesh that belongs to this rank's first row of
            `ends`.
        ends: (n, 2) row i belongs to the node `first_node` + i of the finer mesh. If this node lies
            midway between two nodes of the coarser mesh, the row has the numbers of these two
            nodes; if it lies at a node of the coarser mesh, the row has this number twice.
    """

    coarse: Any
    first_node: int
    ends: npt.NDArray[np.int64]


_bisections: WeakKeyDictionary[Any, Bisection] = WeakKeyDictionary()


def remember(mesh: Any, bisection: Bisection) -> None:
    """Register the refinement that made a mesh, for `nested`, while the mesh exists.

    Not collective.
    """
    _bisections[mesh] = bisection


def nested(V: Any) -> Iterator[tuple[Any, PETSc.Mat]]:
    """Yield the spaces on coarser meshes, each with the interpolation to the previous, finer space.

    Meshes with too many nodes for the next level (`COARSENING`) are skipped. Collective.

    Args:
        V: space of degree 1, on any mesh.
    """
    fine, P = V, None
    while (made := _bisections.get(fine.mesh)) is not None:
        coarse = fem.functionspace(made.coarse, ("Lagrange", 1, (V.dofmap.index_map_bs,)))
        step = _interpolation(made, fine, coarse)
        if P is None:
            P = step
        else:
            P = P.matMult(step)
        if P.getSize()[0] >= COARSENING * P.getSize()[1]:
            yield coarse, P
            P = None
        fine = coarse


def is_nested(V: Any) -> bool:
    """Return whether `nested` has a coarser space for V, for multigrid. Not collective."""
    mesh, nodes = V.mesh, V.mesh.geometry.index_map().size_global
    while (made := _bisections.get(mesh)) is not None:
        mesh = made.coarse
        if nodes >= COARSENING * mesh.geometry.index_map().size_global:
            return True
    return False


def _interpolation(made: Bisection, fine: Any, coarse: Any) -> PETSc.Mat:
    """Return the matrix that interpolates from the coarse space to the fine one. Collective."""
    comm, dim = fine.mesh.comm, fine.dofmap.index_map_bs
    owned = fine.dofmap.index_map.size_local
    nodes = coarse.dofmap.index_map.local_to_global(
        np.arange(len(_numbers(coarse)), dtype=np.int32)
    )
    ends = _told(comm, _numbers(coarse), nodes, made.ends.ravel()).reshape(-1, 2)
    numbers = made.first_node + np.arange(len(ends))
    asked = _numbers(fine)[:owned]
    pair = np.sort([_told(comm, numbers, end, asked) for end in ends.T], axis=0).T
    middle = pair[:, 0] != pair[:, 1]
    used = np.column_stack([np.full(owned, True), middle])[:, None, :].repeat(dim, axis=1)
    columns = dim * pair[:, None, :] + np.arange(dim)[:, None]
    halves = np.where(middle, 0.5, 1.0)[:, None, None] * used
    offsets = np.concatenate([[0], used.sum(axis=2).ravel().cumsum()])
    P = PETSc.Mat().createAIJ(
        [(dim * V.dofmap.index_map.size_local, None) for V in (fine, coarse)],
        bsize=dim,
        csr=(offsets.astype(PETSc.IntType), columns[used].astype(PETSc.IntType), halves[used]),
        comm=comm,
    )
    P.assemble()
    return P


def _numbers(V: Any) -> npt.NDArray[np.int64]:
    """Return the numbers (see `Bisection`) of this rank's nodes, with ghosts. Not collective."""
    numbers = np.zeros(len(V.mesh.geometry.x), dtype=np.int64)
    numbers[V.dofmap.list] = V.mesh.geometry.input_global_indices[geometry_dofmap(V.mesh)]
    return numbers


def _told(
    comm: MPI.Comm,
    numbers: npt.NDArray[np.int64],
    values: npt.NDArray[np.int64],
    asked: npt.NDArray[np.int64],
) -> npt.NDArray[np.int64]:
    """Return the values (m,) at requested nodes, which may be known on other ranks. Collective.

    Args:
        comm: communicator of the ranks.
        numbers: (n,) numbers of nodes that this rank knows; other ranks may know them, too.
        values: (n,) values at the nodes that this rank knows.
        asked: (m,) numbers of the nodes that this rank requests.
    """
    largest = int(reduce_array(comm, numbers.max(initial=0), MPI.MAX))
    sent = PETSc.Vec().createMPI(largest + 1, comm=comm)
    sent.setValues(numbers.astype(PETSc.IntType), values.astype(PETSc.ScalarType))
    sent.assemble()
    wanted = PETSc.IS().createGeneral(asked.astype(PETSc.IntType), comm=MPI.COMM_SELF)
    answer = PETSc.Vec().createSeq(len(asked), comm=MPI.COMM_SELF)
    scatter = PETSc.Scatter().create(sent, wanted, answer, None)
    scatter.scatter(sent, answer)
    result: npt.NDArray[np.int64] = answer.array.astype(np.int64)
    return result


def has_levels(V: Any) -> bool:
    """Return whether a space has multigrid levels below it: degree 1, or coarser meshes.

    Not collective.
    """
    return V.element.basix_element.degree > 1 or is_nested(V)


def _spaces(V: Any) -> Iterator[tuple[Any, PETSc.Mat]]:
    """Yield the spaces below V, each with its interpolation to the finer space. Collective."""
    if V.element.basix_element.degree > 1:
        linear_space = fem.functionspace(V.mesh, ("Lagrange", 1, (V.dofmap.index_map_bs,)))
        P = dolfinx.fem.petsc.interpolation_matrix(linear_space, V)
        P.assemble()
        yield linear_space, P
        V = linear_space
    yield from nested(V)


def add_levels(pc: PETSc.PC, K: PETSc.Mat, V: Any, prescribed: Mask) -> None:
    """Set up a preconditioner as multigrid with the spaces below V as its levels. Collective.

    The matrices of the levels are P'KP, with the interpolation P between the spaces. They need no
    further compiled forms, and include additions to K, such as the springs of floating bodies.
    Apart from such additions, P'KP equals the matrix of the form on the coarser space, since the
    coarser space is a subspace, except at nodes that were moved to curved surfaces.

    Args:
        pc: preconditioner of a KSP whose matrix is K.
        K: the matrix, with identity rows and columns for prescribed values.
        V: a space with levels below it.
        prescribed: (owned degrees of freedom,) whether each is prescribed.
    """
    free = K.createVecLeft()
    free.array = ~prescribed
    matrices, interpolations = [K], []
    for coarse, P in _spaces(V):
        coarse_free = _injected(P, free)
        # if either scaling is left out, corrections change prescribed values, and far more
        # iterations are needed
        P.diagonalScale(free, coarse_free)
        free = coarse_free
        # a copy drops data for further products, which are larger than the matrix
        below = matrices[-1].ptap(P).copy()
        start, _ = below.getOwnershipRange()
        held = start + np.flatnonzero(free.array == 0.0)
        below.zeroRowsColumns(held.astype(PETSc.IntType), 1.0)
        below.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrices.append(below)
        interpolations.append(P)
        lowest = coarse
    set_rigid_body_modes(matrices[-1], lowest)
    pc.setType(PETSc.PC.Type.MG)
    pc.setMGLevels(len(matrices))
    for level, P in enumerate(reversed(interpolations), start=1):
        pc.setMGInterpolation(level, P)
    for level, matrix in enumerate(reversed(matrices[1:])):
        pc.getMGSmoother(level).setOperators(matrix)


def _injected(P: PETSc.Mat, values: PETSc.Vec) -> PETSc.Vec:
    """Return a mask at the nodes of a coarse space from a mask at the nodes of a finer space.

    The nodes of the coarse space are nodes of the finer space, too. The result is rounded, since P
    is not exact. Collective.

    Args:
        P: interpolation from the coarse space to the finer one, with ones in the rows of the common
            nodes and smaller entries elsewhere.
        values: 0 or 1 at the nodes of the finer space.
    """
    ones = P.copy()
    ones.chop(0.99)
    result = ones.createVecRight()
    ones.multTranspose(values, result)
    result.array = result.array.round()
    return result


def set_rigid_body_modes(K: PETSc.Mat, V: Any) -> None:
    """Tell GAMG the rigid body modes, as the near-nullspace of a matrix on a space. Collective.

    Each mode moves all bodies together as one rigid body, so it is a rigid motion of each body,
    too: one set of modes serves any number of bodies.
    """
    nodes, dim = V.dofmap.index_map, V.mesh.geometry.dim
    points = PETSc.Vec().createMPI(
        (dim * nodes.size_local, dim * nodes.size_global), bsize=dim, comm=K.comm
    )
    points.array = V.tabulate_dof_coordinates()[: nodes.size_local, :dim].ravel()
    near_nullspace = PETSc.NullSpace().createRigidBody(points)
    K.setNearNullSpace(near_nullspace)
