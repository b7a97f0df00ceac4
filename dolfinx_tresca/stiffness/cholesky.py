"""Sparse symmetric factorisation of K by CHOLMOD or MUMPS: one factorisation, cheap solves."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from petsc4py import PETSc

from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.stiffness.solver import StiffnessSolver, not_positive_definite

PACKAGE = "pc_factor_mat_solver_type"
ON_ONE_RANK = "cholmod"

#: Workspace of MUMPS beyond its own estimate, in percent. The estimate may be too low by more than
#: the default of 20, as for a column of 300 bodies.
SPARE_WORKSPACE = 200

DEFAULTS = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    PACKAGE: "mumps",
    # for small matrices CHOLMOD's default is LDL', which accepts negative pivots
    "mat_cholmod_factor": "SUPERNODAL",
    "mat_cholmod_print": 0,  # PETSc reports errors
    # METIS; a MUMPS built without it, such as Debian's, takes PORD (INFOG(7) = 4), which among the
    # orderings in Debian's MUMPS (AMD, AMF, QAMD, PORD) gives the sparsest factors of 3D bodies
    "mat_mumps_icntl_7": 5,
    "mat_mumps_icntl_14": SPARE_WORKSPACE,
    "mat_mumps_cntl_1": 0.0,  # no pivoting: K is positive definite, or the check below fails
}

#: Options for saddle-point matrices: L D L' with pivots of size 1 and 2, whose signs are counted.
SADDLE = {
    **{name: value for name, value in DEFAULTS.items() if name != "mat_mumps_cntl_1"},
    "mat_mumps_icntl_13": 1,  # the last front is not factored by ScaLAPACK, which counts no signs
    "mat_mumps_icntl_24": 1,  # detect zero pivots
}


def cholesky(K: PETSc.Mat, petsc_options: Mapping[str, Any], prefix: str | None) -> StiffnessSolver:
    """Return a solver with the Cholesky factors of K. Collective.

    On one rank CHOLMOD is tried first: it takes three quarters of the time of MUMPS. If CHOLMOD
    fails, MUMPS factors K, or gives the reason of the failure. CHOLMOD fails if PETSc is built
    without it, if the factors have more entries than its 32-bit integers count, or if K is not
    positive definite; in the last case it reports the first bad pivot only. The user's options may
    choose another package.

    Args:
        K: the matrix.
        petsc_options: PETSc options in addition to the defaults.
        prefix: prefix of the user's options in PETSc's database; None: there is none.

    Raises:
        StiffnessError: K is not positive definite, or the factorisation failed.
    """
    given = {*petsc_options, *(PETSc.Options(prefix).getAll() if prefix else ())}
    chosen = any(name == PACKAGE or name.startswith("mat_mumps_") for name in given)
    if K.comm.size == 1 and not chosen:
        with suppress(StiffnessError):
            faster = DEFAULTS | {PACKAGE: ON_ONE_RANK}
            return StiffnessSolver("cholesky", K, faster, petsc_options, prefix)
    return StiffnessSolver("cholesky", K, DEFAULTS, petsc_options, prefix, check=_positive_pivots)


def saddle_cholesky(
    K: PETSc.Mat, petsc_options: Mapping[str, Any], prefix: str | None, constraints: int | None
) -> StiffnessSolver:
    """Return a solver with the factors of the saddle-point matrix K = (A, B'; B, -C). Collective.

    Args:
        K: the matrix.
        petsc_options: PETSc options in addition to the defaults.
        prefix: prefix of the user's options in PETSc's database.
        constraints: number of unknowns other than displacements, such as pressures. The number of
            negative pivots must equal this number. By Sylvester's law of inertia A + B'C^-1 B is
            then positive definite; if C is zero, A is positive definite on the vectors u with
            B u = 0. None: the pivots are not checked.

    Raises:
        StiffnessError: K is singular, the number of negative pivots is wrong, or the factorisation
            failed.
    """

    def check(ksp: PETSc.KSP) -> None:
        factor = _mumps_factor(ksp)
        if factor is None:
            return
        negative, zero = factor.getMumpsInfog(12), factor.getMumpsInfog(28)
        if zero > 0:
            raise StiffnessError(
                f"K is singular: {zero} of {factor.getSize()[0]} pivots are zero. Either nothing "
                "holds a body; or a pressure is not determined: if all of the boundary is clamped, "
                "it is known up to a constant only, and spaces must be a stable pair, such as "
                "degree 2 for u and degree 1 for p."
            )
        if constraints is not None and negative != constraints:
            raise StiffnessError(
                f"K has {negative} negative pivots, but {constraints} unknowns that are no "
                "displacements: it is not K of a stable body with a pressure. Its form must be "
                "a(u, v) + b(v, p) + b(u, q) - c(p, q), with c(p, p) >= 0 and a positive definite "
                "where b(u, q) = 0 for all q. Check the signs in the form a, and the material data."
            )

    return StiffnessSolver("cholesky", K, SADDLE, petsc_options, prefix, check=check)


def _mumps_factor(ksp: PETSc.KSP) -> PETSc.Mat | None:
    """Return the factor of MUMPS; None if options have chosen another solver.

    Raises:
        StiffnessError: the factorisation failed.
    """
    pc = ksp.getPC()
    if pc.getType() != PETSc.PC.Type.CHOLESKY or pc.getFactorSolverType() != "mumps":
        return None
    factor = pc.getFactorMatrix()
    failure = factor.getMumpsInfog(1)
    if failure < 0:
        raise StiffnessError(
            f"MUMPS could not factor K: INFOG(1) = {failure}, INFOG(2) = {factor.getMumpsInfog(2)} "
            "(-10: singular, -9 or -13: out of memory; see its manual). For large models take "
            "stiffness='multigrid'."
        )
    return factor


def _positive_pivots(ksp: PETSc.KSP) -> None:
    """Raise an error if MUMPS found negative pivots, or failed.

    Raises:
        StiffnessError: K is not positive definite, or the factorisation failed.
    """
    factor = _mumps_factor(ksp)
    negative = 0 if factor is None else factor.getMumpsInfog(12)
    if factor is not None and negative > 0:
        raise not_positive_definite(f"{negative} of {factor.getSize()[0]} pivots are negative")
