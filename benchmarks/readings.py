"""What people read off a solution, by the default and by others, against the discrete solution.

    tools/fenicsx python3 benchmarks/readings.py --json readings.json

solves the demos' scenes, each from zero, with the default, with others for `local_accuracy`, and
to a residual of 1e-9, and prints by how much peak pressure, greatest slip, forces and numbers of
nodes differ. Forces are measured against the whole contact force, numbers against that of all
nodes.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca import ContactProblem, ContactSolution
from scenes.floating_block import crane_on_clay
from scenes.hertz import cylinder_on_plane, sphere_on_plane, two_spheres
from scenes.implant import implant
from scenes.press_fit import press_fit
from scenes.rigid_obstacle import block_on_ball, block_on_ring
from scenes.two_bricks import ENDS, two_bricks

#: Relative residual of the discrete solution.
EXACT = 1e-9

#: Error that a reader does not see; a node more or less always counts as such.
UNSEEN = 0.01


def scenes(comm: MPI.Comm) -> dict[str, Callable[[], Any]]:
    """Return what makes each scene."""
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
    for N in (8, 16):
        result[f"press_fit_{N}"] = lambda N=N: press_fit(comm, N)
    result["hertz_sphere"] = lambda: sphere_on_plane(comm)
    result["hertz_sphere_degree_2"] = lambda: sphere_on_plane(comm, 0.24, degree=2)
    result["hertz_spheres"] = lambda: two_spheres(comm)
    result["hertz_cylinder"] = lambda: cylinder_on_plane(comm)
    result["crane_16"] = lambda: crane_on_clay(comm, 16)
    return result


def errors(solution: ContactSolution, exact: ContactSolution) -> dict[str, float]:
    """Return the errors of what is read, as parts of it."""

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


def measure(name: str, scene: Any, backend: str, levels: list[float]) -> list[dict[str, Any]]:
    """Return a row for each level of `local_accuracy`. Collective."""
    rows = []
    with ContactProblem(
        scene.a, scene.L, [scene.pair], bcs=scene.bcs, stiffness=backend
    ) as problem:
        exact = problem.solve(rtol=EXACT)
        for level in levels:
            problem.forget()
            solution = problem.solve(local_accuracy=level)
            found = errors(solution, exact)
            seen = [
                key
                for key, error in found.items()
                if error > UNSEEN
                and not (key in ("stick", "pressed") and error * exact.counts.nodes < 1.5)
            ]
            rows.append(
                {
                    "scene": name,
                    "nodes": exact.counts.nodes,
                    "backend": backend,
                    "local_accuracy": level,
                    "status": solution.status.name,
                    "products": solution.products,
                    "krylov_iterations": solution.krylov_iterations,
                    "bound": solution.energy_error_bound,
                    **found,
                    "seen": seen,
                }
            )
    return rows


def text(row: dict[str, Any]) -> str:
    """Return a row of the table."""
    parts = " ".join(f"{100 * row[key]:6.2f}" for key in KEYS)
    return (
        f"{row['scene']:<22} {row['nodes']:>5} {row['backend']:<9} {row['local_accuracy']:>7.0e} "
        f"{row['status']:<10} {row['products']:>4} {parts} {' '.join(row['seen'])}"
    )


#: What is read, in the order of the table.
KEYS = ("peak", "slip", "normal", "tangential", "stick", "pressed")


def summary(rows: list[dict[str, Any]], levels: list[float]) -> str:
    """Return, for each level, how many scenes show an error, and what it costs beside the first."""
    lines = []
    for level in levels:
        mine = [row for row in rows if row["local_accuracy"] == level]
        first = [row for row in rows if row["local_accuracy"] == levels[0]]
        ratios = [a["products"] / b["products"] for a, b in zip(mine, first, strict=True)]
        lines.append(
            f"local_accuracy {level:.0e}: errors to be seen in "
            f"{sum(bool(row['seen']) for row in mine)} of {len(mine)}, products "
            f"{np.mean(ratios):.2f} times those of {levels[0]:.0e}, at most {max(ratios):.2f} times"
        )
    return "\n".join(lines)


def main() -> None:
    """Read the arguments, measure, print, write."""
    comm = MPI.COMM_WORLD
    known = scenes(comm)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="+", default=list(known), choices=known, metavar="NAME")
    backends = ["cholesky", "multigrid"]
    parser.add_argument("--backends", nargs="+", default=backends, choices=backends)
    parser.add_argument("--levels", nargs="+", type=float, default=[0.5, 3e-2, 1e-2, 3e-3, 1e-3])
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for name in arguments.scenes:
        scene = known[name]()
        for backend in arguments.backends:
            rows += measure(name, scene, backend, arguments.levels)
            if comm.rank == 0:
                print(*map(text, rows[-len(arguments.levels) :]), sep="\n", flush=True)
                if arguments.json is not None:
                    arguments.json.write_text(json.dumps(rows, indent=1) + "\n")
    if comm.rank == 0:
        print(summary(rows, arguments.levels))


if __name__ == "__main__":
    main()
