"""How fast displacement, pressure and slip converge: errors and rates on refined meshes.

    tools/fenicsx python3 benchmarks/convergence.py --json FILE --picture FILE

Two blocks of different materials, with cells in the ratio 2 : 3, are pressed together and slide on
each other. The solution is manufactured: pressure, slip and the displacements of the surfaces are
chosen, and the loads follow from the equations. The exact solution is therefore known and smooth,
and no reference mesh is needed. Errors are relative: for the displacement in the energy norm, for
pressure and slip in L2 of the contact surface.

Expected rates: the basis of the multipliers is discontinuous, of degree 1, and reproduces only
constants exactly. So the error in the energy norm falls with h for degree 1, and at least with
h^1.5 for degree 2.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table, add_ranks
from harness.figure import new_figure, plain_ticks, save

from scenes.manufactured import blocks_scene, errors_of
from scenes.patches import KINDS as CELLS

ERRORS = ("energy", "pressure", "slip")

#: cells along the upper and the lower block, times the size k of a mesh
RATIO = (2, 3)

#: sizes k of the meshes
SIZES = {2: (2, 4, 8, 16, 32), 3: (1, 2, 4)}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each mesh of a family, without rates. Collective."""
    cell, degree = case["cell"], case["degree"]
    for k in case["sizes"]:
        scene = blocks_scene(comm, cell, degree, (RATIO[0] * k, RATIO[1] * k))
        with scene.problem() as problem:
            solution = problem.solve(rtol=1e-8)
            solution.raise_if_failed()
            n, m = problem.free_dofs, problem.contact_nodes
        work = {"iterations": solution.iterations, "products": solution.products}
        yield {"k": k, "n": n, "m": m, **work, **errors_of(scene, solution)}


def rates(rows: Sequence[Row], error: str) -> list[float]:
    """Return the rates of an error from each mesh of a family to the next one."""
    return [
        math.log(coarse[error] / fine[error]) / math.log(fine["k"] / coarse["k"])
        for coarse, fine in itertools.pairwise(rows)
    ]


NAMES = {
    "triangle": "triangles",
    "quadrilateral": "quadrilaterals",
    "tetrahedron": "tetrahedra",
    "hexahedron": "hexahedra",
}
TITLES = {
    "energy": "displacement, energy norm",
    "pressure": "contact pressure, L2",
    "slip": "slip, L2",
}
SLOPES = {"energy": (1.0, 1.5), "pressure": (1.0, 1.5), "slip": (1.0, 2.0)}


def draw(path: Path, rows: list[Row]) -> None:
    """Save a picture of the errors against the cell size. On one rank only."""
    from matplotlib.lines import Line2D

    figure, panels = new_figure(3.7, 1, len(ERRORS), sharex=True)
    sizes = np.array([0.5 / max(row["k"] for row in rows), 0.5 / min(row["k"] for row in rows)])
    for panel, error in zip(panels[0], ERRORS, strict=True):
        for cell, degree in dict.fromkeys((row["cell"], row["degree"]) for row in rows):
            own = [row for row in rows if (row["cell"], row["degree"]) == (cell, degree)]
            panel.loglog(
                [0.5 / row["k"] for row in own],
                [row[error] for row in own],
                "o-" if degree == 1 else "s--",
                ms=4,
                lw=1.4,
                color=f"C{CELLS.index(cell)}",
            )
        # below all curves, from the same point
        h = sizes[0] * np.array([1.0, (sizes[1] / sizes[0]) ** 0.75])
        least = 0.35 * min(row[error] for row in rows)
        for slope in SLOPES[error]:
            line = least * (h / h[0]) ** slope
            panel.loglog(h, line, ":", color="grey", lw=1.2)
            name = "$h$" if slope == 1.0 else f"$h^{{{slope:g}}}$"
            panel.annotate(
                name, (h[1], line[1]), (3, 0), textcoords="offset points", color="#404040",
                va="center",
            )  # fmt: skip
        panel.set_title(TITLES[error], fontsize=10)
        panel.set_xlabel("cell size over width of the blocks")
        plain_ticks(panel.xaxis)
    panels[0][0].set_ylabel("relative error")
    handles = [
        Line2D([], [], color=f"C{number}", lw=2, label=NAMES[cell])
        for number, cell in enumerate(CELLS)
        if any(row["cell"] == cell for row in rows)
    ]
    for degree, (marker, dashes) in enumerate((("o", "-"), ("s", "--")), 1):
        label = f"degree {degree}"
        handles.append(Line2D([], [], color="black", marker=marker, ls=dashes, ms=4, label=label))
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9
    )
    save(figure, path)


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the families of meshes."""
    for ranks, cell in itertools.product(arguments.ranks, arguments.cells):
        sizes = arguments.sizes or SIZES[2 if cell in ("triangle", "quadrilateral") else 3]
        for degree in arguments.degrees:
            yield {"cell": cell, "degree": degree, "ranks": ranks, "sizes": sizes}


def last_rate(error: str, degree: int) -> Column:
    """Return the column of a rate between the last two meshes."""
    return Column(
        f"{error}, degree {degree}",
        lambda rows: f"{rates(rows, error)[-1]:.2f}",
        {"degree": degree},
    )


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--cells", nargs="+", default=list(CELLS), choices=CELLS)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2], choices=[1, 2])
    parser.add_argument("--sizes", type=int, nargs="+", metavar="K", help="instead of the usual")
    add_ranks(parser)


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("cell", "degree", "k", "ranks"),
    cases=cases,
    measure=measure,
    options=options,
    draw=draw,
    shown=[
        Column("cell", "{cell}", width=13),
        Column("degree", "{degree}"),
        Column("k", "{k}", width=3),
        Column("n/m", "{n}/{m}", width=12),
        Column("iter/n_A", "{iterations}/{products}"),
        *(Column(error, f"{{{error}:.2e}}", width=8) for error in ERRORS),
    ],
    tables=[
        Table(
            "convergence",
            [
                Column("cells", lambda rows: NAMES[rows[0]["cell"]]),
                *(last_rate(error, degree) for error in ERRORS for degree in (1, 2)),
            ],
            chosen=lambda row: row["ranks"] == 1,
            line=["cell"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
