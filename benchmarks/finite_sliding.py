r"""Finite sliding: cost of a load step, shares of its phases, and cases from the literature.

    OMP_NUM_THREADS=1 tools/fenicsx python3 benchmarks/finite_sliding.py \
        --json benchmarks/data/finite_sliding.json

Cost: shallow ironing in the plane (Fischer and Wriggers 2006) and a hemisphere that is pulled
through a block, in steps of several cells of the surface below. The bodies are neo-Hookean, with
Coulomb's law and F = 0.3; forces and gaps are accurate to 1e-4, the default. The indentation, in
small steps, is not counted. Each Newton step pairs the surfaces anew, factors the tangent by
Cholesky and solves one contact problem. Seconds are processor seconds; the shares of the phases are
parts of the wall-clock time.

Cases (`--cases`): see docs/large_sliding_cases.md and scenes/large_sliding.py.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table

from dolfinx_tresca import Coulomb, Frictionless
from scenes import large_sliding
from scenes.large_sliding import Process

#: Values of a case: for each its quantity, the published values as text, and our value.
Values = list[tuple[str, str, float]]


@dataclass(frozen=True)
class Way:
    """A body that is pressed on another one and pulled along it.

    Attributes:
        body: process that moves the upper body.
        depth: depth to which the body is pressed.
        pressing: number of load steps in which it is pressed.
        length: distance over which it is pulled.
        cell: size of the cells along the way.
    """

    body: Process
    depth: float
    pressing: int
    length: float
    cell: float


def ironing(comm: Comm, size: float) -> Way:
    """Return the block on the foundation, with `size` cells along the foundation. Collective."""
    return Way(large_sliding.ironing(comm, int(size)), 1.0, int(size) // 4, 5.0, 12.0 / size)


def hemisphere(comm: Comm, size: float) -> Way:
    """Return the hemisphere on the block, with cells of the size 1 / `size`. Collective."""
    return Way(large_sliding.hemisphere(comm, size), 0.32, int(size), 1.8, 1.0 / size)


def number(value: float) -> str:
    """Return a value with four digits, or a small value with an exponent."""
    return f"{value:.1e}" if abs(value) < 1e-2 else f"{value:.4g}"


#: Name of a phase in the table -> its names in `ContactSolution.timings`.
PHASES = {
    "pairing": ("pairing",),
    "tangent": ("stiffness",),
    "factorisation": ("cholesky",),
    "contact": ("load", "iteration", "fields"),
}

SCENES = {"ironing": ironing, "hemisphere": hemisphere}


#: Time t -> published vertical and horizontal forces of shallow ironing [N].
IRONING = {
    1.0: ("268 to 332", "55 to 71"),
    1.5: ("338, 365, 408, 421", "102, 189, 160, 143"),
    2.0: ("", ""),
}

#: Depth to which the half ring is pressed, number of load steps, and coefficient of friction.
RING_DEPTH, RING_STEPS, RING_FRICTION = 20.0, 10, 0.5


def ironing_case(comm: Comm, size: float) -> tuple[list[Process], Values]:
    """Solve shallow ironing to t = 2, in steps of two cells. Collective."""
    body = large_sliding.ironing(comm, int(size))
    forces = large_sliding.iron(body, int(size) // 5)
    values = [
        (f"{name} force at t = {time:g} [N]", text, float(force))
        for time, both in forces.items()
        for name, text, force in zip(("vertical", "horizontal"), IRONING[time], both, strict=True)
    ]
    return [body], values


def closed_path(
    comm: Comm, size: float, *, make: Callable[..., Process], down: Sequence[float], cell: float
) -> tuple[list[Process], Values]:
    """Move a body along a rectangle between two depths, without friction. Collective.

    Args:
        comm: communicator of the mesh.
        size: size of the mesh.
        make: function that returns the process.
        down: length of the rectangle and both depths.
        cell: length of a load step times the size.
    """
    body = make(comm, int(size), Frictionless())
    between = (0.0,) * (len(body.motion.value) - 2)
    length, high, low = down
    ends = ((0.0, high), (length, high), (length, low), (0.0, low))
    corners = [(along, *between, -depth) for along, depth in ends]
    changes = large_sliding.there_and_back(body, corners, cell / size)
    return [body], [
        (f"change of the {name} at the end", "0", value) for name, value in changes.items()
    ]


def half_ring_case(comm: Comm, size: float) -> tuple[list[Process], Values]:
    """Press a half ring on a block, with either side as the secondary one. Collective."""
    bodies, values = [], []
    for exchanged in (False, True):
        ring = large_sliding.half_ring(comm, int(size), Coulomb(RING_FRICTION), exchanged=exchanged)
        depths = RING_DEPTH * np.arange(1, RING_STEPS + 1) / RING_STEPS
        force = ring.force(large_sliding.press(ring, depths))
        name = "with sides exchanged" if exchanged else "vertical force"
        values.append((f"{name} at {RING_DEPTH:g} mm [N]", "", float(abs(force[1]))))
        bodies.append(ring)
    return bodies, values


def hertz_case(comm: Comm, size: float) -> tuple[list[Process], Values]:
    """Press an elastic cylinder on a rigid one, 50 radii away from its mesh. Collective."""
    far = large_sliding.hertz_far_away(comm, 1.0 / size, 50.0 * large_sliding.RADIUS)
    here = large_sliding.hertz_far_away(comm, 1.0 / size, 0.0)
    return [], [
        ("peak pressure over Hertz's", "1", far.peak / far.theory.peak),
        ("half width over Hertz's", "1", far.contact_radius / far.theory.contact_radius),
        ("peak pressure over that where it was meshed", "1", far.peak / here.peak),
    ]


#: Title of a case -> function that solves the case, and sizes of its meshes.
CASES: dict[str, tuple[Callable[..., tuple[list[Process], Values]], tuple[int, ...]]] = {
    "shallow ironing": (ironing_case, (60, 120)),
    "closed path, plane": (
        partial(closed_path, make=large_sliding.ironing, down=(5.0, 0.5, 0.8), cell=24.0),
        (40, 60),
    ),
    "closed path, space": (
        partial(closed_path, make=large_sliding.hemisphere, down=(1.6, 0.2, 0.3), cell=2.0),
        (6, 10),
    ),
    "Hertz, 50 radii away": (hertz_case, (10, 20)),
    "half ring on a block": (half_ring_case, (32, 64)),
}


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield meshes and steps, and the cases of the literature."""
    sizes = {"ironing": arguments.ironing, "hemisphere": arguments.hemisphere}
    for scene in arguments.scenes:
        for size in sizes[scene]:
            for cells in arguments.cells:
                yield {"scene": scene, "size": size, "cells": cells, "way": arguments.way}
    for name in arguments.cases:
        for size in CASES[name][1][: arguments.meshes]:
            yield {"case": name, "size": size}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the cost of pulling, or the values of a case. Collective."""
    if "scene" not in case:
        yield from values_of(comm, case)
        return
    way = SCENES[case["scene"]](comm, case["size"])
    body, step = way.body, case["cells"] * way.cell
    between = [0.0] * (len(body.motion.value) - 2)
    timings: Counter[str] = Counter()
    products = halvings = 0
    with body.problem:
        for depth in way.depth * np.arange(1, way.pressing + 1) / way.pressing:
            body.move(0.0, *between, -depth)
        body.newton_steps.clear()
        start, began = time.process_time(), time.perf_counter()
        for number in range(1, max(round(case["way"] * way.length / step), 1) + 1):
            solution = body.move(number * step, *between, -way.depth)
            halvings += len({newton.fraction for newton in solution.newton.steps}) - 1
            products += solution.products
            timings.update(solution.timings)
        seconds, elapsed = time.process_time() - start, time.perf_counter() - began
        steps, force = body.newton_steps, body.force(solution)
        yield {
            "unknowns": body.problem.free_dofs,
            "load_steps": len(steps),
            "halvings": halvings,
            "newton_steps": sum(steps),
            "mean": sum(steps) / len(steps),
            "most": max(steps),
            "products": products / sum(steps),
            "seconds": seconds,
            "shares": {
                phase: sum(timings[name] for name in names) / elapsed
                for phase, names in PHASES.items()
            },
            "ratio": float(abs(force[0] / force[-1])),
            "status": "CONVERGED",  # otherwise a move raises an error
        }


def values_of(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the values of a case of the literature. Collective."""
    start = time.process_time()
    bodies, values = CASES[case["case"]][0](comm, case["size"])
    common: Row = {"seconds": time.process_time() - start}
    if bodies:
        steps = [len(body.newton_steps) for body in bodies]
        common["unknowns"] = bodies[0].problem.free_dofs
        common["load_steps"] = sum(steps)
        common["newton_steps"] = sum(sum(body.newton_steps) for body in bodies)
    for quantity, published, value in values:
        yield {"quantity": quantity, "published": published, "value": value, **common}
        common = {}  # only the first row of a mesh has these figures
    for body in bodies:
        body.problem.destroy()


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="*", default=list(SCENES), choices=SCENES)
    parser.add_argument("--ironing", nargs="+", type=int, default=[60, 120])
    parser.add_argument("--hemisphere", nargs="+", type=int, default=[10, 18])
    parser.add_argument("--cells", nargs="+", type=float, default=[2, 9])
    parser.add_argument("--way", type=float, default=1.0, help="part of the way that is pulled")
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=CASES)
    parser.add_argument("--meshes", type=int, default=2, help="the coarsest ones of each case")


