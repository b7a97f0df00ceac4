"""Solvers for K of degree 2 side by side, and degree 1 with as many unknowns.

    tools/fenicsx python3 benchmarks/degree_2.py --sizes 9 13 18 --repeats 3 --contact

Two bricks, as in the paper, with N cells along each (2 N for degree 1). Columns: unknowns; set-up
of the solver and one linear solve to 1e-8, in processor seconds, which other work on the machine
changes less than those of a clock; iterations; peak memory of both [bytes per unknown], K not
counted; the linear problem from forms to displacement; with --contact the contact problem, its
products and how many linear problems of the same solver it takes. Medians; the solvers take turns.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from mpi4py import MPI

from harness.memory import peak_memory, resident_memory
from tradeoff_scenes import two_bricks

from dolfinx_tresca import ContactProblem
from dolfinx_tresca.stiffness.cholesky import cholesky
from dolfinx_tresca.stiffness.multigrid import CHEBYSHEV, multigrid
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.scene import Scene

#: What each solver is asked for, besides `stiffness="multigrid"`.
SOLVERS: dict[str, Mapping[str, Any]] = {
    "multigrid": {},
    "GAMG of all of K": {"pc_type": "gamg", **CHEBYSHEV},
    "Cholesky": {},
}

HEAD = ("cells", "degree", "unknowns", "solver", "set-up", "solve", "iterations", "bytes", "linear")
CONTACT = ("contact", "products", "linear problems")

Row = dict[str, Any]


def measured(case: Scene, name: str, contact: bool) -> Row:
    """Solve the linear problem, and the contact problem if asked for."""
    gc.collect()
    began = time.process_time()
    with LinearSystem(case.a, case.L, case.bcs) as system:
        system.assemble_stiffness()
        system.assemble_load()
        f = system.f.x.petsc_vec
        u = f.duplicate()
        before, start = resident_memory(MPI.COMM_SELF), time.process_time()
        options = {"ksp_rtol": 1e-8, **SOLVERS[name]}
        with (
            cholesky(system.K, {}, None)
            if name == "Cholesky"
            else multigrid(system.K, system.V, system.prescribed, options, None)
        ) as solver:
            ready = time.process_time()
            solver.solve(f, u)
            done = time.process_time()
            row: Row = {
                "set-up": ready - start,
                "solve": done - ready,
                "iterations": solver.krylov_iterations,
                "bytes": (peak_memory(MPI.COMM_SELF) - before) * 2**20 / f.size,
                "linear": done - began,
            }
        u.destroy()
    if contact:
        gc.collect()
        start = time.process_time()
        stiffness = "cholesky" if name == "Cholesky" else "multigrid"
        with ContactProblem(
            *(case.a, case.L, [case.pair], case.bcs),
            stiffness=stiffness,
            petsc_options=SOLVERS[name],
        ) as problem:
            solution = problem.solve(accuracy=1e-3)
        solution.raise_if_failed()
        row["contact"] = time.process_time() - start
        row["products"] = solution.products
        row["linear problems"] = row["contact"] / row["linear"]
    return row


def print_row(case: str, degree: int, unknowns: int, name: str, rows: Sequence[Row]) -> None:
    """Print the medians of rows."""
    cells = [case, f"{degree}", f"{unknowns:,}", name]
    for column in rows[0]:
        value = median(row[column] for row in rows)
        cells.append(
            f"{value:.0f}" if column in ("iterations", "bytes", "products") else f"{value:.2f}"
        )
    print("| " + " | ".join(cells) + " |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[5, 9], metavar="N")
    parser.add_argument("--cells", nargs="+", default=["tetrahedra", "hexahedra"])
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS)[:2])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--contact", action="store_true")
    arguments = parser.parse_args()
    head = HEAD + CONTACT * arguments.contact
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for cells in arguments.cells:
        for degree in (1, 2):  # compiles forms, and loads what the first run has to load
            measured(two_bricks(3, cells, degree), "multigrid", arguments.contact)
        for N in arguments.sizes:
            runs = [(2, N, name) for name in arguments.solvers] + [(1, 2 * N, "multigrid")]
            cases = {(degree, n): two_bricks(n, cells, degree) for degree, n, _ in runs}
            rows: dict[tuple[int, int, str], list[Row]] = {run: [] for run in runs}
            for _ in range(arguments.repeats):
                for degree, n, name in runs:
                    rows[degree, n, name].append(
                        measured(cases[degree, n], name, arguments.contact)
                    )
            for degree, n, name in runs:
                V = cases[degree, n].V
                unknowns = V.dofmap.index_map.size_global * V.dofmap.index_map_bs
                print_row(cells, degree, unknowns, name, rows[degree, n, name])


if __name__ == "__main__":
    main()
