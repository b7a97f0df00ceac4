"""IMSSN: the symmetrised semi-smooth Newton method with inexact inner solves."""

from __future__ import annotations

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise import mssn
from dolfinx_tresca.optimise.history import Observe
from dolfinx_tresca.optimise.precision import AdaptivePrecision
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.options import SolverOptions


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Minimise q over Lambda by ALGORITHM IMSSN: MSSN with the precision control of (Step 3.1).

    Fast where it converges, but it may cycle where many nodes stick. Collective.
    """
    return mssn.iterate(
        problem, start, options, observe, lambda history: AdaptivePrecision(history, options).next
    )
