"""Adaptive solution: from a coarse mesh to the requested accuracy, of the energy or of a goal."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import call_on_all_ranks, collective, comm_of
from dolfinx_tresca._base.arguments import check_type, checked_integer, checked_number
from dolfinx_tresca._base.compat import same_topology
from dolfinx_tresca._base.functions import assembled
from dolfinx_tresca._base.parallel import (
    agreed_observer,
    each_warning_once,
    errors_on_all_ranks,
    log,
)
from dolfinx_tresca._base.tolerances import FORCING
from dolfinx_tresca.adapt.refinement import check_tagged_mesh, checked_cell_errors, refine
from dolfinx_tresca.derivatives.goals import GoalError
from dolfinx_tresca.errors import ConvergenceError, InputError, shown
from dolfinx_tresca.problem.linear import ContactProblem
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.mesh import TaggedMesh
from dolfinx_tresca.scene.pair import Goal, checked_goal
from dolfinx_tresca.status import AdaptiveStatus, ContactStatus
from dolfinx_tresca.table import Row, Tabulated


@dataclass(frozen=True)
class Level:
    """A mesh of `solve_adaptively`, the solution on it, and the estimated error of the mesh.

    Attributes:
        number: number of the mesh; the first is 0.
        tagged_mesh: the mesh.
        solution: the solution on the mesh.
        free_dofs: degrees of freedom that are not prescribed, as `ContactProblem.free_dofs`.
        error: estimate of the mesh's error: in the energy norm, relative to the solution's norm,
            or, with a goal, the relative error of the goal; infinite if unknown. A goal that does
            not depend on the displacement, such as the pressure on a patch that is open on this
            mesh, tells nothing about the mesh: then the error is that in the energy norm.
        cell_errors: errors of the cells, after `refinement_indicators`; None if unknown.
        products: number of applications of A in all solves on the mesh, adjoint ones included.
        seconds: time on the slowest rank for building, solving and, after the observer, refining.
        goal_error: the goal and its error; None without a goal, or if the solve did not converge.
    """

    number: int
    tagged_mesh: TaggedMesh
    solution: ContactSolution
    free_dofs: int
    error: float
    cell_errors: fem.Function | None
    products: int
    seconds: float
    goal_error: GoalError | None = None

    def __str__(self) -> str:
        return (
            f"level {self.number}: {self.free_dofs} unknowns, error about {self.error:.1e}, "
            f"{self.products} products, {self.seconds:.1f} s"
        )

    def __repr__(self) -> str:
        return f"<Level: {self}>"


@dataclass(frozen=True)
class AdaptiveSolution(Tabulated):
    """The solutions on all meshes, and the reason why no finer mesh followed.

    Attributes:
        status: the reason why no finer mesh followed.
        accuracy: the requested accuracy.
        levels: all meshes with their solutions, from coarse to fine.
    """

    status: AdaptiveStatus
    accuracy: float
    levels: tuple[Level, ...]

    @property
    def solution(self) -> ContactSolution:
        """The solution on the last mesh."""
        return self.levels[-1].solution

    @property
    def tagged_mesh(self) -> TaggedMesh:
        """The last mesh."""
        return self.levels[-1].tagged_mesh

    @property
    def goal_error(self) -> GoalError | None:
        """The goal and its error on the last mesh; None as in `Level.goal_error`."""
        return self.levels[-1].goal_error

    @property
    def error(self) -> float:
        """Estimate of the relative error on the last mesh, in the energy norm or of the goal."""
        return self.levels[-1].error

    def raise_if_failed(self) -> None:
        """Raise a ConvergenceError if the accuracy was not reached. Not collective."""
        self.solution.raise_if_failed()
        if self.status is not AdaptiveStatus.REACHED:
            raise ConvergenceError(
                f"{self.status.value} after {len(self.levels)} mesh(es) with up to "
                f"{self.levels[-1].free_dofs} unknowns: the error is about {self.error:.1e}, "
                f"requested {self.accuracy:.1e}. Allow more meshes or unknowns, request less "
                "accuracy, or take elements of degree 2."
            )

    def _rows(self) -> list[Row]:
        goal, measured = self.goal_error, "solution's norm"
        if goal is not None and self.error == goal.relative_error:  # else see `Level.error`
            measured = f"number, {goal.value:.6g}"
        rows = [
            ("status", f"{self.status.name}: {self.status.value}"),
            ("mesh error", f"about {self.error:.1e} of the {measured}"),
            ("requested", f"{self.accuracy:.1e}"),
            ("seconds", f"{sum(level.seconds for level in self.levels):.1f}"),
            ("level", "unknowns     error  products   seconds"),
        ]
        for level in self.levels:
            numbers = f"{level.free_dofs:8}  {level.error:8.1e}  {level.products:8}"
            rows.append((f"  {level.number}", f"{numbers}  {level.seconds:8.1f}"))
        return rows

    def __repr__(self) -> str:
        return (
            f"<AdaptiveSolution: {self.status.name}, {len(self.levels)} mesh(es), "
            f"{self.levels[-1].free_dofs} unknowns, mesh error {self.error:.1e}>"
        )


def judged(
    number: int,
    tagged_mesh: TaggedMesh,
    problem: ContactProblem,
    solution: ContactSolution,
    goal: Goal | None,
    start: float,
) -> Level:
    """Return the level of a mesh: its solution, and the estimated error, as judged. Collective.

    If the iteration's part of the goal's error exceeds the part `FORCING` of all, the problem is
    solved again, more accurately. `start` is `time.perf_counter()` when work on the mesh began.
    """
    products, goal_error = solution.products, None
    if goal is not None and solution.status is ContactStatus.CONVERGED:
        goal_error = problem.goal_error(goal)
        products += goal_error.products
        wanted = FORCING * goal_error.error
        if wanted < goal_error.iteration_error < math.inf:  # infinite if rows of B are dependent
            # errors of the iteration are of first order in a goal, but of second in the energy
            ratio = wanted / goal_error.iteration_error
            solution = problem.solve(accuracy=max(ratio * solution.energy_error_bound, 1e-10))
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
        seconds=problem.comm.allreduce(time.perf_counter() - start, op=MPI.MAX),
        goal_error=goal_error,
    )


@collective(comm_of("problem", "cell_errors"))
def refinement_indicators(problem: ContactProblem, cell_errors: fem.Function) -> fem.Function:
    """Return cell errors, in secondary cells at least those of opposite cells. Collective.

    `solve_adaptively` refines by these errors, and scripts should too.

    Between two secondary nodes nothing keeps the primary surface from penetrating and gaping, which
    causes no strain. If the secondary side is the stiffer one, its own errors are small; if its
    cells stay coarse, finer cells on the soft side soon no longer reduce the error. So the squared
    error of a secondary cell is at least the sum of those of all opposite cells.

    Args:
        problem: the problem, not yet destroyed.
        cell_errors: error of each cell, of degree 0 [energy^(1/2), or any other unit]:
            `ContactSolution.cell_errors` or `GoalError.cell_errors`.

    Returns:
        a function of the same unit, for `refine`.

    Raises:
        ContactError: the problem was destroyed.
        InputError: the errors are not a function of degree 0 on the problem's mesh, or negative.
    """
    check_type("problem", problem, ContactProblem, "a ContactProblem")
    mesh, operators = problem.mesh, problem.operators
    with errors_on_all_ranks(problem.comm):
        checked_cell_errors(mesh, cell_errors)
        check_type("cell_errors", cell_errors, fem.Function, "a function")
    result = cell_errors.copy()
    nodes, cells = fem.functionspace(mesh, ("Lagrange", 1)), cell_errors.function_space
    node, cell = ufl.TestFunction(nodes), ufl.TestFunction(cells)
    for pair, operator in zip(problem.pairs, operators, strict=True):
        if pair.obstacle is not None:
            continue
        # `transfer` takes nodal densities: squared errors per area, means over the facets at a node
        ds = ufl.Measure("ds", domain=mesh, subdomain_data=pair.facet_tags)
        density = assembled(cell_errors**2 / ufl.FacetArea(mesh) * node * ds(pair.primary), nodes)
        areas = assembled(node * ds(pair.primary), nodes)
        np.divide(density.x.array, areas.x.array, out=density.x.array, where=areas.x.array > 0.0)
        opposite = assembled(operator.transfer(density) * cell * ds(pair.secondary), cells)
        # these squared errors may be negative where the projection of `transfer` overshoots
        result.x.array[:] = np.sqrt(np.maximum(np.square(result.x.array), opposite.x.array))
    return result


#: Function of the user that returns the problem on a mesh. Called on all ranks.
Build: TypeAlias = Callable[[TaggedMesh], ContactProblem]

#: Function that every rank calls with each level: the last one, if it returns True on any rank.
LevelObserver: TypeAlias = Callable[[Level], "bool | None"]


@collective(comm_of("tagged_mesh"), ignored=("observer",))
@each_warning_once()
def solve_adaptively(
    build: Build,
    tagged_mesh: TaggedMesh,
    accuracy: float = 0.05,
    *,
    goal: Goal | None = None,
    fraction: float = 0.7,
    max_dofs: int = 1_000_000,
    max_levels: int = 50,
    after: ContactSolution | None = None,
    observer: LevelObserver | None = None,
) -> AdaptiveSolution:
    """Solve, and refine where errors are large, until the mesh is fine enough. Collective.

    On each mesh the iteration ends with an error below the error of the mesh. If the options of the
    problem are others (`accuracy`, `mesh_part`), the last mesh's problem is solved again with them.

    Args:
        build: function that returns the problem on a given mesh, with function space, forms,
            conditions and pairs as in an ordinary script. This call destroys the problems.
        tagged_mesh: the first mesh, of triangles or tetrahedra, with the curved surfaces that it
            knows (see `refine`). Gaps of curved surfaces have an error of about a hundredth of the
            distance between the surfaces and their flat facets.
        accuracy: wanted relative error of the displacement in the energy norm, in (0, 1). It is
            judged by an estimate (`ContactSolution.discretisation_error`), not a bound.
        goal: a number, such as `NormalForce()`. Its relative error (`ContactProblem.goal_error`)
            then replaces the energy error: it is compared with `accuracy`, and cells are refined
            for it. The iteration continues until the iteration's part of this error is small, too.
            The patch of a `MeanPressure` or `MeanSlip` needs a contact node on the first mesh.
        fraction: part of the sum of squared errors that the cells to be cut have together; see
            `refine`.
        max_dofs: approximate limit for `free_dofs`: no refined mesh that is larger gets a problem.
        max_levels: limit for the number of meshes.
        after: solution of the previous load step, on any mesh; slip on each mesh counts from this
            solution (`ContactProblem.continue_from`).
        observer: function called with each `Level`, such as `print`; True ends after this level.

    Returns:
        the last solution, with all levels; look at its `status`, or call `raise_if_failed()`.

    Raises:
        InputError: an argument is wrong, `build` does not return a problem on the given mesh, the
            mesh has cells that cannot be bisected, or the patch of the goal has no contact node.
        ConvergenceError: the previous load step did not converge.

    Example::

        def build(block):  # with block.mesh, block.facet_tags and block.tags, as in any script
            ...
            return ContactProblem(a, L, [pair], bcs=bcs)

        result = solve_adaptively(build, read_gmsh("part.geo", comm), observer=print)
    """
    check_tagged_mesh(tagged_mesh)
    comm = tagged_mesh.mesh.comm
    if not callable(build):
        raise InputError(f"build must be a function of a TaggedMesh, found {shown(build)}.")
    wanted = checked_number("accuracy", accuracy, "(0, 1)")
    most_dofs = checked_number("max_dofs", max_dofs, "(0, inf]")
    most_levels = checked_integer("max_levels", max_levels)
    checked_number("fraction", fraction, "(0, 1]")
    if after is not None:
        advice = " An AdaptiveSolution has one, its attribute .solution."
        check_type("after", after, ContactSolution, "a ContactSolution", advice)
    observe = agreed_observer(comm, observer, "a Level, such as print")
    levels: list[Level] = []
    while True:
        start = time.perf_counter()
        problem = call_on_all_ranks(comm, "build", partial(build, tagged_mesh))
        with errors_on_all_ranks(comm):
            if not isinstance(problem, ContactProblem):
                raise InputError(
                    f"build must return a ContactProblem, found {shown(problem)}. The mesh's error "
                    "is estimated for linear bodies only: for other ones compare solutions on two "
                    "meshes."
                )
            if not same_topology(problem.mesh, tagged_mesh.mesh):
                raise InputError(
                    "build must return a problem on the mesh that it is given, found one on "
                    "another mesh, such as that of the level before: take space, forms, conditions "
                    "and tags from the argument."
                )
        with problem:
            options = problem.options
            if goal is not None:  # checked before a solve
                checked_goal(goal, len(problem.pairs), problem.mesh.geometry.dim)
            if after is not None:
                problem.continue_from(after)
            # The preconditioner depends on the number of ranks, and so do the error of the
            # iteration and the cells to refine. (Of two bricks with multigrid, squared errors of
            # cells on 1 and 2 ranks differed by 8e-2 with `mesh_part` 0.3, by 1e-2 with 0.003 and
            # by 5e-5 with 3e-5; the widest gap that `cells_to_refine` looks for is about 1e-2.)
            mesh_part = min(options.mesh_part, 1.0 if problem.solves_exactly else 3e-5)
            solution = problem.solve(accuracy="balanced", mesh_part=mesh_part)
            level = judged(len(levels), tagged_mesh, problem, solution, goal, start)
            log(comm, "%s", level)
            stop, status = observe(level), None
            if level.solution.status is not ContactStatus.CONVERGED:
                status = AdaptiveStatus.FAILED
            elif level.error <= wanted:
                status = AdaptiveStatus.REACHED
            elif stop:
                status = AdaptiveStatus.STOPPED
            elif level.number + 1 >= most_levels:
                status = AdaptiveStatus.MAX_LEVELS
            else:
                finer = refine(tagged_mesh, level.cell_errors, fraction)
                dim = tagged_mesh.mesh.topology.dim
                cells = tagged_mesh.mesh.topology.index_map(dim).size_global
                finer_cells = finer.mesh.topology.index_map(dim).size_global
                if finer_cells / cells * level.free_dofs > most_dofs:
                    status = AdaptiveStatus.MAX_DOFS
                else:
                    tagged_mesh = finer
            if status not in (None, AdaptiveStatus.FAILED) and level.solution.options != options:
                final = problem.solve()
                level = replace(level, solution=final, products=level.products + final.products)
        seconds = comm.allreduce(time.perf_counter() - start, op=MPI.MAX)
        levels.append(replace(level, seconds=seconds))
        if status is not None:
            return AdaptiveSolution(status, wanted, tuple(levels))
