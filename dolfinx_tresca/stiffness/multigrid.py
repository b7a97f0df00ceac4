"""Conjugate gradients with multigrid for K: PETSc's GAMG, which degree 2 reaches by way of 1."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from petsc4py import PETSc

from dolfinx_tresca._base.arrays import Mask
from dolfinx_tresca.stiffness.coarse_level import add_degree_1, set_rigid_body_modes
from dolfinx_tresca.stiffness.solver import StiffnessSolver

KRYLOV = {
    "ksp_type": "cg",
    "ksp_norm_type": "natural",  # sqrt(r'M^-1 r): the error in the energy norm, nearly
    "ksp_rtol": 1e-10,
    "ksp_max_it": 500,
    "ksp_divtol": 1e300,  # the error only falls, but residuals may grow before they do
}

SMOOTHER = {
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "pbjacobi",  # a node's degrees of freedom together
    "mg_levels_ksp_max_it": 1,
    # the smoother is indefinite where its largest eigenvalue is underestimated: where stiffnesses
    # differ by 1e5 ten steps miss it
    "mg_levels_esteig_ksp_max_it": 30,
}

GAMG = {
    "pc_type": "gamg",
    "pc_gamg_type": "agg",
    "pc_gamg_threshold": 0.01,
    "pc_gamg_esteig_ksp_max_it": 5,
    **SMOOTHER,
}

P_MULTIGRID = {
    "pc_type": "mg",
    **SMOOTHER,
    "mg_coarse_ksp_type": "preonly",
    **{f"mg_coarse_{name}": value for name, value in GAMG.items()},
}


def multigrid(
    K: PETSc.Mat,
    V: Any,
    prescribed: Mask,
    petsc_options: Mapping[str, Any],
    prefix: str | None,
) -> StiffnessSolver:
    """Return a solver for K. Collective.

    For spaces of degree 1, GAMG. For those of degree 2 p-multigrid: K is smoothed, and what is left
    goes to the space of degree 1 on the same mesh, whose matrix P'KP is GAMG's. Where the options
    name a `pc_type`, GAMG or another, that has K itself.

    Args:
        K: the matrix, with springs, if any; rows and columns that are prescribed are those of the
            identity.
        V: the space.
        prescribed: (owned degrees of freedom,) bool.
        petsc_options: the user's, which take precedence. Those of GAMG and of smoothers hold on all
            levels; with `mg_coarse_` before their names, from degree 1 downwards.
        prefix: of the options in PETSc's database.

    Raises:
        StiffnessError: the set-up failed.
    """
    if V.element.basix_element.degree == 1 or _has_preconditioner(petsc_options, prefix):
        set_rigid_body_modes(K, V)
        return StiffnessSolver("multigrid", K, KRYLOV | GAMG, petsc_options, prefix)
    prepare = partial(add_degree_1, K=K, V=V, prescribed=prescribed)
    below = {
        f"mg_coarse_{name}": value
        for name, value in petsc_options.items()
        if name.startswith(("pc_gamg_", "mg_levels_"))
    }
    options = below | dict(petsc_options)
    return StiffnessSolver("multigrid", K, KRYLOV | P_MULTIGRID, options, prefix, prepare)


def _has_preconditioner(petsc_options: Mapping[str, Any], prefix: str | None) -> bool:
    """Whether the user names a preconditioner, by an argument or in PETSc's database."""
    in_database = prefix is not None and PETSc.Options(prefix).hasName("pc_type")
    return "pc_type" in petsc_options or in_database
