"""Table 38.1 of the paper, ours beside it: iterations and products of every algorithm.

    tools/fenicsx python3 benchmarks/seed_table.py --sizes 16 21 --scenes free_end_2 --json FILE

prints a row for each scene, size and method, and writes a list of objects with the same. The limit
of seconds for a solve is looked at between outer iterations. It runs under mpirun too; the first
rank prints and writes.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any, get_args

from mpi4py import MPI

from memory import peak_memory, reset_peak_memory

from dolfinx_tresca import ContactProblem, Iteration
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.options import Method
from scenes.two_bricks import ENDS, two_bricks

#: iterations / products in the paper, by N
PAPER = {
    "imssn": {16: "10/161", 21: "9/143", 26: "10/185", 31: "10/190", 36: "9/167", 41: "10/216"},
    "ssn": {16: "9/1180", 21: "9/1428", 26: "11/2506", 31: "10/2162", 36: "10/2298", 41: "10/2586"},
}


class TimeLimit:
    """An observer that stops a solve after some seconds."""

    def __init__(self, seconds: float) -> None:
        self._end = time.perf_counter() + seconds

    def __call__(self, iteration: Iteration) -> bool:
        """Say whether time is up."""
        return time.perf_counter() > self._end


def measure(
    comm: MPI.Comm, scene_name: str, N: int, arguments: argparse.Namespace
) -> list[dict[str, Any]]:
    """Solve one scene with every method, each from zero; the set-up is shared. Collective."""
    reset_peak_memory()
    start = time.perf_counter()
    hexahedra = arguments.cell == "hexahedron"
    scene = two_bricks(comm, N, end=scene_name, hexahedra=hexahedra)
    meshed = time.perf_counter()
    rows = []
    with ContactProblem(
        scene.a, scene.L, [scene.pair], bcs=scene.bcs, stiffness=arguments.stiffness
    ) as problem:
        set_up = time.perf_counter() - meshed
        set_up_peak = peak_memory(comm)
        if comm.rank == 0:
            print(
                f"# {scene_name} N={N}: mesh {meshed - start:.1f} s, set-up {set_up:.1f} s",
                flush=True,
            )
        for method in arguments.methods:
            problem.forget()
            reset_peak_memory()
            begin = time.perf_counter()
            solution = problem.solve(
                method=method,
                rtol=arguments.rtol,
                max_iterations=arguments.max_iterations,
                observer=TimeLimit(arguments.limit),
            )
            seconds = set_up + time.perf_counter() - begin
            counts = solution.counts
            rows.append(
                {
                    "scene": scene_name,
                    "cell": arguments.cell,
                    "N": N,
                    "n": problem.free_dofs,
                    "m": problem.contact_nodes,
                    "method": method,
                    "status": solution.status.name,
                    "iterations": solution.iterations,
                    "products": solution.products,
                    "krylov_iterations": solution.krylov_iterations,
                    "rtol": arguments.rtol,
                    "residual": solution.residuals[-1],
                    "q": solution.q[-1],
                    "contact": counts.contact,
                    "stick": counts.stick,
                    "slip": counts.slip,
                    "normal_force": solution.normal_force,
                    "tangential_force": solution.tangential_force,
                    "seconds": seconds,
                    "peak_rss_mb": max(set_up_peak, peak_memory(comm)),
                }
            )
            if comm.rank == 0:
                print_row(rows[-1])
    return rows


COLUMNS = (
    f"{'scene':<11} {'N':>3} {'n/m':>12} {'method':<16} {'iter/n_A':>10} {'paper':>8} "
    f"{'status':<14} {'residual':>8} {'q':>15} {'contact':>7} {'stick':>5} {'slip':>5} "
    f"{'seconds':>8} {'MB':>6}"
)


def print_row(row: dict[str, Any]) -> None:
    """Print a row of the table."""
    # the paper's figures fit the second reading of its text (see the demo)
    paper = PAPER.get(row["method"], {}) if row["scene"] == "free_end_2" else {}
    size = f"{row['n']}/{row['m']}"
    work = f"{row['iterations']}/{row['products']}"
    print(
        f"{row['scene']:<11} {row['N']:>3} {size:>12} {row['method']:<16} {work:>10} "
        f"{paper.get(row['N'], ''):>8} {row['status']:<14} {row['residual']:>8.1e} "
        f"{row['q']:>15.8e} "
        f"{row['contact']:>7} {row['stick']:>5} {row['slip']:>5} {row['seconds']:>8.1f} "
        f"{row['peak_rss_mb']:>6.0f}",
        flush=True,
    )


def main() -> None:
    """Read the arguments, measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[16, 21, 26], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(ENDS), choices=ENDS)
    methods = get_args(Method)
    parser.add_argument("--methods", nargs="+", default=list(methods), choices=methods)
    parser.add_argument("--cell", default="tetrahedron", choices=["tetrahedron", "hexahedron"])
    parser.add_argument("--rtol", type=float, default=1e-6, help="relative natural residual")
    parser.add_argument("--max-iterations", type=int, default=1000)
    parser.add_argument("--limit", type=float, default=300.0, help="seconds for one solve")
    parser.add_argument("--stiffness", default="auto", choices=["auto", "cholesky", "multigrid"])
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()

    comm = MPI.COMM_WORLD
    if comm.rank == 0:
        print(COLUMNS, flush=True)
    with errors_on_all_ranks(comm):  # before hours of work, not after
        if comm.rank == 0 and arguments.json is not None:
            arguments.json.parent.mkdir(parents=True, exist_ok=True)
            arguments.json.touch()
    rows = []
    for scene in arguments.scenes:
        for N in arguments.sizes:
            rows += measure(comm, scene, N, arguments)
            if comm.rank == 0 and arguments.json is not None:
                arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
