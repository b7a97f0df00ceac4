r"""What finite sliding costs: Newton steps in a load step, and where their time goes.

    OMP_NUM_THREADS=1 tools/fenicsx python3 benchmarks/finite_sliding.py \
        --json benchmarks/data/finite_sliding.json

Shallow ironing in the plane (Fischer and Wriggers 2006; `demos/demo_ironing.py` has data and
published forces) and a hemisphere that is pulled through a block, in steps of several cells of the
surface below. Neo-Hookean bodies, Coulomb's law with F = 0.3, forces and gaps to 1e-4, the default.
The indentation, in small steps, is not counted. Each Newton step pairs the surfaces anew, factors
the tangent by Cholesky and solves one contact problem.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    MESHES,
    ContactError,
    ContactPair,
    Coulomb,
    NonlinearContactProblem,
    TaggedMesh,
    read_gmsh,
)
from scenes.elasticity import by_body, fixed, lame_constants
from scenes.rubber_block import neo_hookean

COEFFICIENT, POISSON = 0.3, 0.32


@dataclass(frozen=True)
class Way:
    """A body that is pressed on another one and pulled along it.

    Attributes:
        bodies: mesh and tags.
        problem: the contact problem.
        motion: displacement of the upper body, changed in place.
        depth: how deep it is pressed.
        pressing: number of load steps until it is.
        length: how far it is pulled.
        cell: size of the cells along the way.
    """

    bodies: TaggedMesh
    problem: NonlinearContactProblem
    motion: fem.Constant
    depth: float
    pressing: int
    length: float
    cell: float


def problem_of(
    bodies: TaggedMesh,
    moduli: dict[str, float],
    sides: tuple[str, str],
    clamped: tuple[str, str],
) -> tuple[NonlinearContactProblem, fem.Constant]:
    """Return the problem and the motion of the upper body. Collective.

    Args:
        bodies: mesh and tags.
        moduli: Young's modulus of each body.
        sides: names of the secondary and of the primary side.
        clamped: names of the surface that moves and of the one that is fixed.
    """
    dim, tags, facets = bodies.mesh.geometry.dim, bodies.tags, bodies.facet_tags
    V = fem.functionspace(bodies.mesh, ("Lagrange", 1, (dim,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    mu, lam = lame_constants(by_body(bodies, moduli), POISSON)
    residual = ufl.derivative(neo_hookean(u, mu, lam) * ufl.dx, u, v)
    motion = fem.Constant(bodies.mesh, np.zeros(dim))
    moved, still = (facets.find(tags[name]) for name in clamped)
    bcs = [fixed(V, moved, motion), fixed(V, still)]
    if "symmetry" in tags:
        bcs.append(fixed(V, facets.find(tags["symmetry"]), component=1))
    pair = ContactPair(
        facets, *(tags[name] for name in sides), Coulomb(COEFFICIENT), sliding="finite"
    )
    return NonlinearContactProblem(residual, u, [pair], bcs), motion


def ironing(comm: Comm, size: float) -> Way:
    """Return the block on the foundation, `size` cells along that. Collective."""
    bodies = read_gmsh(MESHES / "ironing.geo", comm, N=int(size))
    problem, motion = problem_of(
        bodies,
        {"foundation": 689.6, "block": 6896.0},
        ("block_arc", "foundation_top"),
        ("block_top", "foundation_bottom"),
    )
    return Way(bodies, problem, motion, 1.0, int(size) // 4, 5.0, 12.0 / size)


def hemisphere(comm: Comm, size: float) -> Way:
    """Return the hemisphere on the block, with cells of the size 1 / `size`. Collective."""
    bodies = read_gmsh(Path(__file__).with_name("hemisphere.geo"), comm, h=1.0 / size)
    problem, motion = problem_of(
        bodies,
        {"block": 1.0, "hemisphere": 10.0},
        ("hemisphere_round", "block_top"),
        ("hemisphere_cut", "block_bottom"),
    )
    return Way(bodies, problem, motion, 0.32, int(size), 1.8, 1.0 / size)


#: Phases of a solve: what the table calls them, and their names in `ContactSolution.timings`.
PHASES = {
    "pairing": ("pairing",),
    "tangent": ("stiffness",),
    "factorisation": ("cholesky",),
    "contact": ("load", "iteration", "fields"),
}

SCENES = {"ironing": ironing, "hemisphere": hemisphere}


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield meshes and steps."""
    sizes = {"ironing": arguments.ironing, "hemisphere": arguments.hemisphere}
    for scene in arguments.scenes:
        for size in sizes[scene]:
            for cells in arguments.cells:
                yield {"scene": scene, "size": size, "cells": cells, "way": arguments.way}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the cost of pulling. Collective."""
    way = SCENES[case["scene"]](comm, case["size"])
    dim = len(way.motion.value)
    number = max(round(case["way"] * way.length / (case["cells"] * way.cell)), 1)
    steps: list[int] = []
    seconds: list[float] = []
    timings: dict[str, float] = {}
    products, halvings, force, failure = 0, 0, np.zeros(dim), ""

    def move(along: float, down: float) -> Any:
        way.motion.value[:] = 0.0
        way.motion.value[0], way.motion.value[-1] = along, -down
        start = time.perf_counter()
        solution = way.problem.solve()
        solution.raise_if_failed()
        way.problem.accept()
        return time.perf_counter() - start, solution

    with way.problem:
        try:
            for depth in way.depth * np.arange(1, way.pressing + 1) / way.pressing:
                move(0.0, depth)
            for place in case["cells"] * way.cell * np.arange(1, number + 1):
                lasted, solution = move(place, way.depth)
                steps.append(len(solution.newton.steps))
                seconds.append(lasted)
                halvings += len({step.fraction for step in solution.newton.steps}) - 1
                products += solution.products
                for name, value in solution.timings.items():
                    timings[name] = timings.get(name, 0.0) + value
                force = solution.pair_resultants[0].force
        except ContactError as error:
            failure = str(error).split(".")[0]
        found = {
            "unknowns": way.problem.free_dofs,
            "load_steps": len(steps),
            "halvings": halvings,
            "status": failure or "CONVERGED",
        }
        if steps:
            found |= {
                "newton_steps": sum(steps),
                "mean": sum(steps) / len(steps),
                "most": max(steps),
                "products": products / sum(steps),
                "seconds": sum(seconds),
                "shares": {
                    phase: sum(timings.get(name, 0.0) for name in names) / sum(seconds)
                    for phase, names in PHASES.items()
                },
                "ratio": float(abs(force[0] / force[-1])),
            }
        yield found


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--ironing", nargs="+", type=int, default=[60, 120])
    parser.add_argument("--hemisphere", nargs="+", type=int, default=[10, 18])
    parser.add_argument("--cells", nargs="+", type=float, default=[2, 9])
    parser.add_argument("--way", type=float, default=1.0, help="part of the way that is pulled")


SHOWN = [
    Column("cells in a step", "{cells:g}"),
    Column("load steps", "{load_steps}"),
    Column("Newton steps in each: mean, most", "{mean:.1f}, {most}"),
    Column("in all", "{newton_steps}"),
    Column("load halved", "{halvings}"),
    Column("products in a Newton step", "{products:.1f}"),
    Column("seconds", "{seconds:.0f}"),
    *(Column(phase, f"{{shares[{phase}]:.0%}}") for phase in PHASES),
    Column("H / V at the end", "{ratio:.4f}"),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "size", "cells", "way"),
    cases=cases,
    measure=measure,
    options=options,
    small={"scene": "ironing", "size": 40, "cells": 2, "way": 0.1},
    shown=[Column("scene", "{scene}", width=16), Column("size", "{size}", width=5), *SHOWN],
    tables=[
        Table(
            "finite_sliding",
            [Column("scene", "{scene}"), Column("unknowns", "{unknowns:,}"), *SHOWN],
            chosen=lambda row: row["way"] == 1.0,
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
