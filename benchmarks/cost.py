"""The cost of contact: a contact solve compared with a linear elastic solve on the same mesh.

    tools/fenicsx python3 benchmarks/cost.py --sizes 16 26 --ranks 1 2 --json FILE

The linear solve has to be paid for without contact, too: assemble K and f of the two bricks without
contact, set up the solver that the contact solve uses, with the same options (MUMPS, or GAMG with
conjugate gradients to a relative residual of 1e-8), and solve once. The contact solve is everything
from `ContactProblem(...)` to the fields. One process, which has loaded everything before, runs both
in turns; medians are taken, and the time for the mesh is not counted. `spread` is (slowest -
fastest) / median, for the linear or the contact solves, whichever is larger; `ratio_of_fastest` is
the better figure on a shared machine.

Accuracy 1e-6 is the relative natural residual (`rtol`). Accuracy 1e-3 is the relative error of the
displacement in the energy norm (`accuracy`), which the solver bounds: `energy_error_bound` is this
bound, and `energy_error` is the error itself, against a solution to a residual of 1e-8.

Memory is the peak (VmHWM, summed over ranks) of two further processes: one only runs a linear
solve, the other only a contact solve. The peak is reset after the mesh was made, but memory that is
in use at that time, such as Python and the mesh, is included.
"""

from __future__ import annotations

import argparse
import gc
import itertools
from collections.abc import Iterator
from statistics import median
from typing import Any

from harness import DASH, Benchmark, Column, Comm, Row, Table, add_ranks, krylov_iterations
from harness.memory import peak_memory, reset_peak_memory
from harness.timing import spread, timed

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactSolution
from dolfinx_tresca.stiffness.solver import cholesky, multigrid
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.scene import Scene
from scenes.two_bricks import two_bricks

SCENES = ("free_end_1", "free_end_2")
BACKENDS = ("cholesky", "multigrid")

#: Requested accuracy of a row -> the argument of `solve`.
ASKED: dict[float, Row] = {1e-3: {"accuracy": 1e-3}, 1e-6: {"rtol": 1e-6}}
IN_WORDS = {1e-3: "error", 1e-6: "residual"}

#: Relative natural residual of the solution that serves as the reference for errors.
TIGHT = 1e-8

#: Options of the linear solve by multigrid: a relative residual of 1e-8 in PETSc's default norm.
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


def contact(scene: Scene, backend: str, accuracy: float) -> ContactSolution:
    """Solve the contact problem from forms to fields. Collective."""
    with scene.problem(stiffness=backend) as problem:
        solution = problem.solve(**ASKED[accuracy])
    solution.raise_if_failed()
    return solution


def energy_norm(scene: Scene, u: Any) -> float:
    """Return |u|_K. Collective."""
    square = fem.assemble_scalar(fem.form(ufl.action(ufl.action(scene.a, u), u)))
    return float(scene.V.mesh.comm.allreduce(square)) ** 0.5


def energy_error(scene: Scene, u: Any, tight: Any) -> float:
    """Return |u - tight|_K / |tight|_K. Collective."""
    difference = fem.Function(scene.V)
    difference.x.array[:] = u.x.array - tight.x.array
    return energy_norm(scene, difference) / energy_norm(scene, tight)


#: Kinds of cases, each of which is measured in processes of its own.
PARTS = ("seconds", "memory of linear", "memory of contact")


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield one case for the seconds, and one case for each figure of memory."""
    loops = (arguments.sizes, arguments.scenes, arguments.ranks, arguments.backends)
    for N, scene, ranks, backend in itertools.product(*loops):
        case = {"scene": scene, "N": N, "ranks": ranks, "backend": backend}
        yield {**case, "part": PARTS[0], "asked": arguments.accuracies,
               "repeats": arguments.repeats}  # fmt: skip
        for accuracy in arguments.accuracies:
            for part in PARTS[1:]:
                yield {**case, "part": part, "accuracy": accuracy}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the seconds or the memory of a case. Collective."""
    scene = two_bricks(comm, case["N"], end=case["scene"])
    if case["part"] == PARTS[0]:
        yield from measure_seconds(comm, scene, case)
        return
    gc.collect()
    reset_peak_memory()
    if case["part"] == PARTS[1]:
        linear(scene, case["backend"])
        yield {"linear_rss_mb": peak_memory(comm)}
    else:
        contact(scene, case["backend"], case["accuracy"])
        yield {"contact_rss_mb": peak_memory(comm)}


def measure_seconds(comm: Comm, scene: Scene, case: Row) -> Iterator[Row]:
    """Yield a row for each accuracy: linear and contact solves in turns. Collective."""
    with scene.problem(stiffness=case["backend"]) as problem:
        tight = problem.solve(rtol=TIGHT)
        sizes = {"n": problem.free_dofs, "m": problem.contact_nodes}
    for accuracy in case["asked"]:
        plain, with_it = [], []
        for _ in range(case["repeats"]):
            plain.append(timed(comm, lambda: linear(scene, case["backend"]))[0])
            seconds, solution = timed(
                comm, lambda accuracy=accuracy: contact(scene, case["backend"], accuracy)
            )
            with_it.append(seconds)
        yield {
            **sizes,
            "accuracy": accuracy,
            "residual": solution.residuals[-1],
            "energy_error_bound": solution.energy_error_bound,
            "energy_error": energy_error(scene, solution.u, tight.u),
            "iterations": solution.iterations,
            "products": solution.products,
            "krylov_iterations": solution.krylov_iterations,
            "linear_seconds": median(plain),
            "contact_seconds": median(with_it),
            "ratio": median(with_it) / median(plain),
            "ratio_of_fastest": min(with_it) / min(plain),
            "repeats": case["repeats"],
            "spread": max(spread(with_it), spread(plain)),
        }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", type=int, nargs="+", default=[16, 26, 36], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--backends", nargs="+", default=list(BACKENDS), choices=BACKENDS)
    parser.add_argument("--accuracies", type=float, nargs="+", default=list(ASKED), choices=ASKED)
    parser.add_argument("--repeats", type=int, default=3, help="turns of linear and contact")
    add_ranks(parser)


def requested(rows: list[Row]) -> str:
    """Return the requested accuracy as a short text."""
    if rows[0].get("accuracy") is None:
        return ""  # it failed before
    accuracy = rows[0]["accuracy"]
    return f"{IN_WORDS[accuracy]} {accuracy:.0e}".replace("e-0", "e-")


COLUMNS = [
    Column("scene", "`{scene}`", width=12),
    Column("n / m", "{n} / {m}", width=14),
    Column("back end", "{backend}", width=9),
    Column("ranks", "{ranks}"),
    Column("requested", requested, width=13),
    Column("energy error: bound / true", "{energy_error_bound:.0e} / {energy_error:.0e}"),
    Column("linear s", "{linear_seconds:.1f}"),
    Column("contact s", "{contact_seconds:.1f}"),
    Column("ratio", "{ratio:.2f}"),
    Column("products", "{products}"),
    Column("Krylov", krylov_iterations),
    Column("linear MB", "{linear_rss_mb:.0f}", missing=DASH),
    Column("contact MB", "{contact_rss_mb:.0f}", missing=DASH),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "N", "backend", "ranks", "accuracy"),
    cases=cases,
    measure=measure,
    small={"N": 4, "repeats": 1},
    options=options,
    shown=[*COLUMNS, Column("spread", "{spread:.2f}")],
    tables=[Table("cost", COLUMNS, chosen=lambda row: "ratio" in row)],
)

if __name__ == "__main__":
    BENCHMARK.main()
