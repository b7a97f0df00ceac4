"""Error and its estimate against unknowns, for meshes refined for a goal or for the energy.

    tools/fenicsx python3 benchmarks/goals.py --json benchmarks/data/goals.json

`solve_adaptively` runs with `goal=` and without it. The value of the goal on a mesh of degree 2,
refined for this goal up to four times `--dofs` unknowns, counts as exact. `random_2d` and
`random_3d` are ten random scenes each, with two goals for each scene.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from statistics import median
from typing import Any

import numpy as np
from harness import DASH, Benchmark, Column, Comm, Row, Table

from dolfinx_tresca import (
    ContactForce,
    Coulomb,
    GoalError,
    Level,
    MeanPressure,
    MeanSlip,
    NormalForce,
    TaggedMesh,
    refine,
    solve_adaptively,
)
from dolfinx_tresca.dual.mesh_error import total
from scenes.hertz import (
    cylinder_on_plane,
    nearest_of_cylinder,
    on_cylinder,
    on_sphere,
    sphere_on_plane,
)
from scenes.pressed_blocks import on_blocks, pressed_blocks
from scenes.random_blocks import RandomBlocks
from scenes.scene import Scene
from scenes.two_bricks import on_bricks, two_bricks

#: Accuracy that is never reached: a limit of unknowns ends each run.
ACCURACY = 1e-12

#: Errors for which meshes are refined.
MARKINGS = ("goal", "energy")

#: Relative energy error of the iteration on meshes that are not refined for the goal.
ITERATION = 1e-6

#: Relative errors of a goal for which tables show the unknowns.
ASKED = (1e-2, 1e-3)

#: Number of random scenes in each dimension.
SCENES = 10

#: An error counts as known if both the error and the exact value are more than this number times
#: the estimated error of the exact value.
RESOLVED = 3.0

#: Lowest and highest good ratio of estimate to error: tables count the meshes in this range.
RANGE = (0.7, 5.0)

#: Factor by which the change of a goal from a mesh to a finer mesh is multiplied for an estimate.
MARGIN = 1.2


@dataclass(frozen=True)
class Study:
    """A goal of a scene.

    Attributes:
        name: name of the goal in the table.
        coarse: function from a communicator to the scene on the first mesh.
        build: function from a mesh and the degree to the scene on this mesh.
        goal: the goal.
        snap: projections to curved surfaces; see `refine`.
    """

    name: str
    coarse: Callable[[Any], Scene]
    build: Callable[..., Scene]
    goal: Any
    snap: dict[str, Any] | None = None


def blocks(name: str, goal: Any) -> Study:
    """Return a study of two blocks in 2D with Tresca's law; `name` is the name of the goal."""
    return Study(f"blocks: {name}", lambda comm: pressed_blocks(comm, 8), on_blocks, goal)


def rubbing(name: str, goal: Any) -> Study:
    """Return a study of the same two blocks with Coulomb's law."""

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
    """Return a study of the two bricks; contact with Coulomb's law alone holds the upper one."""

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


def random_studies(dim: int) -> dict[str, Study]:
    """Return studies of the random scenes, with two goals for each scene."""
    studies = {}
    for seed in range(SCENES):
        blocks = RandomBlocks.drawn(seed, dim)
        goals = sorted(blocks.goals().items())
        for kind, goal in (goals[seed % len(goals)], goals[(seed + 1) % len(goals)]):
            name = f"random_{dim}d_{seed}_{kind.replace(' ', '_')}"
            text = f"random blocks, {dim}D: {kind}"
            studies[name] = Study(text, blocks.coarse, blocks.on, goal)
    return studies


#: Name of a group -> its studies.
RANDOM = {f"random_{dim}d": random_studies(dim) for dim in (2, 3)}

