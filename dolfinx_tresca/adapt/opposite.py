"""Errors of the primary side, passed on to the opposite secondary cells."""

from __future__ import annotations

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.assembly import assembled
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.adapt.refinement import owned_values
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.problem.linear import ContactProblem
from dolfinx_tresca.scene.obstacle import RigidObstacle


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
        owned_values(mesh, cell_errors)
        if not isinstance(cell_errors, fem.Function):
            raise InputError(f"cell_errors must be a function, found {shown(cell_errors)}.")
    result = cell_errors.copy()
    nodes, cells = fem.functionspace(mesh, ("Lagrange", 1)), cell_errors.function_space
    one, cell = ufl.TestFunction(nodes), ufl.TestFunction(cells)
    for pair, operator in zip(problem.pairs, operators, strict=True):
        if isinstance(pair.primary, RigidObstacle):
            continue
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=pair.facet_tags)
        density, areas = (
            assembled(factor * one * ds(pair.primary), nodes)
            for factor in (cell_errors**2 / ufl.FacetArea(mesh), 1.0)
        )
        np.divide(density.x.array, areas.x.array, out=density.x.array, where=areas.x.array > 0.0)
        opposite = assembled(operator.transfer(density) * cell * ds(pair.secondary), cells)
        # `opposite` is negative where the projection of `transfer` overshoots
        squares = np.maximum(np.square(result.x.array), opposite.x.array)
        result.x.array[:] = np.sqrt(squares)
    return result