SHOWN = [
    Column("cells in a step", "{cells:g}"),
    Column("load steps", "{load_steps}"),
    Column("Newton steps in each: mean, most", "{mean:.1f}, {most}"),
    Column("in all", "{newton_steps}"),
    Column("load halved", "{halvings}"),
    Column("products in a Newton step", "{products:.1f}"),
    Column("processor seconds", "{seconds:.0f}"),
    *(Column(phase, f"{{shares[{phase}]:.0%}}") for phase in PHASES),
    Column("H / V at the end", "{ratio:.4f}"),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "case", "size", "cells", "way", "quantity"),
    cases=cases,
    measure=measure,
    options=options,
    small={"scene": "ironing", "size": 40, "cells": 2, "way": 0.1},
    shown=[
        Column("scene", "{scene}", width=12),
        Column("case", "{case}", width=20),
        Column("size", "{size}", width=5),
        Column("quantity", "{quantity}", width=30),
        Column("value", "{value:.5g}", width=8),
        *SHOWN,
    ],
    tables=[
        Table(
            "finite_sliding",
            [Column("scene", "{scene}"), Column("unknowns", "{unknowns:,}"), *SHOWN],
            chosen=lambda row: row.get("way") == 1.0,
        ),
        Table(
            "large_sliding_cases",
            [
                Column("case", "{case}"),
                Column("mesh", "{size:g}"),
                Column("unknowns", "{unknowns:,}"),
                Column("quantity", "{quantity}"),
                Column("published", "{published}"),
                Column("ours", lambda rows: number(rows[0]["value"])),
                Column("load steps", "{load_steps}"),
                Column("Newton steps", "{newton_steps}"),
                Column("processor seconds", "{seconds:.0f}"),
            ],
            chosen=lambda row: "quantity" in row,
            derived=lambda rows: sorted(rows, key=lambda row: list(CASES).index(row["case"])),
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
