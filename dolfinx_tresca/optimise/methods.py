"""The algorithms by name, all with the same signature."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise import gimssn, imssn, mssn, projected_newton, ssn
from dolfinx_tresca.optimise.history import Observe
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.options import Method, SolverOptions

Solve: TypeAlias = Callable[[DualProblem, Array, SolverOptions, Observe], DualSolution]

METHODS: dict[Method, Solve] = {
    "projected_newton": projected_newton.solve,
    "gimssn": gimssn.solve,
    "imssn": imssn.solve,
    "mssn": mssn.solve,
    "ssn": ssn.solve,
}
