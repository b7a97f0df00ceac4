"""Error against unknowns, for meshes refined where the error is large and for uniform meshes.

    tools/fenicsx python3 benchmarks/adaptive.py --json benchmarks/data/adaptive.json

`solve_adaptively` runs with its defaults, and with `fraction=1.0`, which cuts all cells. Both runs
begin with the same coarse mesh, and end before a mesh that has more than `--dofs` unknowns. The
error is the package's estimate of the mesh's error, relative and in the energy norm. The two bricks
have singular edges. The solution for the cylinder on a plane (Hertz, in 2D) is smooth except at the
ends of the contact; new nodes are moved onto the circle. The products of a level are the products
of a rough solve, which decides where to refine; on the last level the products of the final solve
are added. Seconds are processor seconds of everything on a level, the making of the next mesh
included. `linear` is the time of the linear problem on the last mesh, from forms to displacement,
with the same solver for K as in the contact problem.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np
from cost import linear
from harness import DASH, Benchmark, Column, Comm, Row, Table, add_ranks

from dolfinx_tresca import ContactProblem, TaggedMesh, solve_adaptively
from scenes.hertz import cylinder_on_plane, nearest_of_cylinder, on_cylinder
from scenes.scene import Scene
from scenes.two_bricks import on_bricks, two_bricks

#: Accuracy and number of meshes, both never reached: `--dofs` ends each run.
ACCURACY, MOST_LEVELS = 1e-12, 100

#: Kind of meshes -> part of the total squared error that the refined cells have together.
FRACTIONS = {"adaptive": 0.5, "uniform": 1.0}

#: Two choices of meshes for a fitted rate: the number of finest meshes; and the largest ratio of
#: the unknowns of the last mesh to the unknowns of an earlier mesh. (Each adaptive mesh has about
#: twice the unknowns of the previous mesh.)
FITTED, TENFOLD = 4, 10


@dataclass(frozen=True)
class Study:
    """A scene on its first mesh and on refined meshes.

    Attributes:
        name: name of the scene in the table.
        coarse: function from a communicator and a size to the scene on the first mesh.
        build: function from a mesh and the degree to the scene on this mesh.
        size: size of the first mesh, N or h [mm].
        surfaces: name of a tag -> projection to its curved surface.
    """

    name: str
    coarse: Callable[[MPI.Comm, Any], Scene]
    build: Callable[..., Scene]
    size: float
    surfaces: Mapping[str, Any] | None = None


STUDIES = {
    "two_bricks": Study("two bricks", two_bricks, on_bricks, 4),
    "hertz_line": Study(
        "Hertz, a line",
        cylinder_on_plane,
        on_cylinder,
        0.48,
        {"contact": nearest_of_cylinder},
    ),
}


def with_surfaces(study: Study, tagged: TaggedMesh) -> TaggedMesh:
    """Return a mesh of a study that knows its curved surfaces."""
    surfaces = {tagged.tags[name]: function for name, function in (study.surfaces or {}).items()}
    return replace(tagged, geometry=surfaces or None)


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the families of meshes."""
    loops = (arguments.ranks, arguments.scenes, arguments.degrees, arguments.meshes)
    for ranks, scene, degree, meshes in itertools.product(*loops):
        case = {"ranks": ranks, "scene": scene, "degree": degree, "meshes": meshes}
        yield {**case, "dofs": arguments.dofs}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each mesh of a family. Collective."""
    study = STUDIES[case["scene"]]
    began: list[float] = []
    scenes: list[Scene] = []

    def build(tagged: TaggedMesh) -> ContactProblem:
        began.append(time.process_time())
        scenes[:] = [study.build(tagged, degree=case["degree"])]
        return scenes[0].problem()

    result = solve_adaptively(
        build,
        with_surfaces(study, study.coarse(comm, study.size).tagged_mesh),
        ACCURACY,
        fraction=FRACTIONS[case["meshes"]],
        max_dofs=case["dofs"],
        max_levels=MOST_LEVELS,
    )
    began.append(time.process_time())
    for level, (start, end) in zip(result.levels, itertools.pairwise(began), strict=True):
        yield {
            "level": level.number,
            "unknowns": level.free_dofs,
            "error": level.error,
            "products": level.products,
            "seconds": comm.allreduce(end - start, op=MPI.MAX),
            "status": level.solution.status.name,
        }
    backend = "multigrid" if result.solution.krylov_iterations else "cholesky"
    start = time.process_time()
    linear(scenes[0], backend)
    seconds = comm.allreduce(time.process_time() - start, op=MPI.MAX)
    yield {"level": result.levels[-1].number, "linear": seconds}


def rate(rows: Sequence[Row]) -> float:
    """Return the power of 1 / n with which the error falls, fitted to meshes."""
    points = [(row["unknowns"], row["error"]) for row in rows]
    unknowns, errors = np.log(points).T
    return float(-np.polyfit(unknowns, errors, 1)[0])


def rate_of_last(rows: list[Row]) -> str:
    """Return the rate on the last meshes; with their number if it is less than `FITTED`."""
    if len(rows) < 2:
        return DASH
    fitted = rows[-FITTED:]
    return f"{rate(fitted):.2f}" + (f" ({len(fitted)} meshes)" if len(fitted) < FITTED else "")


def rate_of_tenfold(rows: list[Row]) -> str:
    """Return the rate on meshes with at least 1 / `TENFOLD` of the last mesh's unknowns."""
    fitted = [row for row in rows if TENFOLD * row["unknowns"] >= rows[-1]["unknowns"]]
    return f"{rate(fitted):.2f}" if len(fitted) > 1 else DASH


