"""The error by which a mesh is judged and refined: of the energy, or of a goal."""

from __future__ import annotations

import math

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.functions import assembled
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca._base.tolerances import FORCING
from dolfinx_tresca.adapt.levels import Level
from dolfinx_tresca.adapt.refinement import checked_cell_errors
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.problem.linear import ContactProblem
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.goal import Goal
from dolfinx_tresca.scene.mesh import TaggedMesh
from dolfinx_tresca.status import ContactStatus

#: Least relative energy error to which a problem is solved again for the error of a goal.
LEAST_ACCURACY = 1e-10


def judged(
    number: int,
    tagged_mesh: TaggedMesh,
    problem: ContactProblem,
    solution: ContactSolution,
    goal: Goal | None,
) -> Level:
    """Estimate the error of the mesh of a solution; this may solve again. Collective.

    Args:
        number: number of the mesh.
        tagged_mesh: the mesh.
        problem: the problem that was solved.
        solution: the last solution of the problem, solved to the default accuracy.
        goal: the number whose error counts; None: the energy error counts.

    Returns:
        the mesh with its solution, which is accurate enough for the goal; without seconds.
    """
    products, goal_error = solution.products, None
    if goal is not None and solution.status is ContactStatus.CONVERGED:
        goal_error = problem.goal_error(goal)
        products += goal_error.products
        wanted = FORCING * goal_error.error
        if wanted < goal_error.iteration_error < math.inf:  # infinite if rows of B are dependent
            # errors of the iteration are of first order in a goal, but of second in the energy
            ratio = wanted / goal_error.iteration_error
            accuracy = max(ratio * solution.energy_error_bound, LEAST_ACCURACY)
            solution = problem.solve(accuracy=accuracy)
            goal_error = problem.goal_error(goal)
            products += solution.products + goal_error.products
    if goal_error is None or goal_error.adjoint.x.petsc_vec.norm() == 0.0:
        # without a goal; or its patch is open, and tells nothing about the mesh
        error, cell_errors = solution.discretisation_error, solution.cell_errors
    else:
        error, cell_errors = goal_error.relative_error, goal_error.cell_errors
    if cell_errors is not None:
        cell_errors = refinement_indicators(problem, cell_errors)
    return Level(
        number=number,
        tagged_mesh=tagged_mesh,
        solution=solution,
        free_dofs=problem.free_dofs,
        error=math.inf if error is None else error,
        cell_errors=cell_errors,
        products=products,
        seconds=0.0,
        goal_error=goal_error,
    )


@collective(comm_of("problem", "cell_errors"))
def refinement_indicators(problem: ContactProblem, cell_errors: fem.Function) -> fem.Function:
    """Return cell errors, passing on primary errors to opposite secondary cells. Collective.

    `solve_adaptively` refines by these errors, and scripts should too.

    Secondary nodes carry the multipliers: between two secondary nodes nothing keeps the primary
    surface from penetrating and gaping, which causes no strain. If the secondary side is the
    stiffer one, its own errors are small; if its cells stay coarse for that reason, finer cells on
    the soft side soon no longer reduce the error. So the squared error of a secondary cell is at
    least the sum of the squared errors of all opposite cells: secondary cells with many opposite
    cells are refined first.

    Args:
        problem: the problem, not yet destroyed.
        cell_errors: error of each cell, of degree 0 [energy^(1/2), or any other unit]:
            `ContactSolution.cell_errors` or `GoalError.cell_errors`.

    Returns:
        a function of the same unit, for `refine`.

    Raises:
        ContactError: the problem was destroyed.
        InputError: the errors are not a function of degree 0 on the problem's mesh, or are
            negative.

    Example:
        With the cube of `ContactProblem`, whose floor has no errors:

        >>> from dolfinx_tresca import refinement_indicators
        >>> errors = problem.solve().cell_errors
        >>> np.array_equal(refinement_indicators(problem, errors).x.array, errors.x.array)
        True
    """
    if not isinstance(problem, ContactProblem):
        raise InputError(f"problem must be a ContactProblem, found {shown(problem)}.")
    mesh, operators = problem.mesh, problem.operators
    with errors_on_all_ranks(problem.comm):
        checked_cell_errors(mesh, cell_errors)
        if not isinstance(cell_errors, fem.Function):
            raise InputError(f"cell_errors must be a function, found {shown(cell_errors)}.")
    result = cell_errors.copy()
    nodes, cells = fem.functionspace(mesh, ("Lagrange", 1)), cell_errors.function_space
    node, cell = ufl.TestFunction(nodes), ufl.TestFunction(cells)
    for pair, operator in zip(problem.pairs, operators, strict=True):
        if pair.obstacle is not None:
            continue
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=pair.facet_tags)
        density, areas = (
            assembled(factor * node * ds(pair.primary), nodes)
            for factor in (cell_errors**2 / ufl.FacetArea(mesh), 1.0)
        )
        np.divide(density.x.array, areas.x.array, out=density.x.array, where=areas.x.array > 0.0)
        opposite = assembled(operator.transfer(density) * cell * ds(pair.secondary), cells)
        # `opposite` is negative where the projection of `transfer` overshoots
        squares = np.maximum(np.square(result.x.array), opposite.x.array)
        result.x.array[:] = np.sqrt(squares)
    return result