EVERY = {**STUDIES, **{name: one for some in RANDOM.values() for name, one in some.items()}}


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the goals."""
    names = [name for group in arguments.goals for name in RANDOM.get(group, [group])]
    for name in names:
        degrees, markings = arguments.degrees, arguments.markings
        yield {
            "goal": name,
            "dofs": arguments.dofs,
            "degrees": degrees,
            "markings": markings,
            "finer": arguments.finer,
        }


def levels(
    comm: Comm, study: Study, degree: int, dofs: int, goal: Any, finer: bool = False
) -> list[tuple[Row, Any]]:
    """Return for each mesh a row, and the goal's value with its estimated error. Collective."""
    rows: list[tuple[Row, Any]] = []

    class Problem:  # the last problem that was built, for runs without `goal`
        it: Any = None

    def build(tagged: Any) -> Any:
        Problem.it = study.build(tagged, degree=degree).problem()
        return Problem.it

    def note(level: Level) -> None:
        found = level.goal_error
        if found is None:  # the solution is only accurate enough to mark cells: solve again
            Problem.it.solve(accuracy=ITERATION)
            found = Problem.it.goal_error(study.goal)
        figures = {"unknowns": level.free_dofs, "products": level.products}
        if finer:
            figures["finer"] = on_finer_mesh(study, level.tagged_mesh, degree)
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


def on_finer_mesh(study: Study, tagged: TaggedMesh, degree: int) -> float:
    """Return the goal's value with degree 2 instead of 1, or else on smaller cells. Collective."""
    if degree == 2:
        everywhere = np.ones(owned_cells(tagged))
        tagged = refine(tagged, everywhere, fraction=1.0, snap=study.snap)
    with study.build(tagged, degree=2).problem() as problem:
        problem.solve(accuracy=ITERATION)
        return problem.goal_error(study.goal).value


def owned_cells(tagged: TaggedMesh) -> int:
    """Return the number of cells that this rank owns. Not collective."""
    topology = tagged.mesh.topology
    return int(topology.index_map(topology.dim).size_local)


