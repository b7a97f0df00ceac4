"""The cost of a load step: products of solves with the same K, each starting from the last one.

    tools/fenicsx python3 benchmarks/steps.py --sizes 8 16 26 36 41 \
        --json benchmarks/data/steps.json

The load of the two bricks changes ten times, by a factor of 0.9 or 1.1. The factors are random, but
the same in each run. The first solve starts from zero; each later solve starts from the last
multipliers and keeps the products with A. Without history each solve is a static problem, in which
friction depends on the total slip; with `problem.accept()` after each solve, slip counts from the
last step. "rtol 1e-6" solves each step until the natural residual is 1e-6 of the residual at zero;
"default" is `solve()`. Krylov iterations are all iterations of conjugate gradients in a step, on
average over the steps. Seconds of a step are divided by those of the linear solve of cost.py, which
includes assembly and factorisation.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterator
from statistics import mean

import numpy as np
from cost import linear
from harness import DASH, Benchmark, Column, Comm, Row, Table, add_ranks
from harness.timing import timed

from dolfinx_tresca import ContactSolution, ContactStatus, Coulomb, Tresca
from scenes.scene import Scene
from scenes.two_bricks import ENDS, SLIP_BOUND, two_bricks

BACKENDS = ("cholesky", "multigrid")
FRICTION = {"Tresca": Tresca(SLIP_BOUND), "Coulomb": Coulomb(0.3)}

#: Requested accuracy of a row -> the argument of `solve`.
ASKED: dict[str, Row] = {"default": {}, "rtol 1e-6": {"rtol": 1e-6}}

#: Number of linear solves, of which the fastest counts.
LINEAR = 3

#: Seed of the signs of the changes; relative size of a change; number of changes.
SEED, CHANGE, STEPS = 1, 0.1, 10


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield models and solvers for K."""
    loops = (arguments.ranks, arguments.sizes, arguments.scenes, arguments.friction)
    for ranks, N, scene, friction in itertools.product(*loops):
        for backend in arguments.backends:
            case = {"ranks": ranks, "N": N, "scene": scene, "friction": friction}
            yield {**case, "backend": backend, "asked": arguments.asked}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each accuracy, without history and with it. Collective."""
    scene = two_bricks(comm, case["N"], end=case["scene"])
    scene = scene.but(friction=FRICTION[case["friction"]])
    linear(scene, case["backend"])  # compiles, loads and allocates what later solves need
    seconds = min(timed(comm, lambda: linear(scene, case["backend"]))[0] for _ in range(LINEAR))
    for asked, history in itertools.product(case["asked"], (False, True)):
        found = steps(scene, case["backend"], asked, history)
        ratio = mean(found["seconds"]) / seconds
        yield {
            "asked": asked,
            "history": history,
            **found,
            "linear_seconds": seconds,
            "ratio": ratio,
        }


def steps(scene: Scene, backend: str, asked: str, history: bool) -> Row:
    """Return the costs of the first solve and of the steps after it. Collective."""
    load = scene.data.load
    first = load.value.copy()
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], STEPS)
    factors = np.cumprod([1.0, *(1.0 + CHANGE * signs)])
    solutions, seconds = [], []
    with scene.problem(stiffness=backend) as problem:
        n, m = problem.free_dofs, problem.contact_nodes
        for factor in factors:
            load.value[:] = factor * first

            def step() -> ContactSolution:
                solution = problem.solve(**ASKED[asked])
                if history:
                    problem.accept(unconverged=True)  # the row shows failures
                return solution

            needed, solution = timed(scene.mesh.comm, step)
            solutions.append(solution)
            seconds.append(needed)
    load.value[:] = first
    cold, *warm = solutions
    failed = [one for one in solutions if one.status is not ContactStatus.CONVERGED]
    return {
        "n": n,
        "m": m,
        "factors": factors.tolist(),
        "cold": cold.products,
        "cold_krylov": cold.krylov_iterations,
        "products": [solution.products for solution in warm],
        "seconds": seconds[1:],
        "krylov": [solution.krylov_iterations for solution in warm],
        "iterations": [solution.iterations for solution in warm],
        "failed": len(failed),
        "status": (failed or solutions)[0].status.name,
    }


def counts(rows: list[Row]) -> str:
    """Return the products of the first solve, and the mean and the maximum of the steps."""
    (row,) = rows
    if "products" not in row:
        return DASH
    text = f"{row['cold']} / {mean(row['products']):.1f} / {max(row['products'])}"
    return text + (f" ({row['failed']} not converged)" if row["failed"] else "")


def krylov(rows: list[Row]) -> str:
    """Return the mean of the Krylov iterations of a step; a direct solver has none."""
    found = mean(rows[-1].get("krylov", [0]))
    return f"{found:.0f}" if found else DASH


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16, 26], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(ENDS), choices=ENDS)
    parser.add_argument("--friction", nargs="+", default=list(FRICTION), choices=FRICTION)
    parser.add_argument("--backends", nargs="+", default=list(BACKENDS), choices=BACKENDS)
    parser.add_argument("--asked", nargs="+", default=list(ASKED), choices=ASKED)
    add_ranks(parser)


def each(backend: str) -> list[Column]:
    """Return the columns of a solver for K."""
    without, accepted = ({"backend": backend, "history": history} for history in (False, True))
    columns = [
        Column(f"{backend}: cold / mean / most", counts, without, DASH),
        Column("the same with `accept()`", counts, accepted, DASH),
    ]
    if backend == "multigrid":
        columns.append(Column("Krylov, mean", krylov, without, DASH))
        columns.append(Column("with `accept()`", krylov, accepted, DASH))
    return columns


WHAT = [
    Column("friction", "{friction}", width=8),
    Column("requested", "{asked}", width=9),
    Column("scene", "`{scene}`", width=12),
    Column("N", "{N}", width=2),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("friction", "asked", "scene", "N", "backend", "history", "ranks"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        *WHAT,
        Column("back end", "{backend}", width=9),
        Column("history", "{history}"),
        Column("cold / mean / most", counts, width=18),
        Column("Krylov", krylov),
        Column("over linear", "{ratio:.2f}"),
    ],
    tables=[
        Table(
            "steps",
            [*WHAT, *(column for backend in BACKENDS for column in each(backend))],
            chosen=lambda row: row["ranks"] == 1,
            line=["friction", "asked", "scene", "N"],
        ),
        Table(
            "steps_cost",
            [
                *WHAT,
                Column("n", "{n}"),
                *(
                    Column(
                        f"{backend}{' with `accept()`' * history}",
                        "{ratio:.2f}",
                        {"backend": backend, "history": history},
                    )
                    for backend in BACKENDS
                    for history in (False, True)
                ),
            ],
            chosen=lambda row: row["ranks"] == 1,
            line=["friction", "asked", "scene", "N"],
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
