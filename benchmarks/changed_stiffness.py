"""The cost of a solve after a change of K; information about the old A is reused.

    tools/fenicsx python3 benchmarks/changed_stiffness.py \
        --json benchmarks/data/changed_stiffness.json

The stiffness of the two bricks changes (`CHANGES`), as in later steps of Newton's method. The first
solve starts from zero; then K changes, and the next solve starts from the last multipliers. "rtol
1e-6" solves until the natural residual is 1e-6 of the residual at zero; "default" is `solve()`.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterator
from statistics import mean
from typing import Any

import numpy as np
from harness import DASH, Benchmark, Column, Comm, Row, Table
from steps import ASKED, BACKENDS

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactStatus
from scenes.elasticity import elasticity
from scenes.scene import Scene
from scenes.two_bricks import ENDS, YOUNG, two_bricks

#: Height of the contact surface, and half the thickness of the layer around it that changes alone
#: [m].
CONTACT, LAYER = 1.0, 0.15

#: Seed of the random waves, and the number of changes.
SEED, CHANGES_IN_A_ROW = 3, 10


def wave(amplitude: float) -> Callable[[Any], Any]:
    """Return the function 1 plus a wave in the directions x and z."""
    return lambda x: 1 + amplitude * ufl.sin(6 * x[0]) * ufl.cos(6 * x[2])


def layer(factor: float) -> Callable[[Any], Any]:
    """Return the function that is `factor` near the contact, and 1 elsewhere."""
    return lambda x: 1 + (factor - 1) * ufl.conditional(abs(x[2] - CONTACT) < LAYER, 1.0, 0.0)


def upper(factor: float) -> Callable[[Any], Any]:
    """Return the function that is `factor` in the upper brick, and 1 in the lower brick."""
    return lambda x: 1 + (factor - 1) * ufl.conditional(x[2] > CONTACT, 1.0, 0.0)


#: Name, with _ for blanks -> factor of Young's modulus, as a function of the position.
FACTORS: dict[str, Callable[[Any], Any]] = {
    "wave_of_1_%": wave(0.01),
    "wave_of_10_%": wave(0.1),
    "wave_of_50_%": wave(0.5),
    "all_2_times_stiffer": lambda x: 2.0 + 0.0 * x[0],
    "upper_brick_2_times": upper(2.0),
    "near_the_contact_2_times": layer(2.0),
    "upper_brick_30_times": upper(30.0),
    "near_the_contact_0.1_times": layer(0.1),
}
FIBRES, IN_A_ROW = "fibres_along_x_as_stiff", "ten_random_waves_of_50_%"
CHANGES = [*FACTORS, FIBRES, IN_A_ROW]


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield models and solvers for K."""
    loops = (arguments.sizes, arguments.scenes, arguments.backends)
    for N, scene, backend in itertools.product(*loops):
        case = {"N": N, "scene": scene, "backend": backend}
        yield {**case, "change": arguments.changes, "asked": arguments.asked}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each change and accuracy. Collective."""
    scene = two_bricks(comm, case["N"], end=case["scene"])
    for change, asked in itertools.product(case["change"], case["asked"]):
        yield {"change": change, "asked": asked, **changed(scene, case["backend"], change, asked)}


def form(scene: Scene, change: str) -> tuple[Any, list[Callable[[], None]]]:
    """Return the form, and functions, to be called in turn, that change its coefficients."""
    V, poisson = scene.V, scene.data.poisson
    x = ufl.SpatialCoordinate(scene.mesh)
    on = fem.Constant(scene.mesh, 0.0)

    def switch() -> None:
        on.value = 1.0

    if change == FIBRES:
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        fibres = on * YOUNG * u[0].dx(0) * v[0].dx(0) * ufl.dx
        return elasticity(V, YOUNG, poisson) + fibres, [switch]
    if change in FACTORS:
        young = YOUNG * (1 + on * (FACTORS[change](x) - 1))
        return elasticity(V, young, poisson), [switch]
    rng = np.random.default_rng(SEED)
    q = fem.Constant(scene.mesh, np.zeros(4))

    def another() -> None:
        on.value = 0.5
        q.value[:] = rng.uniform(0.0, 8.0, 4)

    young = YOUNG * (1 + on * ufl.sin(q[0] * x[0] + q[1]) * ufl.cos(q[2] * x[2] + q[3]))
    return elasticity(V, young, poisson), [another] * CHANGES_IN_A_ROW


def changed(scene: Scene, backend: str, change: str, asked: str) -> Row:
    """Return the costs of the first solve and of the solves after changes. Collective."""
    a, changes = form(scene, change)
    with scene.problem(a=a, stiffness=backend) as problem:
        solutions = [problem.solve(**ASKED[asked])]
        for apply in changes:
            apply()
            problem.update_stiffness()
            solutions.append(problem.solve(**ASKED[asked]))
    first, *later = solutions
    failed = [one for one in solutions if one.status is not ContactStatus.CONVERGED]
    return {
        "first": first.products,
        "first_krylov": first.krylov_iterations,
        "products": [solution.products for solution in later],
        "krylov": [solution.krylov_iterations for solution in later],
        "status": (failed or solutions)[0].status.name,
    }


def counts(rows: list[Row]) -> str:
    """Return the products of the first solve, and their mean for the solves after changes."""
    (row,) = rows
    if "products" not in row:
        return DASH
    later = mean(row["products"])
    return f"{row['first']} / {later:.1f}" if later % 1 else f"{row['first']} / {later:.0f}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", type=int, nargs="+", default=[8, 16], metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(ENDS), choices=ENDS)
    parser.add_argument("--backends", nargs="+", default=list(BACKENDS), choices=BACKENDS)
    parser.add_argument("--changes", nargs="+", default=CHANGES, choices=CHANGES)
    parser.add_argument("--asked", nargs="+", default=list(ASKED), choices=ASKED)


def words(rows: list[Row]) -> str:
    """Return the name of the change, with blanks."""
    return str(rows[-1]["change"]).replace("_", " ")


def asked_of(backend: str, asked: str) -> Column:
    """Return the column of a solver for K and an accuracy."""
    return Column(f"{backend}, {asked}", counts, {"backend": backend, "asked": asked}, DASH)


WHAT = [
    Column("change of Young's modulus", words, width=26),
    Column("scene", "`{scene}`", width=12),
    Column("N", "{N}", width=2),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("change", "scene", "N", "backend", "asked"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        *WHAT,
        Column("back end", "{backend}", width=9),
        Column("requested", "{asked}", width=9),
        Column("first / later", counts, width=12),
    ],
    tables=[
        Table(
            "changed_stiffness",
            [*WHAT, *(asked_of(*one) for one in itertools.product(BACKENDS, ASKED))],
            line=["change", "scene", "N"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
