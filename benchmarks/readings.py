"""Errors of quantities that users read off, by `local_accuracy`, against the discrete solution.

    tools/fenicsx python3 benchmarks/readings.py --json readings.json

The demos' scenes are solved, each from zero, with the default and other values of `local_accuracy`.
The printed errors [%] of the peak pressure, the greatest slip, the forces and the numbers of nodes
are differences from a solution to a residual of 1e-9. Errors of forces are relative to the whole
contact force, errors of numbers to the number of all contact nodes.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table, add_ranks

from dolfinx_tresca import ContactProblem, ContactSolution, SolverOptions, Tresca
from scenes.floating_block import crane_on_clay
from scenes.hertz import cylinder_on_plane, sphere_on_plane, two_spheres
from scenes.implant import implant
from scenes.press_fit import FRICTION, lame_pressure, press_fit
from scenes.rigid_obstacle import block_on_ball, block_on_ring
from scenes.two_bricks import ENDS, two_bricks

#: Relative residual of the solution that counts as the discrete solution.
EXACT = 1e-9

#: Largest error that a reader does not notice. A difference of one node is never noticed.
UNSEEN = 0.01


def scenes(comm: Comm) -> dict[str, Callable[[], Any]]:
    """Return name -> function that returns the scene."""
    result: dict[str, Callable[[], Any]] = {
        f"{end}_{N}": lambda end=end, N=N: two_bricks(comm, N, end=end)
        for N in (4, 6, 10, 16)
        for end in ENDS
    }
    result["bricks_hexahedra_8"] = lambda: two_bricks(comm, 8, hexahedra=True)
    for N in (8, 16):
        result[f"ball_{N}"] = lambda N=N: block_on_ball(comm, N)
    result["ring_16"] = lambda: block_on_ring(comm, 16)
    for N in (8, 12, 20):
        result[f"implant_{N}"] = lambda N=N: implant(comm, N)
    # given slip bounds, as in the other scenes, instead of Coulomb's law
    tresca = Tresca(FRICTION * lame_pressure())
    for N in (8, 16):
        result[f"press_fit_{N}"] = lambda N=N: press_fit(comm, N).but(friction=tresca)
    result["hertz_sphere"] = lambda: sphere_on_plane(comm)
    result["hertz_sphere_degree_2"] = lambda: sphere_on_plane(comm, 0.24, degree=2)
    result["hertz_spheres"] = lambda: two_spheres(comm)
    result["hertz_cylinder"] = lambda: cylinder_on_plane(comm)
    result["crane_16"] = lambda: crane_on_clay(comm, 16)
    return result


def errors(solution: ContactSolution, exact: ContactSolution) -> dict[str, float]:
    """Return the relative errors of the quantities in `KEYS`."""

    def of(value: float, true: float, size: float) -> float:
        return abs(value - true) / size if size > 0.0 else 0.0

    force = float(np.hypot(exact.normal_force, exact.tangential_force))
    one, other = solution.counts, exact.counts
    return {
        "peak": of(solution.peak_pressure, exact.peak_pressure, exact.peak_pressure),
        "slip": of(solution.greatest_slip, exact.greatest_slip, exact.greatest_slip),
        "normal": of(solution.normal_force, exact.normal_force, force),
        "tangential": of(solution.tangential_force, exact.tangential_force, force),
        "stick": abs(one.stick - other.stick) / other.nodes,
        "pressed": abs(one.contact - other.contact) / other.nodes,
    }


#: Quantities that are read off, in the order of the table.
KEYS = ("peak", "slip", "normal", "tangential", "stick", "pressed")


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield scenes and solvers for K."""
    loops = (arguments.ranks, arguments.scenes, arguments.backends)
    for ranks, scene, backend in itertools.product(*loops):
        yield {"ranks": ranks, "scene": scene, "backend": backend, "levels": arguments.levels}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each level of `local_accuracy`. Collective."""
    scene = scenes(comm)[case["scene"]]()
    with ContactProblem(
        scene.a, scene.L, [scene.pair], bcs=scene.bcs, stiffness=case["backend"]
    ) as problem:
        exact = problem.solve(rtol=EXACT)
        first = None
        for level in case["levels"]:
            problem.forget()
            solution = problem.solve(local_accuracy=level)
            first = first or solution.products
            found = errors(solution, exact)
            yield {
                "local_accuracy": level,
                "nodes": exact.counts.nodes,
                "status": solution.status.name,
                "products": solution.products,
                "products_over_first": solution.products / first,
                "krylov_iterations": solution.krylov_iterations,
                "bound": solution.energy_error_bound,
                **found,
                "seen": [key for key in KEYS if is_seen(key, found[key], exact.counts.nodes)],
            }


def is_seen(key: str, error: float, nodes: int) -> bool:
    """Return whether a reader notices an error."""
    return error > UNSEEN and not (key in ("stick", "pressed") and error * nodes < 1.5)


def percent(key: str) -> Column:
    """Return the column of an error."""
    return Column(key, lambda rows: f"{100 * rows[0][key]:.2f}" if key in rows[0] else "")


def level(rows: list[Row]) -> str:
    """Return the value of `local_accuracy` of a line, as text."""
    value = rows[0]["local_accuracy"]
    is_default = value == SolverOptions().local_accuracy
    return f"**{value:g}, the default**" if is_default else f"{value:g}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    known = list(scenes(MPI.COMM_WORLD))
    parser.add_argument("--scenes", nargs="+", default=known, choices=known, metavar="NAME")
    backends = ["cholesky", "multigrid"]
    parser.add_argument("--backends", nargs="+", default=backends, choices=backends)
    parser.add_argument("--levels", nargs="+", type=float, default=[0.5, 3e-2, 1e-2, 3e-3, 1e-3])
    add_ranks(parser)


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "backend", "local_accuracy", "ranks"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        Column("scene", "{scene}", width=21),
        Column("nodes", "{nodes}"),
        Column("backend", "{backend}", width=9),
        Column("level", "{local_accuracy:.0e}"),
        Column("products", "{products}"),
        *map(percent, KEYS),
        Column("seen", lambda rows: " ".join(rows[0].get("seen", []))),
    ],
    tables=[
        Table(
            "readings",
            [
                Column("`local_accuracy`", level),
                Column(
                    "errors to be seen in",
                    lambda rows: f"{sum(bool(row['seen']) for row in rows)} of {len(rows)}",
                ),
                Column(
                    "products",
                    lambda rows: f"{np.mean([row['products_over_first'] for row in rows]):.2f}",
                ),
                Column(
                    "at most",
                    lambda rows: f"{max(row['products_over_first'] for row in rows):.1f}",
                ),
            ],
            chosen=lambda row: "seen" in row and row["ranks"] == 1,
            line=["local_accuracy"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
