"""The table of the algorithms by name. All algorithms have the same signature."""

from __future__ import annotations

from collections.abc import Callable

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.optimise import paper
from dolfinx_tresca.optimise.newton import fixed_point, projected_newton
from dolfinx_tresca.optimise.problem import DualProblem, DualSolution
from dolfinx_tresca.optimise.record.history import Observe
from dolfinx_tresca.optimise.sets.feasible_set import FeasibleSet
from dolfinx_tresca.options import Method, SolverOptions

METHODS: dict[Method, Callable[[DualProblem, Array, SolverOptions, Observe], DualSolution]] = {
    "projected_newton": projected_newton.solve,
    "gimssn": paper.gimssn,
    "imssn": paper.imssn,
    "mssn": paper.mssn,
    "ssn": paper.ssn,
}


def solve(
    problem: DualProblem, start: Array, options: SolverOptions, observe: Observe
) -> DualSolution:
    """Solve a problem of Tresca or Coulomb friction by the method of the options. Collective.

    For Coulomb friction, `fixed_point` takes the place of the default method, `projected_newton`.

    Raises:
        InputError: a method of the paper, which is for slip bounds that are given, was chosen for
            slip bounds that depend on the pressure.
    """
    if isinstance(problem.admissible, FeasibleSet):
        return METHODS[options.method](problem, start, options, observe)
    if options.method == "projected_newton":
        return fixed_point.solve(problem, start, options, observe)
    raise InputError(
        f"method={options.method!r} needs slip bounds that are given: here they depend on the "
        "pressure. Leave out `method`, or give the friction as Tresca, Bonded or Frictionless."
    )
