"""Iterations, products, time and memory by the number of bricks in walls held only by contact.

    tools/fenicsx python3 benchmarks/assemblies.py --json assemblies.json

Dry walls in running bond (`scenes/wall.py`) are loaded by their weight, and then also pushed at the
top by a part of the weight of a course. Both problems are solved to a relative residual of 1e-6.
One pair declares all contacts. Seconds are processor seconds of all ranks; for the weight they are
counted from forms to fields. "Cholesky" is the wall-clock time of the factorisation of K.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator

from harness import Benchmark, Column, Comm, Row, Table, add_ranks
from harness.memory import peak_memory, reset_peak_memory

from dolfinx_tresca import ContactStatus
from scenes.wall import HEIGHT, wall

#: Number of bricks -> bricks in a course, and courses; every second course has one more brick.
SIZES = {
    1: (1, 1),
    2: (2, 1),
    52: (6, 8),
    150: (12, 12),
    490: (24, 20),
    2046: (46, 44),
    5005: (71, 70),
}

#: The force of the push, divided by the weight of a course.
PUSH = 0.2

#: Relative residual at which solves end.
RTOL = 1e-6


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield walls."""
    for ranks, bricks in itertools.product(arguments.ranks, arguments.bricks):
        yield {"ranks": ranks, "bricks": bricks}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the figures of a wall. Collective."""
    scene = wall(comm, *SIZES[case["bricks"]], one_pair=case["bricks"] > 1)
    reset_peak_memory()

    def seconds(start: float) -> float:
        """Return the sum over the ranks of the processor seconds since `start`."""
        return comm.allreduce(time.process_time() - start)

    begin = time.process_time()
    course = scene.data.weights.sum() / SIZES[case["bricks"]][1]
    with scene.problem() as problem:
        for name, part in (("weight", 0.0), ("push", PUSH)):
            scene.data.push.value = part * course / HEIGHT
            solution = problem.solve(rtol=RTOL)
            yield {
                f"{name}_iterations": solution.iterations,
                f"{name}_products": solution.products,
                f"{name}_seconds": seconds(begin),
                **({"cholesky": solution.timings["cholesky"]} if name == "weight" else {}),
                "nodes": solution.counts.nodes,
                "peak_mb": peak_memory(comm),
                "status": solution.status.name,
            }
            if solution.status is not ContactStatus.CONVERGED:
                return
            problem.accept()
            begin = time.process_time()


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--bricks", nargs="+", type=int, default=list(SIZES), choices=SIZES)
    add_ranks(parser)


COLUMNS = [
    Column("ranks", "{ranks}"),
    Column("bricks", "{bricks}"),
    Column("contact nodes", "{nodes}"),
    Column("weight: iterations / products", "{weight_iterations} / {weight_products}"),
    Column("seconds", "{weight_seconds:.2f}"),
    Column("of it Cholesky", "{cholesky:.3f}"),
    Column("push: iterations / products", "{push_iterations} / {push_products}", missing="-"),
    Column("seconds of it", "{push_seconds:.2f}", missing="-"),
    Column("peak memory [MB]", "{peak_mb:.0f}"),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("bricks", "ranks"),
    cases=cases,
    measure=measure,
    options=options,
    small={"bricks": 2},
    shown=COLUMNS,
    tables=[Table("assemblies", COLUMNS, line=["ranks", "bricks"])],
)

if __name__ == "__main__":
    BENCHMARK.main()
