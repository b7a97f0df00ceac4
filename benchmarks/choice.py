"""Contact problems with Cholesky and with multigrid: the figures behind `stiffness="auto"`.

    tools/fenicsx python3 benchmarks/choice.py --json benchmarks/data/choice.json

The scenes of the trade-off, solved to the default accuracy with both solvers in turns. Seconds are
processor seconds from forms to fields and error estimate, medians of some repetitions in one
process. The cost of factors depends on the size of the separators of a body, and not on the number
of unknowns alone; so the scenes have bulky and flat bodies, and meshes that are uniform, graded by
hand or refined where the error is large. Refined meshes follow from each other, by the estimate of
the error of the previous mesh, and a solve starts from the tractions of the previous mesh. The
levels of multigrid are then the previous meshes.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Iterator
from statistics import median

from harness import Benchmark, Column, Comm, Row, Table
from tradeoff_scenes import SCENES, Mesh

from dolfinx_tresca import ContactSolution, refine
from scenes.scene import Scene

SOLVERS = ("cholesky", "multigrid")

#: Scene, degree, cells -> meshes; a refined mesh is the first one of a sequence. The accuracy of
#: the crane only selects the coarse mesh from which adaptive solves of the trade-off start.
CASES = {
    ("two_bricks", 1, "tetrahedra"): [Mesh("tetrahedra", 1, N) for N in (16, 22, 28)],
    ("two_bricks", 2, "tetrahedra"): [Mesh("tetrahedra", 2, N) for N in (8, 11, 14)],
    ("two_bricks", 2, "hexahedra"): [Mesh("hexahedra", 2, N) for N in (8, 12)],
    ("two_bricks", 2, "graded hexahedra"): [Mesh("hexahedra", 2, N, 2.0) for N in (8, 12)],
    ("hertz", 1, "tetrahedra"): [Mesh("tetrahedra", 1, h) for h in (0.1, 0.08, 0.065)],
    ("hertz", 2, "tetrahedra"): [Mesh("tetrahedra", 2, h) for h in (0.28, 0.22, 0.17)],
    ("two_bricks", 1, "refined"): [Mesh("tetrahedra", 1, 4)],
    ("two_bricks", 2, "refined"): [Mesh("tetrahedra", 2, 4)],
    ("hertz", 1, "refined"): [Mesh("tetrahedra", 1, 0.4)],
    ("hertz", 2, "refined"): [Mesh("tetrahedra", 2, 0.8)],
    ("implant", 1, "refined"): [Mesh("tetrahedra", 1, 8)],
    ("implant", 2, "refined"): [Mesh("tetrahedra", 2, 8)],
    ("crane", 1, "refined"): [Mesh("tetrahedra", 1, 8, accuracy=0.2)],
    ("crane", 2, "refined"): [Mesh("tetrahedra", 2, 8, accuracy=0.2)],
}

#: Refined meshes with fewer unknowns are solved, but not shown: there the solver hardly matters.
FEWEST = 20_000


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield scenes with their degree and kind of cells."""
    for scene, degree, cells in CASES:
        if scene in arguments.scenes and degree in arguments.degrees:
            case = {"scene": scene, "degree": degree, "cells": cells}
            yield case | {"most": arguments.most, "repeats": arguments.repeats}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each mesh."""
    study, degree = SCENES[case["scene"]], case["degree"]
    meshes = CASES[case["scene"], degree, case["cells"]]
    if case["cells"] != "refined":
        for mesh in meshes:
            scene = study.on(study.tagged(mesh), degree=degree)
            if mesh is meshes[0] or scene.unknowns <= case["most"]:
                yield compared(scene, None, case["repeats"])[0]
        return
    tagged, before = [study.tagged(meshes[0])], None  # levels of multigrid need all meshes
    while True:
        row, before = compared(study.on(tagged[-1], degree=degree), before, case["repeats"])
        if row["unknowns"] >= min(FEWEST, case["most"]):
            yield row
        if 2 * row["unknowns"] > case["most"]:
            return
        tagged.append(refine(tagged[-1], before.cell_errors))


def compared(
    scene: Scene, before: ContactSolution | None, repeats: int
) -> tuple[Row, ContactSolution]:
    """Return the figures of both solvers, and a solution.

    Args:
        scene: the scene.
        before: a solution on a coarser mesh, from which the solves start; None: they start at zero.
        repeats: number of solves with each solver.
    """
    seconds: dict[str, list[float]] = {solver: [] for solver in SOLVERS}
    products = {}
    for _ in range(repeats):
        for solver in SOLVERS:
            gc.collect()
            start = time.process_time()
            with scene.problem(stiffness=solver) as problem:
                if before is not None:
                    problem.start_from(before)
                solution = problem.solve()
            seconds[solver].append(time.process_time() - start)
            solution.raise_if_failed()
            products[solver] = solution.products
    row: Row = {"unknowns": scene.unknowns}
    for solver in SOLVERS:
        row |= {solver: median(seconds[solver]), f"{solver}_products": products[solver]}
    return row | {"ratio": row["cholesky"] / row["multigrid"]}, solution


def ratios(rows: list[Row]) -> str:
    """Return the ratio of the seconds for each number of unknowns."""
    return "; ".join(f"{row['unknowns']:,}: {row['ratio']:.2f}" for row in rows)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--degrees", nargs="+", type=int, choices=(1, 2), default=[1, 2])
    parser.add_argument("--most", type=int, default=150_000, help="largest number of unknowns")
    parser.add_argument("--repeats", type=int, default=3)


COLUMNS = [
    Column("scene", "`{scene}`", width=12),
    Column("degree", "{degree}"),
    Column("cells", "{cells}", width=16),
    Column("unknowns", "{unknowns:,}"),
    Column("Cholesky [s]", "{cholesky:.2f}"),
    Column("products", "{cholesky_products}"),
    Column("multigrid [s]", "{multigrid:.2f}"),
    Column("products", "{multigrid_products}"),
    Column("ratio", "{ratio:.2f}"),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "degree", "cells", "unknowns"),
    cases=cases,
    measure=measure,
    options=options,
    small={"most": 1_000, "repeats": 1},
    shown=COLUMNS,
    tables=[
        Table(
            "choice",
            [*COLUMNS[:3], Column("unknowns: Cholesky / multigrid", ratios)],
            line=["scene", "degree", "cells"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
