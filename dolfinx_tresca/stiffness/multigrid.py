"""Conjugate gradients with smoothed-aggregation multigrid (PETSc's GAMG) for K."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from petsc4py import PETSc

from dolfinx_tresca.stiffness.solver import StiffnessSolver

DEFAULTS = {
    "ksp_type": "cg",
    "ksp_norm_type": "natural",  # sqrt(r'M^-1 r): the error in the energy norm, nearly
    "ksp_rtol": 1e-10,
    "ksp_max_it": 500,
    "ksp_divtol": 1e300,  # the error only falls, but residuals may grow before they do
    "pc_type": "gamg",
    "pc_gamg_type": "agg",
    "pc_gamg_threshold": 0.01,
    "pc_gamg_esteig_ksp_max_it": 5,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "pbjacobi",  # a node's degrees of freedom together
    "mg_levels_ksp_max_it": 1,
    # the smoother is indefinite where its largest eigenvalue is underestimated: where stiffnesses
    # differ by 1e5 ten steps miss it
    "mg_levels_esteig_ksp_max_it": 30,
}


def multigrid(
    K: PETSc.Mat, V: Any, petsc_options: Mapping[str, Any], prefix: str | None
) -> StiffnessSolver:
    """Return a solver for K on the space V. Collective.

    The rigid body motions of all of space are the near-nullspace: on each body they are its own, so
    one set serves any number of bodies.
    """
    nodes, dim = V.dofmap.index_map, V.mesh.geometry.dim
    points = PETSc.Vec().createMPI(
        (dim * nodes.size_local, dim * nodes.size_global), bsize=dim, comm=K.comm
    )
    points.array = V.tabulate_dof_coordinates()[: nodes.size_local, :dim].ravel()
    near_nullspace = PETSc.NullSpace().createRigidBody(points)
    K.setNearNullSpace(near_nullspace)
    near_nullspace.destroy()
    points.destroy()
    return StiffnessSolver("multigrid", K, DEFAULTS, petsc_options, prefix)
