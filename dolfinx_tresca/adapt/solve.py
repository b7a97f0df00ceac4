"""Adaptive solution: from a coarse mesh to the requested accuracy."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

from mpi4py import MPI

from dolfinx_tresca._base.agreement import call_on_all_ranks, collective, comm_of
from dolfinx_tresca._base.arrays import real
from dolfinx_tresca._base.parallel import (
    agreed_observer,
    each_warning_once,
    errors_on_all_ranks,
    log,
    reduce_array,
)
from dolfinx_tresca.adapt.judgement import judged
from dolfinx_tresca.adapt.levels import AdaptiveSolution, Level
from dolfinx_tresca.adapt.refinement import (
    bisected,
    check_fraction,
    check_tagged_mesh,
    check_type,
    distributed,
    is_same,
)
from dolfinx_tresca.adapt.snapping import Snap, checked_snap
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.problem.linear import ContactProblem
from dolfinx_tresca.problem.process import ContactProcess
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.goal import Goal, checked_goal
from dolfinx_tresca.scene.mesh import TaggedMesh
from dolfinx_tresca.status import AdaptiveStatus, ContactStatus

#: Function of the user that returns the problem on a mesh. Called on all ranks.
Build: TypeAlias = Callable[[TaggedMesh], ContactProblem]

#: Function that every rank calls with each level; if it returns True on any rank, this level is the
#: last one.
LevelObserver: TypeAlias = Callable[[Level], "bool | None"]

#: `SolverOptions.mesh_part` and `local_accuracy` of solutions that only choose the cells to refine.
ROUGH_PART = 0.3

#: `SolverOptions.mesh_part` of solutions that only choose the cells to refine, if solves with K are
#: iterative: then the preconditioner depends on the number of ranks, and so do the error of the
#: iteration and the marked cells. (Of two bricks with multigrid, squared errors of cells on 1 and 2
#: ranks differed by 8e-2 with `ROUGH_PART`, by 1e-2 with 0.003 and by 5e-5 with the part below,
#: which takes half as many products again. The widest gap of `NEARLY` is about 1e-2 there.)
REPRODUCIBLE_PART = 3e-5

#: `local_accuracy` on the last mesh, relative to the mesh's error, and its largest value. (On two
#: bricks with an error of 16 %, peak pressure, greatest slip and forces agreed with the discrete
#: solution to 0.5 %, for 14 products; with the default of 3e-3 they agreed to 0.1 %, for 20
#: products.)
LOCAL_PART, MOST_LOCAL = 0.3, 0.1


@collective(comm_of("tagged_mesh"), ignored=("observer",))
@each_warning_once()
def solve_adaptively(
    build: Build,
    tagged_mesh: TaggedMesh,
    accuracy: float = 0.05,
    *,
    goal: Goal | None = None,
    fraction: float = 0.7,
    snap: Snap | None = None,
    max_dofs: int = 1_000_000,
    max_levels: int = 50,
    after: ContactSolution | None = None,
    observer: LevelObserver | None = None,
) -> AdaptiveSolution:
    """Solve, and refine where errors are large, until the mesh is fine enough. Collective.

    The cells with the largest errors are cut, and the problem is solved on the new mesh, until the
    estimated error is small enough. On each mesh the iteration ends with an error below the error
    of the mesh. On the last mesh the options
    of the problem decide when the iteration ends, except that `local_accuracy` is at least 0.3
    times the error of the mesh, or 0.1 if 0.1 is less: a smaller value would cost products and
    improve nothing. If the options set `rtol`, this last solve uses the options unchanged.

    Args:
        build: function that returns the problem on a given mesh, with function space, forms,
            conditions and pairs as in an ordinary script. This call destroys the problems.
        tagged_mesh: the first mesh, of triangles or tetrahedra. It need not be fine anywhere; but
            gaps and interferences of curved surfaces have an error of about a hundredth of the
            distance between the surfaces and their flat facets.
        accuracy: wanted relative error of the displacement in the energy norm, in (0, 1). It is
            judged by an estimate (`ContactSolution.discretisation_error`), not a bound.
        goal: a number, such as `NormalForce()`. Its relative error (`ContactProblem.goal_error`)
            then replaces the energy error: it is compared with `accuracy`, and cells are refined
            for it. The iteration continues until the iteration's part of this error is small, too.
            The patch of a `MeanPressure` or `MeanSlip` needs a contact node on the first mesh.
        fraction: part of the sum of squared errors that the cells to be cut have together; see
            `refine`. (On two bricks 0.5 and 0.85 took up to 1.2 times as long; with 0.5 there are
            more meshes, and fewer unknowns on the last one.)
        snap: projections to curved surfaces; see `refine`.
        max_dofs: approximate limit for `free_dofs` of a mesh: no problem is made on a larger mesh.
        max_levels: limit for the number of meshes.
        after: solution of the previous load step, on any mesh; slip on each mesh counts from this
            solution (`ContactProblem.continue_from`).
        observer: function that is called with each `Level`, such as `print`; if it returns True,
            this level is the last one.

    Returns:
        the last solution, with all levels; look at its `status`, or call `raise_if_failed()`.

    Raises:
        InputError: an argument is wrong, `build` does not return a problem on the given mesh, the
            mesh has cells that cannot be bisected, or the patch of the goal has no contact node.
        ConvergenceError: the previous load step did not converge.

    Example:
        A square is pressed on a floor by half of its upper side.

        >>> from mpi4py import MPI
        >>> import numpy as np
        >>> import ufl
        >>> from dolfinx import fem, mesh
        >>> from dolfinx_tresca import ContactPair, ContactProblem, RigidPlane, TaggedMesh, Tresca
        >>> from dolfinx_tresca import solve_adaptively
        >>> square = mesh.create_unit_square(MPI.COMM_WORLD, 4, 4)
        >>> def facets(y):
        ...     return mesh.locate_entities_boundary(square, 1, lambda x: abs(x[1] - y) < 1e-9)
        >>> indices = np.concatenate([facets(0.0), facets(1.0)])
        >>> values = np.repeat(np.array([1, 2], dtype=np.int32), 4)
        >>> order = np.argsort(indices)
        >>> facet_tags = mesh.meshtags(square, 1, indices[order], values[order])
        >>> none = mesh.meshtags(square, 2, np.zeros(0, np.int32), np.zeros(0, np.int32))
        >>> def build(block):
        ...     V = fem.functionspace(block.mesh, ("Lagrange", 1, (2,)))
        ...     u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        ...     x = ufl.SpatialCoordinate(block.mesh)
        ...     a = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx
        ...     ds = ufl.Measure("ds", domain=block.mesh, subdomain_data=block.facet_tags)
        ...     L = -ufl.conditional(x[0] < 0.5, 0.1, 0.0) * v[1] * ds(block.tags["top"])
        ...     floor = RigidPlane(point=(0, 0, 0), normal=(0, 1, 0))
        ...     pair = ContactPair(block.facet_tags, block.tags["bottom"], floor, Tresca(0.01))
        ...     return ContactProblem(a, L, [pair])
        >>> block = TaggedMesh(square, none, facet_tags, {"bottom": 1, "top": 2})
        >>> result = solve_adaptively(build, block, accuracy=0.1, observer=lambda level: None)
        >>> result.status
        <AdaptiveStatus.REACHED: 'accuracy reached'>
        >>> result.error <= 0.1
        True
    """
    check_type(tagged_mesh)
    comm = tagged_mesh.mesh.comm
    with errors_on_all_ranks(comm):
        _check(build, accuracy, after)
        most_dofs = checked_limit("max_dofs", max_dofs)
        most_levels = checked_limit("max_levels", max_levels)
        check_fraction(fraction)
        check_tagged_mesh(tagged_mesh)
        checked_snap(tagged_mesh, snap)
    observe = agreed_observer(comm, observer, "a Level, such as print")
    levels: list[Level] = []
    while True:
        start = time.perf_counter()
        problem = call_on_all_ranks(comm, "build", partial(build, tagged_mesh))
        with errors_on_all_ranks(comm):
            _check_problem(problem, tagged_mesh)
        with problem:
            options = problem.options
            if goal is not None:  # checked before a solve
                checked_goal(goal, len(problem.pairs), problem.mesh.geometry.dim)
            if after is not None:
                problem.continue_from(after)
            # the marked cells shall be the same on any number of ranks
            solution = problem.solve(
                accuracy="balanced",
                mesh_part=ROUGH_PART if problem.solves_exactly else REPRODUCIBLE_PART,
                local_accuracy=max(ROUGH_PART, options.local_accuracy),
            )
            level = judged(len(levels), tagged_mesh, problem, solution, goal)
            level = replace(level, seconds=_seconds(comm, start))
            log(comm, "%s", level)
            stop, status = observe(level), None
            if level.solution.status is not ContactStatus.CONVERGED:
                status = AdaptiveStatus.FAILED
            elif level.error <= accuracy:
                status = AdaptiveStatus.REACHED
            elif stop:
                status = AdaptiveStatus.STOPPED
            elif level.number + 1 >= most_levels:
                status = AdaptiveStatus.MAX_LEVELS
            else:
                cells = bisected(tagged_mesh, level.cell_errors, fraction)
                cell_map = tagged_mesh.mesh.topology.index_map(tagged_mesh.mesh.topology.dim)
                growth = reduce_array(comm, len(cells.parent)) / cell_map.size_global
                if growth * level.free_dofs > most_dofs:
                    status = AdaptiveStatus.MAX_DOFS
                else:
                    tagged_mesh = distributed(tagged_mesh, cells, snap)
            if status not in (None, AdaptiveStatus.FAILED):  # now with the options of the problem
                local = options.local_accuracy
                if options.balanced:
                    local = max(local, min(LOCAL_PART * level.error, MOST_LOCAL))
                solution = problem.solve(local_accuracy=local)
                products = level.products + solution.products
                level = replace(level, solution=solution, products=products)
        levels.append(replace(level, seconds=_seconds(comm, start)))
        if status is not None:
            return AdaptiveSolution(status, float(accuracy), tuple(levels))


def _seconds(comm: MPI.Comm, start: float) -> float:
    """Return the seconds since `start` on the slowest rank. Collective."""
    return float(comm.allreduce(time.perf_counter() - start, op=MPI.MAX))


def _check_problem(problem: Any, tagged_mesh: TaggedMesh) -> None:
    """Check what `build` returned. Not collective.

    Raises:
        InputError: the value is not a problem, or is a problem on another mesh.
    """
    if isinstance(problem, ContactProcess) and not isinstance(problem, ContactProblem):
        raise InputError(
            "solve_adaptively estimates the mesh's error of linear bodies only, found a "
            f"{type(problem).__name__}: refine the mesh by hand, and compare two solutions."
        )
    if not isinstance(problem, ContactProblem):
        raise InputError(f"build must return a ContactProblem, found {shown(problem)}.")
    if not is_same(tagged_mesh.mesh, problem.mesh):
        raise InputError(
            "build must return a problem on the mesh that it is given, found one on another mesh, "
            "such as that of the level before: take space, forms, conditions and tags from the "
            "argument."
        )


def _check(build: Build, accuracy: float, after: Any) -> None:
    """Check arguments. Not collective.

    Raises:
        InputError: an argument is of the wrong type or out of its range.
    """
    if not callable(build):
        raise InputError(f"build must be a function of a TaggedMesh, found {shown(build)}.")
    number = real(accuracy)
    if number is None or not 0.0 < number < 1.0:
        raise InputError(f"accuracy must be a number in (0, 1), found {shown(accuracy)}.")
    if isinstance(after, AdaptiveSolution):
        raise InputError(
            "after must be a ContactSolution, found an AdaptiveSolution: take its .solution."
        )
    if after is not None and not isinstance(after, ContactSolution):
        raise InputError(f"after must be a ContactSolution, found {shown(after)}.")


def checked_limit(name: str, value: Any) -> float:
    """Check a limit for the size or the number of meshes, and return it. Not collective.

    Raises:
        InputError: the limit is of the wrong type or not positive, or `max_levels` not an integer.
    """
    number = real(value)
    if number is None or not number > 0.0:
        raise InputError(f"{name} must be a positive number, found {shown(value)}.")
    if name == "max_levels" and not (number.is_integer() or math.isinf(number)):
        raise InputError(f"{name} must be a positive integer, found {shown(value)}.")
    return number