def last_over_linear(rows: list[Row]) -> str:
    """Return the time of the last level, divided by the time of the linear problem on its mesh."""
    last = rows[-1]
    return f"{last['seconds'] / last['linear']:.1f}" if "linear" in last else DASH


def percent(row: Row) -> str:
    """Return the error of a mesh as text, in percent."""
    return f"{100 * row['error']:.2g} %"


def first_to_last(text: Callable[[Row], str]) -> Callable[[list[Row]], str]:
    """Return a function that writes a text for the first and the last mesh."""
    return lambda rows: f"{text(rows[0])} to {text(rows[-1])}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", default=list(STUDIES), choices=STUDIES)
    parser.add_argument("--degrees", type=int, nargs="+", default=[1, 2], choices=[1, 2])
    parser.add_argument("--meshes", nargs="+", default=list(FRACTIONS), choices=FRACTIONS)
    parser.add_argument("--dofs", type=int, default=70_000, help="no mesh has more, about")
    add_ranks(parser)


SCENE = Column("scene", lambda rows: STUDIES[rows[0]["scene"]].name, width=13)
DEGREE = Column("degree", "{degree}")


def on_one_rank(row: Row) -> bool:
    """Return whether tables show a row."""
    return row["ranks"] == 1 and "error" in row


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "degree", "meshes", "level", "ranks"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        SCENE,
        DEGREE,
        Column("meshes", "{meshes}", width=8),
        Column("level", "{level}"),
        Column("unknowns", "{unknowns}"),
        Column("error", "{error:.1e}", width=7),
        Column("products", "{products}"),
        Column("seconds", "{seconds:.1f}"),
    ],
    tables=[
        Table(
            "adaptive",
            [
                SCENE,
                DEGREE,
                Column("meshes", "{meshes}"),
                Column("levels", lambda rows: f"{len(rows)}"),
                Column("unknowns", first_to_last("{unknowns:,}".format_map)),
                Column("error", first_to_last(percent)),
                Column("rate, four meshes", rate_of_last),
                Column("rate, tenfold", rate_of_tenfold),
                Column("products", lambda rows: f"{sum(row['products'] for row in rows)}"),
                Column("seconds", lambda rows: f"{sum(row['seconds'] for row in rows):.0f}"),
                Column("last mesh over linear solve", last_over_linear),
            ],
            chosen=on_one_rank,
            line=["scene", "degree", "meshes"],
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
