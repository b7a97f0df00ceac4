"""How fast displacement, pressure and slip converge: errors and rates on refined meshes.

    tools/fenicsx python3 benchmarks/convergence.py --json FILE --picture FILE

Two blocks of different materials, meshed 2 : 3, are pressed together and slide on each other. Loads
are made such that the exact solution is known and smooth: chosen are pressure, slip and the
displacements of the surfaces, the rest follows from the equations (a manufactured solution), so
there is no reference mesh. Errors are relative: of the displacement in the energy norm, of pressure
and slip in L2 of the contact surface. It prints a row for each mesh and writes the same as JSON.
`--from FILE` draws what was measured before. It runs under mpirun too; the first rank prints and
writes.

What to expect: the multipliers are discontinuous of degree 1 and only constants are exact in them,
so the energy norm converges with h for degree 1 and with h^1.5 at least for degree 2.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from kept import add_files, keep, new_figure, plain_ticks, redraw, save

from dolfinx_tresca._base.parallel import errors_on_all_ranks
from scenes.manufactured import blocks_scene, errors_of
from scenes.patches import KINDS as CELLS

ERRORS = ("energy", "pressure", "slip")

#: cells along the upper and the lower block, times the size k of a mesh
RATIO = (2, 3)

#: sizes k of the meshes
SIZES = {2: (2, 4, 8, 16, 32), 3: (1, 2, 4)}


def measure(comm: MPI.Comm, cell: str, degree: int, k: int) -> dict[str, Any]:
    """Solve on one mesh and return a row of the table, without rates. Collective."""
    scene = blocks_scene(comm, cell, degree, (RATIO[0] * k, RATIO[1] * k))
    start = time.perf_counter()
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-8)
        seconds = time.perf_counter() - start
        solution.raise_if_failed()
        n, m = problem.free_dofs, problem.contact_nodes
    return {
        "cell": cell,
        "degree": degree,
        "k": k,
        "n": n,
        "m": m,
        "slip_nodes": solution.counts.slip,
        "contact": solution.counts.contact,
        "iterations": solution.iterations,
        "products": solution.products,
        "seconds": seconds,
        **errors_of(scene, solution),
    }


def add_rates(rows: list[dict[str, Any]]) -> None:
    """Add to each row but the first of a family the rates of its errors."""
    for coarse, fine in itertools.pairwise(rows):
        if all(coarse[key] == fine[key] for key in ("cell", "degree")):
            for error in ERRORS:
                rate = math.log(coarse[error] / fine[error]) / math.log(fine["k"] / coarse["k"])
                fine[f"{error}_rate"] = rate


COLUMNS = f"{'cell':<14} {'degree':>6} {'k':>3} {'n/m':>12} {'iter/n_A':>9} " + " ".join(
    f"{error:>9} {'rate':>5}" for error in ERRORS
)


def print_row(row: dict[str, Any]) -> None:
    """Print a row of the table."""
    size, work = f"{row['n']}/{row['m']}", f"{row['iterations']}/{row['products']}"
    errors = " ".join(
        f"{row[error]:>9.2e} "
        + (f"{row[f'{error}_rate']:>5.2f}" if f"{error}_rate" in row else " " * 5)
        for error in ERRORS
    )
    print(
        f"{row['cell']:<14} {row['degree']:>6} {row['k']:>3} {size:>12} {work:>9} {errors}",
        flush=True,
    )


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


def draw(path: Path, rows: list[dict[str, Any]]) -> None:
    """Save errors over the size of the cells as a picture. On one rank only."""
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
    handles = [Line2D([], [], color=f"C{CELLS.index(cell)}", lw=2, label=NAMES[cell])
               for cell in CELLS if any(row["cell"] == cell for row in rows)]  # fmt: skip
    for degree, style in ((1, "o-"), (2, "s--")):
        marker, line_style = style[0], style[1:]
        handles.append(
            Line2D([], [], color="black", marker=marker, ls=line_style, ms=4,
                   label=f"degree {degree}")
        )  # fmt: skip
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9
    )
    save(figure, path)


def main() -> None:
    """Read the arguments, measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", nargs="+", default=list(CELLS), choices=CELLS)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2], choices=[1, 2])
    parser.add_argument("--sizes", type=int, nargs="+", metavar="K", help="instead of the usual")
    add_files(parser)
    arguments = parser.parse_args()
    if redraw(arguments, draw):
        return

    comm = MPI.COMM_WORLD
    with errors_on_all_ranks(comm):  # before the work, not after
        if comm.rank == 0 and arguments.json is not None:
            keep(arguments.json, [])
    if comm.rank == 0:
        print(COLUMNS, flush=True)
    rows: list[dict[str, Any]] = []
    for cell in arguments.cells:
        usual = SIZES[2 if cell in ("triangle", "quadrilateral") else 3]
        for degree in arguments.degrees:
            for k in arguments.sizes or usual:
                rows.append(measure(comm, cell, degree, k))
                add_rates(rows)
                if comm.rank == 0:
                    print_row(rows[-1])
    if comm.rank == 0:
        keep(arguments.json, rows)
        if arguments.picture is not None:
            draw(arguments.picture, rows)


if __name__ == "__main__":
    main()
