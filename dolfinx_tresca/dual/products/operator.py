"""The dual operator A = B K^-1 B' on distributed vectors, and A as a matrix.

The matrix is sparse for many bodies, from solves that serve all bodies at once, or dense, with a
column for each multiplier.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csc_array, csr_array

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.bodies import label_bodies, labels_of
from dolfinx_tresca._base.petsc import dense_matrix, sparse_matrix
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.solvers.products import WholeModel
from dolfinx_tresca.stiffness.solver import SPARE_WORKSPACE, StiffnessSolver


class DualOperator:
    """A of (38.4), for one K: each product is one solve with K.

    If bodies float, K stands for K_p, which is K with springs that fix these bodies
    (`floating/fixing.py`).

    The caller keeps B and the solver.

    Attributes:
        jump: B.
        solver: solver for K.
        exact: whether products are exact to rounding (a direct solver for K).
        products: number of products with A.
    """

    def __init__(self, jump: JumpOperator, solver: StiffnessSolver) -> None:
        """Prepare products, without computing any. Collective."""
        self.jump, self.solver = jump, solver
        self.comm = self.jump.comm
        self.exact = solver.exact
        self.products = 0

    def apply(self, x: Array) -> Array:
        """Return A x to the accuracy in the solver's options; counted in `products`. Collective.

        Args:
            x: (size,) multipliers.
        """
        self.products += 1
        u = self.jump.work
        self.solver.solve(self.jump.contact_force(x), u)
        u.array[self.jump.system.prescribed] = 0.0
        return self.jump.of_unknowns(u)

    def apply_to_all(self, X: Array, B: PETSc.Mat) -> Array:
        """Return A X for X (size, k), with a direct solver for all columns together. Collective.

        This costs far less than k single products. Each column is counted in `products`.

        Args:
            X: (size, k) multipliers.
            B: the matrix of jumps in A = B K^-1 B', or a matrix that replaces it.
        """
        self.products += X.shape[1]
        multipliers = dense_matrix(X, self.comm)
        forces = B.transposeMatMult(multipliers)
        forces.getDenseArray()[self.jump.system.prescribed] = 0.0
        displacements = forces.duplicate()
        self.solver.solve_several(forces, displacements)
        displacements.getDenseArray()[self.jump.system.prescribed] = 0.0
        jumps = B.matMult(displacements)
        product: Array = jumps.getDenseArray().copy()
        for owned in (multipliers, forces, displacements, jumps):
            owned.destroy()
        return product


#: A is computed as a sparse matrix if no body has more than the part BODY_SHARE of all multipliers,
#: or more than MOST_ON_BODY multipliers. Both numbers limit the number of solves with K. With half
#: the share, two of 216 standing piles of stones (`tests/validation/test_random_piles.py`) are not
#: solved, and all piles together take 3,594 iterations and 7,088 products in place of 1,253 and
#: 8,243; with twice the share, they take 463 and 8,770. Two walls of 15 bricks, with up to 220 and
#: 348 multipliers on a brick, would take 0.5 and 0.65 times the time if A were computed as a
#: matrix.
BODY_SHARE, MOST_ON_BODY = 0.5, 200

#: Number of solves with K in one block.
BLOCK = 32

#: Largest number of rows of a dense matrix with a direct solver for K, and with an iterative
#: solver, which needs a solve for each column. With 3,000 rows, a step of Newton's method takes
#: some seconds, and the matrix takes 72 MB on each rank.
LARGEST_DENSE, LARGEST_DENSE_ITERATIVE = 3000, 300


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
    row, body, forces = _forces_on_bodies(jump, label, bodies)
    acts = csr_array((np.ones(len(row)), (row, body)), shape=(len(jump.gap), bodies))
    members = csc_array(jump.reductions.stacked(acts))  # row indices: the multipliers of each body
    members.sort_indices()
    size, numbers = members.shape[0], np.diff(members.indptr)
    count = int(numbers.max())
    if not 0 < count <= min(BODY_SHARE * size, MOST_ON_BODY):
        return None
    members.data = np.arange(members.nnz) - np.repeat(members.indptr[:-1], numbers)
    start, end = jump.matrix.getOwnershipRange()
    place = csr_array(members)[start:end].data
    B = sparse_matrix(forces, jump.matrix.getSizes()[1], jump.comm)
    responses = _columns(operator, place, count, B)
    force, column = np.nonzero(np.arange(count) < numbers[body, None])
    multiplier = members.indices[members.indptr[body[force]] + column]
    entries = (responses[force, column], (row[force], multiplier))
    rows = csr_array(entries, shape=(len(jump.gap), size))
    return WholeModel(jump.reductions, rows, start, jump.row_nodes, local_compliance, _solve)


def dense_model(operator: DualOperator, local_compliance: Array) -> WholeModel | None:
    """Return A as a dense matrix: one solve with K for each multiplier, in blocks. Collective.

    The result is None if A is too large (`LARGEST_DENSE`, `LARGEST_DENSE_ITERATIVE`).

    Args:
        operator: A. Each solve counts as a product.
        local_compliance: (size,) compliance of nodes whose neighbours are fixed.
    """
    jump, size = operator.jump, operator.jump.matrix.getSize()[0]
    if size > (LARGEST_DENSE if operator.exact else LARGEST_DENSE_ITERATIVE):
        return None
    start, end = jump.matrix.getOwnershipRange()
    rows = _columns(operator, np.arange(start, end), size, jump.matrix)
    return WholeModel(jump.reductions, rows, start, jump.row_nodes, local_compliance, _solve)


def _columns(operator: DualOperator, place: Indices, count: int, B: PETSc.Mat) -> Array:
    """Return products (size, count) with unit vectors or sums of unit vectors. Collective.

    Args:
        operator: A.
        place: (size,) column in which each multiplier is 1.
        count: number of columns.
        B: see `DualOperator.apply_to_all`.
    """
    result = np.empty((len(place), count))
    for start in range(0, count, BLOCK):
        columns = np.arange(start, min(start + BLOCK, count))
        units = (place[:, None] == columns).astype(np.float64)
        result[:, columns] = operator.apply_to_all(units, B)
    return result


def _solve(matrix: csr_array, right: Array) -> Array:
    """Solve with a sparse matrix (n, n) on this rank alone, by MUMPS. Not collective.

    On a wall of 2,046 bricks, MUMPS takes a sixth of the time of SciPy's SuperLU, and its factors
    take a third of the memory.

    Raises:
        StiffnessError: the factorisation failed.
    """
    A = sparse_matrix(matrix, matrix.shape, MPI.COMM_SELF)
    factors = PETSc.PC().create(MPI.COMM_SELF)
    x, b = A.createVecs()
    b.array = right
    factors.setOperators(A)
    factors.setType(PETSc.PC.Type.LU)
    factors.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
    factors.setFactorSetUpSolverType()
    factor = factors.getFactorMatrix()
    # ordering by approximate minimum fill: for a matrix of 5,005 bricks, it takes 0.76 times the
    # time of MUMPS's own choice, and 0.87 times the memory
    factor.setMumpsIcntl(7, 2)
    factor.setMumpsIcntl(14, SPARE_WORKSPACE)
    factors.apply(b, x)
    failure = factor.getMumpsInfog(1)
    if failure < 0:
        raise StiffnessError(
            f"MUMPS could not solve for the contacts of many bodies: INFOG(1) = {failure} "
            "(-9 or -13: out of memory; see its manual)."
        )
    return np.array(x.array)


def _forces_on_bodies(
    jump: JumpOperator, label: Indices, bodies: int
) -> tuple[Indices, Indices, csr_array]:
    """Return the rows of B, split into the rows of the matrices B_b of all bodies. Collective.

    Args:
        jump: B.
        label: the body of each node of this rank.
        bodies: number of bodies.

    Returns:
        the local number (m,) of the multiplier of each row of this rank; the body (m,) on which the
        multiplier acts in this row; and the rows (m, all unknowns). Rows are sorted by multiplier,
        then by body.
    """
    V, (pointers, indices, data) = jump.system.V, jump.matrix.getValuesCSR()
    row = np.repeat(np.arange(len(jump.gap)), np.diff(pointers))
    row, indices, data = (entries[data != 0.0] for entries in (row, indices, data))
    nodes, position = np.unique(indices // V.dofmap.index_map_bs, return_inverse=True)
    owned = label[: V.dofmap.index_map.size_local]
    body = labels_of(V, owned, nodes.astype(np.int64))[position]
    number, force = np.unique(row * bodies + body, return_inverse=True)
    shape = (len(number), jump.matrix.getSize()[1])
    return number // bodies, number % bodies, csr_array((data, (force, indices)), shape=shape)
