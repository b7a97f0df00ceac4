"""Sparse Cholesky factorisation of K by CHOLMOD or MUMPS: one factorisation, cheap solves."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from petsc4py import PETSc

from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.stiffness.solver import StiffnessSolver

PACKAGE = "pc_factor_mat_solver_type"
ON_ONE_RANK = "cholmod"

DEFAULTS = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    PACKAGE: "mumps",
    # what CHOLMOD would take for small matrices is LDL', which lets negative pivots pass
    "mat_cholmod_factor": "SUPERNODAL",
    "mat_cholmod_print": 0,  # errors come by PETSc
    # METIS; where MUMPS is built without, as Debian's is, it takes PORD, as INFOG(7) = 4 tells: of
    # what Debian's has (AMD, AMF, QAMD, PORD) that gives the sparsest factors of volumes
    "mat_mumps_icntl_7": 5,
    "mat_mumps_icntl_14": 200,  # percent of workspace to spare: its estimate is too low at times
    "mat_mumps_cntl_1": 0.0,  # no pivoting: K is positive definite, or else the check below says so
}


def cholesky(K: PETSc.Mat, petsc_options: Mapping[str, Any], prefix: str | None) -> StiffnessSolver:
    """Return a factorised K. Collective.

    By CHOLMOD on one rank, which takes three quarters of MUMPS' time; what it does not factor MUMPS
    does, or says why it cannot: PETSc may be built without CHOLMOD, factors may have more entries
    than its 32-bit integers count, and of a K that is not positive definite it notes but the first
    bad pivot. MUMPS it is, too, where the user has options for it.

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


def _positive_pivots(ksp: PETSc.KSP) -> None:
    """Raise where MUMPS met pivots that are not positive, or failed."""
    pc = ksp.getPC()
    if pc.getType() != PETSc.PC.Type.CHOLESKY:
        return
    factor = pc.getFactorMatrix()
    if pc.getFactorSolverType() != "mumps":
        return
    failure, negative = factor.getMumpsInfog(1), factor.getMumpsInfog(12)
    if failure < 0:
        raise StiffnessError(
            f"MUMPS could not factor K: INFOG(1) = {failure}, INFOG(2) = {factor.getMumpsInfog(2)} "
            "(-10: singular, -9 or -13: out of memory; see its manual). For large models take "
            "stiffness='multigrid'."
        )
    if negative > 0:
        raise StiffnessError(
            f"K is not positive definite: {negative} of {factor.getSize()[0]} pivots are negative. "
            "Check Young's moduli, Poisson ratios (below 0.5) and the signs in the form a."
        )
