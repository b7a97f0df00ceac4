"""A = B K^-1 B': its products, and what is known of A without them.

- `sparse_rows`: A as a sparse matrix, for many small bodies.
- `NearField`: a cheap approximation of A, with the bodies clamped some cells from the contact.
- `ContactCompliance`: A for one B and one K. A product is one solve with K; every one is counted.
"""

from __future__ import annotations

from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csc_array, csr_array

from dolfinx import la

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, Mask, Matrix
from dolfinx_tresca._base.bodies import label_bodies, labels_of
from dolfinx_tresca._base.parallel import largest_abs
from dolfinx_tresca._base.petsc import (
    PetscOwner,
    dense_matrix,
    destroyed_on_error,
    product,
    sparse_matrix,
)
from dolfinx_tresca.dual.accuracy import DiscretisationError, EnergyBound
from dolfinx_tresca.dual.jump import JumpOperator, local_stiffness
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.floating.equilibrium import FloatingBodies
from dolfinx_tresca.floating.rigid_modes import FixingSprings
from dolfinx_tresca.solvers.problem import KnownProducts
from dolfinx_tresca.solvers.products import ProductStore, WholeModel
from dolfinx_tresca.stiffness.solver import SPARE_WORKSPACE, StiffnessSolver, cholesky

#: A is computed as a sparse matrix if no body has more than the part BODY_SHARE of all multipliers,
#: or more than MOST_ON_BODY multipliers, which limit the number of solves with K.
BODY_SHARE, MOST_ON_BODY = 0.5, 200

#: Number of solves with K in one block.
BLOCK = 32

#: Largest number of rows of a dense matrix with a direct solver for K, and with an iterative
#: solver, which needs a solve for each column. With 3,000 rows, a step of Newton's method takes
#: some seconds, and the matrix takes 72 MB on each rank.
LARGEST_DENSE, LARGEST_DENSE_ITERATIVE = 3000, 300


def sparse_rows(compliance: ContactCompliance) -> csr_array | None:
    """Return this rank's rows (size, n) of the sparse matrix A, for many small bodies. Collective.

    The result is None if a body has too many multipliers (`BODY_SHARE`, `MOST_ON_BODY`), with an
    iterative solver for K, and in a mixed space, where it does not work. Solves count as products.

    K is block diagonal, with a block K_b for each body, also if springs that fix floating bodies
    are added. Hence A = sum of A_b with A_b = B_b K_b^-1 B_b', where B_b has the columns of body b:
    A couples multipliers only if they act on the same body. One solve with K finds one column of
    each A_b: in this solve, each body is loaded by one of its own multipliers, without the opposite
    force on the other body of this multiplier. The number of solves is the largest number of
    multipliers on a body, however many bodies there are. (Compare Curtis, Powell and Reid 1974, On
    the estimation of sparse Jacobian matrices.)
    """
    jump = compliance.jump
    if not compliance.exact or jump.system.component is not None:
        return None
    label = label_bodies(jump.system.V)
    bodies = jump.comm.allreduce(int(label.max(initial=-1)), op=MPI.MAX) + 1
    row, body, split_rows = _rows_of_bodies(jump, label, bodies)
    # column b has the numbers of the multipliers on body b as row indices, ascending
    acts = csr_array((np.ones(len(row)), (row, body)), shape=(len(jump.gap), bodies))
    members = csc_array(jump.reductions.stacked(acts))
    members.sort_indices()
    size, numbers = members.shape[0], np.diff(members.indptr)
    solves = int(numbers.max())
    if not 0 < solves <= min(BODY_SHARE * size, MOST_ON_BODY):
        return None
    # a multiplier is loaded in the solve of its position on the body, 0 in the first one: such
    # zeros are stored, and this rank's entries have the order of `split_rows`
    members.data = np.arange(members.nnz) - np.repeat(members.indptr[:-1], numbers)
    solve_of_row = csr_array(members)[slice(*jump.matrix.getOwnershipRange())].data
    B = sparse_matrix(split_rows, jump.matrix.getSizes()[1], jump.comm)
    responses = compliance.columns(solve_of_row, solves, B)
    # in each solve, a split row responds to one multiplier of its body; entries of a row of B on
    # two bodies have the same place in A, where csr_array adds them: the sum of the A_b
    split_row, solve = np.nonzero(np.arange(solves) < numbers[body, None])
    multiplier = members.indices[members.indptr[body[split_row]] + solve]
    entries = (responses[split_row, solve], (row[split_row], multiplier))
    return csr_array(entries, shape=(len(jump.gap), size))


