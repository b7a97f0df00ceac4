"""Cost of derivatives relative to solves: for one solution, and through a process.

    tools/fenicsx python3 benchmarks/gradients.py --json benchmarks/data/gradients.json

The two bricks have Coulomb friction with F = 0.3. The load changes by a factor of 0.9 or 1.1 from
solve to solve, and solves end at a residual of 1e-8. "One solution": the gradient
of the normal force is computed after the first solve, which starts from zero, and after each later
solve; the control is a gap that is one number, or a Function with a value at each node of the mesh.
"Process": all solves are recorded, with `accept()` after each, and the gradient of the last normal
force goes back through all of them. Seconds are processor seconds of one thread on one rank, which
depend less on other work on the machine.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from statistics import mean
from typing import Any

import numpy as np
from harness import DASH, Benchmark, Column, Comm, Row, Table
from harness.timing import timed

from dolfinx import fem

from dolfinx_tresca import ContactStatus, Coulomb, NormalForce
from scenes.two_bricks import ENDS, two_bricks

#: Solvers for K.
BACKENDS = ("cholesky", "multigrid")

#: Relative residual at which solves end, and number of solves after the first one.
RTOL, LATER = 1e-8, 6

#: Seed of the signs of the changes of the load, and relative size of a change.
SEED, CHANGE = 1, 0.1

#: Kinds of gradients: of one solution or a process, and with respect to which gap.
WHAT = ("one solution, one value", "one solution, many values", "process, many values")


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield models and solvers for K."""
    loops = (arguments.sizes, arguments.scenes, arguments.backends, WHAT)
    for N, scene, backend, what in itertools.product(*loops):
        yield {"N": N, "scene": scene, "backend": backend, "what": what}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the row of a case. Collective."""
    scene = two_bricks(comm, case["N"], end=case["scene"])
    gap: Any = fem.Constant(scene.mesh, 0.0)
    if "many" in case["what"]:
        gap = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1)), name="gap")
    scene = scene.but(friction=Coulomb(0.3), gap=gap)
    load = scene.data.load
    first = load.value.copy()
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], LATER)
    factors = np.cumprod([1.0, *(1.0 + CHANGE * signs)])
    solves, gradients, solutions = [], [], []
    is_process = "process" in case["what"]
    with scene.problem(stiffness=case["backend"], expected_solves=LATER) as problem:
        with problem.record() if is_process else nullcontext() as tape:
            for factor in factors:
                load.value[:] = factor * first
                took, solution = timed(comm, lambda: problem.solve(rtol=RTOL))
                solves.append(took)
                solutions.append(solution)
                if is_process:
                    problem.accept()
                else:
                    took, _ = timed(comm, lambda: problem.gradient(NormalForce(), [gap]))
                    gradients.append(took)
        if is_process:
            goal = {len(tape) - 1: NormalForce()}
            gradients.append(timed(comm, lambda: tape.gradient(goal, [gap]))[0])
        products = [solution.products for solution in solutions]
        free = problem.free_dofs
    load.value[:] = first
    failed = [one for one in solutions if one.status is not ContactStatus.CONVERGED]
    yield {
        "n": free,
        "values": int(gap.x.index_map.size_global) if "many" in case["what"] else 1,
        "solves": solves,
        "gradients": gradients,
        "products": products,
        "status": (failed or solutions)[0].status.name,
    }


def ratio(later: bool) -> Callable[[list[Row]], str]:
    """Return a function that writes the time of a gradient divided by the time of its solve.

    For a process the time of the gradient is divided by the time of all solves.

    Args:
        later: whether to take the means of the later gradients and solves instead of the first.
    """

    def text(rows: list[Row]) -> str:
        (row,) = rows
        solves, gradients = row.get("solves"), row.get("gradients")
        if not solves or (len(gradients) == 1 and not later):
            return DASH
        if len(gradients) == 1:
            return f"{gradients[0] / sum(solves):.2f}"
        part = slice(1, None) if later else slice(0, 1)
        return f"{mean(gradients[part]) / mean(solves[part]):.2f}"

    return text


def mean_of(name: str) -> Callable[[list[Row]], str]:
    """Return a function that writes the first seconds, and the mean of the later seconds."""

    def text(rows: list[Row]) -> str:
        (row,) = rows
        found = row.get(name)
        if not found:
            return DASH
        return f"{found[0]:.2f}" + (f" / {mean(found[1:]):.2f}" if len(found) > 1 else "")

    return text


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=["free_end_2"], choices=ENDS)
    parser.add_argument("--backends", nargs="+", default=list(BACKENDS), choices=BACKENDS)


COLUMNS = [
    Column("gradient", "{what}", width=37),
    Column("scene", "`{scene}`", width=12),
    Column("N", "{N}", width=2),
    Column("solver for K", "{backend}", width=9),
    Column("values", "{values}", width=6),
    Column("solve, first / later [s]", mean_of("solves"), width=13),
    Column("gradient, first / later [s]", mean_of("gradients"), width=13),
    Column("over the first solve", ratio(False), width=5),
    Column("over a later solve, or the process", ratio(True), width=5),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("what", "scene", "N", "backend"),
    cases=cases,
    measure=measure,
    options=options,
    small={"N": 3},
    shown=COLUMNS,
    tables=[Table("gradients", COLUMNS)],
)

if __name__ == "__main__":
    BENCHMARK.main()
