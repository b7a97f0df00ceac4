"""The error by which a mesh is judged and refined: of the energy, or of a goal."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dolfinx import fem

from dolfinx_tresca._base.forcing import FORCING
from dolfinx_tresca.adapt.opposite import refinement_indicators
from dolfinx_tresca.derivatives.goals import GoalError
from dolfinx_tresca.problem.linear import ContactProblem
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.goal import Goal
from dolfinx_tresca.status import ContactStatus

#: Least relative energy error to which a problem is solved again for the error of a goal.
LEAST_ACCURACY = 1e-10


@dataclass(frozen=True)
class Judgement:
    """The error of the solution on a mesh.

    Attributes:
        solution: solution on the mesh, accurate enough for the goal.
        error: relative error; infinite if unknown. It is the error of the goal, or the energy error
            if there is no goal, or if the goal does not depend on the displacement. An example of
            such a goal is the pressure on a patch that is open on this mesh, and may close with
            smaller cells.
        cell_errors: errors of the cells, after `refinement_indicators`; None if unknown.
        products: number of applications of A in all solves on the mesh, adjoint ones included.
        goal_error: error of the goal, if there is one.
    """

    solution: ContactSolution
    error: float
    cell_errors: fem.Function | None
    products: int
    goal_error: GoalError | None


def judged(problem: ContactProblem, solution: ContactSolution, goal: Goal | None) -> Judgement:
    """Estimate the error of the mesh of a solution; this may solve again. Collective.

    Args:
        problem: the problem that was solved.
        solution: the last solution of the problem, solved to the default accuracy.
        goal: the number whose error counts; None: the energy error counts.
    """
    products = solution.products
    if goal is None or solution.status is not ContactStatus.CONVERGED:
        cells = _for_refinement(problem, solution.cell_errors)
        return Judgement(solution, _energy_error(solution), cells, products, None)
    found = problem.goal_error(goal)
    products += found.products
    wanted = FORCING * found.error
    if wanted < found.iteration_error < math.inf:  # infinite if rows of B are dependent
        # errors of the iteration are of first order in a goal, but of second order in the energy
        part = wanted / found.iteration_error
        accuracy = max(part * solution.energy_error_bound, LEAST_ACCURACY)
        solution = problem.solve(accuracy=accuracy)
        found = problem.goal_error(goal)
        products += solution.products + found.products
    error, cell_errors = found.relative_error, found.cell_errors
    if found.adjoint.x.petsc_vec.norm() == 0.0:  # an open patch tells nothing about the mesh
        error, cell_errors = _energy_error(solution), solution.cell_errors
    return Judgement(solution, error, _for_refinement(problem, cell_errors), products, found)


def _energy_error(solution: ContactSolution) -> float:
    """Return the relative discretisation error, or infinity if it is unknown. Not collective."""
    error = solution.discretisation_error
    return math.inf if error is None else error


def _for_refinement(
    problem: ContactProblem, cell_errors: fem.Function | None
) -> fem.Function | None:
    """Return the `refinement_indicators` of cell errors; None if they are unknown. Collective."""
    if cell_errors is None:
        return None
    return refinement_indicators(problem, cell_errors)
