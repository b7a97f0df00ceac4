"""Growth of processor seconds with unknowns, contact nodes, load steps, pairs and bodies.

    OMP_NUM_THREADS=1 tools/fenicsx python3 benchmarks/growth.py --json FILE

Each kind of case increases one number and, if possible, keeps the other numbers:

    unknowns        two bricks (`scenes/two_bricks.py`), n from 10^4 to 3 10^6; with Cholesky only
                    to 2 10^5, since the factors take much memory
    contact_nodes   one layer of cells on a rigid plane: n is a multiple of the contact nodes
    load_steps      1,000 small changes of the load of two bricks, with one K
    pairs           one body on rigid planes, a pair for each of up to 50 strips, or for each
                    quarter of the 50 strips; together they are half of the lower face
    bodies          walls of up to 490 bricks that only contact holds (`scenes/wall.py`)
    import, start   a new process: `import dolfinx_tresca`, or everything from its start until two
                    bricks with N = 4 are solved; with an empty or a full cache of compiled forms

Seconds are processor seconds (`time.process_time`; for new processes with their compilers), from
forms to fields, without the time for the mesh. `exponent` is the slope of log(seconds) against
log(number) between the previous row and this row.
"""

from __future__ import annotations

import argparse
import gc
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from harness import DASH, Benchmark, Column, Comm, Row, Table
from harness.memory import peak_memory, reset_peak_memory

import ufl

from dolfinx_tresca import ContactPair, RigidPlane, Tresca
from scenes.boxes import Body, boxes
from scenes.elasticity import elasticity, fixed
from scenes.scene import Scene
from scenes.two_bricks import two_bricks
from scenes.wall import wall

#: Number of bricks -> bricks in a course, and number of courses.
WALLS = {2: (2, 1), 52: (6, 8), 150: (12, 12), 490: (24, 20)}

#: Kind -> numbers: cells along a brick or a plate, steps, pairs or bricks; 1: the cache is full.
NUMBERS: dict[str, tuple[int, ...]] = {
    "unknowns": (12, 20, 32, 61, 80),
    "contact_nodes": (20, 40, 80),
    "load_steps": (125, 250, 500, 1000),
    "pairs": (1, 10, 50, 200),
    "bodies": tuple(WALLS),
    "import": (1,),
    "start": (0, 1),
}
BACKENDS = ("cholesky", "multigrid")

#: Largest number of cells along a brick with Cholesky.
MOST_FACTORED = 32

ROOT = Path(__file__).parents[1]

#: Relative residual at which solves end, and relative change of the load from step to step.
RTOL, CHANGE = 1e-6, 0.02

#: Largest number of strips of the plate; with more pairs the pairs are parts of strips.
MOST_STRIPS = 50

#: Kind -> program of a new process: the import, or the first solution.
PROGRAMS = {
    "import": "import dolfinx_tresca",
    "start": (
        "from mpi4py import MPI; from scenes.two_bricks import bricks_problem; "
        "bricks_problem(MPI.COMM_WORLD, 4).solve()"
    ),
}


