"""Error against time and memory, for the choice of mesh, accuracy, algorithm and K-solver.

    tools/fenicsx python3 benchmarks/tradeoff.py --json FILE --picture FILE

The two bricks (`free_end_1`), the ball of Hertz, the implant and the crane are solved on meshes of
several kinds and sizes. On some meshes one of tolerance, algorithm and K-solver is varied at a
time. The script prints a row for each run; then, for each scene, the errors and costs by the
requested part of the mesh's error, the Pareto fronts, and the cheapest run for an error of 10, 5,
2, 1 and 0.1 percent.

Errors are relative. They are errors of the whole answer (mesh and iteration) against a reference, a
solution on a fine mesh: errors of the displacement in the energy norm, of pressure and slip in L2
of the contact surface, of the largest nodal pressure, and of the normal force. `mesh` is the energy
error of a solution to a residual of 1e-8 on the same mesh, which is the error of the mesh alone;
`algebra` is the energy norm of the difference from this solution. `estimate` is the package's
estimate of the mesh's error, and `effect.` is the estimate divided by the energy error. The
reference has an error, too. Its energy error is the package's estimate; the square of this error is
added to the squares of the errors of other solutions. Its other errors follow from the difference
from a coarser reference, on the assumption that they fall like the estimate. Pressures of Hertz are
compared with theory, whose error is about (a/R)^2. Errors that are not larger than the error of the
reference or of theory are not resolved.

Seconds are processor seconds from geometry to fields: mesh, forms, `ContactProblem(...)` and
`solve`, or `solve_adaptively` with all its meshes; `wall` is wall-clock time, which depends on
other work on the machine. Both are the least of some repetitions, after a small run that compiles
all forms. Memory is the peak memory of the process minus its memory before the run.

The axes, along which settings vary, are: `mesh` (defaults on all meshes); `backend` (on all meshes
of degree 1); `part` (`accuracy` is this part of the package's estimate of the mesh's error);
`rtol`; `method` (each method solves to the default accuracy); `krylov` (relative residual of each
solve with K in imssn; by default imssn chooses this residual); and `fraction` (the argument of
`solve_adaptively`). Rows with the axis `pairing` are of versions that paired nodes in another way.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import itertools
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

from harness import Benchmark, Comm, Row
from harness.limit import TimeLimit
from harness.memory import peak_memory, reset_peak_memory, resident_memory
from harness.timing import timed
from tradeoff_scenes import SCENES, Mesh, Reference, Study, energy_norm, numbers, theory_of
from tradeoff_tables import COLUMNS, TABLES, draw, summary

from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    NormalForce,
    TaggedMesh,
    solve_adaptively,
)
from scenes.scene import Scene

AXES = ("mesh", "backend", "part", "rtol", "method", "krylov", "fraction")

PARTS = (0.5, 0.3, 0.1, 0.03, 0.01)
RTOLS = tuple(10.0**-k for k in range(1, 11))
METHODS = ("imssn", "gimssn", "ssn", "mssn")
KRYLOV = (1e-2, 1e-4, 1e-6, 1e-8)
FRACTIONS = (0.15, 0.3, 0.5, 0.7, 0.85)

#: Limit for the unknowns of adaptive meshes.
MOST = 2_000_000

#: Relative natural residual of solutions whose algebraic error is negligible.
TIGHT = 1e-8


@dataclass(frozen=True)
class Setting:
    """The settings that are varied on one mesh; `axis` names the varied setting."""

    axis: str = "mesh"
    pairing: str = "auto"
    stiffness: str = "auto"
    method: str = "projected_newton"
    rtol: float | None = None
    part: float | None = None
    krylov: float | None = None
    fraction: float = 0.5
    petsc: dict[str, Any] = field(default_factory=dict)

    @property
    def asked(self) -> str:
        """The stopping criterion of the iteration, as text."""
        if self.rtol is not None:
            return f"rtol {self.rtol:.0e}"
        return "default" if self.part is None else f"part {self.part:g}"


def settings(scene: Study, mesh: Mesh, axes: list[str]) -> Iterator[Setting]:
    """Yield the settings of the runs on a mesh."""
    if "mesh" in axes:  # with flat cells multigrid needs three times the iterations
        yield Setting(stiffness="auto" if mesh.grading == 1.0 else "cholesky")
    if mesh.accuracy:
        if "fraction" in axes and mesh in scene.base:
            for fraction in FRACTIONS:
                yield Setting("fraction", fraction=fraction)
        return
    if mesh.degree == 1 and "backend" in axes:
        for stiffness in ("cholesky", "multigrid"):
            yield Setting("backend", stiffness=stiffness)
    if mesh not in scene.base:
        return
    if "part" in axes:
        for stiffness, part in itertools.product(("cholesky", "multigrid"), PARTS):
            yield Setting("part", part=part, stiffness=stiffness)
    if "rtol" in axes:
        for rtol in RTOLS:
            yield Setting("rtol", rtol=rtol)
    if "method" in axes:
        for method in METHODS:
            yield Setting("method", method=method)
    if "krylov" in axes:
        for accuracy in KRYLOV:
            options = {"ksp_rtol": accuracy}
            yield Setting("krylov", "auto", "multigrid", "imssn", krylov=accuracy, petsc=options)


@dataclass(frozen=True)
class Answer:
    """A solution with its scene, and the size of its mesh."""

    case: Scene
    solution: ContactSolution
    unknowns: int
    contact_nodes: int
    levels: int


def answer(
    study: Study,
    mesh: Mesh,
    setting: Setting | None = None,
    mesh_error: float = math.inf,
    limit: float = math.inf,
) -> Answer:
    """Solve from geometry to fields.

    Args:
        study: the scene.
        mesh: the mesh; the first mesh of an adaptive solve if `mesh.accuracy` is not 0.
        setting: the settings of the run; None: the defaults.
        mesh_error: the package's estimate of the mesh's error, for `setting.part`.
        limit: limit for the iteration [processor seconds].
    """
    setting = setting or Setting()
    tagged = study.tagged(mesh)
    if mesh.accuracy:
        return adapted(study, mesh, tagged, setting)
    case = study.on(tagged, degree=mesh.degree)
    asked: dict[str, Any] = {"rtol": setting.rtol}
    if setting.part is not None:
        asked = {"accuracy": setting.part * mesh_error}
    pair = dataclasses.replace(case.pair, pairing=setting.pairing)
    with case.problem(
        pairs=[pair], stiffness=setting.stiffness, petsc_options=setting.petsc
    ) as problem:
        solution = problem.solve(
            method=setting.method, max_iterations=10_000, observer=TimeLimit(limit), **asked
        )
        return Answer(case, solution, problem.free_dofs, problem.contact_nodes, 1)


def adapted(study: Study, mesh: Mesh, tagged: TaggedMesh, setting: Setting) -> Answer:
    """Solve on adaptive meshes to the accuracy `mesh.accuracy`."""
    last: list[tuple[Scene, ContactProblem]] = []

    def build(finer: TaggedMesh) -> ContactProblem:
        case = study.on(finer, degree=mesh.degree)
        last[:] = [(case, case.problem())]
        return last[0][1]

    result = solve_adaptively(
        build,
        tagged,
        mesh.accuracy,
        goal=NormalForce() if mesh.goal == "force" else None,
        fraction=setting.fraction,
        max_dofs=MOST,
    )
    ((case, problem),) = last
    levels = len(result.levels)
    return Answer(case, result.solution, result.levels[-1].free_dofs, problem.contact_nodes, levels)


def measured(
    study: Study, mesh: Mesh, setting: Setting, mesh_error: float, task: Row
) -> tuple[Answer, Row]:
    """Solve repeatedly; return the answer, and the least seconds and the memory."""
    comm = MPI.COMM_SELF
    seconds, wall, memory = [], [], 0.0
    while len(seconds) < task["repeats"] and sum(seconds) < task["enough"]:
        gc.collect()
        before = resident_memory(comm)
        reset_peak_memory()
        start = time.process_time()
        needed, found = timed(
            comm, lambda: answer(study, mesh, setting, mesh_error, task["seconds"])
        )
        seconds.append(time.process_time() - start)
        wall.append(needed)
        memory = max(memory, peak_memory(comm) - before)
    solution = found.solution
    cost = {
        "n": found.unknowns,
        "m": found.contact_nodes,
        "levels": found.levels,
        "chosen": "multigrid" if solution.krylov_iterations else "cholesky",
        "seconds": min(seconds),
        "all_seconds": seconds,
        "wall": min(wall),
        "memory_mb": memory,
    }
    return found, cost


class OnMesh:
    """Runs on one mesh, which share the solution without algebraic error and the estimate."""

    def __init__(self, name: str, mesh: Mesh, reference: Reference) -> None:
        self._name, self._mesh, self._reference = name, mesh, reference
        self._study = SCENES[name]
        self._tight: dict[str, tuple[Answer, float]] = {}
        self._estimate: float | None = None

    def _without_algebra(self, pairing: str) -> tuple[Answer, float]:
        """Return a solution to a small residual, and its energy error: the error of the mesh."""
        if pairing not in self._tight:
            found = answer(self._study, self._mesh, Setting(pairing=pairing, rtol=TIGHT))
            error = self._reference.errors(found.case, found.solution)["energy"]
            self._tight[pairing] = found, error
        return self._tight[pairing]

    @property
    def _mesh_error(self) -> float:
        """The package's estimate of the mesh's error."""
        if self._estimate is None:
            self._estimate = answer(self._study, self._mesh).solution.discretisation_error
        assert self._estimate is not None  # the default accuracy always needs this estimate
        return self._estimate

    def run(self, setting: Setting, task: Row) -> Row:
        """Solve with a setting and return its row."""
        mesh = self._mesh
        row: Row = {"scene": self._name, "family": mesh.family, **dataclasses.asdict(mesh)}
        row |= dataclasses.asdict(setting) | {"asked": setting.asked}
        mesh_error = math.inf if setting.part is None else self._mesh_error
        try:
            found, cost = measured(self._study, mesh, setting, mesh_error, task)
        except ContactError as error:
            return {**row, "status": f"{error}"}
        solution = found.solution
        row |= cost | self._reference.errors(found.case, solution)
        if not mesh.accuracy and setting.axis not in ("mesh", "backend"):
            row |= self._algebra(found, setting.pairing)
        estimate = solution.discretisation_error
        return {
            **row,
            "status": solution.status.name,
            "iterations": solution.iterations,
            "products": solution.products,
            "krylov_iterations": solution.krylov_iterations,
            "residual": solution.residuals[-1],
            "energy_error_bound": solution.energy_error_bound,
            "discretisation_error": estimate,
            "effectivity": None if estimate is None else estimate / row["energy"],
        }

    def _algebra(self, found: Answer, pairing: str) -> Row:
        """Return the error of the mesh and the error of the iteration."""
        tight, mesh_error = self._without_algebra(pairing)
        case, u = tight.case, tight.solution.u
        difference = fem.Function(case.V)
        difference.x.array[:] = found.solution.u.x.array - u.x.array
        norm = energy_norm(case, u)
        return {
            "mesh_error": mesh_error,
            "algebra_error": energy_norm(case, difference) / norm,
        }


def make_reference(name: str, level: int) -> tuple[Reference, Row]:
    """Return a reference of a scene, and a row with the reference's own errors.

    Args:
        name: name of the scene.
        level: number of the reference; 0 is the finest.
    """
    study = SCENES[name]
    fine, coarse = study.references[level : level + 2]
    other = answer(study, coarse)
    once = {"repeats": 1, "enough": math.inf, "seconds": math.inf}
    found, cost = measured(study, fine, Setting(), math.inf, once)
    errors = [each.solution.discretisation_error for each in (found, other)]
    ratio = errors[0] / errors[1]
    reference = Reference(found.case, found.solution, errors[0])
    differences = reference.errors(other.case, other.solution)
    own = {key: value * ratio / (1 - ratio**2) ** 0.5 for key, value in differences.items()}
    for key in numbers(found.solution):
        own[key] = differences[key] * ratio / (1 - ratio)
    theory = theory_of(found.case, found.solution)
    if theory is not None:
        own["pressure"] = own["peak"] = (theory.contact_radius / theory.radius) ** 2
    row = {"scene": name, "family": fine.family, **dataclasses.asdict(fine)}
    row |= dataclasses.asdict(Setting("reference")) | {"asked": Setting().asked}
    row |= cost | own | {"energy": errors[0], "status": found.solution.status.name}
    return reference, row


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the scenes; all runs of a scene share one reference."""
    names = ("axes", "quick", "repeats", "enough", "seconds")
    for scene in arguments.scenes:
        yield {"scene": scene, **{name: getattr(arguments, name) for name in names}}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the row of a scene's reference, and the rows of all runs."""
    name = case["scene"]
    scene = SCENES[name]
    reference, row = make_reference(name, int(case["quick"]))
    yield row
    warm: set[str] = set()
    for mesh in scene.coarsest(3) if case["quick"] else scene.meshes:
        if mesh.family not in warm:
            warm_up(name, mesh, reference)
            warm.add(mesh.family)
        on_mesh: OnMesh | None = None
        for setting in settings(scene, mesh, case["axes"]):
            on_mesh = on_mesh or OnMesh(name, mesh, reference)
            yield on_mesh.run(setting, case)


def warm_up(name: str, mesh: Mesh, reference: Reference) -> None:
    """Compile and load everything that runs on this kind of mesh need."""
    on_mesh = OnMesh(name, mesh, reference)
    for stiffness in ("cholesky",) if mesh.accuracy else ("cholesky", "multigrid"):
        on_mesh.run(Setting(stiffness=stiffness), {"repeats": 1, "enough": 0.1, "seconds": 60.0})


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--axes", nargs="+", default=list(AXES), choices=AXES)
    parser.add_argument("--quick", action="store_true", help="coarser meshes and references")
    parser.add_argument("--repeats", type=int, default=3, help="at most, of a quick run")
    parser.add_argument("--enough", type=float, default=2.0, help="seconds; then no repetition")
    parser.add_argument("--seconds", type=float, default=30.0, help="limit for an iteration")


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=(
        "quick", "scene", "cell", "degree", "size", "grading", "accuracy", "goal",
        "axis", "pairing", "stiffness", "method", "rtol", "part", "krylov", "fraction",
    ),
    cases=cases,
    measure=measure,
    options=options,
    summary=summary,
    draw=draw,
    shown=COLUMNS,
    tables=TABLES,
)  # fmt: skip

if __name__ == "__main__":
    BENCHMARK.main()