def _solve(matrix: csr_array, right: Array) -> Array:
    """Solve with a sparse matrix (n, n) on this rank alone, by MUMPS. Not collective.

    On a wall of 2,046 bricks, MUMPS takes a sixth of the time of SciPy's SuperLU, and less memory.
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


def _rows_of_bodies(
    jump: JumpOperator, label: Indices, bodies: int
) -> tuple[Indices, Indices, csr_array]:
    """Return this rank's rows of B, split by the nodes' body `label` into rows of B_b. Collective.

    Returns:
        of each split row the local number (m,) of its row of B, and its body (m,); and the split
        rows (m, all unknowns). They are sorted by row of B, then by body.
    """
    V, (pointers, indices, data) = jump.system.V, jump.matrix.getValuesCSR()
    row = np.repeat(np.arange(len(jump.gap)), np.diff(pointers))
    row, indices, data = (entries[data != 0.0] for entries in (row, indices, data))
    # the body of each entry that is not zero, from the node of its column
    nodes, position = np.unique(indices // V.dofmap.index_map_bs, return_inverse=True)
    owned = label[: V.dofmap.index_map.size_local]
    body = labels_of(V, owned, nodes.astype(np.int64))[position]
    key, split_row = np.unique(row * bodies + body, return_inverse=True)
    shape = (len(key), jump.matrix.getSize()[1])
    return key // bodies, key % bodies, csr_array((data, (split_row, indices)), shape=shape)


#: Number of layers of cells around the contact whose nodes may move. (With one, two bricks take up
#: to three products more, and with multigrid up to a fifth more Krylov iterations.)
LAYERS = 2

#: Largest number of unknowns of the level, whose factorisation takes a hundredth of a second. (On
#: two bricks, a solve takes 63 Krylov iterations with 42 unknowns, and 54 with 2,244.)
MOST_UNKNOWNS = 3000


def coarse_level(pc: PETSc.PC) -> tuple[list[PETSc.Mat], StiffnessSolver] | None:
    """Return the largest level of multigrid that is small enough, and the factors of its matrix.

    The level has at most `MOST_UNKNOWNS` unknowns, and the matrix P'K P. Collective.

    Returns:
        the interpolations whose product is P, the finest first, and the factors, owned by the
        caller; None without multigrid or a small level, or if the matrix is singular.
    """
    # levels from fine to coarse; the coarsest may be solved by a further multigrid
    interpolations: list[PETSc.Mat] = []
    while pc.getType() in (PETSc.PC.Type.GAMG, PETSc.PC.Type.MG):
        for level in range(pc.getMGLevels() - 1, 0, -1):
            interpolations.append(pc.getMGInterpolation(level))
            matrix = pc.getMGSmoother(level - 1).getOperators()[0]
            if matrix.getSize()[0] <= MOST_UNKNOWNS:
                matrix = matrix.convert("aij", PETSc.Mat())
                matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
                try:
                    return interpolations, cholesky(matrix, {}, None)
                except StiffnessError:  # multigrid may work with a singular level
                    return None
        pc = pc.getMGSmoother(0).getPC()
    return None


class NearField(PetscOwner):
    """The approximation D = B S B' <= A, where S <= K^-1 approximates K^-1 near the contact.

    Effects of tractions that oscillate between nodes decay within a few cells: nodes further away
    may be clamped (as in FETI's preconditioners: Farhat, Mandel and Roux 1994). Further away, the
    effect of tractions is smooth: products with A represent it, and with multigrid a coarse level
    in S most of it. Without this level, contact solves take 1.3 to 1.8 times the Krylov iterations.

    S solves a local system, with K on the degrees of freedom near the contact while all others are
    clamped, twice. Between the two solves, a system on a coarse level of multigrid is solved. The
    right-hand side of each solve is the remaining residual. With the projections P_1 and P_0 onto
    the local and the coarse space, which are orthogonal in the energy inner product,
    K^-1 - S = (1 - P_1)(1 - P_0)(1 - P_1) K^-1. This is symmetric and positive semidefinite
    (Schwarz's method: Toselli and Widlund 2005, chapter 2). If the solver for K has no coarse
    level, the local system is solved once, and K^-1 - S = (1 - P_1) K^-1. Owns PETSc objects: call
    `destroy()`. The caller keeps B and the solver for K.
    """

    def __init__(self, jump: JumpOperator, solver: StiffnessSolver) -> None:
        """Find nodes near the contact, and factor K there and on the coarse level. Collective."""
        self._jump, K = jump, solver.matrix
        self.comm = jump.comm
        near = np.repeat(_near(jump, LAYERS), jump.system.V.dofmap.index_map_bs)
        self._dofs = np.flatnonzero(near & ~jump.system.prescribed)
        numbers = (K.getOwnershipRange()[0] + self._dofs).astype(PETSc.IntType)
        rows = PETSc.IS().createGeneral(numbers, comm=K.comm)
        K_local = K.createSubMatrix(rows, rows)
        K_local.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._local = cholesky(K_local, {}, None)
        self._local_u, self._local_f = K_local.createVecs()
        self._u = jump.work
        self._coarse = coarse_level(solver.preconditioner)
        if self._coarse is not None:
            self._residuals = [K.createVecLeft(), *(P.createVecRight() for P in self._coarse[0])]
            self._corrections = [residual.duplicate() for residual in self._residuals]
            # the rows of K that couple the local degrees of freedom with all degrees of freedom
            self._rows = K.createSubMatrix(rows, None)

    def destroy(self) -> None:
        """Free the PETSc objects. Collective."""
        self._local.destroy()
        if self._coarse is not None:
            # on several ranks, an interpolation is never freed if Python drops its reference after
            # the hierarchy, which refers to it as well
            for owned in (*self._coarse[0], self._coarse[1]):
                owned.destroy()

    def apply(self, x: Array) -> Array:
        """Return D x, (size,). Collective."""
        # the first local solve
        force = self._jump.contact_force(x)
        self._local_f.array = force.array[self._dofs]
        self._local.solve(self._local_f, self._local_u)
        self._u.set(0.0)
        self._u.array[self._dofs] = self._local_u.array
        if self._coarse is not None:
            # the coarse solve: the residual f - K u goes down the levels, and the correction up
            interpolations, factors = self._coarse
            residuals, corrections = self._residuals, self._corrections
            self._rows.multTranspose(self._local_u, residuals[0])
            residuals[0].aypx(-1.0, force)
            for level, P in enumerate(interpolations):
                P.multTranspose(residuals[level], residuals[level + 1])
            factors.solve(residuals[-1], corrections[-1])
            for level, P in reversed(list(enumerate(interpolations))):
                P.mult(corrections[level + 1], corrections[level])
            self._u.axpy(1.0, corrections[0])
            # the second local solve
            self._rows.mult(self._u, self._local_f)
            self._local_f.array = force.array[self._dofs] - self._local_f.array
            self._local.solve(self._local_f, self._local_u)
            self._u.array[self._dofs] += self._local_u.array
        self._u.array[self._jump.system.prescribed] = 0.0
        return self._jump.of_unknowns(self._u)


def _near(jump: JumpOperator, layers: int) -> Mask:
    """Return a mask of the owned nodes within some layers of cells from the contact. Collective."""
    V, B = jump.system.V, jump.matrix
    nodes, cells = V.dofmap.index_map, V.dofmap.list
    # nodes with a nonzero entry in B, on any rank
    touched, (_, columns, values) = B.createVecRight(), B.getValuesCSR()
    touched.setValues(columns, np.abs(values), PETSc.InsertMode.ADD)
    touched.assemble()
    of_nodes = touched.array.reshape(nodes.size_local, V.dofmap.index_map_bs)  # maybe no nodes
    near = la.vector(nodes, 1, np.float64)
    near.array[: nodes.size_local] = of_nodes.any(axis=1)
    for _ in range(layers):
        near.scatter_forward()
        around = cells[(near.array[cells] > 0.0).any(axis=1)]
        near.array[around] = 1.0
        near.scatter_reverse(la.InsertMode.add)
    return np.asarray(near.array[: nodes.size_local] > 0.0)


#: With a direct solver, A is computed at once if it has at most `FEW` rows; if K has fewer than
#: `CHEAP` unknowns, as in the plane, the number may be larger in proportion, up to `MOST_AT_ONCE`.
#: (Without, two strips in the plane with 802 rows, continued from a file, take six times the time;
#: without the limit, a layer of 400 cells that touches with all of its 441 lower nodes takes four.)
FEW, CHEAP, MOST_AT_ONCE = 400, 10_000, 1000


class ContactCompliance(PetscOwner):
    """A = B K^-1 B' of (38.4), and all data that follow from K alone: computed once for each K.

    If bodies float, K stands for K_p, which is K with springs that fix these bodies
    (`floating/rigid_modes.py`). Data that not every solve needs are computed on first access. Owns
    PETSc objects, the solver among them: call `destroy()`. The caller keeps B.

    Attributes:
        springs: the springs in the solver's K that the system's K lacks; None: no body needs any.
        exact: whether products are exact to rounding (a direct solver for K).
        products: number of products with A.
    """

    def __init__(
        self, jump: JumpOperator, solver: StiffnessSolver, springs: FixingSprings | None
    ) -> None:
        """Keep the arguments; in a mixed space, prepare `error_bound`. Collective.

        Raises:
            StiffnessError: rows of B depend on those of incompressibility; the solver is destroyed.
        """
        self.jump, self.solver, self.springs, self.comm = jump, solver, springs, jump.comm
        self.exact, self.products = solver.exact, 0
        self._store: KnownProducts | None = None
        if jump.system.component is not None:  # a mixed space of displacement and pressure
            with destroyed_on_error(solver):
                _ = self.error_bound  # raises the error

    def destroy(self) -> None:
        """Free the PETSc objects, and those of the solver. Collective."""
        self._destroy_but_solver()
        self.solver.destroy()

    def _destroy_but_solver(self) -> None:
        # without references to them, their matrices and vectors are freed on several ranks as well
        vars(self).pop("error_bound", None)
        if (near := vars(self).pop("near_field", None)) is not None:
            near.destroy()

    def on(self, jump: JumpOperator) -> ContactCompliance:
        """Return the compliance for another B, such as the B of displaced surfaces. Collective.

        The solver is the same. PETSc objects of this compliance are destroyed, except the solver.
        K need not be factored: surfaces are also paired after a factorisation has failed.
        """
        self._destroy_but_solver()
        return ContactCompliance(jump, self.solver, self.springs)

    def apply(self, x: Array) -> Array:
        """Return A x (size,) to the accuracy in the solver's options; a product. Collective."""
        self.products += 1
        u = self.jump.work
        self.solver.solve(self.jump.contact_force(x), u)
        u.array[self.jump.system.prescribed] = 0.0
        return self.jump.of_unknowns(u)

    def columns(self, place: Indices, count: int, B: PETSc.Mat) -> Array:
        """Return B K^-1 B'E (rows, count), where each row of E has a single 1. Collective.

        The 1 of each of this rank's rows is in the column `place` (rows,). Each column counts as a
        product. Blocks of columns are solved together, which with a direct solver costs far less
        than single products. B is that of A, or has its split rows (`sparse_rows`).
        """
        prescribed, result = self.jump.system.prescribed, np.empty((len(place), count))
        for start in range(0, count, BLOCK):
            block = np.arange(start, min(start + BLOCK, count))
            multipliers = dense_matrix((place[:, None] == block).astype(np.float64), self.comm)
            forces = B.transposeMatMult(multipliers)
            forces.getDenseArray()[prescribed] = 0.0
            displacements = forces.duplicate()
            self.solver.solve_several(forces, displacements)
            displacements.getDenseArray()[prescribed] = 0.0
            jumps = B.matMult(displacements)
            result[:, block] = jumps.getDenseArray()
            for owned in (multipliers, forces, displacements, jumps):
                owned.destroy()
        self.products += count
        return result

    def known_products(self) -> KnownProducts:
        """Return the store of all known products with A. Collective.

        The first call computes A if it is sparse, or if it has few rows (`FEW`).
        """
        if self._store is not None:
            return self._store
        rows = sparse_rows(self)
        if rows is not None:
            self._store = self._whole(rows)
            return self._store
        jump, (size, unknowns) = self.jump, self.jump.matrix.getSize()
        # in a mixed space, clamped nodes round the near field would fix its volume
        has_near = size > 0 and jump.system.component is None
        near = (lambda x: self.near_field.apply(x)) if has_near else None
        self._store = ProductStore(
            jump.reductions, np.reciprocal(self.nodal_stiffness), apply_near=near
        )
        if self.exact and 0 < size <= min(FEW * max(1.0, CHEAP / unknowns), MOST_AT_ONCE):
            self.complete_products()
        return self._store

    def complete_products(self) -> bool:
        """Compute A as a dense matrix, unless it is known or too large; return whether it is known.

        Each of its rows takes one solve with K, which counts as a product. Collective.
        """
        B = self.jump.matrix
        size, most = B.getSize()[0], LARGEST_DENSE if self.exact else LARGEST_DENSE_ITERATIVE
        if not isinstance(self._store, WholeModel) and size <= most:
            self._store = self._whole(self.columns(np.arange(*B.getOwnershipRange()), size, B))
        return isinstance(self._store, WholeModel)

    def _whole(self, rows: Matrix) -> WholeModel:
        """Return the model of A from this rank's rows (size, n), dense or sparse. Collective."""
        jump, start = self.jump, self.jump.matrix.getOwnershipRange()[0]
        return WholeModel(jump.reductions, rows, start, np.reciprocal(self.nodal_stiffness), _solve)

    def forget(self) -> None:
        """Drop all products. Not collective."""
        self._store = None

    @cached_property
    def floating(self) -> FloatingBodies | None:
        """The floating and softly held bodies; None if there are none. Collective."""
        if self.springs is None:
            return None
        U, stiffness = self.springs.response(self.jump.system.K, self.solver)
        return FloatingBodies(self.springs.modes, U, stiffness, product(self.jump.matrix, U))

    @cached_property
    def error_bound(self) -> EnergyBound:
        """The object that bounds errors in the energy norm. Collective."""
        return EnergyBound(self.jump, self.nodal_stiffness)

    @cached_property
    def near_field(self) -> NearField:
        """The near field, an approximation of A for oscillating tractions. Collective."""
        return NearField(self.jump, self.solver)

    @cached_property
    def estimator(self) -> DiscretisationError:
        """The object that estimates the error of the mesh. Collective."""
        system = self.jump.system
        return DiscretisationError(system.form, system.V, system.axisymmetric)

    @cached_property
    def nodal_stiffness(self) -> Array:
        """`local_stiffness` (size,), the same for all directions of a friction disc. Collective."""
        return self.jump.discs.mean_over_discs(local_stiffness(self.jump))

    @cached_property
    def stress_rounding(self) -> float:
        """Size of the pressures [stress] that the rounding of coordinates causes. Collective."""
        jump = self.jump
        stress = self.nodal_stiffness * jump.stress_scale / jump.length_scale
        stiffness, extent = largest_abs(jump.comm, stress, jump.system.V.mesh.geometry.x)
        return ROUNDING * extent * stiffness
