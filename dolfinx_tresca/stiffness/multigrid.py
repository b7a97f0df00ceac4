"""Conjugate gradients for K, with multigrid on known coarser spaces, and GAMG below them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from petsc4py import PETSc

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca.stiffness.coarse_level import add_levels, has_levels, set_rigid_body_modes
from dolfinx_tresca.stiffness.solver import StiffnessSolver

KRYLOV = {
    "ksp_type": "cg",
    "ksp_norm_type": "natural",  # sqrt(r'M^-1 r), which is nearly the error in the energy norm
    "ksp_rtol": 1e-10,
    "ksp_max_it": 500,
    "ksp_divtol": 1e300,  # the error only falls, but residuals may grow before they fall
}

#: Smoother on one rank, symmetric block Gauss-Seidel. Errors fall in the energy norm for any
#: positive definite K: the preconditioner is positive definite without an estimate of eigenvalues.
GAUSS_SEIDEL = {
    "mg_levels_ksp_type": "richardson",
    "mg_levels_pc_type": "sor",  # treats a node's degrees of freedom together
    "mg_levels_ksp_max_it": 1,
}

#: Smoother on several ranks. Each rank applies the Gauss-Seidel method to its own rows,
#: M = diag(M_i). The largest eigenvalue of M^-1 K may approach the number of ranks that meet at a
#: node, and errors grow if this eigenvalue exceeds 2 (on three and more ranks the preconditioner
#: was seen to be indefinite). Chebyshev's polynomial, made for this largest eigenvalue, avoids the
#: growth.
CHEBYSHEV = {
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "sor",
    "mg_levels_ksp_max_it": 1,
    # steps that estimate the largest eigenvalue: if the estimate is too low, the smoother is
    # indefinite. With stiffnesses that differ by 1e5, ten steps were too few
    "mg_levels_esteig_ksp_max_it": 30,
}

#: Options that name a smoother.
SMOOTHERS = [
    f"{level}mg_levels_{kind}_type" for level in ("", "mg_coarse_") for kind in ("ksp", "pc")
]

#: Solver on the coarsest space: two cycles of GAMG. The cycles are cheap, since K of degree 1 has a
#: fifteenth of the entries of K of degree 2; with one cycle a solve takes a third more iterations.
COARSEST = {
    "mg_coarse_ksp_type": "richardson",
    "mg_coarse_ksp_max_it": 2,
    "mg_coarse_ksp_norm_type": "none",
}

GAMG = {
    "pc_type": "gamg",
    "pc_gamg_type": "agg",
    "pc_gamg_threshold": 0.01,
    "pc_gamg_esteig_ksp_max_it": 5,
}


def multigrid(
    K: PETSc.Mat,
    V: Any,
    prescribed: Mask,
    petsc_options: Mapping[str, Any],
    prefix: str | None,
) -> StiffnessSolver:
    """Return a solver for K by conjugate gradients with multigrid. Collective.

    The level below a space of degree 2 is the space of degree 1 on the same mesh; the levels below
    a space on a mesh from `adapt.refine` are spaces on the coarser meshes. Errors are smoothed on
    each of these spaces, and GAMG is applied to the matrix P'KP of the coarsest space, with the
    interpolation P to V, or to K if there are no levels below. If the options name a `pc_type`,
    GAMG or another, this preconditioner is applied to K; if they name a smoother, `CHEBYSHEV`
    completes its options.

    Args:
        K: the matrix, with the springs of floating bodies, if there are any, and with identity rows
            and columns for prescribed values.
        V: the space of the unknowns u.
        prescribed: (owned degrees of freedom,) whether each is prescribed.
        petsc_options: options of the user, which take precedence. Options of GAMG and of smoothers
            apply to all levels; with `mg_coarse_` before their names, only to the levels of GAMG,
            from the coarsest space downwards.
        prefix: prefix of the options in PETSc's database.

    Raises:
        StiffnessError: the set-up failed.
    """

    def named(option: str) -> bool:
        """Return whether the user gives an option, by the argument or in PETSc's database."""
        in_database = prefix is not None and PETSc.Options(prefix).hasName(option)
        return option in petsc_options or in_database

    smoother = GAUSS_SEIDEL if K.comm.size == 1 and not any(map(named, SMOOTHERS)) else CHEBYSHEV
    gamg = GAMG | smoother
    if not has_levels(V) or named("pc_type"):
        set_rigid_body_modes(K, V)
        return StiffnessSolver("multigrid", K, KRYLOV | gamg, petsc_options, prefix)
    levels = {"pc_type": "mg", **COARSEST, **smoother}
    levels.update({f"mg_coarse_{name}": value for name, value in gamg.items()})
    below = {
        f"mg_coarse_{name}": value
        for name, value in petsc_options.items()
        if name.startswith(("pc_gamg_", "mg_levels_"))
    }
    prepare = partial(add_levels, K=K, V=V, prescribed=prescribed)
    return StiffnessSolver(
        "multigrid", K, KRYLOV | levels, below | dict(petsc_options), prefix, prepare
    )
