"""What benchmarks/cost.py measures, in a process or a group of ranks of its own.

    mpirun -n 2 python3 benchmarks/cost_runs.py '{"task": "time", ...}' FILE

does one task and writes what it found to FILE; cost.py says which tasks there are.
"""

from __future__ import annotations

import gc
import json
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

sys.path.insert(0, str(Path(__file__).parents[1] / "demos"))
from demo_two_bricks import Scene, two_bricks
from memory import peak_memory, reset_peak_memory

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactProblem, ContactSolution
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.multigrid import multigrid
from dolfinx_tresca.stiffness.system import LinearSystem

#: What the accuracies are.
ASKED = {"1e-3": {"accuracy": 1e-3}, "1e-6": {"rtol": 1e-6}}

#: Relative natural residual of the solution with which others are compared.
TIGHT = 1e-8

#: Of the linear solve by multigrid: a relative residual of 1e-8, as PETSc measures by default.
LINEAR_MULTIGRID = {"ksp_rtol": 1e-8, "ksp_norm_type": "preconditioned"}


def linear(scene: Scene, backend: str) -> None:
    """Assemble and solve the elastic problem without contact, once. Collective."""
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        system.assemble_load()
        u = fem.Function(scene.V)
        with (
            cholesky(system.K, {}, None)
            if backend == "cholesky"
            else multigrid(system.K, scene.V, system.prescribed, LINEAR_MULTIGRID, None)
        ) as solver:
            solver.solve(system.f.x.petsc_vec, u.x.petsc_vec)
        u.x.scatter_forward()


def contact(scene: Scene, backend: str, accuracy: str) -> ContactSolution:
    """Solve the contact problem from forms to fields. Collective."""
    with ContactProblem(
        scene.a, scene.L, [scene.pair], bcs=scene.bcs, stiffness=backend
    ) as problem:
        solution = problem.solve(**ASKED[accuracy])
    solution.raise_if_failed()
    return solution


def seconds_of(comm: MPI.Comm, work: Callable[[], Any]) -> tuple[float, Any]:
    """Return how long the slowest rank takes, and the result. Collective."""
    gc.collect()
    comm.barrier()
    start = time.perf_counter()
    result = work()
    return comm.allreduce(time.perf_counter() - start, op=MPI.MAX), result


def energy_norm(scene: Scene, u: Any) -> float:
    """Return |u|_K. Collective."""
    square = fem.assemble_scalar(fem.form(ufl.action(ufl.action(scene.a, u), u)))
    return float(scene.V.mesh.comm.allreduce(square)) ** 0.5


def energy_error(scene: Scene, u: Any, tight: Any) -> float:
    """Return |u - tight|_K / |tight|_K. Collective."""
    difference = fem.Function(scene.V)
    difference.x.array[:] = u.x.array - tight.x.array
    return energy_norm(scene, difference) / energy_norm(scene, tight)


def measure_times(scene: Scene, task: dict[str, Any]) -> dict[str, Any]:
    """Measure the linear and the contact solve in turns. Collective."""
    comm = scene.V.mesh.comm
    with ContactProblem(
        scene.a, scene.L, [scene.pair], bcs=scene.bcs, stiffness=task["backend"]
    ) as problem:
        tight = problem.solve(rtol=TIGHT)
        chosen = next(name for name in ("cholesky", "multigrid") if name in tight.timings)
        sizes = {"n": problem.free_dofs, "m": problem.contact_nodes, "chosen": chosen}
    runs: dict[str, dict[str, Any]] = {}
    seconds: dict[str, list[float]] = {accuracy: [] for accuracy in task["accuracies"]}
    linear_seconds: dict[str, list[float]] = {accuracy: [] for accuracy in task["accuracies"]}
    for _ in range(task["repeats"]):
        for accuracy in task["accuracies"]:
            needed, _ = seconds_of(comm, lambda: linear(scene, chosen))
            linear_seconds[accuracy].append(needed)
            needed, solution = seconds_of(
                comm, lambda accuracy=accuracy: contact(scene, task["backend"], accuracy)
            )
            seconds[accuracy].append(needed)
            runs[accuracy] = {
                "residual": solution.residuals[-1],
                "energy_error_bound": solution.energy_error_bound,
                "energy_error": energy_error(scene, solution.u, tight.u),
                "iterations": solution.iterations,
                "products": solution.products,
                "krylov_iterations": solution.krylov_iterations,
            }
    for accuracy, run in runs.items():
        run.update(linear=linear_seconds[accuracy], contact=seconds[accuracy])
    return {**sizes, "tight_residual": tight.residuals[-1], "runs": runs}


def measure_memory(scene: Scene, task: dict[str, Any]) -> dict[str, Any]:
    """Measure the peak of one solve; the mesh and what Python loads are in it. Collective."""
    gc.collect()
    reset_peak_memory()
    if task["task"] == "linear_memory":
        linear(scene, task["backend"])
    else:
        contact(scene, task["backend"], task["accuracy"])
    return {"mb": peak_memory(scene.V.mesh.comm)}


def main() -> None:
    """Do the task."""
    task = json.loads(sys.argv[1])
    # beyond this allocations fail, and the task with a message, before the machine runs dry
    resource.setrlimit(resource.RLIMIT_AS, (task["memory"], task["memory"]))
    comm = MPI.COMM_WORLD
    small = two_bricks(comm, 4, end=task["scene"])  # loads what the first run has to load
    linear(small, "cholesky" if task["backend"] == "auto" else task["backend"])
    contact(small, task["backend"], "1e-6")
    scene = two_bricks(comm, task["N"], end=task["scene"])
    result = (measure_times if task["task"] == "time" else measure_memory)(scene, task)
    if comm.rank == 0:
        Path(sys.argv[2]).write_text(json.dumps(result))


if __name__ == "__main__":
    main()
