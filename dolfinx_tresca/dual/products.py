"""A = B K^-1 B': its products, and what is known of A without them.

- `SurfaceCompliance`: the part of K^-1 that contact needs, shared by all pairings with one K.
- `NearField`: a cheap approximation of A, with the bodies clamped some cells from the contact.
- `ContactCompliance`: A for one B and one K. A product is one solve with K; every one is counted.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.sparse import csc_array, csr_array, eye_array

from dolfinx import la

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, Matrix
from dolfinx_tresca._base.bodies import couples_bodies
from dolfinx_tresca._base.parallel import gather_rows, largest_abs, reduce_array
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

#: Number of right-hand sides for which `ContactCompliance.columns` solves with K together.
BLOCK = 32

#: Largest number of rows of a dense matrix A with a direct solver for K, and with an iterative
#: solver, whose solves for the columns take longer. With 3,000 rows, a step of Newton's method
#: takes some seconds, and the matrix takes 72 MB on each rank.
LARGEST_DENSE, LARGEST_DENSE_ITERATIVE = 3000, 300

#: A is a sparse matrix if a smaller part of its entries than `SPARSE_SHARE` may differ from zero.
#: With `MOST_ENTRIES` entries, a sparse matrix takes 240 MB on each rank.
SPARSE_SHARE, MOST_ENTRIES = 0.25, 20_000_000


class SurfaceCompliance:
    """S, the part of K^-1 between the degrees of freedom that contact acts on: A = B S B'.

    K couples no two bodies: so one solve with K, in which each body has one unit load, finds a
    column of S for each body (compare Curtis, Powell and Reid 1974). The number of solves is the
    largest number of columns of a body, however many bodies there are. All pairings with one K
    share S; degrees of freedom on which contact acts for the first time get new columns.

    Attributes:
        body: (owned degrees of freedom,) number of the body of each one; `bodies` counts bodies.
        dofs: (s,) the global numbers of the degrees of freedom, ascending; on every rank.
        matrix: (s, s) S, sparse; on every rank.
    """

    def __init__(self, system: Any) -> None:
        """Begin without degrees of freedom. Collective."""
        nodes, block = system.V.dofmap.index_map, system.V.dofmap.index_map_bs
        self.body = np.repeat(system.body_of_node[: nodes.size_local], block)
        self.bodies = 1.0 + float(largest_abs(system.comm, self.body)[0])
        self._comm, self._moves = system.comm, system.moves
        self._range = block * np.array(nodes.local_range)
        self.dofs = self.body[:0]
        self.matrix = csr_array((0, 0))

    def rows(self, compliance: ContactCompliance, solves: int, most_rows: int) -> Matrix | None:
        """Return this rank's rows (size, n) of A = B S B'; None if that is too much. Collective.

        New columns of S take solves with K, which count as products. The result is None if these
        are more than `solves`, if S or A would have more than `MOST_ENTRIES` entries, or if A has
        n > `most_rows` rows on all ranks and is not sparse (`SPARSE_SHARE`).
        """
        jump, comm = compliance.jump, self._comm
        start, end = self._range  # of the numbers that this rank owns
        n, unknowns = jump.matrix.getSize()
        row_starts, columns, values = jump.matrix.getValuesCSR()
        B = csr_array((values, columns, row_starts), shape=(len(jump.gap), unknowns))
        B.eliminate_zeros()
        # `dofs` of S: those until now, and those that B touches on any rank, unless prescribed
        touched = np.unique(gather_rows(comm, np.unique(B.indices)).astype(np.intp))
        own = touched[(start <= touched) & (touched < end)]
        moving = own[self._moves[own - start]]
        dofs = np.union1d(self.dofs, gather_rows(comm, moving))
        B = csr_array(B[:, dofs])
        # `on_body` (s, bodies) has a 1 at the body of each of them
        mine = slice(*np.searchsorted(dofs, self._range))  # those of this rank
        body = gather_rows(comm, self.body[dofs[mine] - start])
        s, bodies = len(body), body.max(initial=0) + 1
        on_body = csr_array((np.ones(s), body, np.arange(s + 1)), shape=(s, bodies))
        # numbers of entries: A couples multipliers of the same body, and S its degrees of freedom
        acts_on_body = csc_array(abs(B) @ on_body)
        multipliers = np.diff(acts_on_body.indptr).astype(np.float64)
        counts = np.array([reduce_array(comm, multipliers), on_body.sum(axis=0)])
        entries_of_A, entries_of_S = np.square(counts).sum(axis=1)
        is_sparse = entries_of_A < SPARSE_SHARE * n**2
        if max(entries_of_A, entries_of_S) > MOST_ENTRIES or not (is_sparse or n <= most_rows):
            return None
        # one solve serves one new degree of freedom of every body
        is_new = np.isin(dofs, self.dofs, invert=True)
        if np.bincount(body[is_new], minlength=1).max() > solves:
            return None
        if is_new.any():
            # solve number i has a unit load on the i-th new degree of freedom of each body
            new = np.flatnonzero(is_new)
            members = csc_array(on_body[new])  # those of a body in one column
            number_of_body = np.diff(members.indptr)
            starts = np.repeat(members.indptr[:-1], number_of_body)  # of their columns
            solve = np.full(s, -1)
            solve[new[members.indices]] = np.arange(len(new)) - starts
            unit_rows = eye_array(unknowns, format="csr")[dofs[mine]]
            units = sparse_matrix(unit_rows, jump.matrix.getSizes()[1], comm)
            responses = compliance.columns(solve[mine], int(number_of_body.max()), units)
            # what moves in a solve is due to the load on the same body: an entry of that column
            row, new_column = (on_body[mine] @ on_body[new].T).nonzero()
            column = new[new_column]
            entries = responses[row, solve[column]]
            added = csr_array((entries, (row, column)), shape=(len(responses), s))
            added = jump.reductions.stacked(added)
            # S is symmetric: new rows of old columns are new columns of old rows
            old = eye_array(s, format="csr")[:, ~is_new]
            old_rows = old @ (old.T @ added)
            self.matrix = old @ self.matrix @ old.T + added + old_rows.T
            self.dofs = dofs
        rows = B @ self.matrix @ jump.reductions.stacked(B).T
        return csr_array(rows) if is_sparse else np.asarray(rows.toarray())


def _solve(matrix: csr_array, right: Array) -> Array:
    """Return matrix^-1 right, (n,), by MUMPS on this rank alone. Not collective.

    `WholeModel` uses it for Newton steps. On 2,046 bricks, SciPy's SuperLU takes six times as long.
    """
    equations = sparse_matrix(matrix, matrix.shape, MPI.COMM_SELF)
    factors = PETSc.PC().create(MPI.COMM_SELF)
    x, b = equations.createVecs()
    b.array = right
    factors.setOperators(equations)
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


#: Number of layers of cells around the contact whose nodes may move in `NearField`. (With one, two
#: bricks take up to three products more, and with multigrid up to a fifth more Krylov iterations.)
LAYERS = 2

#: Largest number of unknowns of `coarse_level`, whose factorisation takes a hundredth of a second.
#: (On two bricks, a solve takes 63 Krylov iterations with 42 unknowns, and 54 with 2,244.)
MOST_UNKNOWNS = 3000


def coarse_level(pc: PETSc.PC) -> tuple[list[PETSc.Mat], StiffnessSolver] | None:
    """Return the largest small level of multigrid, on which `NearField` solves. Collective.

    The level has at most `MOST_UNKNOWNS` unknowns, and the matrix P'K P, which is factored.

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

    D stands for A in the model where no product is known. Effects of tractions that oscillate
    between nodes decay within a few cells, so nodes further away may be clamped (as in FETI's
    preconditioners: Farhat, Mandel and Roux 1994). Smooth effects are left to products with A, and
    with multigrid to a coarse level, without which solves take 1.3 to 1.8 times the iterations.

    S makes three solves, each for the residual that is left: with K near the contact, all other
    degrees of freedom clamped; on the coarse level; and again near the contact. With the
    projections P_1 and P_0 onto the local and the coarse space, orthogonal in energy,
    K^-1 - S = (1 - P_1)(1 - P_0)(1 - P_1) K^-1. This is symmetric and positive semidefinite
    (Schwarz's method: Toselli and Widlund 2005, chapter 2). Without a coarse level, the first solve
    is the only one, and K^-1 - S = (1 - P_1) K^-1. Owns PETSc objects: call `destroy()`. The caller
    keeps B and the solver for K.
    """

    def __init__(self, jump: JumpOperator, solver: StiffnessSolver) -> None:
        """Find nodes near the contact, and factor K there and on the coarse level. Collective."""
        self._jump, self.comm = jump, jump.comm
        K, V = solver.matrix, jump.system.V
        nodes, block, cells = V.dofmap.index_map, V.dofmap.index_map_bs, V.dofmap.list
        # nodes on which contact acts: with a nonzero entry in B, on any rank
        touched = jump.matrix.createVecRight()
        _, columns, values = jump.matrix.getValuesCSR()
        touched.setValues(columns, np.abs(values), PETSc.InsertMode.ADD)
        touched.assemble()
        of_nodes = touched.array.reshape(nodes.size_local, block)  # maybe no nodes
        near = la.vector(nodes, 1, np.float64)
        near.array[: nodes.size_local] = of_nodes.any(axis=1)
        # and those of layer after layer of cells around them
        for _ in range(LAYERS):
            near.scatter_forward()
            around = cells[(near.array[cells] > 0.0).any(axis=1)]
            near.array[around] = 1.0
            near.scatter_reverse(la.InsertMode.add)
        is_near = np.repeat(near.array[: nodes.size_local] > 0.0, block)
        self._dofs = np.flatnonzero(is_near & ~jump.system.prescribed)
        # K of these degrees of freedom, all others clamped
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
        """Return D x (size,), an approximation of A x without a solve with K. Collective."""
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


#: With a direct solver, A is computed before the first iteration if it is sparse or has at most
#: `MOST_AT_ONCE` rows, and if the solves for it read at most `ENTRIES_AT_ONCE` entries of the
#: factors for each body, in a quarter to half of a second. (Without A, two strips with 802 rows,
#: continued from a file, take six times the time; two bricks of 24,576 unknowns a quarter of it.)
ENTRIES_AT_ONCE, MOST_AT_ONCE = 3e8, 1000


class ContactCompliance(PetscOwner):
    """A = B K^-1 B' of (38.4) for one B and one K, with data that follow from both.

    If bodies float, K stands for K_p, which is K with springs that fix these bodies
    (`floating/rigid_modes.py`). Data that not every solve needs are computed on first access. Owns
    PETSc objects, the solver among them: call `destroy()`. The caller keeps B.

    Attributes:
        springs: the springs in the solver's K_p that are not in K; None: no body needs any.
        exact: whether products are exact to rounding (a direct solver for K).
        products: number of products with A so far, for reports and limits on their number.
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
        self._products_before = 0  # by former pairings, after the last use of `surfaces`
        if jump.system.component is not None:  # a mixed space of displacement and pressure
            with destroyed_on_error(solver):
                _ = self.error_bound  # raises the error

    def destroy(self) -> None:
        """Free the PETSc objects, and those of the solver. Collective."""
        self._destroy_but_solver()
        self.solver.destroy()

    def _destroy_but_solver(self) -> None:
        # what only these objects own is freed with them, on several ranks by `free_unused`
        vars(self).pop("error_bound", None)
        near = vars(self).pop("near_field", None)
        if near is not None:
            near.destroy()

    def on(self, jump: JumpOperator) -> ContactCompliance:
        """Return the compliance for another B, such as the B of displaced surfaces. Collective.

        The solver is kept, even if K could not be factored and it is destroyed; all else is freed.
        """
        self._destroy_but_solver()
        result = ContactCompliance(jump, self.solver, self.springs)
        result._products_before = self._products_before + self.products
        if "surfaces" in vars(self):
            vars(result)["surfaces"] = self.surfaces
        return result

    def apply(self, x: Array) -> Array:
        """Return A x (size,) to the accuracy in the solver's options; a product. Collective."""
        self.products += 1
        u = self.jump.work
        self.solver.solve(self.jump.contact_force(x), u)
        u.array[self.jump.system.prescribed] = 0.0
        return self.jump.of_unknowns(u)

    def columns(self, column: Indices, count: int, B: PETSc.Mat) -> Array:
        """Return this rank's rows (rows, count) of B K^-1 B'E, of A or of S. Collective.

        For each row of B on this rank, E has a 1 in the column `column` (rows,); -1: in none. Each
        column is a product. A direct solver solves blocks of columns together, which costs far less
        than single products. For A, B is the jump operator; for S (if `exact`), it has unit rows.
        """
        if not self.exact:  # of iterations for a block, PETSc tells neither number nor failures
            responses = [self.apply(1.0 * (column == k)) for k in range(count)]
            return np.reshape(responses, (count, len(column))).T
        prescribed, result = self.jump.system.prescribed, np.empty((len(column), count))
        for start in range(0, count, BLOCK):
            block = np.arange(start, min(start + BLOCK, count))
            multipliers = dense_matrix((column[:, None] == block).astype(np.float64), self.comm)
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
        """Return the known products with A, or A as a matrix (`WholeModel`). Collective.

        The first call computes the matrix if this takes little time (`ENTRIES_AT_ONCE`).
        """
        if self._store is None:
            jump, n = self.jump, self.jump.matrix.getSize()[0]
            # in a mixed space, clamped nodes round the near field would fix its volume
            is_mixed = jump.system.component is not None
            near = None if is_mixed or n == 0 else (lambda x: self.near_field.apply(x))
            compliance = np.reciprocal(self.nodal_stiffness)
            self._store = ProductStore(jump.reductions, compliance, apply_near=near)
            if self.exact and n > 0:
                bodies = 1.0 if self.surfaces is None else self.surfaces.bodies
                solves = ENTRIES_AT_ONCE * bodies / self.solver.entries
                self.complete_products(solves, MOST_AT_ONCE)
        return self._store

    def complete_products(self, solves: float = np.inf, most_rows: int = LARGEST_DENSE) -> bool:
        """Compute A as a matrix if it is not too large; return whether it is known. Collective.

        At most `solves` solves with K are made, which count as products, and a dense A has at most
        `most_rows` rows. A follows from S (`surfaces`) if this takes fewer solves than A has rows,
        or, beyond the limit `solves`, no more than former pairings with this K have taken products.
        """
        if isinstance(self._store, WholeModel):
            return True
        B, n = self.jump.matrix, self.jump.matrix.getSize()[0]
        start, end = B.getOwnershipRange()
        if not self.exact:
            most_rows = LARGEST_DENSE_ITERATIVE
        rows = None  # this rank's rows of A
        if self.surfaces is not None:
            limit = max(int(min(solves, n - 1)), self._products_before)
            rows = self.surfaces.rows(self, limit, most_rows)
        if rows is not None:
            self._products_before = -self.products  # those until now do not count
        elif n <= min(solves, most_rows):
            rows = self.columns(np.arange(start, end), n, B)
        if rows is not None:
            compliance = np.reciprocal(self.nodal_stiffness)
            self._store = WholeModel(self.jump.reductions, rows, start, compliance, _solve)
        return rows is not None

    def forget(self) -> None:
        """Drop all known products with A, and S. Not collective."""
        self._store = None
        vars(self).pop("surfaces", None)

    @cached_property
    def surfaces(self) -> SurfaceCompliance | None:
        """S; None if K is solved iteratively, has a pressure, or couples bodies. Collective."""
        if not self.exact or self.jump.system.component is not None:
            return None
        surfaces = SurfaceCompliance(self.jump.system)
        return None if couples_bodies(self.solver.matrix, surfaces.body) else surfaces

    @cached_property
    def floating(self) -> FloatingBodies | None:
        """The floating and softly held bodies; None if there are none. Collective."""
        if self.springs is None:
            return None
        U, stiffness = self.springs.response(self.jump.system.K, self.solver)
        return FloatingBodies(self.springs.modes, U, stiffness, product(self.jump.matrix, U))

    @cached_property
    def error_bound(self) -> EnergyBound:
        """The bound of the iteration's error in the energy norm. Collective."""
        return EnergyBound(self.jump, self.nodal_stiffness)

    @cached_property
    def near_field(self) -> NearField:
        """The near field, an approximation of A for oscillating tractions. Collective."""
        return NearField(self.jump, self.solver)

    @cached_property
    def estimator(self) -> DiscretisationError:
        """The estimate of the mesh's error in the energy norm. Collective."""
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
        by_length = self.nodal_stiffness * jump.stress_scale / jump.length_scale
        stiffness, extent = largest_abs(jump.comm, by_length, jump.system.V.mesh.geometry.x)
        return ROUNDING * extent * stiffness
