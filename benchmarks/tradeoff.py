"""Error against time and memory, by the kind and the size of the mesh.

    tools/fenicsx python3 benchmarks/tradeoff.py --json FILE --picture FILE

The two bricks (`free_end_1`), the ball of Hertz, the implant and the crane are solved on meshes of
several kinds and sizes, with the package's defaults; and on some of these meshes with a requested
error of the iteration that is a part of the package's estimate of the mesh's error.

Errors are relative, and of the whole answer (mesh and iteration), against a reference on a fine
mesh (`harness/reference.py`). Its energy error is the package's estimate, whose square is added to
the squares of the errors of other solutions. Its other errors follow from the difference from a
coarser reference, on the assumption that they fall like the estimate. Pressures of Hertz are
compared with theory, whose error is about (a/R)^2. Errors that are not larger than that of the
reference or of theory are not resolved. `algebra` is the energy norm of the difference from a
solution to a residual of 1e-8 on the same mesh.

Seconds are processor seconds from geometry to fields: mesh, forms, `ContactProblem(...)` and
`solve`, or `solve_adaptively` with all its meshes, after a small run that compiles all forms.
Memory is the peak memory of the process minus its memory before the run.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from cost import energy_error
from harness import Benchmark, Column, Comm, Row, Table
from harness.figure import new_figure, percent_ticks, plain_ticks, save
from harness.memory import peak_memory, reset_peak_memory, resident_memory
from harness.reference import Reference, numbers, theory_of
from harness.timing import timed

from dolfinx_tresca import (
    MESHES,
    ContactError,
    ContactProblem,
    ContactSolution,
    NormalForce,
    TaggedMesh,
    read_gmsh,
    solve_adaptively,
)
from dolfinx_tresca._base.compat import geometry_dofmap
from scenes import floating_block
from scenes import implant as stem
from scenes.hertz import on_sphere, sphere_on_plane
from scenes.scene import Scene
from scenes.two_bricks import on_bricks

#: Requested errors of the iteration, as parts of the estimated error of the mesh.
PARTS = (0.5, 0.3, 0.1, 0.03, 0.01)

#: Limit for the unknowns of adaptive meshes.
MOST = 2_000_000

#: Relative natural residual of solutions whose algebraic error is negligible.
TIGHT = 1e-8

#: Cells along the foot of the crane on its coarsest mesh, and length of the load on its arm [m].
FOOT_CELLS, TROLLEY = 8, 0.5


@dataclass(frozen=True)
class Mesh:
    """A mesh with its elements, and the adaptive refinement that starts from it.

    Attributes:
        cell: "tetrahedra" or "hexahedra".
        degree: degree of the displacement.
        size: N, or h [mm] for Hertz.
        grading: exponent of the grading towards the faces of the bricks; 1: no grading.
        accuracy: argument of `solve_adaptively`, which starts from this mesh; 0: the mesh is not
            refined.
        goal: quantity to which `accuracy` refers, "energy" or "force".
    """

    cell: str
    degree: int
    size: float
    grading: float = 1.0
    accuracy: float = 0.0
    goal: str = "energy"

    @property
    def family(self) -> str:
        """Name of the kind of mesh, without the size."""
        name = {"tetrahedra": "P", "hexahedra": "Q"}[self.cell] + str(self.degree)
        if self.accuracy:
            return name + (" adaptive" if self.goal == "energy" else f" for {self.goal}")
        return name + (" graded" if self.grading != 1.0 else "")


def family(cell: str, degree: int, *sizes: float, grading: float = 1.0) -> list[Mesh]:
    """Return meshes of one kind, with the given sizes."""
    return [Mesh(cell, degree, size, grading) for size in sizes]


def adaptive(degree: int, size: float, *accuracies: float, goal: str = "energy") -> list[Mesh]:
    """Return meshes from which adaptive solves start, one for each requested accuracy."""
    return [Mesh("tetrahedra", degree, size, 1.0, asked, goal) for asked in accuracies]


def two_bricks(mesh: Mesh) -> TaggedMesh:
    """Return the two bricks, with N cells along each.

    With a grading g nodes are moved: the distance of a node from the nearest face of its brick, as
    a part of half the brick's size, is raised to the power g, since singularities are at the edges.
    """
    hexahedra = int(mesh.cell == "hexahedra")
    tagged = read_gmsh(MESHES / "two_bricks.geo", MPI.COMM_SELF, N=int(mesh.size), Hex=hexahedra)
    if mesh.grading != 1.0:
        x, size = tagged.mesh.geometry.x, np.array([2.0, 1.0, 1.0])
        upper = np.zeros(len(x))
        cells = tagged.cell_tags.find(tagged.tags["upper"])
        upper[geometry_dofmap(tagged.mesh)[cells]] = 1.0
        start = np.outer(upper, [0.0, 0.0, 1.0])
        t = (2 * (x - start) / size).clip(0, 2)
        moved = np.where(t < 1, t**mesh.grading, 2 - (2 - t) ** mesh.grading)
        x[:] = start + 0.5 * size * moved
    return tagged


def hertz(mesh: Mesh) -> TaggedMesh:
    """Return the ball with cells of size h [mm] at the contact; all other cells shrink with h."""
    h, growth = mesh.size, 2.5 * mesh.size / mesh.degree
    return sphere_on_plane(MPI.COMM_SELF, h, Growth=growth).tagged_mesh


def implant(mesh: Mesh) -> TaggedMesh:
    """Return stem and bone, with N cells round the half hole.

    Cells far from the stem shrink as N grows, like the cells near the stem. Otherwise the outer
    walls of the bone, where the modulus rises by a factor of 15 within a cell, would have most of
    the error.
    """
    N = int(mesh.size)
    return stem.implant(MPI.COMM_SELF, N, Growth=min(0.35, 4.0 / N)).tagged_mesh


def on_implant(hip: TaggedMesh, *, degree: int) -> Scene:
    """Return the implant after its whole motion; the modulus also varies within cells."""
    scene = stem.on_implant(hip, degree=degree, smooth=True)
    scene.data.motion.value[:] = stem.MOTION
    return scene


def crane(mesh: Mesh) -> TaggedMesh:
    """Return crane and clay, with N cells along the foot."""
    N, hexahedra = int(mesh.size), int(mesh.cell == "hexahedra")
    M = N + 1 if mesh.accuracy else 9 * N // 4 + 1 - 9 * N // 4 % 2  # odd, see the .geo file
    return floating_block.crane_on_clay(MPI.COMM_SELF, N, M=M, Hex=hexahedra).tagged_mesh


def on_crane(tagged: TaggedMesh, *, degree: int) -> Scene:
    """Return the crane with a load whose length is the same on all meshes."""
    return floating_block.on_crane(tagged, TROLLEY, degree=degree)


@dataclass(frozen=True)
class Study:
    """A scene, the meshes on which it is solved, and the meshes of its references.

    Attributes:
        title: name of the scene in tables.
        tagged: function from the description of a mesh to the `TaggedMesh`.
        on: function from a `TaggedMesh` and the degree to the scene.
        meshes: meshes that are measured.
        base: meshes on which the requested error of the iteration is varied.
        references: meshes of two references, the finer one first; the error of the finer one is
            estimated from the other.
    """

    title: str
    tagged: Callable[[Mesh], TaggedMesh]
    on: Callable[..., Scene]
    meshes: Sequence[Mesh]
    base: Sequence[Mesh]
    references: Sequence[Mesh]


SCENES = {
    "two_bricks": Study(
        "two bricks",
        two_bricks,
        on_bricks,
        [
            *family("tetrahedra", 1, 8, 16),
            *adaptive(1, 4, 0.3, 0.2, 0.14),
            *family("tetrahedra", 2, 4, 8),
            *family("hexahedra", 2, 4, 8, 12, 18, grading=2.0),
            *adaptive(2, 4, 0.3, 0.2, 0.14, 0.1, 0.08, 0.05),
            *adaptive(2, 4, 0.03, goal="force"),
        ],
        (Mesh("tetrahedra", 1, 16), Mesh("hexahedra", 2, 8, 2.0)),
        adaptive(2, 4, 0.04, 0.08),
    ),
    "hertz": Study(
        "Hertz",
        hertz,
        on_sphere,
        [
            *family("tetrahedra", 1, 0.4, 0.24, 0.16, 0.12),
            *adaptive(1, 0.4, 0.2, 0.14, 0.1),
            *family("tetrahedra", 2, 0.8, 0.4, 0.28),
            *adaptive(2, 0.8, 0.1, 0.05, 0.03, 0.015),
            *adaptive(2, 0.8, 0.01, goal="force"),
        ],
        (Mesh("tetrahedra", 1, 0.12), Mesh("tetrahedra", 2, 0.28)),
        adaptive(2, 0.8, 0.0095, 0.02),
    ),
    "implant": Study(
        "implant",
        implant,
        on_implant,
        [
            *family("tetrahedra", 1, 8, 12, 16, 20),
            *adaptive(1, 8, 0.4, 0.3, 0.2),
            *family("tetrahedra", 2, 8, 12),
            *adaptive(2, 8, 0.28, 0.2, 0.14, 0.1, 0.05),
            *adaptive(2, 8, 0.03, goal="force"),
        ],
        (Mesh("tetrahedra", 1, 20), Mesh("tetrahedra", 2, 12)),
        adaptive(2, 8, 0.035, 0.07),
    ),
    "crane": Study(
        "crane",
        crane,
        on_crane,
        [
            *family("hexahedra", 1, 8, 16),
            *family("hexahedra", 2, 8),
            *adaptive(1, FOOT_CELLS, 0.3, 0.2),
            *adaptive(2, FOOT_CELLS, 0.2, 0.14, 0.1),
        ],
        (Mesh("hexahedra", 1, 16),),
        adaptive(2, FOOT_CELLS, 0.05, 0.1),
    ),
}


@dataclass(frozen=True)
class Answer:
    """A solution with its scene, and the size of its mesh."""

    scene: Scene
    solution: ContactSolution
    unknowns: int


def answer(study: Study, mesh: Mesh, stiffness: str = "auto", **asked: Any) -> Answer:
    """Solve from geometry to fields.

    Args:
        study: the scene.
        mesh: the mesh; the first mesh of an adaptive solve if `mesh.accuracy` is not 0.
        stiffness: solver for K.
        asked: arguments of `solve`.
    """
    tagged = study.tagged(mesh)
    if mesh.accuracy:
        return adapted(study, mesh, tagged)
    scene = study.on(tagged, degree=mesh.degree)
    with scene.problem(stiffness=stiffness) as problem:
        return Answer(scene, problem.solve(max_iterations=10_000, **asked), problem.free_dofs)


def adapted(study: Study, mesh: Mesh, tagged: TaggedMesh) -> Answer:
    """Solve on adaptive meshes to the accuracy `mesh.accuracy`."""
    scenes: list[Scene] = []

    def build(finer: TaggedMesh) -> ContactProblem:
        scenes[:] = [study.on(finer, degree=mesh.degree)]
        return scenes[0].problem()

    goal = NormalForce() if mesh.goal == "force" else None
    result = solve_adaptively(build, tagged, mesh.accuracy, goal=goal, max_dofs=MOST)
    return Answer(scenes[0], result.solution, result.levels[-1].free_dofs)


def measured(study: Study, mesh: Mesh, stiffness: str, **asked: Any) -> tuple[Answer, Row]:
    """Solve; return the answer, and its size, seconds and memory."""
    comm = MPI.COMM_SELF
    gc.collect()
    before = resident_memory(comm)
    reset_peak_memory()
    seconds, solved = timed(comm, lambda: answer(study, mesh, stiffness, **asked))
    return solved, {
        "n": solved.unknowns,
        "chosen": "multigrid" if solved.solution.krylov_iterations else "cholesky",
        "seconds": seconds,
        "memory_mb": peak_memory(comm) - before,
        "status": solved.solution.status.name,
    }


def described(name: str, mesh: Mesh, axis: str, stiffness: str, part: float | None = None) -> Row:
    """Return the fields that say which run a row has."""
    run = {"axis": axis, "stiffness": stiffness, "part": part}
    return {"scene": name, "family": mesh.family, **dataclasses.asdict(mesh), **run}


def make_reference(name: str) -> tuple[Reference, Row]:
    """Return the reference of a scene, and a row with the reference's own errors."""
    study = SCENES[name]
    fine, coarse = study.references
    coarser = answer(study, coarse)
    finer, cost = measured(study, fine, "auto")
    error = finer.solution.discretisation_error
    ratio = error / coarser.solution.discretisation_error
    reference = Reference(finer.scene, finer.solution, error)
    differences = reference.errors(coarser.scene, coarser.solution)
    own = {key: value * ratio / (1 - ratio**2) ** 0.5 for key, value in differences.items()}
    for key in numbers(finer.solution):
        own[key] = differences[key] * ratio / (1 - ratio)
    theory = theory_of(finer.scene, finer.solution)
    if theory is not None:
        own["pressure"] = own["peak"] = (theory.contact_radius / theory.radius) ** 2
    return reference, described(name, fine, "reference", "auto") | cost | own | {"energy": error}


