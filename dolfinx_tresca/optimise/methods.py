"""The table of the algorithms by name. All algorithms have the same signature."""

from __future__ import annotations

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.newton import fixed_point, projected_newton
from dolfinx_tresca.optimise.paper import gimssn, mssn, ssn, sweeps
from dolfinx_tresca.optimise.paper.sweeps import Solve
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.history import Observe
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.options import Method, SolverOptions

METHODS: dict[Method, Solve] = {
    "projected_newton": projected_newton.solve,
    "gimssn": gimssn.solve,
    "imssn": mssn.solve_inexactly,
    "mssn": mssn.solve_exactly,
    "ssn": ssn.solve,
}


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Solve a problem of Tresca or Coulomb friction by the method of the options. Collective.

    For Coulomb friction, `fixed_point` takes the place of the default method, `projected_newton`,
    and the methods of the paper solve a sequence of Tresca problems, see `sweeps`.
    """
    tresca = METHODS[options.method]
    if isinstance(problem.admissible, FeasibleSet):
        return tresca(problem, start, options, observe)
    if options.method == "projected_newton":
        return fixed_point.solve(problem, start, options, observe)
    return sweeps.solve(problem, start, options, observe, tresca)
