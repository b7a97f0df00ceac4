"""The table of the algorithms by name. All algorithms have the same signature."""

from __future__ import annotations

from collections.abc import Callable

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.optimise import paper
from dolfinx_tresca.optimise.newton import iteration
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.history import Observe
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.options import Method, SolverOptions

METHODS: dict[Method, Callable[[DualProblem, Array, SolverOptions, Observe], DualSolution]] = {
    "projected_newton": iteration.solve,
    "gimssn": paper.gimssn,
    "imssn": paper.imssn,
    "mssn": paper.mssn,
    "ssn": paper.ssn,
}


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Solve a problem of Tresca or Coulomb friction by the method of the options. Collective.

    Raises:
        InputError: a method of the paper, which is for slip bounds that are given, was chosen for
            slip bounds that depend on the pressure.
    """
    if options.method != "projected_newton" and not isinstance(problem.admissible, FeasibleSet):
        raise InputError(
            f"method={options.method!r} needs slip bounds that are given: here they depend on the "
            "pressure. Leave out `method`, or give the friction as Tresca, Bonded or Frictionless."
        )
    return METHODS[options.method](problem, start, options, observe)
