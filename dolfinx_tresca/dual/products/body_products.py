"""A as a matrix: sparse for many bodies, from solves that serve all bodies at once, or dense."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.parallel import gather_rows
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.operator import DualOperator
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.optimise.models.whole_model import WholeModel
from dolfinx_tresca.stiffness.cholesky import SPARE_WORKSPACE
from dolfinx_tresca.surface.numbering import label_bodies

#: A is computed as a sparse matrix if no body has more than the part BODY_SHARE of all multipliers,
#: or more than MOST_ON_BODY multipliers. Both numbers limit the number of solves with K. With half
#: the share, two of 216 standing piles of stones (`tests/validation/test_random_piles.py`) are not
#: solved, and all piles together take 3,594 iterations and 7,088 products in place of 1,253 and
#: 8,243; with twice the share, they take 463 and 8,770. Two walls of 15 bricks, with up to 220 and
#: 348 multipliers on a brick, would take 0.5 and 0.65 times the time if A were computed as a
#: matrix.
BODY_SHARE, MOST_ON_BODY = 0.5, 200

#: Value of MUMPS's option ICNTL(7) for an ordering by approximate minimum fill. For a matrix of
#: 5,005 bricks, this ordering takes 0.76 times the time of MUMPS's own choice, and 0.87 times the
#: memory.
MINIMUM_FILL = 2

#: Number of solves with K in one block.
BLOCK = 32


def sparse_model(operator: DualOperator, local_compliance: Array) -> WholeModel | None:
    """Return A as a sparse matrix for many small bodies; None if this does not pay. Collective.

    The matrix does not pay if a body has too many multipliers (`BODY_SHARE`, `MOST_ON_BODY`). The
    result is also None with an iterative solver for K or a mixed space, for which the method does
    not work.

    K is block diagonal, with a block K_b for each body, also if springs that fix floating bodies
    are added. Hence A = sum of A_b with A_b = B_b K_b^-1 B_b', where B_b has the columns of body b:
    A couples multipliers only if they act on the same body. One solve with K finds one column of
    each A_b: in this solve, each body is loaded by one of its own multipliers, without the opposite
    force on the other body of this multiplier. The number of solves is the largest number of
    multipliers on a body, however many bodies there are. (Compare Curtis, Powell and Reid 1974, On
    the estimation of sparse Jacobian matrices.)

    Args:
        operator: A. Each solve counts as a product.
        local_compliance: (size,) compliance of nodes whose neighbours are fixed.
    """
    jump = operator.jump
    if not operator.exact or jump.system.component is not None:
        return None
    label = label_bodies(jump.system.V)
    bodies = jump.comm.allreduce(int(label.max(initial=-1)), op=MPI.MAX) + 1
    if BODY_SHARE * bodies < 1.0:  # some body has a larger share of the multipliers
        return None
    forces = _BodyForces.of(jump, label, bodies)
    size = jump.matrix.getSize()[0]
    count = forces.members.shape[1]
    if not 0 < count <= min(BODY_SHARE * size, MOST_ON_BODY):
        return None
    values = np.empty((len(forces.row), count))
    for first in range(0, count, BLOCK):
        some = range(first, min(first + BLOCK, count))
        values[:, some.start : some.stop] = forces.responses(operator, some)
    column = forces.members[forces.body]
    row = np.broadcast_to(forces.row[:, None], column.shape)
    kept = column >= 0
    rows = csr_array((values[kept], (row[kept], column[kept])), shape=(len(jump.gap), size))
    first = jump.matrix.getOwnershipRange()[0]
    return WholeModel(jump.reductions, rows, first, _nodes(jump), local_compliance, _solve)


def dense_model(operator: DualOperator, local_compliance: Array) -> WholeModel:
    """Return A as a dense matrix: one solve with K for each multiplier, in blocks. Collective.

    Args:
        operator: A. Each solve counts as a product.
        local_compliance: (size,) compliance of nodes whose neighbours are fixed.
    """
    jump = operator.jump
    first, end = jump.matrix.getOwnershipRange()
    size = jump.matrix.getSize()[0]
    rows = np.empty((end - first, size))
    for start in range(0, size, BLOCK):
        columns = np.arange(start, min(start + BLOCK, size))
        units = (np.arange(first, end)[:, None] == columns).astype(np.float64)
        rows[:, columns] = operator.apply_to_all(units)
    return WholeModel(jump.reductions, rows, first, _nodes(jump), local_compliance, _solve)


def _solve(matrix: csr_array, right: Array) -> Array:
    """Solve with a sparse matrix (n, n) on this rank alone, by MUMPS. Not collective.

    On a wall of 2,046 bricks, MUMPS takes a sixth of the time of SciPy's SuperLU, and its factors
    take a third of the memory.

    Raises:
        StiffnessError: the factorisation failed.
    """
    indptr, indices = (one.astype(PETSc.IntType) for one in (matrix.indptr, matrix.indices))
    A = PETSc.Mat().createAIJ(matrix.shape, csr=(indptr, indices, matrix.data), comm=MPI.COMM_SELF)
    result = np.empty(len(right))
    b, x = (PETSc.Vec().createWithArray(one, comm=MPI.COMM_SELF) for one in (right, result))
    factors = PETSc.PC().create(MPI.COMM_SELF)
    try:
        factors.setOperators(A)
        factors.setType(PETSc.PC.Type.LU)
        factors.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        factors.setFactorSetUpSolverType()
        factor = factors.getFactorMatrix()
        factor.setMumpsIcntl(7, MINIMUM_FILL)
        factor.setMumpsIcntl(14, SPARE_WORKSPACE)
        factors.apply(b, x)
        failure = factor.getMumpsInfog(1)
    finally:
        for owned in (factors, x, b, A):
            owned.destroy()
    if failure < 0:
        raise StiffnessError(
            f"MUMPS could not solve for the contacts of many bodies: INFOG(1) = {failure} "
            "(-9 or -13: out of memory; see its manual)."
        )
    return result


def _nodes(jump: JumpOperator) -> Indices:
    """Return the number (size,) of each multiplier's node; nodes are numbered pair by pair."""
    first = 0
    result: list[Indices] = [np.empty(0, dtype=np.intp)]
    for pair in jump.pairs:
        result.append(first + pair.row_node.astype(np.intp))
        first += len(pair.nodes)
    return np.concatenate(result)


