"""The dual problem of a scene, assembled without the package's problem, and a solver by PETSc."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array

from dolfinx import fem

from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products import ContactCompliance
from dolfinx_tresca.dual.program import DualProgram, InitialGuess
from dolfinx_tresca.dual.slip_bounds import SlipBounds
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from dolfinx_tresca.stiffness.solver import cholesky, multigrid
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.scene import Scene


@contextmanager
def dual_program(
    scene: Scene, stiffness: str = "cholesky", **petsc_options: Any
) -> Iterator[DualProgram]:
    """Assemble A, b and Lambda of a scene with one pair, and free them afterwards. Collective.

    Multigrid solves to a relative residual of 1e-12, unless `petsc_options` have `ksp_rtol`.
    """
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        system.assemble_load()
        if stiffness == "cholesky":
            solver = cholesky(system.K, {}, None)
        else:
            options = {"ksp_rtol": 1e-12} | petsc_options
            solver = multigrid(system.K, scene.V, system.prescribed, options, None)
        operators = pair_surfaces(scene.V, system.prescribed, scene.pair)
        bounds = [SlipBounds(scene.V).nodal_bounds(scene.pair.friction, operators.nodes)]
        with (
            JumpOperator(system, [operators]) as jump,
            ContactCompliance(jump, solver, None) as compliance,
        ):
            guess = InitialGuess(np.zeros(len(system.prescribed)))
            yield DualProgram(compliance, guess, bounds)


def dense_matrix(dual: DualProgram) -> np.ndarray:
    """Return A from its products with unit vectors, for a scene on one rank."""
    A = np.column_stack([dual.compliance.apply(unit) for unit in np.eye(len(dual.b))])
    return 0.5 * (A + A.T)


def on_one_rank(matrix: PETSc.Mat) -> csr_array:
    """Return a matrix of one rank as a scipy matrix."""
    return csr_array(matrix.getValuesCSR()[::-1], shape=matrix.size)


def points_of(scene: Scene, operators: PairOperators) -> np.ndarray:
    """Return the points (n, 3) of the contact nodes of this rank."""
    points: np.ndarray = scene.V.tabulate_dof_coordinates()[operators.nodes]
    return points


def linear_solution(a: Any, L: Any, bcs: list[Any], *, axisymmetric: bool = False) -> fem.Function:
    """Return the displacement of bodies without contact. Collective."""
    with LinearSystem(a, L, bcs, axisymmetric=axisymmetric) as system:
        u = fem.Function(system.space)
        system.assemble_stiffness()
        system.assemble_load()
        with cholesky(system.K, {}, None) as solver:
            solver.solve(system.f.x.petsc_vec, u.x.petsc_vec)
    u.x.scatter_forward()
    return u


def direct_solver(matrix: PETSc.Mat) -> PETSc.KSP:
    """Return PETSc's solver with MUMPS, without code of the package. The caller destroys it."""
    ksp = PETSc.KSP().create(matrix.comm)
    ksp.setOperators(matrix)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    return ksp
