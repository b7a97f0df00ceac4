"""Stiffness of a single contact node whose neighbours are fixed."""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import LEAST_DIVISOR, Array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.stiffness.system import LinearSystem


def nodal_compliance(system: LinearSystem) -> PETSc.Vec:
    """Return 1 / diag(K), zero except at free displacements; owned by the caller. Collective."""
    compliance = system.K.getDiagonal()
    compliance.array = np.divide(
        1.0, compliance.array, where=system.moves, out=np.zeros(len(system.moves))
    )
    return compliance


def entrywise(matrix: PETSc.Mat, function: Callable[[Array], Array]) -> PETSc.Mat:
    """Return a new matrix with a function applied to each entry; the caller owns it. Collective."""
    result = matrix.copy()
    result.assemble()
    rows, columns, values = result.getValuesCSR()
    result.setValuesCSR(rows, columns, function(values))
    result.assemble()
    return result


def local_stiffness(jump: JumpOperator) -> Array:
    """Return 1 / diag(B diag(K)^-1 B'), (size,): force per jump of each row of B. Collective.

    This is the stiffness of a node whose neighbours are fixed. In A, neighbours are not fixed:
    diag(A) is about the inverse of this stiffness, times a factor that hardly varies over a
    surface.
    """
    B = jump.matrix
    squares = entrywise(B, np.square)
    compliance, total = nodal_compliance(jump.system), B.createVecLeft()
    squares.mult(compliance, total)
    result: Array = 1.0 / np.maximum(total.array, LEAST_DIVISOR)
    for owned in (squares, compliance, total):
        owned.destroy()
    return result
