"""What Coulomb friction costs, in products with A, over Tresca friction of the same scene.

    tools/fenicsx python3 benchmarks/coulomb.py [--fast]

prints the table in benchmarks/README.md. Each case is a problem of its own, from nothing. For
Tresca's law the bounds are those of the demo, or F = 0.3 times Hertz's mean pressure. The ball is
rolled over the plane: pushed sideways at its middle while it is pressed, so that part of the
contact sticks and part slips.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

sys.path.insert(0, str(Path(__file__).parents[1] / "demos"))
import demo_hertz
import demo_implant
import demo_two_bricks

from dolfinx_tresca import ContactProblem, Coulomb, Tresca
from dolfinx_tresca.scene.friction import DryFriction

COEFFICIENTS = (0.1, 0.3, 0.6, 1.0)
BACKENDS = ("cholesky", "multigrid")
ASKED: dict[str, dict[str, float]] = {"1e-6": {"rtol": 1e-6}, "default": {}}

#: What is wanted of the ratio.
GOAL = 1.3


def bricks(end: str, N: int) -> tuple[Any, DryFriction]:
    """Return the two bricks and their law."""
    scene = demo_two_bricks.two_bricks(MPI.COMM_WORLD, N, end=end)
    return scene, scene.pair.friction


def ball(h: float) -> tuple[Any, DryFriction]:
    """Return the ball on the plane, pushed along x."""
    scene = demo_hertz.sphere_on_plane(MPI.COMM_WORLD, h)
    bodies, V = scene.bodies, scene.V
    push = [demo_hertz.fix(V, bodies, "upper_cut", 0, 0.02 * scene.approach)]
    # x = 0 is a plane of antisymmetry for the push, and of symmetry for the pressure: a ball that
    # may move along x there is a quarter of another scene, which will do for counts
    held = [scene.bcs[1], scene.bcs[2]]
    mean = 2.0 / 3.0 * 0.55
    return dataclasses.replace(scene, bcs=[*held, *push]), Tresca(0.3 * mean)


def implant(N: int) -> tuple[Any, DryFriction]:
    """Return the stem in bone with the head moved all the way."""
    scene = demo_implant.implant(MPI.COMM_WORLD, N)
    scene.motion.value[:] = demo_implant.MOTION
    return scene, scene.pair.friction


SCENES: dict[str, Callable[[bool], tuple[Any, DryFriction]]] = {
    "two bricks, free_end_1": lambda fast: bricks("free_end_1", 8 if fast else 16),
    "two bricks, free_end_2": lambda fast: bricks("free_end_2", 8 if fast else 16),
    "ball, pushed": lambda fast: ball(0.4 if fast else 0.16),
    "implant": lambda fast: implant(8 if fast else 16),
}


def solved(scene: Any, friction: DryFriction, backend: str, asked: str) -> dict[str, Any]:
    """Solve one case from nothing; return what is counted. Collective."""
    pair = dataclasses.replace(scene.pair, friction=friction)
    with ContactProblem(scene.a, scene.L, [pair], bcs=scene.bcs, stiffness=backend) as problem:
        solution = problem.solve(**ASKED[asked])
    return {
        "products": solution.products,
        "iterations": solution.iterations,
        "status": solution.status.name,
        "residuals": solution.residuals,
        "contact": solution.counts.contact,
        "contact_stick": solution.counts.contact_stick,
        "krylov": solution.krylov_iterations,
    }


def row(scene: Any, tresca: DryFriction, backend: str, asked: str) -> list[str]:
    """Return products with Tresca's law, and with Coulomb's over those. Collective."""
    base = solved(scene, tresca, backend, asked)
    cells = [f"{base['products']}"]
    for coefficient in COEFFICIENTS:
        found = solved(scene, Coulomb(coefficient), backend, asked)
        ratio = found["products"] / base["products"]
        text = f"{found['products']} ({ratio:.2f})"
        if found["status"] != "CONVERGED":
            text += f" {found['status']}"
        cells.append(f"**{text}**" if ratio > GOAL else text)
    return cells


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fast", action="store_true", help="coarse meshes")
    parser.add_argument("--scene", help="those whose names have this in them", default="")
    arguments = parser.parse_args()
    header = ["scene", "solver for K", "asked", "Tresca", *(f"F = {F}" for F in COEFFICIENTS)]
    lines = [header, ["---"] * len(header)]
    for name, build in SCENES.items():
        if arguments.scene in name:
            scene, tresca = build(arguments.fast)
            for backend, asked in itertools.product(BACKENDS, ASKED):
                lines.append([name, backend, asked, *row(scene, tresca, backend, asked)])
                if MPI.COMM_WORLD.rank == 0:
                    print(f"| {' | '.join(lines[-1])} |", file=sys.stderr, flush=True)
    if MPI.COMM_WORLD.rank == 0:
        print("\n".join(f"| {' | '.join(cells)} |" for cells in lines))


if __name__ == "__main__":
    main()
