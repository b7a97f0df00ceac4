"""From a coarse mesh to the accuracy that is asked for."""

from __future__ import annotations

import math
import numbers
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

from mpi4py import MPI

from dolfinx_tresca._base.parallel import answer_of_any, errors_on_all_ranks, log
from dolfinx_tresca.adapt.judgement import judged
from dolfinx_tresca.adapt.levels import AdaptiveSolution, Level
from dolfinx_tresca.adapt.refinement import check_cells, check_fraction, refine
from dolfinx_tresca.adapt.snapping import Snap, checked_snap
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.problem import ContactProblem
from dolfinx_tresca.scene.goal import Goal
from dolfinx_tresca.scene.mesh import TaggedMesh
from dolfinx_tresca.status import AdaptiveStatus, ContactStatus

#: The user's own: the problem on a mesh. Called on all ranks.
Build: TypeAlias = Callable[[TaggedMesh], ContactProblem]

#: Called on every rank with each level; returning True on any rank makes it the last.
LevelObserver: TypeAlias = Callable[[Level], "bool | None"]

#: `SolverOptions.local_accuracy` where the solution is only to say which cells to refine.
ROUGH = 0.3


def solve_adaptively(
    build: Build,
    tagged_mesh: TaggedMesh,
    accuracy: float = 0.05,
    *,
    goal: Goal | None = None,
    fraction: float = 0.5,
    snap: Snap | None = None,
    max_dofs: int = 1_000_000,
    max_levels: int = 20,
    max_seconds: float = math.inf,
    observer: LevelObserver | None = None,
) -> AdaptiveSolution:
    """Solve, refine where the error is, and so on until the mesh is fine enough. Collective.

    On each mesh the iteration ends with an error well below that of the mesh, and starts from the
    tractions on the mesh before; on the last one the options of the problem decide when it ends.

    Args:
        build: returns the problem on a mesh that it is given: function space, forms, conditions and
            pairs are those of an ordinary script. Problems are destroyed here.
        tagged_mesh: the first mesh, of triangles or tetrahedra. It need not be fine anywhere, but
            where curved surfaces meet: gaps or an interference much smaller than the distance of
            flat facets from them are not seen well on meshes that are not regular.
        accuracy: wanted error of the displacement in the energy norm, as a part of it, in (0, 1).
            It is judged by an estimate (`ContactSolution.discretisation_error`), no bound.
        goal: a number whose error counts instead, as a part of it (`ContactProblem.goal_error`),
            and for which cells are refined, such as `NormalForce()`. Then the iteration goes on
            until its own part in that is small, too.
        fraction: of the sum of squared errors that is in the cells to refine; see `refine`.
        snap: for curved surfaces; see `refine`.
        max_dofs: no mesh with more unknowns than that is tried, about.
        max_levels: number of meshes.
        max_seconds: no mesh is tried that would not be solved by then, about.
        observer: called with each `Level`, such as `print`; returning True makes it the last.

    Returns:
        the last solution, with all levels; look at its `status`, or call `raise_if_failed()`.

    Raises:
        InputError: an argument is wrong, `build` returns no problem on its mesh, or the mesh has
            cells that cannot be bisected.

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
    comm = tagged_mesh.mesh.comm
    with errors_on_all_ranks(comm):
        _check(build, observer, accuracy, max_dofs, max_levels, max_seconds)
        check_fraction(fraction)
        check_cells(tagged_mesh.mesh)
        checked_snap(tagged_mesh, snap)
    begin = time.perf_counter()
    levels: list[Level] = []
    while True:
        start = time.perf_counter()
        problem = build(tagged_mesh)
        with errors_on_all_ranks(comm):
            _check_problem(problem)
        with problem:
            if levels:
                problem.start_from(levels[-1].solution)
            rough = max(ROUGH, problem.options.local_accuracy)
            solution = problem.solve(accuracy="balanced", local_accuracy=rough)
            judgement = judged(problem, solution, goal)
            level = Level(
                number=len(levels),
                tagged_mesh=tagged_mesh,
                solution=judgement.solution,
                unknowns=problem.free_dofs,
                error=judgement.error,
                products=judgement.products,
                seconds=_seconds(comm, start),
                goal=judgement.goal,
            )
            log(comm, "%s", level)
            status = _judged(level, accuracy, max_levels, answer_of_any(comm, observer, level))
            finer = tagged_mesh
            if status is None:
                finer = refine(tagged_mesh, judgement.cell_errors, fraction, snap)
                growth = _cells(finer) / _cells(tagged_mesh)
                if growth * level.unknowns > max_dofs:
                    status = AdaptiveStatus.MAX_DOFS
                elif _seconds(comm, begin) + growth * level.seconds > max_seconds:
                    status = AdaptiveStatus.MAX_SECONDS
            if status not in (None, AdaptiveStatus.FAILED):
                solution = problem.solve()
                level = replace(
                    level, solution=solution, products=level.products + solution.products
                )
        levels.append(replace(level, seconds=_seconds(comm, start)))
        if status is not None:
            return AdaptiveSolution(status, float(accuracy), tuple(levels))
        tagged_mesh = finer


def _judged(level: Level, accuracy: float, max_levels: int, stop: bool) -> AdaptiveStatus | None:
    """Return why a level is the last, None if it need not be. Not collective."""
    if level.solution.status is not ContactStatus.CONVERGED:
        return AdaptiveStatus.FAILED
    if level.error <= accuracy:
        return AdaptiveStatus.REACHED
    if stop:
        return AdaptiveStatus.STOPPED
    return AdaptiveStatus.MAX_LEVELS if level.number + 1 >= max_levels else None


def _seconds(comm: MPI.Comm, start: float) -> float:
    """Return the seconds since then on the slowest rank. Collective."""
    return float(comm.allreduce(time.perf_counter() - start, op=MPI.MAX))


def _cells(tagged_mesh: TaggedMesh) -> int:
    topology = tagged_mesh.mesh.topology
    return int(topology.index_map(topology.dim).size_global)


def _check_problem(problem: Any) -> None:
    """Check what `build` returned. Not collective.

    Raises:
        InputError: it is no problem.
    """
    if not isinstance(problem, ContactProblem):
        raise InputError(f"build must return a ContactProblem, found {shown(problem)}.")


def _check(
    build: Build,
    observer: LevelObserver | None,
    accuracy: float,
    max_dofs: float,
    max_levels: int,
    max_seconds: float,
) -> None:
    """Check arguments. Not collective.

    Raises:
        InputError: one is of the wrong type or out of its range.
    """
    if not callable(build):
        raise InputError(f"build must be a function of a TaggedMesh, found {shown(build)}.")
    if observer is not None and not callable(observer):
        raise InputError(
            f"observer must be a function of a Level, such as print, found {shown(observer)}."
        )
    if not isinstance(accuracy, numbers.Real) or not 0.0 < accuracy < 1.0:
        raise InputError(f"accuracy must be a number in (0, 1), found {shown(accuracy)}.")
    limits: dict[str, float] = {
        "max_dofs": max_dofs,
        "max_levels": max_levels,
        "max_seconds": max_seconds,
    }
    for name, value in limits.items():
        if not isinstance(value, numbers.Real) or not value > 0.0:
            raise InputError(f"{name} must be a positive number, found {shown(value)}.")
