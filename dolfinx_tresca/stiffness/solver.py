"""The solver for K u = f: a PETSc KSP with its own options."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import count
from typing import Any

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arguments import check_type
from dolfinx_tresca._base.arrays import LEAST_DIVISOR
from dolfinx_tresca._base.parallel import warn
from dolfinx_tresca._base.petsc import PetscOwner, destroyed_on_error
from dolfinx_tresca._base.tolerances import ROUGH
from dolfinx_tresca.errors import ContactError, InputError, StiffnessError, shown

#: Advice for breakdowns without a solution, by PETSc's reason.
_ADVICE = {
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_MAT: (
        "It met a displacement of negative strain energy: K is not positive definite. Check "
        "Young's moduli, Poisson ratios (below 0.5) and the signs in the form a."
    ),
    PETSc.KSP.ConvergedReason.DIVERGED_INDEFINITE_PC: (
        "The preconditioner is not positive definite. Either K is not, by the material data; or "
        "stiffnesses differ so much (by 1e12, say) that rounding spoils the coarse matrices or, "
        "on several ranks, the smoother misjudges its largest eigenvalue. stiffness='cholesky' "
        "has no preconditioner and tells which: take it, or make soft parts less soft, or raise "
        "mg_levels_esteig_ksp_max_it in petsc_options."
    ),
}

_numbers = count()


def not_positive_definite(evidence: str) -> StiffnessError:
    """Return the error to raise if K is not positive definite, with a clause that shows it."""
    error = StiffnessError(
        f"K is not positive definite: {evidence}. Check Young's moduli (a value in every cell), "
        "Poisson ratios (below 0.5) and the signs in the form a."
    )
    error.evidence = evidence
    return error


class StiffnessSolver(PetscOwner):
    """Solves K u = f for many f.

    Owns PETSc objects: call `destroy()`.

    Attributes:
        name: "cholesky" or "multigrid".
        solves: number of solved systems.
        krylov_iterations: iterations of all solves together; 0 for a direct solver.
    """

    def __init__(
        self,
        name: str,
        K: PETSc.Mat,
        defaults: Mapping[str, Any],
        petsc_options: Mapping[str, Any],
        prefix: str | None,
        prepare: Callable[[PETSc.PC], None] = lambda pc: None,
        check: Callable[[PETSc.KSP], None] = lambda ksp: None,
    ) -> None:
        """Set the solver up: factor K, or build the hierarchy. Collective.

        Args:
            name: name of the solver for tables.
            K: the matrix.
            defaults: PETSc options that define the solver.
            petsc_options: options of the user, which take precedence.
            prefix: prefix in PETSc's database of options. Options that this database has already,
                from a command line, take precedence over `defaults`. None: a new prefix.
            prepare: function that sets up those parts of the preconditioner that options cannot set
                up.
            check: function that raises an error if the finished set-up shows that K is not positive
                definite.

        Raises:
            InputError: the options allow no iteration.
            StiffnessError: the set-up failed.
        """
        self.name, self.comm = name, K.comm
        self.solves = 0
        self.krylov_iterations = 0
        self._least_eigenvalue = 1.0
        self._warned = self._measured = False
        prefix = f"dolfinx_tresca_{next(_numbers)}_" if prefix is None else prefix
        self._ksp: Any = PETSc.KSP().create(K.comm)
        self._ksp.setOptionsPrefix(prefix)
        self._ksp.setOperators(K)
        options = PETSc.Options(prefix)
        mine = {key: value for key, value in defaults.items() if not options.hasName(key)}
        mine |= petsc_options
        for key, value in mine.items():
            options[key] = value
        try:
            with destroyed_on_error(self):
                prepare(self._ksp.getPC())
                self._ksp.setFromOptions()
                if self._ksp.getTolerances()[3] < 1:  # PETSc would write beyond an empty array
                    raise InputError("ksp_max_it must be at least 1, found 0.")
                self._ksp.setComputeEigenvalues(True)
                self._ksp.setUp()
                check(self._ksp)
        except PETSc.Error as error:
            raise StiffnessError(
                f"setting up the {name} solver for K failed: {error}. Check the material data, "
                "the PETSc options, and whether memory suffices."
            ) from error
        finally:
            for key in mine:
                del options[key]

    def check_ready(self) -> None:
        """Check that K is factored, or that its preconditioner is set up.

        Raises:
            ContactError: the solver was destroyed.
        """
        if self._ksp is None:
            raise ContactError(
                "K is not factored: the problem was destroyed, or its update_stiffness() failed."
            )

    @property
    def matrix(self) -> PETSc.Mat:
        """K, owned by the solver."""
        return self._ksp.getOperators()[0]

    @property
    def preconditioner(self) -> PETSc.PC:
        """The preconditioner, or the factorisation; owned by the solver."""
        return self._ksp.getPC()

    @property
    def exact(self) -> bool:
        """Whether solves are exact to rounding, whatever accuracy is requested."""
        return self._ksp is None or self._ksp.getType() == PETSc.KSP.Type.PREONLY

    def solve_several(self, F: PETSc.Mat, U: PETSc.Mat) -> None:
        """Solve K U = F for the columns of dense matrices. Collective.

        Raises:
            StiffnessError: the solver failed.
        """
        for matrix in (F, U):
            matrix.assemble()
        self._ksp.matSolve(F, U)
        self.solves += F.getSize()[1]
        if self._ksp.getConvergedReason() < 0:
            raise self._failure()

    def improve(self, f: PETSc.Vec, u: PETSc.Vec, *, rtol: float, accuracy: float) -> float:
        """Solve K u = f from the present `u`, only to the requested accuracy. Collective.

        Args:
            f: right-hand side.
            u: first guess, from whose best multiple the iteration starts; on return the solution.
            rtol: relative error in the energy norm at which the iteration stops.
            accuracy: absolute error in the energy norm, as `error` estimates it, at which the
                iteration stops as well. Neither `rtol` nor `accuracy` has an effect on a direct
                solver.

        Returns:
            |u - K^-1 f|_K [energy^(1/2)], estimated as in `error`, but from the residual that the
            iteration updates, which contains no rounding; 0 for a direct solver. The error is
            larger than requested if the iteration stopped early: at its largest number of steps, or
            when rounding broke it down near the solution. The caller must judge whether the error
            is acceptable.

        Raises:
            ContactError: the solver was destroyed.
            StiffnessError: the iteration broke down.
        """
        self.check_ready()
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
        """Replace u by its multiple nearest to K^-1 f; return whether the multiple is not zero.

        The distance is in the energy norm. After a change of load a guess may be larger than the
        solution by many orders of magnitude; rounding of the guess then exceeds the requested
        accuracy.
        """
        Ku = f.duplicate()
        self.matrix.mult(u, Ku)
        square, work = float(u.dot(Ku)), float(u.dot(f))
        Ku.destroy()
        factor = work / square if 0.0 < square < np.inf else 0.0
        if not np.isfinite(factor):
            factor = 0.0
        u.scale(factor)
        return factor != 0.0

    def solve(self, f: PETSc.Vec, u: PETSc.Vec) -> float:
        """Solve K u = f, to the accuracy in the solver's options. Collective.

        Returns:
            the remaining error, as `improve` returns it.

        Raises:
            ContactError: the solver was destroyed.
            StiffnessError: the iteration broke down.
        """
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
            accepted = np.inf
            if reason != PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT:
                accepted = ROUGH * self.error(f, f.duplicate())
            if not (np.isfinite(error) and error <= accepted):  # below, rounding is the cause
                raise self._failure()
            if not self._warned:  # once, since further solves will miss the tolerance, too
                self._warned = True
                warn(
                    self.comm,
                    "the %s solver for K stopped after %d iterations, by PETSc's reason %d, with "
                    "an error of %.1e in the energy norm, and misses its tolerance; further ones "
                    "are not reported. Try stiffness='cholesky', or other petsc_options.",
                    *(self.name, iterations, reason, error),
                )
        return error

    def _check_exact(self, f: PETSc.Vec, u: PETSc.Vec) -> None:
        """Check, once, that a solve without iteration is exact to rounding. Collective.

        The measure is the backward error |f - K u| / (|K| |u| + |f|), in the maximum norm.

        Raises:
            StiffnessError: the solve is not exact.
        """
        size = f.norm(PETSc.NormType.INFINITY)
        if self._measured or not size > 0.0:
            return
        self._measured = True
        K, residual = self.matrix, self.matrix.createVecLeft()
        K.mult(u, residual)
        residual.axpy(-1.0, f)
        terms = K.norm(PETSc.NormType.INFINITY) * u.norm(PETSc.NormType.INFINITY) + size
        error = residual.norm(PETSc.NormType.INFINITY) / terms
        if error > 1e-8:  # a factorisation leaves about 1e-16, whatever the condition of K
            raise StiffnessError(
                f"the {self.name} solver for K, {self}, does not iterate, and leaves {error:.1e} "
                "of K u as residual: that is no exact solve, and errors would not be known. Take "
                'petsc_options={"ksp_type": "cg"} with this preconditioner.'
            )

    @property
    def uncertainty(self) -> float:
        """Ratio by which an error in the energy norm may exceed sqrt(r'M^-1 r).

        Here r is the residual and M the preconditioner. The ratio is lambda_min(M^-1 K)^(-1/2). It
        is estimated by the Lanczos process in conjugate gradients. The estimate is exact in the
        limit of many iterations, and too low after few iterations. It is 1 for direct solvers.
        """
        return 1.0 / float(np.sqrt(self._least_eigenvalue))

    def error(self, f: PETSc.Vec, u: PETSc.Vec) -> float:
        """Return an estimate of |u - K^-1 f|_K, or 0 for a direct solver. Collective.

        The estimate is sqrt(|r'M^-1 r|) times `uncertainty`, with the residual r and the
        preconditioner M. It is a bound if `uncertainty` is large enough. If M is indefinite, the
        value is no estimate.
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


def check_options(petsc_options: Any, prefix: Any) -> None:
    """Check the types of PETSc options and of their prefix. Not collective.

    Raises:
        InputError: a type is wrong, or the prefix has a leading hyphen.
    """
    names = 'a mapping from names, such as {"ksp_rtol": 1e-8}'
    check_type("petsc_options", petsc_options, Mapping, names)
    for key in petsc_options:
        check_type("a name in petsc_options", key, str, "a string")
    if prefix is not None and (not isinstance(prefix, str) or prefix.startswith("-")):
        raise InputError(
            f"petsc_options_prefix must be a string without leading hyphen, found {shown(prefix)}."
        )
