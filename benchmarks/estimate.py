"""The package's estimate of the mesh's error divided by the error, on scenes with a reference.

    tools/fenicsx python3 benchmarks/estimate.py --json benchmarks/data/estimate.json

References have elements of degree 2. Their meshes are refined where the error is large; the mesh of
the two bricks is graded towards all edges instead. Errors are energy norms of differences of
gradients, computed at the points of a quadrature rule on the mesh of the reference. The error of
the reference itself is an estimate. If one side is 100 times stiffer, the multipliers of the
reference are on the softer side, and the meshes are made by `solve_adaptively`: n is the number of
meshes up to the present one.

Contact terms measure how far complementarity is violated between nodes, where pressure and gap, or
friction and slip, are interpolated linearly: the root of 2 times the integral of p d + g |s| - t s,
divided by the error. A residual estimate would contain these terms in addition to the residuals of
the elements.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from harness import Benchmark, Column, Comm, Row, Table
from tradeoff_scenes import Mesh, Reference
from tradeoff_scenes import two_bricks as graded_bricks

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactSolution, TaggedMesh, solve_adaptively
from scenes.hertz import cylinder_on_plane, nearest_of_cylinder, on_cylinder
from scenes.pressed_blocks import on_blocks, pressed_blocks
from scenes.scene import Scene
from scenes.two_bricks import on_bricks, two_bricks

#: Accuracy that is never reached: a limit of unknowns ends the refinement of references.
ACCURACY = 1e-12

CELLS = {2: ("triangle", "quadrilateral"), 3: ("tetrahedron", "hexahedron")}


@dataclass(frozen=True)
class Study:
    """A scene, and the way to its reference.

    Attributes:
        name: name of the scene in the table.
        case: function from a communicator, a number of cells, a kind of cells and a degree to the
            scene.
        refined: function from a mesh and a degree to the scene of a refined reference; None: the
            reference is `fine`.
        fine: function that returns the scene of the reference; None: the reference is refined.
        sizes: numbers of cells of the meshes.
        dim: dimension of space.
        cells: kinds of cells; None: all kinds in this dimension.
        snap: projections to curved surfaces; see `refine`.
    """

    name: str
    case: Callable[..., Scene]
    refined: Callable[..., Scene] | None = None
    fine: Callable[[], Scene] | None = None
    sizes: tuple[int, ...] = (8, 16, 32)
    dim: int = 2
    cells: tuple[str, ...] | None = None
    snap: dict[str, Any] = field(default_factory=dict)


def blocks(comm: Comm, n: int, cell: str, degree: int, **kind: Any) -> Scene:
    """Return two blocks that are pressed together; see `pressed_blocks`."""
    return pressed_blocks(comm, n, cell=cell, degree=degree, **kind)


def cylinder(comm: Comm, n: int, cell: str, degree: int) -> Scene:
    """Return the cylinder on a plane, with about n / 4 cells in the contact."""
    quadrilaterals = cell == "quadrilateral"
    return cylinder_on_plane(comm, 3.84 / n, degree=degree, quadrilaterals=quadrilaterals)


def bricks(comm: Comm, n: int, cell: str, degree: int) -> Scene:
    """Return the two bricks."""
    return two_bricks(comm, n, hexahedra=cell == "hexahedron", degree=degree)


def fine_bricks() -> Scene:
    """Return the two bricks with small cells at their edges, where stresses are singular."""
    return on_bricks(graded_bricks(Mesh("hexahedra", 2, 9, grading=3.0)), degree=2)


def of_blocks(name: str, narrow: bool = False, **kind: Any) -> Study:
    """Return a study of the blocks."""
    return Study(name, partial(blocks, narrow=narrow, **kind), partial(on_blocks, **kind))


def refined_blocks(comm: Comm, n: int, cell: str, degree: int, lower: float) -> Scene:
    """Return a narrow block on a wide one, on the nth mesh of an adaptive solve."""
    result = solve_adaptively(
        lambda tagged: on_blocks(tagged, degree=degree, lower=lower).problem(),
        pressed_blocks(comm, 4, cell=cell, narrow=True).tagged_mesh,
        ACCURACY,
        max_levels=n,
    )
    return on_blocks(result.tagged_mesh, degree=degree, lower=lower)


def softer_secondary(blocks: TaggedMesh, degree: int, lower: float) -> Scene:
    """Return the blocks; the softer block is the secondary side."""
    scene = on_blocks(blocks, degree=degree, lower=lower)
    if lower > 1.0:
        return scene
    return scene.but(secondary=scene.tags["lower_contact"], primary=scene.tags["upper_contact"])


def of_refined_blocks(name: str, lower: float, dim: int = 2) -> Study:
    """Return a study of adaptive meshes; `lower` is the lower block's modulus over the upper's."""
    return Study(
        name,
        partial(refined_blocks, lower=lower),
        partial(softer_secondary, lower=lower),
        sizes=(4, 8, 12),
        dim=dim,
        cells=CELLS[dim][:1],
    )


STUDIES = {
    "blocks": of_blocks("blocks, sheared"),
    "punch": of_blocks("a narrow one on a wide one", narrow=True),
    "inclusion_10": of_blocks("inclusion, 10 times stiffer", ratio=10.0),
    "inclusion_1000": of_blocks("inclusion, 1000 times stiffer", ratio=1000.0),
    "poisson_0.49": of_blocks("Poisson's ratio 0.49", poisson=0.49),
    "poisson_0.499": of_blocks("Poisson's ratio 0.499", poisson=0.499),
    "secondary_100": of_refined_blocks("secondary 100 times stiffer", 0.01),
    "secondary_100_3d": of_refined_blocks("secondary 100 times stiffer, 3D", 0.01, dim=3),
    "primary_100": of_refined_blocks("primary 100 times stiffer", 100.0),
    "hertz": Study("Hertz, a line", cylinder, on_cylinder, snap={"contact": nearest_of_cylinder}),
    "bricks": Study(
        "two bricks",
        bricks,
        fine=fine_bricks,
        sizes=(4, 6, 8),
        dim=3,
    ),
}

#: Studies on adaptive meshes. They need finer references than the others (`--dofs`).
ON_ADAPTIVE_MESHES = ("secondary_100", "secondary_100_3d", "primary_100")


def reference(name: str, comm: Comm, dofs: int) -> tuple[Reference, float]:
    """Return the reference of a scene, and an estimate of the reference's own relative error."""
    study = STUDIES[name]
    if study.fine is not None:
        scene = study.fine()
        with scene.problem(stiffness="cholesky") as problem:
            solution = problem.solve(accuracy="balanced")
        return Reference(scene, solution), solution.discretisation_error or math.inf
    refined = study.refined
    assert refined is not None
    result = solve_adaptively(
        lambda tagged: refined(tagged, degree=2).problem(),
        study.case(comm, study.sizes[0], CELLS[study.dim][0], 1).tagged_mesh,
        ACCURACY,
        snap=study.snap,
        max_dofs=dofs,
    )
    return Reference(refined(result.tagged_mesh, degree=2), result.solution), result.error