def unsigned(found: GoalError) -> float:
    """Return the sum over the cells of the products of both errors' energy norms. Collective."""
    return total(found.cell_errors) ** 2


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each mesh. Collective."""
    study, dofs = EVERY[case["goal"]], case["dofs"]
    *_, (_, exact) = levels(comm, study, 2, 4 * dofs, study.goal)
    scale = abs(exact.value)
    for degree, marking in itertools.product(case["degrees"], case["markings"]):
        goal = study.goal if marking == "goal" else None
        found_on = levels(comm, study, degree, dofs, goal, case["finer"])
        for number, (figures, found) in enumerate(found_on):
            yield {
                "kind": study.name,
                "type": type(study.goal).__name__,
                "degree": degree,
                "marking": marking,
                "level": number,
                **figures,
                "value": found.value,
                "right": exact.value,
                "error": abs(found.value - exact.value) / scale,
                "corrected": abs(found.corrected_value - exact.value) / scale,
                "estimate": found.error / scale,
                "signed": found.signed_error / scale,
                "unsigned": unsigned(found) / scale,
                "state_changes": found.state_changes / scale,
                "reference": exact.relative_error,
            }


def needed(accuracy: float) -> Callable[[list[Row]], str]:
    """Return a function that writes the unknowns from which on the error is at most `accuracy`."""

    def text(rows: list[Row]) -> str:
        good = list(itertools.takewhile(lambda row: row["error"] <= accuracy, reversed(rows)))
        return f"{good[-1]['unknowns']:,}" if good else DASH

    return text


def known(rows: list[Row]) -> list[Row]:
    """Return the rows whose error is known well enough (`RESOLVED`)."""
    return [row for row in rows if RESOLVED * row["reference"] < min(row["error"], 1.0)]


def effectivity(estimate: str) -> Callable[[list[Row]], str]:
    """Return a function that writes the least, median and largest ratio of estimate to error."""

    def text(rows: list[Row]) -> str:
        ratios = [row[estimate] / row["error"] for row in known(rows)]
        return f"{min(ratios):.1f}, {median(ratios):.1f}, {max(ratios):.1f}" if ratios else DASH

    return text


def crossing(rows: list[Row]) -> list[Row]:
    """Return the rows whose error changes its sign from the previous or to the next mesh."""
    lines: dict[Any, list[Row]] = {}
    for row in rows:
        lines.setdefault((row["goal"], row["degree"], row["marking"]), []).append(row)
    result = []
    for line in lines.values():
        signs = [row["value"] < row["right"] for row in line]
        around = zip(line, [signs[0], *signs], signs, [*signs[1:], signs[-1]], strict=False)
        result += [row for row, before, here, after in around if not before == here == after]
    return result


def share(estimate: Callable[[Row], float], beyond: bool = False) -> Callable[[list[Row]], str]:
    """Return a function that writes the number of meshes on which estimate / error is in `RANGE`.

    Args:
        estimate: function from a row to an estimate, relative to the exact value.
        beyond: whether to write the numbers of meshes below and above the range instead, and the
            number of these meshes where the error passes through zero.
    """

    def text(rows: list[Row]) -> str:
        through = [id(row) for row in crossing(rows)]
        counted = [row for row in known(rows) if row["unsigned"] > 0.0 and estimate(row) >= 0.0]
        ratios = [estimate(row) / row["error"] for row in counted]
        below, above = (
            [row for row, ratio in zip(counted, ratios, strict=True) if sign * ratio > sign * limit]
            for sign, limit in zip((-1, 1), RANGE, strict=True)
        )
        if not counted:
            return DASH
        if beyond:
            passing = sum(id(row) in through for row in below + above)
            return f"{len(below)}, {len(above)} ({passing})"
        good = len(counted) - len(below) - len(above)
        return f"{good} of {len(counted)} ({good / len(counted):.0%})"

    return text


def best_possible(row: Row) -> float:
    """Return |s| + |error - s|: the estimate if the size of the error of s were known.

    Here s is `GoalError.signed_error`.
    """
    error = (row["right"] - row["value"]) / abs(row["right"])
    return abs(row["signed"]) + abs(error - row["signed"])


def by_finer_mesh(row: Row) -> float:
    """Return `MARGIN` times the relative change to a finer mesh; -1 without a finer mesh."""
    if "finer" not in row:
        return -1.0
    return MARGIN * abs(row["finer"] - row["value"]) / abs(row["right"])


def corrected(rows: list[Row]) -> str:
    """Return how many corrected values have smaller and larger errors, and the number of all."""
    counted = known(rows)
    nearer, farther = (
        sum(sign * row["corrected"] < sign * row["error"] for row in counted) for sign in (1, -1)
    )
    return f"{nearer}, {farther} of {len(counted)}"


def scenes(rows: list[Row]) -> str:
    """Return the number of scenes in a line, all with the same kind of goal."""
    return f"{len({row['goal'] for row in rows})}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--goals", nargs="+", default=list(STUDIES), choices=[*EVERY, *RANDOM])
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2], choices=[1, 2])
    parser.add_argument("--markings", nargs="+", default=MARKINGS, choices=MARKINGS)
    parser.add_argument("--finer", action="store_true", help="solve on a finer mesh as well")
    parser.add_argument("--dofs", type=int, default=20_000, help="no mesh has more, about")


GOAL = Column("number", "{kind}", width=36)
DEGREE, MARKING = Column("degree", "{degree}"), Column("refined for", "{marking}")

#: Columns that compare estimates and corrected values with the error.
RATIOS = [
    Column("estimate over error: least, median, largest", effectivity("estimate")),
    Column("without signs", effectivity("unsigned")),
    Column("corrected: nearer, farther", corrected),
]

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
        Column("without signs", "{unsigned:.1e}"),
        Column("corrected", "{corrected:.1e}"),
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
                *RATIOS,
            ],
            chosen=lambda row: row["goal"] in STUDIES,
            line=["goal", "degree", "marking"],
        ),
        Table(
            "goal_ranges",
            [
                Column("number", "{type}"),
                DEGREE,
                Column("estimate 0.7 to 5 times the error", share(lambda row: row["estimate"])),
                Column(
                    "below, above (error passes through zero)",
                    share(lambda row: row["estimate"], beyond=True),
                ),
                Column("if the rest's size were known", share(best_possible)),
                Column("by a finer mesh", share(by_finer_mesh)),
            ],
            line=["type", "degree"],
        ),
        Table(
            "random_goals",
            [GOAL, DEGREE, Column("scenes", scenes), *RATIOS],
            chosen=lambda row: row["goal"] not in STUDIES,
            line=["kind", "degree"],
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