@dataclass(frozen=True)
class _BodyForces:
    """The forces of this rank's multipliers on each body that they act on.

    Attributes:
        jump: B.
        row: (m,) multiplier of each force, a local number.
        body: (m,) body on which each force acts.
        members: (bodies, count) global numbers of the multipliers that act on each body; -1 at the
            end of the row of a body with fewer multipliers.
        place: (m,) column of `members` that holds each force's multiplier, in the row of its body.
        unknowns: (n,) global numbers of the unknowns that this rank's rows of B couple, ascending.
        weights: (m, n) for each force the row of B of its multiplier, with the entries on its body
            only.
    """

    jump: JumpOperator
    row: Indices
    body: Indices
    members: Indices
    place: Indices
    unknowns: Indices
    weights: csr_array

    @classmethod
    def of(cls, jump: JumpOperator, label: Indices, bodies: int) -> _BodyForces:
        """Find the bodies that each multiplier acts on. Collective.

        Args:
            jump: B.
            label: the body of each node of this rank.
            bodies: number of bodies.
        """
        V, B = jump.system.V, jump.matrix
        start, end = B.getOwnershipRange()
        pointers, indices, data = B.getValuesCSR()
        row = np.repeat(np.arange(end - start), np.diff(pointers))
        row, indices, data = (one[data != 0.0] for one in (row, indices, data))
        unknowns, position = np.unique(indices, return_inverse=True)
        labels = B.createVecRight()
        labels.array = np.repeat(label[: V.dofmap.index_map.size_local], V.dofmap.index_map_bs)
        body = _fetched(unknowns)(labels).astype(np.intp)[position]
        labels.destroy()
        force, entry = np.unique(row * bodies + body, return_inverse=True)
        row, body = force // bodies, force % bodies
        weights = csr_array((data, (entry, position)), shape=(len(force), len(unknowns)))

        everywhere = gather_rows(jump.comm, np.column_stack([row + start, body]))
        order = np.argsort(everywhere[:, 1], kind="stable")
        numbers = np.bincount(everywhere[:, 1], minlength=bodies)
        place = np.empty(len(order), dtype=np.intp)
        place[order] = np.arange(len(order)) - (np.cumsum(numbers) - numbers)[everywhere[order, 1]]
        members = np.full((bodies, int(numbers.max(initial=0))), -1)
        members[everywhere[:, 1], place] = everywhere[:, 0]
        mine = slice(*np.searchsorted(everywhere[:, 0], [start, end]))
        return cls(jump, row, body, members, place[mine], unknowns, weights)

    def responses(self, operator: DualOperator, some: range) -> Array:
        """Return for each force the jump (m, len(some)) of its body alone. Collective.

        In each column, one multiplier on each body is 1, and acts on this body alone.

        Args:
            operator: A, whose solver for K is used; each column counts as a product.
            some: columns of `members` with the multipliers that are 1.
        """
        operator.products += len(some)
        forces, displacements = (operator.solver.several(len(some)) for _ in range(2))
        vector, prescribed = self.jump.matrix.createVecRight(), self.jump.system.prescribed
        entries = self.weights.tocoo()
        place, unknown = self.place[entries.row], self.unknowns[entries.col]
        for column, number in enumerate(some):
            acts = place == number
            vector.set(0.0)
            vector.setValues(
                unknown[acts].astype(PETSc.IntType), entries.data[acts], PETSc.InsertMode.ADD
            )
            vector.assemble()
            vector.array[prescribed] = 0.0
            forces.getDenseArray()[:, column] = vector.array
        operator.solver.solve_several(forces, displacements)
        result, fetch = np.empty((len(self.row), len(some))), _fetched(self.unknowns)
        for column in range(len(some)):
            u = displacements.getDenseArray()[:, column]
            vector.array = np.where(prescribed, 0.0, u)
            result[:, column] = self.weights @ fetch(vector)
        for owned in (forces, displacements, vector):
            owned.destroy()
        return result


def _fetched(unknowns: Indices) -> Callable[[PETSc.Vec], Array]:
    """Return a collective function that reads a vector's values at unknowns of any rank.

    Args:
        unknowns: (n,) global numbers of unknowns.
    """
    wanted = PETSc.IS().createGeneral(unknowns.astype(PETSc.IntType), comm=MPI.COMM_SELF)

    def fetch(vector: PETSc.Vec) -> Array:
        values = PETSc.Vec().createSeq(len(unknowns), comm=MPI.COMM_SELF)
        scatter = PETSc.Scatter().create(vector, wanted, values, None)
        scatter.scatter(vector, values)
        result = np.array(values.array)
        scatter.destroy()
        values.destroy()
        return result

    return fetch
