"""A scene's dual problem, put together by hand."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from dolfinx_tresca.dual.initial_guess import InitialGuess
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.products.compliance import ContactCompliance
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_bounds import SlipBounds
from dolfinx_tresca.pairing.choice import pair_surfaces
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.multigrid import multigrid
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.scene import Scene


@contextmanager
def dual_program(
    scene: Scene, stiffness: str = "cholesky", **petsc_options: Any
) -> Iterator[DualProgram]:
    """Put A, b and Lambda together, and free all of it afterwards. Collective.

    Multigrid solves to 1e-12, unless its options say something else.
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
        bounds = [SlipBounds(scene.V).at(scene.pair.friction, operators.nodes)]
        with (
            JumpOperator(system, [operators]) as jump,
            InitialGuess(jump) as guess,
            ContactCompliance(jump, solver, None) as compliance,
        ):
            dual = DualProgram.of(compliance, guess, bounds)
            dual.response.solve_load()
            yield dual


def dense_matrix(dual: DualProgram) -> np.ndarray:
    """Return A from its products with unit vectors, of a scene on one rank."""
    A = np.column_stack([dual.apply(unit) for unit in np.eye(len(dual.b))])
    return 0.5 * (A + A.T)


def points_of(scene: Scene, operators: PairOperators) -> np.ndarray:
    """Return where the contact nodes of this rank are, (n, 3)."""
    points: np.ndarray = scene.V.tabulate_dof_coordinates()[operators.nodes]
    return points