def on_mesh(name: str, mesh: Mesh, reference: Reference) -> Iterator[Row]:
    """Yield the row of a mesh, and the rows for each part of its error."""
    study = SCENES[name]
    # with flat cells multigrid needs three times the iterations
    stiffness = "auto" if mesh.grading == 1.0 else "cholesky"
    row = described(name, mesh, "mesh", stiffness)
    try:
        solved, cost = measured(study, mesh, stiffness)
    except ContactError as error:
        yield {**row, "status": f"{error}"}
        return
    estimate = solved.solution.discretisation_error
    yield {
        **row, **cost, **reference.errors(solved.scene, solved.solution),
        "products": solved.solution.products, "discretisation_error": estimate,
    }  # fmt: skip
    if mesh not in study.base:
        return
    tight = answer(study, mesh, rtol=TIGHT)
    for stiffness, part in itertools.product(("cholesky", "multigrid"), PARTS):
        solved, cost = measured(study, mesh, stiffness, accuracy=part * estimate)
        yield {
            **described(name, mesh, "part", stiffness, part), **cost,
            **reference.errors(solved.scene, solved.solution),
            "products": solved.solution.products,
            "energy_error_bound": solved.solution.energy_error_bound,
            "algebra_error": energy_error(tight.scene, solved.solution.u, tight.solution.u),
        }  # fmt: skip


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the scenes; all runs of a scene share one reference."""
    for scene in arguments.scenes:
        yield {"scene": scene}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the row of a scene's reference, and the rows of all runs. Runs on one rank."""
    name = case["scene"]
    study = SCENES[name]
    reference, row = make_reference(name)
    yield row
    compiled: set[str] = set()
    for mesh in study.meshes:
        if mesh.family not in compiled:
            for stiffness in ("cholesky",) if mesh.accuracy else ("cholesky", "multigrid"):
                small = answer(study, mesh, stiffness)
                reference.errors(small.scene, small.solution)
            compiled.add(mesh.family)
        yield from on_mesh(name, mesh, reference)