def contact_terms(scene: Scene, solution: ContactSolution) -> float:
    """Return the root of twice the integral of p d + g |s| - t s, divided by |u|_K."""
    surface = solution.surface
    density = surface.pressure * abs(surface.gap)
    if surface.traction is not None and surface.slip is not None:
        bound = scene.pair.friction.slip_bound  # a number in all these scenes
        length = ufl.sqrt(ufl.inner(surface.slip, surface.slip) + 1e-300)
        density += abs(bound * length - ufl.inner(surface.traction, surface.slip))
    work = fem.assemble_scalar(fem.form(density * ufl.dx(metadata={"quadrature_degree": 4})))
    norm = fem.assemble_scalar(fem.form(ufl.action(ufl.action(scene.a, solution.u), solution.u)))
    return math.sqrt(2.0 * work / norm)


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the scenes; a case has all meshes of a scene, since they share one reference."""
    for name in arguments.scenes:
        yield {"scene": name, "dofs": arguments.dofs, "coarse": arguments.coarse}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each mesh. Runs on one rank."""
    study = STUDIES[case["scene"]]
    found, left = reference(case["scene"], comm, case["dofs"])
    sizes = study.sizes[: case["coarse"]]
    for cell, degree, n in itertools.product(study.cells or CELLS[study.dim], (1, 2), sizes):
        if study.dim == 3 and degree == 2 and n > study.sizes[1]:
            continue
        scene = study.case(comm, n, cell, degree)
        with scene.problem(stiffness="cholesky") as problem:
            solution = problem.solve(accuracy="balanced")
            unknowns = problem.free_dofs
        error = found.errors(scene, solution)["energy"]
        yield {
            "cell": cell,
            "degree": degree,
            "n": n,
            "unknowns": unknowns,
            "error": error,
            "estimate": solution.discretisation_error,
            "contact_terms": contact_terms(scene, solution) / error,
            "reference": left,
            "status": solution.status.name,
        }


def ratios(rows: list[Row]) -> str:
    """Return the ratios of estimate to error, from the coarsest to the finest mesh."""
    return ", ".join(f"{row['estimate'] / row['error']:.2f}" for row in rows)


def errors(rows: list[Row]) -> str:
    """Return the errors of the coarsest and the finest mesh."""
    return f"{100 * rows[0]['error']:.2g} to {100 * rows[-1]['error']:.2g} %"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    given = [name for name in STUDIES if name not in ON_ADAPTIVE_MESHES]
    parser.add_argument("--scenes", nargs="+", default=given, choices=STUDIES)
    parser.add_argument("--dofs", type=int, default=40_000, help="of references, about")
    parser.add_argument("--coarse", type=int, default=3, help="only so many meshes of each kind")


SCENE = Column("scene", lambda rows: STUDIES[rows[0]["scene"]].name, width=31)
CELL = Column("cell", "{cell}", width=13)
DEGREE = Column("degree", "{degree}")

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "cell", "degree", "n"),
    cases=cases,
    measure=measure,
    options=options,
    shown=[
        SCENE,
        CELL,
        DEGREE,
        Column("n", "{n}"),
        Column("error", "{error:.4f}", width=7),
        Column("estimate/error", ratios, width=14),
        Column("contact terms", "{contact_terms:.3f}"),
    ],
    tables=[
        Table(
            "estimate",
            [
                SCENE,
                CELL,
                DEGREE,
                Column("error", errors),
                Column("estimate over error", ratios),
                Column(
                    "contact terms over error",
                    lambda rows: f"{max(row['contact_terms'] for row in rows):.2f}",
                ),
            ],
            line=["scene", "cell", "degree"],
        ),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
