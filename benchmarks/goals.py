"""Meshes refined for a number, beside those for the energy: error and estimate over unknowns.

    tools/fenicsx python3 benchmarks/goals.py --json benchmarks/data/goals.json

`solve_adaptively` with `goal=` and without. What is right is the number on a mesh of degree 2 that
was refined for it up to four times `--dofs`.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

from harness import DASH, Benchmark, Column, Comm, Row, Table

from dolfinx_tresca import (
    ContactForce,
    Coulomb,
    Level,
    MeanPressure,
    MeanSlip,
    NormalForce,
    solve_adaptively,
)
from scenes.hertz import (
    cylinder_on_plane,
    nearest_of_cylinder,
    on_cylinder,
    on_sphere,
    sphere_on_plane,
)
from scenes.pressed_blocks import on_blocks, pressed_blocks
from scenes.scene import Scene
from scenes.two_bricks import on_bricks, two_bricks

#: Never reached: unknowns end each run.
ACCURACY = 1e-12

#: What meshes are refined for.
MARKINGS = ("goal", "energy")

#: Relative energy error of the iteration where a number is not what is refined for.
ITERATION = 1e-6

#: Relative errors of a number that tables ask for.
ASKED = (1e-2, 1e-3)


@dataclass(frozen=True)
class Study:
    """A number of a scene.

    Attributes:
        name: in the table.
        coarse: from a communicator.
        build: from a mesh and the degree.
        goal: the number.
        snap: for curved surfaces.
    """

    name: str
    coarse: Callable[[Any], Scene]
    build: Callable[..., Scene]
    goal: Any
    snap: dict[str, Any] | None = None


def blocks(name: str, goal: Any) -> Study:
    """Return a study of the section of two blocks."""
    return Study(f"blocks: {name}", lambda comm: pressed_blocks(comm, 8), on_blocks, goal)


def rubbing(name: str, goal: Any) -> Study:
    """Return a study of the same with Coulomb's law."""

    def build(tagged: Any, degree: int) -> Scene:
        return on_blocks(tagged, degree=degree).but(friction=Coulomb(0.3))

    return Study(f"blocks, Coulomb: {name}", lambda comm: pressed_blocks(comm, 8), build, goal)


def bricks(name: str, goal: Any) -> Study:
    """Return a study of the two bricks, in 3D."""
    return Study(f"bricks: {name}", lambda comm: two_bricks(comm, 4), on_bricks, goal)


def ball(name: str, goal: Any) -> Study:
    """Return a study of an eighth of a ball on a plane."""
    return Study(f"Hertz, a ball: {name}", lambda c: sphere_on_plane(c, 0.8), on_sphere, goal)


def floating_brick(name: str, goal: Any) -> Study:
    """Return a study of the two bricks where contact with Coulomb's law alone holds the upper."""

    def build(tagged: Any, degree: int) -> Scene:
        scene = on_bricks(tagged, degree=degree)
        return replace(scene, bcs=[scene.fixed("lower_fixed")]).but(friction=Coulomb(0.3))

    return Study(f"floating brick, Coulomb: {name}", lambda comm: two_bricks(comm, 4), build, goal)


def hertz(name: str, goal: Any) -> Study:
    """Return a study of the cylinder on a plane."""
    snap = {"contact": nearest_of_cylinder}
    return Study(
        f"Hertz, a line: {name}", lambda c: cylinder_on_plane(c, 0.24), on_cylinder, goal, snap
    )