#: Kind of error -> its name in tables.
ERRORS = {
    "energy": "energy",
    "pressure": "pressure in L2",
    "peak": "peak pressure",
    "force": "contact force",
    "slip": "slip in L2",
}
TARGETS = (0.1, 0.05, 0.02, 0.01, 0.001)

#: Largest error that counts as rounding, such as the error of a force that statics determine.
EXACT = 1e-9

#: Largest ratio of an error to another error that counts as an improvement.
GAIN = 0.97


def converged(rows: list[Row], scene: str, error: str) -> list[Row]:
    """Return the converged rows of a scene on its meshes; the reference only for "energy"."""
    axes = ("mesh", "reference") if error == "energy" else ("mesh",)
    return [
        row
        for row in rows
        if row["scene"] == scene and row["axis"] in axes
        if row.get("status") == "CONVERGED" and error in row
    ]


def parts(rows: list[Row]) -> list[Row]:
    """Return the rows of axis "part", with errors divided by those of the best run.

    The best run has the least algebraic error on the same mesh and with the same K-solver.
    """
    runs = [row for row in rows if row["axis"] == "part" and row.get("status") == "CONVERGED"]
    result = []
    for row in runs:
        same = ("scene", "family", "size", "chosen")
        alike = [run for run in runs if all(run[name] == row[name] for name in same)]
        best = min(alike, key=lambda run: run["algebra_error"])
        result.append({**row, **{e: row[e] / best[e] for e in ERRORS if e in best}})
    return result


