"""What Coulomb friction costs, in products with A, over Tresca friction of the same scene.

    tools/fenicsx python3 benchmarks/coulomb.py [--fast]

prints the table in benchmarks/README.md. Each case is a problem of its own, from nothing. For
Tresca's law the bounds are those of the scene, or 0.3 times the ball's mean pressure. In brackets:
products over those of Tresca's law, and over those of Tresca's law with the bounds that the
solution ended with. On one rank.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca import Coulomb, Tresca
from dolfinx_tresca.scene.friction import Friction
from scenes.hertz import sphere_on_plane
from scenes.implant import MOTION, implant
from scenes.scene import Scene
from scenes.two_bricks import two_bricks

COEFFICIENTS = (0.1, 0.3, 0.6, 1.0)
BACKENDS = ("cholesky", "multigrid")
ASKED: dict[str, dict[str, float]] = {"1e-6": {"rtol": 1e-6}, "default": {}}

#: What is wanted of the ratio.
GOAL = 1.3


def pushed_ball(comm: MPI.Comm, h: float) -> Scene:
    """Return the ball on the plane, pushed along x at its middle. Collective.

    The plane x = 0 is free to move along x then: with its mirror image it would be no ball, which
    will do for counts.
    """
    scene = sphere_on_plane(comm, h)
    push = scene.fixed("upper_cut", 0.02 * scene.data.approach, 0)
    mean = 0.37  # MPa, of the pressure
    scene = replace(scene, bcs=[*scene.bcs[1:], push])
    return scene.but(friction=Tresca(0.3 * mean))


def moved_implant(comm: MPI.Comm, N: int) -> Scene:
    """Return the stem in bone with the head moved all the way. Collective."""
    scene = implant(comm, N)
    scene.data.motion.value[:] = MOTION
    return scene


#: Name -> scene, on a coarse mesh or not.
SCENES: dict[str, Callable[[MPI.Comm, bool], Scene]] = {
    "two bricks, free_end_1": lambda comm, fast: two_bricks(
        comm, 8 if fast else 16, end="free_end_1"
    ),
    "two bricks, free_end_2": lambda comm, fast: two_bricks(
        comm, 8 if fast else 16, end="free_end_2"
    ),
    "ball, pushed": lambda comm, fast: pushed_ball(comm, 0.4 if fast else 0.16),
    "implant": lambda comm, fast: moved_implant(comm, 8 if fast else 16),
}


def solved(scene: Scene, friction: Friction, backend: str, asked: str) -> dict[str, Any]:
    """Solve one case from nothing; return what is counted. On one rank."""
    scene = scene.but(friction=friction)
    with scene.problem(stiffness=backend) as problem:
        solution = problem.solve(**ASKED[asked])
        (normal, _), operators = problem._jump.slices[0], problem._jump.pairs[0]
        points = scene.V.tabulate_dof_coordinates()[operators.nodes]
    pressure = np.zeros(len(points))
    pressure[operators.normal_node] = solution.multipliers[normal]
    return {
        "products": solution.products,
        "status": solution.status.name,
        "residuals": solution.residuals,
        "points": points,
        "pressure": pressure,
    }


def frozen(coefficient: float, found: dict[str, Any]) -> Tresca:
    """Return Tresca's law with the bounds of a solution with Coulomb's."""
    tree, bounds = cKDTree(found["points"]), coefficient * found["pressure"]
    return Tresca(lambda x: bounds[tree.query(x.T)[1]])


def row(scene: Scene, backend: str, asked: str) -> list[str]:
    """Return products with Tresca's law, and with Coulomb's, over those. On one rank."""
    base = solved(scene, scene.pair.friction, backend, asked)
    cells = [f"{base['products']}"]
    for coefficient in COEFFICIENTS:
        found = solved(scene, Coulomb(coefficient), backend, asked)
        same = solved(scene, frozen(coefficient, found), backend, asked)
        ratio = found["products"] / base["products"]
        text = f"{found['products']} ({ratio:.2f}; {found['products'] / same['products']:.2f})"
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
    for cells in (header, ["---"] * len(header)):
        print(f"| {' | '.join(cells)} |")
    for name, build in SCENES.items():
        if arguments.scene in name:
            scene = build(MPI.COMM_SELF, arguments.fast)
            for backend, asked in itertools.product(BACKENDS, ASKED):
                cells = [name, backend, asked, *row(scene, backend, asked)]
                print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