STUDIES = {
    "normal": blocks("normal force", NormalForce()),
    "tangential": blocks("tangential force", ContactForce((1.0, 0.0))),
    "pressure": blocks("mean pressure", MeanPressure((0.3, 1.0), 0.15)),
    "slip": blocks("mean slip", MeanSlip((0.8, 1.0), 0.2, (1.0, 0.0))),
    "hertz_force": hertz("force", NormalForce()),
    "hertz_peak": hertz("pressure in the middle", MeanPressure((0.0, 0.0), 0.4)),
    "coulomb_force": rubbing("normal force", NormalForce()),
    "coulomb_slip": rubbing("mean slip", MeanSlip((0.8, 1.0), 0.2, (1.0, 0.0))),
    "bricks_force": bricks("normal force", NormalForce()),
    "bricks_slip": bricks("mean slip", MeanSlip((0.25, 0.5, 1.0), 0.5, (1.0, 0.0, 0.0))),
    "ball_force": ball("force", NormalForce()),
    "ball_peak": ball("pressure in the middle", MeanPressure((0.0, 0.0, 0.0), 0.8)),
    "floating_slip": floating_brick("mean slip", MeanSlip((0.25, 0.5, 1.0), 0.5, (1.0, 0.0, 0.0))),
}


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the numbers."""
    for name in arguments.goals:
        degrees, markings = arguments.degrees, arguments.markings
        yield {"goal": name, "dofs": arguments.dofs, "degrees": degrees, "markings": markings}


def levels(comm: Comm, study: Study, degree: int, dofs: int, goal: Any) -> list[tuple[Row, Any]]:
    """Return a row for each mesh, and the number with its estimate. Collective."""
    rows: list[tuple[Row, Any]] = []

    class Problem:  # the last problem that was built, for numbers that are not refined for
        it: Any = None

    def build(tagged: Any) -> Any:
        Problem.it = study.build(tagged, degree=degree).problem()
        return Problem.it

    def note(level: Level) -> None:
        found = level.goal_error
        if found is None:  # a rough solution says where to refine, but its number is rough, too
            Problem.it.solve(accuracy=ITERATION)
            found = Problem.it.goal_error(study.goal)
        figures = {"unknowns": level.free_dofs, "products": level.products}
        rows.append((figures, found))

    solve_adaptively(
        build,
        study.coarse(comm).tagged_mesh,
        ACCURACY,
        goal=goal,
        snap=study.snap,
        max_dofs=dofs,
        max_levels=40,
        observer=note,
    )
    return rows


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each mesh. Collective."""
    study, dofs = STUDIES[case["goal"]], case["dofs"]
    *_, (_, exact) = levels(comm, study, 2, 4 * dofs, study.goal)
    for degree, marking in itertools.product(case["degrees"], case["markings"]):
        goal = study.goal if marking == "goal" else None
        for number, (figures, found) in enumerate(levels(comm, study, degree, dofs, goal)):
            yield {
                "degree": degree,
                "marking": marking,
                "level": number,
                **figures,
                "value": found.value,
                "error": abs(found.value - exact.value) / abs(exact.value),
                "estimate": found.relative_error,
                "signed": abs(found.signed_error / found.value),
                "reference": exact.relative_error,
            }


def needed(accuracy: float) -> Callable[[list[Row]], str]:
    """Return a function that writes the unknowns from which on the error stays that small."""

    def text(rows: list[Row]) -> str:
        good = list(itertools.takewhile(lambda row: row["error"] <= accuracy, reversed(rows)))
        return f"{good[-1]['unknowns']:,}" if good else DASH

    return text


def effectivity(rows: list[Row]) -> str:
    """Return the least, the median, and the largest ratio of estimate and error.

    Of those errors that the estimate of what is right does not exceed.
    """
    known = [row for row in rows if row["error"] > row["reference"]]
    ratios = [row["estimate"] / row["error"] for row in known]
    return f"{min(ratios):.1f}, {median(ratios):.1f}, {max(ratios):.1f}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--goals", nargs="+", default=list(STUDIES), choices=STUDIES)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2], choices=[1, 2])
    parser.add_argument("--markings", nargs="+", default=MARKINGS, choices=MARKINGS)
    parser.add_argument("--dofs", type=int, default=20_000, help="no mesh has more, about")


GOAL = Column("number", lambda rows: STUDIES[rows[0]["goal"]].name, width=36)
DEGREE, MARKING = Column("degree", "{degree}"), Column("refined for", "{marking}")

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("goal", "degree", "marking", "level"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        GOAL,
        DEGREE,
        MARKING,
        Column("level", "{level}"),
        Column("unknowns", "{unknowns}"),
        Column("error", "{error:.1e}", width=7),
        Column("estimate", "{estimate:.1e}"),
        Column("with signs", "{signed:.1e}"),
        Column("products", "{products}"),
    ],
    tables=[
        Table(
            "goals",
            [
                GOAL,
                DEGREE,
                MARKING,
                Column("levels", lambda rows: f"{len(rows)}"),
                *(Column(f"unknowns for {100 * a:g} %", needed(a)) for a in ASKED),
                Column("last error", lambda rows: f"{rows[-1]['error']:.1e}"),
                Column("its estimate", lambda rows: f"{rows[-1]['estimate']:.1e}"),
                Column("estimate over error: least, median, largest", effectivity),
            ],
            line=["goal", "degree", "marking"],
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