def name_of(row: Row) -> str:
    """Return the mesh of a row as a short text."""
    size = f"h = {row['size']:g} mm" if row["scene"] == "hertz" else f"N = {row['size']:g}"
    return f"{row['family']}, " + (f"accuracy={row['accuracy']:g}" if row["accuracy"] else size)


def advice(rows: list[Row]) -> list[Row]:
    """Return the quickest mesh for each error in each scene."""
    result: list[Row] = []
    for reference in [row for row in rows if row["axis"] == "reference"]:
        for error in ERRORS:
            own = converged(rows, reference["scene"], error)
            result += advice_on(error, own, reference) if own else []
    return result


def advice_on(error: str, own: list[Row], reference: Row) -> Iterator[Row]:
    """Yield the quickest mesh for each target of one kind of error, up to the first missed target.

    The error of a number may be small by chance. So the error of a row is replaced by the largest
    of these: its own error, the errors on all finer meshes of its kind, and the reference's error.
    """
    doubtful = [{**row, error: max(row[error], reference[error])} for row in own]
    lasting = [
        {**row, error: max(finer[error] for finer in doubtful if is_finer(finer, row))}
        for row in doubtful
    ]
    for (name, missed), same in groupby(picked(error, lasting), lambda p: (name_of(p[1]), p[2])):
        targets, rows, _ = zip(*same, strict=True)
        row = rows[0]
        ends = dict.fromkeys((f"{100 * targets[0]:g}", f"{100 * targets[-1]:g}"))
        known = error != "energy" and reference[error] > row[error] / 3
        doubt = f" ± {100 * reference[error]:.2g} %" if known else ""
        yield {
            **row,
            "scene": SCENES[row["scene"]].title,
            "error": f"{ERRORS[error]}, {' to '.join(ends)} %",
            "take": ("not reached: " if missed else "") + name,
            "reached": f"{100 * row[error]:.2g} %{doubt}" if row[error] > EXACT else "rounding",
        }


