"""Error over wall time and memory: which mesh, accuracy, algorithm and K-solver to take.

    tools/fenicsx python3 benchmarks/tradeoff.py --json FILE --picture FILE

For the two bricks (`free_end_1`), the ball of Hertz and the implant it solves on meshes of several
kinds and sizes, and on two of them with other tolerances, algorithms and K-solvers, one at a time.
It prints a row for each run, then for each scene what the balance of errors costs, the Pareto
fronts, and what to take for an error of 10, 1 and 0.1 percent. It writes the rows as JSON, of which
`--from FILE --picture FILE` draws the picture again.

Errors are relative, those of the whole answer (mesh and iteration) against a solution on a fine
mesh: of the displacement in the energy norm, of pressure and slip in L2 of the contact surface.
`mesh` is the energy error of a solution to a residual of 1e-8 on the same mesh, so the mesh's own;
`algebra` is the energy norm of the difference from that one. `estimate` is the package's estimate
of the mesh's error, `effect.` it over `mesh`. The reference has an error too: about the difference
from a coarser one, as it goes with a rate of 1.5. What is not above that is not resolved.

Seconds are those from forms to fields (`ContactProblem(...)` and `solve`), without the mesh, the
best of some repetitions, after a small run has compiled what there is to compile. Memory is what
the process held at the peak beyond what it held before, so without mesh and Python.

The axes: `mesh` (defaults on all meshes), `backend` and `pairing` (on all meshes of degree 1; by
default the bricks are paired node-to-node there, for degree 2 there is mortar only),
`part` (the iteration's error over the mesh's at which "balanced" stops), `rtol`, `method` (each to
the default accuracy), `krylov` (accuracy of the solver for K: of the products of projected_newton,
and of each solve of imssn).
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
from unittest import mock

from mpi4py import MPI

from kept import add_files, keep, redraw
from memory import peak_memory, reset_peak_memory, resident_memory
from tradeoff_scenes import RATE, SCENES, Mesh, Reference, Study, energy_norm, solved
from tradeoff_tables import (
    COLUMNS,
    Row,
    draw,
    print_advice,
    print_effectivity,
    print_fronts,
    print_parts,
    print_row,
)

from dolfinx import fem

from dolfinx_tresca import ContactError, ContactProblem, ContactSolution
from dolfinx_tresca.optimise import iterate, stopping
from scenes.scene import Scene

AXES = ("mesh", "backend", "pairing", "part", "rtol", "method", "krylov")

PARTS = (0.5, 0.3, 0.1, 0.03, 0.01)
RTOLS = tuple(10.0**-k for k in range(1, 11))
METHODS = ("imssn", "gimssn", "ssn", "mssn")
KRYLOV = {"projected_newton": (0.5, 0.3, 0.1, 0.03, 0.01), "imssn": (1e-2, 1e-4, 1e-6, 1e-8)}

#: Relative natural residual of the solutions without algebraic error.
TIGHT = 1e-8


@dataclass(frozen=True)
class Setting:
    """All that may differ on one mesh."""

    axis: str = "mesh"
    pairing: str = "auto"
    stiffness: str = "auto"
    method: str = "projected_newton"
    rtol: float | None = None
    part: float = stopping.BALANCED
    krylov: float | None = None
    petsc: dict[str, Any] = field(default_factory=dict)

    @property
    def asked(self) -> str:
        """What decides when the iteration ends."""
        return f"part {self.part:g}" if self.rtol is None else f"rtol {self.rtol:.0e}"


def settings(scene: Study, mesh: Mesh, axes: list[str]) -> Iterator[Setting]:
    """Yield what is run on a mesh."""
    if "mesh" in axes:
        yield Setting()
    if mesh.degree == 1 and "backend" in axes:
        for stiffness in ("cholesky", "multigrid"):
            yield Setting("backend", stiffness=stiffness)
    if mesh.degree == 1 and "pairing" in axes and scene is SCENES["two_bricks"]:
        yield Setting("pairing", pairing="mortar")
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
        for accuracy in KRYLOV["projected_newton"]:
            yield Setting("krylov", stiffness="multigrid", krylov=accuracy)
        for accuracy in KRYLOV["imssn"]:
            options = {"ksp_rtol": accuracy}
            yield Setting("krylov", "auto", "multigrid", "imssn", krylov=accuracy, petsc=options)


class TimeLimit:
    """Stops a solve that takes too long."""

    def __init__(self, seconds: float) -> None:
        self._end = time.perf_counter() + seconds

    def __call__(self, iteration: Any) -> bool:
        """Whether time is up."""
        return time.perf_counter() > self._end


def contact(case: Scene, setting: Setting, limit: float) -> tuple[ContactSolution, ContactProblem]:
    """Solve from forms to fields."""
    pair = dataclasses.replace(case.pair, pairing=setting.pairing)
    options: dict[str, Any] = {"method": setting.method, "max_iterations": 10_000}
    options |= {"accuracy": "balanced"} if setting.rtol is None else {"rtol": setting.rtol}
    if setting.part != stopping.BALANCED:
        options["local_accuracy"] = 0.9  # energies alone
    products = iterate.STEP_ACCURACY if setting.krylov is None else setting.krylov
    with (
        # factors that users cannot choose
        mock.patch.object(stopping, "BALANCED", setting.part),
        mock.patch.object(iterate, "STEP_ACCURACY", products),
        ContactProblem(
            case.a,
            case.L,
            [pair],
            bcs=case.bcs,
            stiffness=setting.stiffness,
            petsc_options=setting.petsc,
        ) as problem,
    ):
        return problem.solve(observer=TimeLimit(limit), **options), problem


def measured(
    case: Scene, setting: Setting, arguments: argparse.Namespace
) -> tuple[ContactSolution, Row]:
    """Return a solution and its cost."""
    comm = case.mesh.comm
    seconds, memory = [], 0.0
    while len(seconds) < arguments.repeats and sum(seconds) < arguments.enough:
        gc.collect()
        before = resident_memory(comm)
        reset_peak_memory()
        start = time.perf_counter()
        solution, problem = contact(case, setting, arguments.seconds)
        seconds.append(time.perf_counter() - start)
        memory = max(memory, peak_memory(comm) - before)
    cost = {
        "n": problem.free_dofs,
        "m": problem.contact_nodes,
        "chosen": next(name for name in ("cholesky", "multigrid") if name in solution.timings),
        "seconds": min(seconds),
        "all_seconds": seconds,
        "memory_mb": memory,
    }
    return solution, cost


class OnMesh:
    """Runs on one mesh."""

    def __init__(self, name: str, mesh: Mesh, reference: Reference) -> None:
        self._name, self._mesh, self._reference = name, mesh, reference
        self._case = SCENES[name].case(mesh)
        self._tight: dict[str, tuple[ContactSolution, float]] = {}

    def _without_algebra(self, pairing: str) -> tuple[ContactSolution, float]:
        """Return a solution to a small residual, and the error of the mesh that it tells."""
        if pairing not in self._tight:
            solution, _ = contact(self._case, Setting(pairing=pairing, rtol=TIGHT), math.inf)
            error = self._reference.errors(self._case, solution)["energy"]
            self._tight[pairing] = solution, error
        return self._tight[pairing]

    def run(self, setting: Setting, arguments: argparse.Namespace) -> Row:
        """Return a row."""
        case, mesh = self._case, self._mesh
        row: Row = {"scene": self._name, "family": mesh.family, **dataclasses.asdict(mesh)}
        row |= dataclasses.asdict(setting) | {"asked": setting.asked}
        try:
            solution, cost = measured(case, setting, arguments)
        except ContactError as error:
            return {**row, "status": f"{error}"}
        tight, mesh_error = self._without_algebra(setting.pairing)
        difference = fem.Function(case.V)
        difference.x.array[:] = solution.u.x.array - tight.u.x.array
        estimate = solution.discretisation_error
        return {
            **row,
            **cost,
            "status": solution.status.name,
            "iterations": solution.iterations,
            "products": solution.products,
            "krylov_iterations": solution.krylov_iterations,
            "residual": solution.residuals[-1],
            **self._reference.errors(case, solution),
            "mesh_error": mesh_error,
            "algebra_error": energy_norm(case, difference) / energy_norm(case, tight.u),
            "energy_error_bound": solution.energy_error_bound,
            "discretisation_error": estimate,
            "effectivity": None if estimate is None else estimate / mesh_error,
        }


def make_reference(name: str, level: int) -> tuple[Reference, Row]:
    """Return a reference of a scene, 0 being the best, and a row that tells its own errors."""
    fine, coarse = SCENES[name].references[level : level + 2]
    start = time.perf_counter()
    case = SCENES[name].case(fine)
    solution, problem = solved(case)
    reference = Reference(case, solution)
    sizes = fine.size, coarse.size
    ratio = (min(sizes) / max(sizes)) ** RATE
    case = SCENES[name].case(coarse)
    differences = reference.errors(case, solved(case)[0])
    own = {key: value * ratio / (1 - ratio**2) ** 0.5 for key, value in differences.items()}
    row = {"scene": name, "family": fine.family, **dataclasses.asdict(fine), "axis": "reference"}
    row |= {"n": problem.free_dofs, "m": problem.contact_nodes, **own}
    errors = ", ".join(f"{key} {value:.1e}" for key, value in own.items())
    print(
        f"{name}: the reference, {fine.family} of size {fine.size:g} with n/m = {row['n']}/"
        f"{row['m']}, took {time.perf_counter() - start:.0f} seconds; its own errors: {errors}",
        flush=True,
    )
    return reference, row


def main() -> None:
    """Read the arguments, measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))
    parser.add_argument("--axes", nargs="+", default=list(AXES), choices=AXES)
    parser.add_argument("--quick", action="store_true", help="coarser meshes and references")
    parser.add_argument("--repeats", type=int, default=3, help="at most, of a quick run")
    parser.add_argument("--enough", type=float, default=2.0, help="seconds; then no repetition")
    parser.add_argument("--seconds", type=float, default=30.0, help="limit for an iteration")
    add_files(parser)
    arguments = parser.parse_args()
    if redraw(arguments, draw):
        return
    if MPI.COMM_WORLD.size > 1:
        parser.error("it runs on one rank")
    for path in (arguments.json, arguments.picture):  # before the work, not after
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)

    rows: list[Row] = []
    for name in arguments.scenes:
        scene = SCENES[name]
        reference, row = make_reference(name, int(arguments.quick))
        rows.append(row)
        print(COLUMNS, flush=True)
        warm: set[str] = set()
        for mesh in scene.coarsest(3) if arguments.quick else scene.meshes:
            if mesh.family not in warm:
                warm_up(name, mesh, reference)
                warm.add(mesh.family)
            on_mesh: OnMesh | None = None
            for setting in settings(scene, mesh, arguments.axes):
                on_mesh = on_mesh or OnMesh(name, mesh, reference)
                rows.append(on_mesh.run(setting, arguments))
                print_row(rows[-1])
                keep(arguments.json, rows)
    for name in arguments.scenes:
        print_parts(rows, name)
        print_fronts(rows, name)
        print_effectivity(rows, name)
    for name in arguments.scenes:
        print_advice(rows, name)
    if arguments.picture is not None:
        draw(arguments.picture, rows)


def warm_up(name: str, mesh: Mesh, reference: Reference) -> None:
    """Compile and load all that runs on this kind of mesh need."""
    on_mesh = OnMesh(name, mesh, reference)
    for stiffness in ("cholesky", "multigrid"):
        on_mesh.run(
            Setting(stiffness=stiffness),
            argparse.Namespace(repeats=1, enough=0.1, seconds=60.0),
        )


if __name__ == "__main__":
    main()
