"""Multigrid levels on the coarser meshes from which bisection made a mesh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from dolfinx import fem

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
            P, factors = P.matMult(step), (P, step)
            for factor in factors:
                factor.destroy()
        if P.getSize()[0] >= COARSENING * P.getSize()[1]:
            yield coarse, P
            P = None
        fine = coarse
    if P is not None:
        P.destroy()


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
    for used in (sent, wanted, answer, scatter):
        used.destroy()
    return result