def is_finer(finer: Row, row: Row) -> bool:
    """Return whether a row is on the same mesh or a finer mesh of the same kind."""
    same = all(finer[name] == row[name] for name in ("family", "axis"))
    return finer == row or (same and finer["n"] > row["n"])


def picked(error: str, rows: list[Row]) -> Iterator[tuple[float, Row, bool]]:
    """Yield (target, quickest row, whether missed) for each target, up to the first missed one."""
    best = min(row[error] for row in rows)
    for target in TARGETS:
        enough = [row for row in rows if row[error] <= target]
        enough_or_best = enough or [row for row in rows if row[error] <= best / GAIN]
        yield target, min(enough_or_best, key=lambda row: row["seconds"]), not enough
        if not enough:
            return  # smaller targets will be missed, too


#: Family of meshes -> name, colour, and width of the line; adaptive meshes stand out.
KINDS = {
    "P1": ("tetrahedra, degree 1", "#9ecae1", 1.2),
    "P2": ("tetrahedra, degree 2", "#fdae6b", 1.2),
    "Q1": ("hexahedra, degree 1", "#bdbdbd", 1.2),
    "Q2": ("hexahedra, degree 2", "#969696", 1.2),
    "Q2 graded": ("hexahedra, degree 2, graded by hand", "#31a354", 1.6),
    "P1 adaptive": ("adaptive, degree 1", "#08519c", 2.2),
    "P2 adaptive": ("adaptive, degree 2", "#d94801", 2.2),
    "P2 for force": ("adaptive for the force, degree 2", "#756bb1", 1.6),
}


