"""Table 38.1 of the paper and our results: iterations and products of each algorithm.

    tools/fenicsx python3 benchmarks/seed_table.py --sizes 16 21 --scenes free_end_2 --json FILE

Seconds are processor seconds of all threads. A solve ends with the first step after which it has
taken more than `--seconds`.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Iterator
from functools import partial
from typing import get_args

from harness import DASH, Benchmark, Column, Comm, Row, Table, add_ranks
from harness.memory import peak_memory, reset_peak_memory

from dolfinx_tresca.options import Method
from scenes.two_bricks import ENDS, two_bricks

#: Algorithm -> N -> iterations / products in the paper. The numbers fit the second reading of the
#: paper's text (see the demo).
PAPER = {
    "imssn": {16: "10/161", 21: "9/143", 26: "10/185", 31: "10/190", 36: "9/167", 41: "10/216"},
    "ssn": {16: "9/1180", 21: "9/1428", 26: "11/2506", 31: "10/2162", 36: "10/2298", 41: "10/2586"},
}
PAPERS_SCENE = "free_end_2"


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield scenes, sizes and methods."""
    loops = (arguments.ranks, arguments.scenes, arguments.sizes, arguments.methods)
    for ranks, scene, N, method in itertools.product(*loops):
        asked = {"cell": arguments.cell, "stiffness": arguments.stiffness, "rtol": arguments.rtol}
        limits = {"max_iterations": arguments.max_iterations, "seconds": arguments.seconds}
        yield {"ranks": ranks, "scene": scene, "N": N, "method": method, **asked, **limits}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the row of a case, from forms to fields. Collective."""
    hexahedra = case["cell"] == "hexahedron"
    scene = two_bricks(comm, case["N"], end=case["scene"], hexahedra=hexahedra)
    reset_peak_memory()
    start = time.process_time()
    with scene.problem(stiffness=case["stiffness"]) as problem:
        end = time.process_time() + case["seconds"]
        solution = problem.solve(
            method=case["method"],
            rtol=case["rtol"],
            max_iterations=case["max_iterations"],
            observer=lambda _: time.process_time() > end,
        )
        seconds = time.process_time() - start
        counts = solution.counts
        yield {
            "n": problem.free_dofs,
            "m": problem.contact_nodes,
            "status": solution.status.name,
            "iterations": solution.iterations,
            "products": solution.products,
            "krylov_iterations": solution.krylov_iterations,
            "residual": solution.residuals[-1],
            "q": solution.q[-1],
            "contact": counts.contact,
            "stick": counts.stick,
            "slip": counts.slip,
            "normal_force": solution.normal_force,
            "tangential_force": solution.tangential_force,
            "seconds": seconds,
            "peak_rss_mb": peak_memory(comm),
        }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", type=int, nargs="+", default=[16, 21, 26], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(ENDS), choices=ENDS)
    methods = get_args(Method)
    parser.add_argument("--methods", nargs="+", default=list(methods), choices=methods)
    parser.add_argument("--cell", default="tetrahedron", choices=["tetrahedron", "hexahedron"])
    parser.add_argument("--rtol", type=float, default=1e-6, help="relative natural residual")
    parser.add_argument("--max-iterations", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=300.0, help="processor seconds of a solve")
    parser.add_argument("--stiffness", default="auto", choices=["auto", "cholesky", "multigrid"])
    add_ranks(parser)


def work(rows: list[Row]) -> str:
    """Return iterations / products; in brackets with the residual if the solve was stopped."""
    row = rows[-1]
    if row["status"] == "CONVERGED":
        text = f"{row['iterations']}/{row['products']}"
        return f"**{text}**" if row["method"] == "projected_newton" else text
    return f"({row['iterations']}/{row['products']}: {row['residual']:.0e})"


def papers(rows: list[Row], method: str) -> str:
    """Return the paper's iterations / products for the size of a row; empty if there are none."""
    return PAPER[method].get(rows[0]["N"], "")


def is_papers(row: Row, scene: str) -> bool:
    """Return whether a row has the paper's settings, for a scene."""
    papers = {"scene": scene, "cell": "tetrahedron", "rtol": 1e-6}
    ours = {"stiffness": "cholesky", "ranks": 1}
    return (papers | ours).items() <= row.items()


def counts_table(scene: str, *columns: Column) -> Table:
    """Return the table of iterations and products for a scene."""
    return Table(
        f"paper_{scene}",
        [Column("n / m", "{n} / {m}"), *columns],
        chosen=lambda row: "iterations" in row and is_papers(row, scene),
        line=["N"],
    )


OURS = {m: Column(m, work, {"method": m}, missing=DASH) for m in get_args(Method)}
THEIRS = {m: Column(f"paper: {m.upper()}", partial(papers, method=m)) for m in PAPER}

RESULTS = [
    Column("q [MN m]", "{q:.8e}", width=15),
    Column("contact", "{contact}"),
    Column("stick", "{stick}"),
    Column("slip", "{slip}", width=5),
    Column("seconds", "{seconds:.1f}"),
    Column("peak memory [MB]", "{peak_rss_mb:.0f}"),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "cell", "N", "method", "stiffness", "rtol", "ranks"),
    cases=cases,
    measure=measure,
    small={"N": 4},
    options=options,
    shown=[
        Column("scene", "{scene}", width=10),
        Column("N", "{N}", width=3),
        Column("n/m", "{n}/{m}", width=12),
        Column("method", "{method}", width=16),
        Column("iter/n_A", "{iterations}/{products}"),
        Column("paper", lambda rows: PAPER.get(rows[0]["method"], {}).get(rows[0]["N"], "")
               if rows[0]["scene"] == PAPERS_SCENE else "", width=7),
        Column("residual", "{residual:.1e}"),
        *RESULTS,
        Column("status", "{status}"),
    ],
    tables=[
        counts_table(
            "free_end_2", OURS["projected_newton"], OURS["imssn"], THEIRS["imssn"], OURS["ssn"],
            THEIRS["ssn"], OURS["mssn"], OURS["gimssn"],
        ),
        counts_table(
            "free_end_1",
            *(OURS[m] for m in ("projected_newton", "imssn", "ssn", "mssn", "gimssn")),
        ),
        Table(
            "two_bricks",
            [
                Column("scene", "`{scene}`"),
                Column("N", "{N}"),
                *RESULTS,
            ],
            chosen=lambda row: "q" in row
            and row["method"] == "projected_newton"
            and any(is_papers(row, scene) for scene in ENDS),
        ),
        Table(
            "solve_on_ranks",
            [
                Column("scene", "`{scene}`"),
                Column("ranks", "{ranks}"),
                Column("iterations / products", "{iterations} / {products}"),
                Column("Krylov iterations", "{krylov_iterations}"),
                Column("peak memory of all ranks [MB]", "{peak_rss_mb:.0f}"),
            ],
            chosen=lambda row: row["stiffness"] == "multigrid",
        ),
    ],
)  # fmt: skip

if __name__ == "__main__":
    BENCHMARK.main()
