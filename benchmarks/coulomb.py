"""Products with A for Coulomb friction, compared with Tresca friction in the same scene.

    tools/fenicsx python3 benchmarks/coulomb.py --json benchmarks/data/coulomb.json

Each solve is a new problem without known products; N is the number of cells along a brick or block,
or round the half hole of the implant. "1e-6" solves until the natural residual is 1e-6 of the
residual at zero; "default" is `solve()`. The rows of Coulomb's law have their own `products`, the
products of Tresca's law with the scene's own bound (`tresca`), and the products of Tresca's law
with the final bounds of the Coulomb solution (`frozen`).

The sixteen cases take 20 to 35 seconds each on a busy machine, about seven minutes in all.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterator

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table, add_ranks
from scipy.spatial import cKDTree

from dolfinx_tresca import ContactSolution, ContactStatus, Coulomb, Tresca
from dolfinx_tresca.scene.friction import Friction
from scenes.implant import MOTION, implant
from scenes.nodal import surface_nodes_of
from scenes.rigid_obstacle import block_on_ball
from scenes.scene import Scene
from scenes.two_bricks import two_bricks

COEFFICIENTS = (0.1, 0.3, 0.6, 1.0)
BACKENDS = ("cholesky", "multigrid")

#: Requested accuracy of a row -> the argument of `solve`.
ASKED: dict[str, Row] = {"1e-6": {"rtol": 1e-6}, "default": {}}

#: Largest desired ratio of the products to those of Tresca's law with the scene's own bound.
GOAL = 1.3


def moved_implant(comm: Comm, N: int) -> Scene:
    """Return the stem in bone, with the head moved by its whole displacement. Collective."""
    scene = implant(comm, N)
    scene.data.motion.value[:] = MOTION
    return scene


#: Name -> function that returns the scene for a size, and the size for the table.
SCENES: dict[str, tuple[Callable[[Comm, int], Scene], int]] = {
    "free_end_1": (lambda comm, N: two_bricks(comm, N, end="free_end_1"), 16),
    "free_end_2": (lambda comm, N: two_bricks(comm, N, end="free_end_2"), 16),
    "block_on_ball": (block_on_ball, 24),
    "implant": (moved_implant, 16),
}


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield scenes, solvers for K and accuracies."""
    loops = (arguments.ranks, arguments.scenes, arguments.backends, arguments.asked)
    for ranks, scene, backend, asked in itertools.product(*loops):
        N = arguments.size or SCENES[scene][1]
        yield {"ranks": ranks, "scene": scene, "N": N, "backend": backend, "asked": asked}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield one row for Tresca's law (F is None), and one for each coefficient. Collective."""
    scene = SCENES[case["scene"]][0](comm, case["N"])

    def solved(friction: Friction) -> ContactSolution:
        with scene.but(friction=friction).problem(stiffness=case["backend"]) as problem:
            return problem.solve(**ASKED[case["asked"]])

    tresca = solved(scene.pair.friction)
    tresca.raise_if_failed()
    yield {"F": None, **counted(tresca)}
    for F in COEFFICIENTS:
        found = solved(Coulomb(F))
        frozen = solved(Tresca(bounds(comm, F, found)))
        frozen.raise_if_failed()
        row = {"F": F, **counted(found)}
        yield {**row, "tresca": tresca.products, "frozen": frozen.products}


def counted(solution: ContactSolution) -> Row:
    """Return the status, the products and the counts of nodes of a solve."""
    counts = solution.counts
    return {
        "status": solution.status.name,
        "products": solution.products,
        "contact": counts.contact,
        "contact_stick": counts.contact_stick,
    }


def bounds(comm: Comm, F: float, solution: ContactSolution) -> Callable[[np.ndarray], np.ndarray]:
    """Return the slip bounds [stress] of a solution, as a function of points. Collective."""
    points, fields = surface_nodes_of(solution)
    tree = cKDTree(np.concatenate(comm.allgather(points)))
    values = F * np.concatenate(comm.allgather(fields["pressure"]))
    return lambda x: values[tree.query(x.T)[1]]


def law(rows: list[Row]) -> str:
    """Return the coefficient of a row, for the terminal."""
    F = rows[-1].get("F")
    return "Tresca" if F is None else f"{F}"


def over_tresca(rows: list[Row]) -> str:
    """Return the products, and in brackets their ratios to `tresca` and to `frozen`."""
    (row,) = rows
    ratio, frozen = (row["products"] / row[name] for name in ("tresca", "frozen"))
    text = f"{row['products']} ({ratio:.2f}; {frozen:.2f})"
    if row["status"] != ContactStatus.CONVERGED.name:
        text += f" {row['status']}"
    return f"**{text}**" if ratio > GOAL else text


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--size", type=int, metavar="N", help="in place of the scene's own")
    parser.add_argument("--backends", nargs="+", default=list(BACKENDS), choices=BACKENDS)
    parser.add_argument("--asked", nargs="+", default=list(ASKED), choices=ASKED)
    add_ranks(parser)


WHAT = [
    Column("scene", "`{scene}`", width=15),
    Column("N", "{N}", width=2),
    Column("solver for K", "{backend}"),
    Column("requested", "{asked}", width=9),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "N", "backend", "asked", "F", "ranks"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        *WHAT,
        Column("F", law, width=6),
        Column("products", "{products}"),
        Column("Tresca", "{tresca}"),
        Column("its bounds", "{frozen}"),
    ],
    tables=[
        Table(
            "coulomb",
            [
                *WHAT,
                Column("Tresca", "{products}", {"F": None}),
                *(Column(f"F = {F}", over_tresca, {"F": F}) for F in COEFFICIENTS),
            ],
            chosen=lambda row: row["ranks"] == 1,
            line=["scene", "N", "backend", "asked"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