def draw(path: Path, rows: list[Row]) -> None:
    """Save a picture of errors against seconds: a row for each scene, a column for each error."""
    from matplotlib.lines import Line2D

    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    figure, panels = new_figure(1.0 + 2.2 * len(scenes), len(scenes), 3)
    for line, scene in zip(panels, scenes, strict=True):
        reference = next(r for r in rows if r["scene"] == scene and r["axis"] == "reference")
        largest = max((row["force"] for row in converged(rows, scene, "energy")), default=0.0)
        errors = ("energy", "pressure", "force" if largest > EXACT else "slip")
        for panel, error in zip(line, errors, strict=True):
            draw_errors(panel, converged(rows, scene, error), error, reference[error])
            panel.set_title(f"{SCENES[scene].title}: {ERRORS[error]}", fontsize=10)
        line[0].set_ylabel("relative error")
    for panel in panels[-1]:
        panel.set_xlabel("seconds, from geometry to answer")
    drawn = {row["family"] for row in rows if row["axis"] == "mesh"}
    handles = [
        Line2D([], [], color=color, lw=width, marker="o", ms=4, label=label)
        for kind, (label, color, width) in KINDS.items()
        if kind in drawn
    ]
    handles.append(Line2D([], [], color="0.4", ls=":", label="not resolved below"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    save(figure, path)


def draw_errors(panel: Any, rows: list[Row], error: str, unresolved: float) -> None:
    """Draw an error against seconds: a curve for each kind of mesh."""
    for kind, (_, color, width) in KINDS.items():
        runs = sorted((row for row in rows if row["family"] == kind), key=lambda row: row["n"])
        x, y = ([row[name] for row in runs] for name in ("seconds", error))
        panel.loglog(x, y, "o-", ms=3.5, color=color, lw=width)
    panel.axhline(unresolved, color="0.4", ls=":", lw=1.2)
    least = max(min(row[error] for row in rows), 0.3 * unresolved)
    panel.set_ylim(0.7 * least, 1.5 * max(row[error] for row in rows))
    plain_ticks(panel.xaxis)
    percent_ticks(panel.yaxis)
    panel.grid(lw=0.3, color="0.85")
    panel.spines[["top", "right"]].set_visible(False)


def products(rows: list[Row]) -> str:
    """Return the products of each scene with Cholesky and P1 meshes, as text."""
    own = [row for row in rows if (row["family"], row["chosen"]) == ("P1", "cholesky")]
    return " / ".join(str(row["products"]) for row in own)


def range_of(error: str) -> Column:
    """Return the column with the range of an error, relative to the best run."""

    def text(rows: list[Row]) -> str:
        values = [row[error] for row in rows if error in row]
        return " to ".join(dict.fromkeys((f"{min(values):.2f}", f"{max(values):.2f}")))

    return Column(error, text)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=list(SCENES))


COSTS = [
    Column("n", "{n:,}"),
    Column("seconds", "{seconds:.1f}"),
    Column("MB", "{memory_mb:.0f}"),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=(
        "scene", "cell", "degree", "size", "grading", "accuracy", "goal", "axis", "stiffness",
        "part",
    ),
    cases=cases,
    measure=measure,
    options=options,
    draw=draw,
    shown=[
        Column("scene", "{scene}", width=10),
        Column("mesh", lambda rows: name_of(rows[0]), width=25),
        Column("axis", "{axis}", width=9),
        Column("K-solver", "{chosen}", width=9),
        Column("part", "{part:g}", width=5),
        *COSTS,
        Column("products", "{products}"),
        *(Column(error, f"{{{error}:.1e}}", width=8) for error in ERRORS),
        Column("algebra", "{algebra_error:.1e}", width=8),
    ],
    tables=[
        Table(
            "tradeoff",
            [
                Column("scene", "{scene}"),
                Column("error", "{error}"),
                Column("take", "{take}"),
                *COSTS,
                Column("reached", "{reached}"),
            ],
            line=["scene", "error"],
            derived=advice,
        ),
        Table(
            "tradeoff_parts",
            [
                Column("part", "{part:g}"),
                Column("products", products),
                *map(range_of, ("energy", "pressure", "slip")),
            ],
            line=["part"],
            derived=parts,
        ),
    ],
)  # fmt: skip

if __name__ == "__main__":
    BENCHMARK.main()