def plate(comm: MPI.Comm, cells: int, parts: int = 0) -> Scene:
    """Return a layer of cells, held above, that a wavy body force presses on a rigid plane.

    If `parts` is 0, one pair has the whole lower face. Otherwise each of `parts` strips, or parts
    of strips, has a pair; together they are half of the face.
    """
    height = 1.0 / cells
    made = boxes(comm, "hexahedron", [Body((cells, 1), [(0.0, 1.0), (0.0, 1.0), (0.0, height)])])

    def at(z: float) -> Callable[[np.ndarray], np.ndarray]:
        return lambda x: np.isclose(x[:, 2], z, atol=1e-3 * height)

    strips = min(parts, MOST_STRIPS)
    pieces = parts // max(strips, 1)

    def part(k: int) -> Callable[[np.ndarray], np.ndarray]:
        column, row = 2 * (k // pieces), k % pieces

        def marker(x: np.ndarray) -> np.ndarray:
            across, along = (x[:, 0] * 2 * strips).astype(int), (x[:, 1] * pieces).astype(int)
            return at(0.0)(x) & (across == column) & (np.minimum(along, pieces - 1) == row)

        return marker

    faces = [part(k) for k in range(parts)] if parts else [at(0.0)]
    tags = made.tags((1, [0], at(height)), *((2 + k, [0], where) for k, where in enumerate(faces)))
    x = ufl.SpatialCoordinate(made.mesh)
    wave = ufl.cos(2.0 * ufl.pi * x[0]) * ufl.cos(2.0 * ufl.pi * x[1])
    L = ufl.inner(ufl.as_vector((0.5, 0.0, -wave)) / height, ufl.TestFunction(made.V)) * ufl.dx
    plane = RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    pairs = [ContactPair(tags, 2 + k, plane, Tresca(0.2)) for k in range(len(faces))]
    bcs = [fixed(made.V, tags.find(1))]
    return Scene(made.V, elasticity(made.V, 1e4, 0.3), L, bcs, pairs, tags)


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the figures of a case. Collective."""
    kind, number = case["kind"], case["number"]
    if kind in PROGRAMS:
        yield {"seconds": in_new_process(PROGRAMS[kind], full_cache=bool(number))}
        return
    scene = SCENES[kind](comm, number)
    gc.collect()
    reset_peak_memory()
    start = time.process_time()
    with scene.problem(stiffness=case["backend"]) as problem:
        found = {"n": problem.free_dofs, "m": problem.contact_nodes, "counted": number}
        if kind in ("unknowns", "contact_nodes"):
            found["counted"] = found["n" if kind == "unknowns" else "m"]
        solutions = [problem.solve(rtol=RTOL)]
        if kind == "load_steps":
            load, first = scene.data.load, scene.data.load.value.copy()
            start = time.process_time()
            for step in range(number):
                load.value[:] = (1.0 + CHANGE * np.sin(step)) * first
                solutions.append(problem.solve(rtol=RTOL))
                problem.accept()
            del solutions[0]
        yield {
            **found,
            "products": sum(solution.products for solution in solutions),
            "seconds": time.process_time() - start,
            "mb": peak_memory(comm),
            "status": solutions[-1].status.name,
        }


#: The scene of each kind, by its number.
SCENES: dict[str, Callable[[Any, int], Scene]] = {
    "unknowns": two_bricks,
    "contact_nodes": plate,
    "load_steps": lambda comm, _: two_bricks(comm, 8),
    "pairs": lambda comm, parts: plate(comm, 100, parts),
    "bodies": lambda comm, bricks: wall(comm, *WALLS[bricks]),
}


def in_new_process(program: str, *, full_cache: bool) -> float:
    """Return the processor seconds of a new Python and of the compilers that it starts."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "XDG_CACHE_HOME": cache}
        for _ in range(1 + full_cache):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run([sys.executable, "-c", program], env=environment, cwd=ROOT, check=True)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield kinds, solvers for K and numbers."""
    for kind in arguments.kinds:
        backends = BACKENDS if kind == "unknowns" else ["none" if kind in PROGRAMS else "cholesky"]
        for backend in backends:
            for number in NUMBERS[kind][: arguments.most]:
                if kind == "unknowns" and backend == "cholesky" and number > MOST_FACTORED:
                    continue
                yield {"kind": kind, "backend": backend, "number": number}


def with_exponents(rows: list[Row]) -> list[Row]:
    """Return the rows, with the exponent from the previous row of the same kind."""
    result: list[Row] = []
    for row in rows:
        last = result[-1] if result else {}
        exponent = {}
        if all(last.get(name) == row[name] for name in ("kind", "backend")) and "counted" in row:
            growth = math.log(row["seconds"] / last["seconds"])
            exponent = {"exponent": growth / math.log(row["counted"] / last["counted"])}
        result.append({**row, **exponent})
    return result


def name(row: Row) -> str:
    """Return the kind and the number of a row as text."""
    if "counted" in row:
        return f"{row['counted']:,} {row['kind'].replace('_', ' ')}"
    cache = "a full" if row["number"] else "an empty"
    return f"{row['kind']}" + (f", {cache} cache of forms" if row["kind"] == "start" else "")


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--kinds", nargs="+", default=list(NUMBERS), choices=NUMBERS)
    parser.add_argument("--most", type=int, default=5, help="numbers of each kind")


COLUMNS = [
    Column("what", lambda rows: name(rows[0]), width=30),
    Column("back end", "{backend}", width=9),
    Column("n", "{n}", width=8, missing=DASH),
    Column("m", "{m}", width=6, missing=DASH),
    Column("products", "{products}", missing=DASH),
    Column("seconds", "{seconds:.2f}"),
    Column("exponent", "{exponent:.2f}", missing=DASH),
    Column("MB", "{mb:.0f}", missing=DASH),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("kind", "backend", "number"),
    cases=cases,
    measure=measure,
    small={"number": 2},
    options=options,
    shown=COLUMNS,
    tables=[Table("growth", COLUMNS, derived=with_exponents)],
)

if __name__ == "__main__":
    BENCHMARK.main()
