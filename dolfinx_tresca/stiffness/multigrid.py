"""Conjugate gradients with multigrid for K: spaces that are known to be coarser, and then GAMG."""

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
    "ksp_norm_type": "natural",  # sqrt(r'M^-1 r): the error in the energy norm, nearly
    "ksp_rtol": 1e-10,
    "ksp_max_it": 500,
    "ksp_divtol": 1e300,  # the error only falls, but residuals may grow before they do
}

#: Block Gauss-Seidel there and back: its errors fall in the energy norm for any positive definite
#: K, so that the preconditioner is positive definite, without an estimate of eigenvalues.
GAUSS_SEIDEL = {
    "mg_levels_ksp_type": "richardson",
    "mg_levels_pc_type": "sor",  # a node's degrees of freedom together
    "mg_levels_ksp_max_it": 1,
}

#: On several ranks Gauss-Seidel is each rank's own, M = diag(M_i): the largest eigenvalue of M^-1 K
#: may come near the number of ranks that meet, and from 2 on errors grow (from three ranks on the
#: preconditioner was seen indefinite). A polynomial of that eigenvalue makes them fall again.
CHEBYSHEV = {
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "sor",
    "mg_levels_ksp_max_it": 1,
    # the smoother is indefinite where its largest eigenvalue is underestimated: where stiffnesses
    # differ by 1e5 ten steps were seen to miss that of a block diagonal
    "mg_levels_esteig_ksp_max_it": 30,
}

#: Options that name a smoother.
SMOOTHERS = [
    f"{level}mg_levels_{kind}_type" for level in ("", "mg_coarse_") for kind in ("ksp", "pc")
]

#: What is done with the coarsest space: two cycles of GAMG. K of degree 1 has a fifteenth of the
#: entries that it has for degree 2, while one cycle leaves a third more iterations.
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
    """Return a solver for K. Collective.

    Below degree 2 there is degree 1 on the same mesh, below a mesh that `adapt.refine` made those
    that it was made of: on each of these spaces errors are smoothed, and the matrix P'KP of the
    coarsest is GAMG's, K itself where there are none. Where the options name a `pc_type`, GAMG or
    another, that has K itself; where they name a smoother, what they leave open is as `CHEBYSHEV`
    has it.

    Args:
        K: the matrix, with springs, if any; rows and columns that are prescribed are those of the
            identity.
        V: the space.
        prescribed: (owned degrees of freedom,) bool.
        petsc_options: the user's, which take precedence. Those of GAMG and of smoothers hold on all
            levels; with `mg_coarse_` before their names, from the coarsest space downwards.
        prefix: prefix of the options in PETSc's database.

    Raises:
        StiffnessError: the set-up failed.
    """

    def named(option: str) -> bool:
        """Whether the user gives an option, by the argument or in PETSc's database."""
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
