"""The solver for K u = f: a PETSc KSP, with the options of a factorisation or of multigrid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from itertools import count
from typing import Any

from petsc4py import PETSc

import numpy as np

import dolfinx.fem.petsc
from dolfinx import fem

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Mask
from dolfinx_tresca._base.parallel import warn
from dolfinx_tresca._base.petsc import PetscOwner, destroyed_on_error
from dolfinx_tresca._base.tolerances import ROUGH
from dolfinx_tresca.errors import ContactError, InputError, StiffnessError

#: Advice for breakdowns without a solution, by PETSc's reason.
_ADVICE = {
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT: (
        "It met a displacement of negative strain energy: K is not positive definite. Check "
        "Young's moduli, Poisson ratios (below 0.5) and the signs in the form a."
    ),
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC: (
        "The preconditioner is not positive definite. Either K is not, by the material data; or "
        "stiffnesses differ so much (by 1e12, say) that rounding spoils the multigrid. Take "
        "stiffness='cholesky', which tells which, or raise mg_levels_esteig_ksp_max_it."
    ),
}

_numbers = count()


def indefinite_error(evidence: str) -> StiffnessError:
    """Return the error to raise if K is not positive definite; the evidence is a clause.

    The error keeps the evidence, for example "3 of 90 pivots are negative", as an attribute.
    """
    error = StiffnessError(
        f"K is not positive definite: {evidence}. Check Young's moduli (a value in every cell), "
        "Poisson ratios (below 0.5) and the signs in the form a."
    )
    error.evidence = evidence
    return error


class StiffnessSolver(PetscOwner):
    """Solves K u = f for many f; owns PETSc objects: call `destroy()`.

    Attributes:
        name: "cholesky" or "multigrid".
        solves: number of solved systems.
        krylov_iterations: iterations of all solves; 0 for a direct solver.
    """

    def __init__(
        self,
        name: str,
        K: PETSc.Mat,
        defaults: Mapping[str, Any],
        petsc_options: Mapping[str, Any],
        prefix: str | None,
        prepare: Callable[[PETSc.PC], None] = lambda pc: None,
    ) -> None:
        """Set the solver up: factor K, or build the hierarchy. Collective.

        The user's `petsc_options` override those in PETSc's database with the `prefix` (None: a new
        one), and these override the `defaults`, which define the solver. The function `prepare`
        sets up parts of the preconditioner that options cannot set up.
        """
        self.name, self.comm = name, K.comm
        self.solves = self.krylov_iterations = 0
        self._least_eigenvalue, self._warned, self._measured = 1.0, False, False
        prefix = f"dolfinx_tresca_{next(_numbers)}_" if prefix is None else prefix
        self._ksp: Any = PETSc.KSP().create(K.comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setOperators(K)
        options = PETSc.Options(prefix)
        applied = {key: value for key, value in defaults.items() if not options.hasName(key)}
        applied |= petsc_options
        for key, value in applied.items():
            options[key] = value
        try:
            with destroyed_on_error(self):
                prepare(self._ksp.getPC())
                self._ksp.setFromOptions()
                if self._ksp.getTolerances()[3] < 1:  # PETSc would write beyond an empty array
                    raise InputError("ksp_max_it must be at least 1, found 0.")
                self._ksp.setComputeEigenvalues(True)
                self._ksp.setUp()
        except PETSc.Error as error:
            raise StiffnessError(
                f"setting up the {name} solver for K failed: {error}. Check the material data, "
                "the PETSc options, and whether memory suffices."
            ) from error
        finally:
            for key in applied:
                del options[key]

    def check_ready(self) -> None:
        """Check that K is factored, or that its preconditioner is set up."""
        if self._ksp is None:
            raise ContactError(
                "K is not factored: the problem was destroyed, or its update_stiffness() failed."
            )

    @property
    def matrix(self) -> PETSc.Mat:
        """The matrix that was given as K, which callers must not destroy."""
        return self._ksp.getOperators()[0]

    @property
    def preconditioner(self) -> PETSc.PC:
        """The preconditioner, or the factorisation, which callers must not destroy."""
        return self._ksp.getPC()

    @property
    def exact(self) -> bool:
        """Whether solves are exact to rounding for any requested accuracy, as with factors."""
        return self._ksp is None or self._ksp.getType() == PETSc.KSP.Type.PREONLY

    @property
    def entries(self) -> float:
        """Number of entries that a direct solve reads: those of the factors, or at least of K."""
        pc, K = self.preconditioner, self.matrix
        factors = pc.getFactorMatrix() if pc.getType() in ("lu", "cholesky") else K
        return max(float(matrix.getInfo()["nz_used"]) for matrix in (K, factors))

    def solve_several(self, F: PETSc.Mat, U: PETSc.Mat) -> None:
        """Solve K U = F for the columns of dense matrices, with a direct solver. Collective."""
        for matrix in (F, U):
            matrix.assemble()
        self._ksp.matSolve(F, U)
        self.solves += F.getSize()[1]
        if self._ksp.getConvergedReason() < 0:
            raise self._failure()

    def improve(self, f: PETSc.Vec, u: PETSc.Vec, *, rtol: float, accuracy: float) -> float:
        """Solve K u = f from the best multiple of the given u, and return the error. Collective.

        An iteration stops at the relative error `rtol`, or at the absolute error `accuracy`, both
        in the energy norm. The result estimates |u - K^-1 f|_K [energy^(1/2)]; 0 for a direct
        solver. It is as in `error`, but if the iteration converged from the residual that it
        updates, which contains no rounding. The caller must judge it: it is larger than requested
        if the iteration ended at its largest number of steps, or by rounding near the solution.
        """
        if self.exact:
            return self.solve(f, u)
        tolerances = self._ksp.getTolerances()
        self._ksp.setInitialGuessNonzero(self._scale_guess(u, f))
        self._ksp.setTolerances(rtol=rtol, atol=max(accuracy / self.uncertainty, LEAST_DIVISOR))
        try:
            return self.solve(f, u)
        finally:
            self._ksp.setTolerances(*tolerances)
            self._ksp.setInitialGuessNonzero(False)

    def _scale_guess(self, u: PETSc.Vec, f: PETSc.Vec) -> bool:
        """Replace u by its multiple nearest to K^-1 f; return whether that is not zero. Collective.

        In the energy norm this is u (u'f) / (u'K u). After a change of load, rounding of a guess
        that is too large may exceed the requested accuracy.
        """
        Ku = f.duplicate()
        self.matrix.mult(u, Ku)
        square, work = float(u.dot(Ku)), float(u.dot(f))
        Ku.destroy()
        factor = work / square if square > 0.0 and np.isfinite(work / square) else 0.0
        u.scale(factor)
        return factor != 0.0

    def solve(self, f: PETSc.Vec, u: PETSc.Vec) -> float:
        """Solve K u = f to the accuracy in the options; return the `error`. Collective."""
        self.check_ready()
        self._ksp.solve(f, u)
        self.solves += 1
        reason = self._ksp.getConvergedReason()
        if self.exact:
            if reason < 0:
                raise self._failure()
            self._check_exact(f, u)
            return 0.0
        iterations = self._ksp.getIterationNumber()
        self.krylov_iterations += iterations
        if self._ksp.getType() == PETSc.KSP.Type.CG and iterations > 1:
            ritz_value = float(self._ksp.computeEigenvalues().real.min())  # of M^-1 K
            if ritz_value > 0.0:
                self._least_eigenvalue = min(self._least_eigenvalue, ritz_value)
        if reason > 0 and self._ksp.getNormType() == PETSc.KSP.NormType.NATURAL:
            return float(self._ksp.getResidualNorm()) * self.uncertainty
        # residuals that are updated from step to step do not contain rounding
        error = self.error(f, u)
        if reason < 0:
            self._check_stop(f, error)
        return error

    def _check_stop(self, f: PETSc.Vec, error: float) -> None:
        """Raise an error if an iteration broke down far from the solution. Collective.

        Near the solution, rounding is the cause. Then, or after the largest number of iterations,
        the log warns, once, since further solves will miss the tolerance, too.
        """
        reason, accepted = self._ksp.getConvergedReason(), np.inf
        if reason != PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
            accepted = ROUGH * self.error(f, f.duplicate())  # of u = 0
        if not (np.isfinite(error) and error <= accepted):
            raise self._failure()
        if not self._warned:
            self._warned = True
            warn(
                self.comm,
                "the %s solver for K stopped after %d iterations, by PETSc's reason %d, with an "
                "error of %.1e in the energy norm, and misses its tolerance; further ones are not "
                "reported. Try stiffness='cholesky', or other petsc_options.",
                *(self.name, self._ksp.getIterationNumber(), reason, error),
            )

    def _check_exact(self, f: PETSc.Vec, u: PETSc.Vec) -> None:
        """Check once that a solve without iteration, of any options, is exact. Collective."""
        largest_force = f.norm(PETSc.NormType.INFINITY)
        if self._measured or not largest_force > 0.0:
            return
        self._measured = True
        K, residual = self.matrix, self.matrix.createVecLeft()
        K.mult(u, residual)
        residual.axpy(-1.0, f)
        terms = K.norm(PETSc.NormType.INFINITY) * u.norm(PETSc.NormType.INFINITY)
        error = residual.norm(PETSc.NormType.INFINITY) / (terms + largest_force)
        if error > 1e-8:  # a factorisation leaves about 1e-16, whatever the condition of K
            raise StiffnessError(
                f"{self}, without iteration, leaves {error:.1e} of K u as residual: that is no "
                'exact solve, and errors would not be known. Take {"ksp_type": "cg"}.'
            )

    @property
    def uncertainty(self) -> float:
        """Ratio lambda_min(M^-1 K)^(-1/2) by which an error may exceed sqrt(r'M^-1 r); see `error`.

        The Lanczos process in conjugate gradients estimates it, too low after few iterations. It is
        1 for direct solvers.
        """
        return 1.0 / float(np.sqrt(self._least_eigenvalue))

    def error(self, f: PETSc.Vec, u: PETSc.Vec) -> float:
        """Return an estimate of |u - K^-1 f|_K, or 0 for a direct solver. Collective.

        It is sqrt(|r'M^-1 r|) times `uncertainty`, with the residual r and the preconditioner M: a
        bound if `uncertainty` is large enough, and no estimate if M is indefinite.
        """
        if self.exact:
            return 0.0
        residual, corrected = f.duplicate(), f.duplicate()
        self.matrix.mult(u, residual)
        residual.aypx(-1.0, f)
        self.preconditioner.apply(residual, corrected)
        square = float(residual.dot(corrected))
        residual.destroy()
        corrected.destroy()
        return float(np.sqrt(abs(square))) * self.uncertainty

    def _failure(self) -> StiffnessError:
        """Return the error to raise after a failed solve."""
        reason = self._ksp.getConvergedReason()
        advice = _ADVICE.get(reason, "Try stiffness='cholesky', or other petsc_options.")
        return StiffnessError(
            f"the {self.name} solver for K ended with PETSc's reason {reason} after "
            f"{self._ksp.getIterationNumber()} iterations. {advice}"
        )

    def __str__(self) -> str:
        if self._ksp is None:
            return f"{self.name}, not set up"
        pc = self._ksp.getPC()
        kind = f"{self._ksp.getType()} with {pc.getType()}"
        if pc.getType() == PETSc.PC.Type.MG:
            below = pc.getMGCoarseSolve().getPC().getType()
            kind += f" of {pc.getMGLevels()} levels, {below} below"
        if pc.getType() == PETSc.PC.Type.CHOLESKY:
            package, factor = pc.getFactorSolverType(), pc.getFactorMatrix()
            kind += f", {package.upper()}"
            if package == "mumps":  # INFOG(22): megabytes of all ranks in the factorisation
                kind += f", {factor.getMumpsInfog(22)} MB"
        return f"{self.name} ({kind})"

    def destroy(self) -> None:
        """Free the PETSc objects; a later `solve` is an error. Collective."""
        if self._ksp is not None:
            self._ksp.destroy()
            self._ksp = None


#: Workspace of MUMPS beyond its own estimate, in percent. The estimate may be too low by more than
#: the default of 20, as for a column of 300 bodies.
SPARE_WORKSPACE = 200


def _given(petsc_options: Mapping[str, Any], prefix: str | None) -> set[str]:
    """Return the names of the user's options in the argument and in PETSc's database."""
    return {*petsc_options, *(() if prefix is None else PETSc.Options(prefix).getAll())}


def cholesky(
    K: PETSc.Mat, options: Mapping[str, Any], prefix: str | None, negative_pivots: int | None = 0
) -> StiffnessSolver:
    """Return a solver with the factors of K, with the user's options and prefix. Collective.

    A saddle-point matrix (A, B'; B, -C) has as many `negative_pivots` as unknowns other than
    displacements: then, by Sylvester's law of inertia, A + B'C^-1 B is positive definite, or, if C
    is zero, A on the vectors u with B u = 0. None: K may have pivots of any sign, but not zero.
    """
    defaults: dict[str, Any] = {
        "ksp_type": "preonly",
        "pc_type": "cholesky",
        "pc_factor_mat_solver_type": "mumps",
        # CHOLMOD's default for small matrices, LDL', accepts negative pivots
        "mat_cholmod_factor": "SUPERNODAL",
        "mat_cholmod_print": 0,  # PETSc reports errors
        # METIS; a MUMPS without it, as in Debian, takes PORD, which of its own orderings gives the
        # sparsest factors of bodies in 3D
        "mat_mumps_icntl_7": 5,
        "mat_mumps_icntl_14": SPARE_WORKSPACE,
    }
    if negative_pivots == 0:  # no pivoting: K is positive definite, or the check below fails
        defaults["mat_mumps_cntl_1"] = 0.0
    else:  # L D L' with pivots of size 1 and 2, whose signs are counted
        defaults["mat_mumps_icntl_13"] = 1  # no ScaLAPACK in the last front: it counts no signs
        defaults["mat_mumps_icntl_24"] = 1  # detect zero pivots
    package = "pc_factor_mat_solver_type"
    chosen = any(name.startswith((package, "mat_mumps_")) for name in _given(options, prefix))
    if K.comm.size == 1 and negative_pivots == 0 and not chosen:
        # CHOLMOD's solves take half the time of MUMPS's. It fails where PETSc does not have it,
        # where its 32-bit integers overflow, and for an indefinite K, whose pivots MUMPS counts
        with suppress(StiffnessError):
            return StiffnessSolver("cholesky", K, defaults | {package: "cholmod"}, options, prefix)
    solver = StiffnessSolver("cholesky", K, defaults, options, prefix)
    with destroyed_on_error(solver):
        _check_pivots(K, solver.preconditioner, negative_pivots)
    return solver


def _check_pivots(K: PETSc.Mat, pc: PETSc.PC, negative_pivots: int | None) -> None:
    """Check the signs of MUMPS's pivots: none negative, or as `cholesky` says for saddle points."""
    if pc.getType() != PETSc.PC.Type.CHOLESKY or pc.getFactorSolverType() != "mumps":
        return  # the user has chosen another solver
    failure, reason, negative, zero = map(pc.getFactorMatrix().getMumpsInfog, (1, 2, 12, 28))
    if failure < 0:
        raise StiffnessError(
            f"MUMPS could not factor K: INFOG(1) = {failure}, INFOG(2) = {reason} (-10: "
            "singular, -9 or -13: out of memory). For large models take stiffness='multigrid'."
        )
    if negative_pivots == 0 and negative > 0:
        raise indefinite_error(f"{negative} of {K.getSize()[0]} pivots are negative")
    if negative_pivots != 0 and zero > 0:
        raise StiffnessError(
            f"K is singular: {zero} of {K.getSize()[0]} pivots are zero. Nothing holds a body; "
            "or a pressure is not determined, since all of the boundary is clamped, or since "
            "spaces are no stable pair, such as degree 2 for u and degree 1 for p."
        )
    if negative_pivots and negative != negative_pivots:
        error = StiffnessError(
            f"K has {negative} negative pivots, but {negative_pivots} unknowns that are no "
            "displacements. Check the material data, and the signs of the form: a(u, v) + "
            "b(v, p) + b(u, q) - c(p, q), where c(p, p) >= 0 and a is positive definite."
        )
        if negative > negative_pivots:
            error.evidence = f"{negative - negative_pivots} pivots of displacements are negative"
        raise error


def multigrid(
    K: PETSc.Mat, V: Any, prescribed: Mask, petsc_options: Mapping[str, Any], prefix: str | None
) -> StiffnessSolver:
    """Return a solver for K by conjugate gradients with multigrid. Collective.

    For degree 2, errors are smoothed on V and on the space of degree 1 on the same mesh, and GAMG
    is applied to the matrix P'KP of the latter, with the interpolation P; for degree 1, GAMG is
    applied to K. If the options name a `pc_type`, this preconditioner is applied to K; if they name
    a smoother, Chebyshev's polynomials complete its options. Options of GAMG and of smoothers apply
    to all levels; with `mg_coarse_` before their names, only to GAMG's, from degree 1 down.
    """
    given = _given(petsc_options, prefix)
    krylov: dict[str, Any] = {
        "ksp_type": "cg",
        "ksp_norm_type": "natural",  # sqrt(r'M^-1 r), which is nearly the error in the energy norm
        "ksp_rtol": 1e-10,
        "ksp_max_it": 500,
        "ksp_divtol": 1e300,  # the error only falls, but residuals may grow before they fall
    }
    gamg: dict[str, Any] = {
        "pc_type": "gamg",
        "pc_gamg_type": "agg",
        "pc_gamg_threshold": 0.01,
        "pc_gamg_esteig_ksp_max_it": 5,
    }
    smoother: dict[str, Any] = {"mg_levels_pc_type": "sor", "mg_levels_ksp_max_it": 1}
    types = ("mg_levels_ksp_type", "mg_levels_pc_type")
    smoothers = {*types, *(f"mg_coarse_{name}" for name in types)}
    if K.comm.size == 1 and given.isdisjoint(smoothers):
        # symmetric block Gauss-Seidel: errors fall in the energy norm for any positive definite K,
        # and the preconditioner is positive definite without an estimate of eigenvalues
        smoother["mg_levels_ksp_type"] = "richardson"
    else:
        # Each rank applies the Gauss-Seidel method to its own rows, M = diag(M_i). The largest
        # eigenvalue of M^-1 K may approach the number of ranks that meet at a node, and errors grow
        # if it exceeds 2. Chebyshev's polynomial, made for this largest eigenvalue, avoids the
        # growth. If its estimate is too low, the smoother is indefinite: with stiffnesses that
        # differ by 1e5, ten steps of the estimate were too few.
        smoother["mg_levels_ksp_type"] = "chebyshev"
        smoother["mg_levels_esteig_ksp_max_it"] = 30
    gamg |= smoother
    if V.element.basix_element.degree == 1 or "pc_type" in given:
        _set_rigid_body_modes(K, V)
        return StiffnessSolver("multigrid", K, krylov | gamg, petsc_options, prefix)
    two_levels: dict[str, Any] = {
        "pc_type": "mg",
        # two cycles of GAMG on the coarsest space. They are cheap, since K of degree 1 has a
        # fifteenth of the entries of K of degree 2; with one, a solve takes a third more iterations
        "mg_coarse_ksp_type": "richardson",
        "mg_coarse_ksp_max_it": 2,
        "mg_coarse_ksp_norm_type": "none",
        **smoother,
    }
    two_levels |= {f"mg_coarse_{name}": value for name, value in gamg.items()}
    # the user's options once more with the prefix of the GAMG solver, which is the coarse solver
    repeated_for_gamg = {
        f"mg_coarse_{name}": value
        for name, value in petsc_options.items()
        if name.startswith(("pc_gamg_", "mg_levels_"))
    }
    prepare = partial(_add_degree_1, K=K, V=V, prescribed=prescribed)
    options = repeated_for_gamg | dict(petsc_options)
    return StiffnessSolver("multigrid", K, krylov | two_levels, options, prefix, prepare)


def _add_degree_1(pc: PETSc.PC, K: PETSc.Mat, V: Any, prescribed: Mask) -> None:
    """Make a preconditioner of degree 2 a multigrid with a level of degree 1 below. Collective.

    The matrix P'KP of the level includes additions to K, such as the springs of floating bodies.
    """
    coarse = fem.functionspace(V.mesh, ("Lagrange", 1, (V.dofmap.index_map_bs,)))
    P = dolfinx.fem.petsc.interpolation_matrix(coarse, V)
    P.assemble()
    free = K.createVecLeft()
    free.array = ~prescribed
    ones = P.copy()
    ones.chop(0.99)  # common nodes have a 1, and other nodes smaller entries
    coarse_free = ones.createVecRight()
    ones.multTranspose(free, coarse_free)
    coarse_free.array = coarse_free.array.round()
    # if either scaling is left out, corrections change prescribed values, and far more iterations
    # are needed
    P.diagonalScale(free, coarse_free)
    # a copy drops data for further products, which are larger than the matrix
    matrix = K.ptap(P).copy()
    held = matrix.getOwnershipRange()[0] + np.flatnonzero(coarse_free.array == 0.0)
    matrix.zeroRowsColumns(held.astype(PETSc.IntType), 1.0)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    _set_rigid_body_modes(matrix, coarse)
    pc.setType(PETSc.PC.Type.MG)
    pc.setMGLevels(2)
    pc.setMGInterpolation(1, P)
    pc.getMGSmoother(0).setOperators(matrix)


def _set_rigid_body_modes(K: PETSc.Mat, V: Any) -> None:
    """Tell GAMG the rigid modes of the whole mesh, which on each body are its own. Collective."""
    nodes, dim = V.dofmap.index_map, V.mesh.geometry.dim
    points = K.createVecRight()
    points.setBlockSize(dim)
    points.array = V.tabulate_dof_coordinates()[: nodes.size_local, :dim].ravel()
    K.setNearNullSpace(PETSc.NullSpace().createRigidBody(points))
