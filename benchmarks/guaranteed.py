"""The guaranteed bound of the whole error beside the error, the estimate, and the cost of a solve.

    tools/fenicsx python3 benchmarks/guaranteed.py --json benchmarks/data/guaranteed.json

The block on a plane and the two blocks have known solutions. "random" and "random_3d" are 100
blocks on a plane each, of triangles and tetrahedra, with random loads, materials and meshes.
Seconds are processor time. The error of the two bricks is the root of twice the energy above that
of a mesh of degree 2: an upper bound of the error of the displacement.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table
from harness.figure import new_figure, save

from dolfinx_tresca.dual.accuracy import DiscretisationError, total
from scenes.known_contact import block_on_plane
from scenes.manufactured import blocks_scene, norm
from scenes.scene import Scene
from scenes.two_bricks import two_bricks

#: Scene, cell, degree, and cells along x.
MESHES: dict[str, tuple[str, int, tuple[int, ...]]] = {
    "lifts": ("triangle", 1, (8, 16, 32, 64)),
    "slips": ("triangle", 1, (8, 16, 32, 64, 128)),
    "slips_degree_2": ("triangle", 2, (8, 16, 32)),
    "two_blocks": ("triangle", 1, (4, 8, 16)),
    "two_blocks_3d": ("tetrahedron", 1, (3, 6, 12)),
    "bricks_free_end_1": ("tetrahedron", 1, (3, 6, 8)),
    "bricks_free_end_2": ("tetrahedron", 1, (3, 6, 8)),
}

#: Cells along the bricks whose energy of degree 2 is the reference.
REFERENCE = 8

#: Cells of the random blocks, and limits of half the number of cells along x.
RANDOM = {"random": ("triangle", 3, 9), "random_3d": ("tetrahedron", 1, 4)}

#: Titles of the panels of the picture.
PANELS = {"slips": "triangles, a block slips", "bricks_free_end_2": "tetrahedra, two bricks"}


def draw(path: Path, rows: list[dict[str, Any]]) -> None:
    """Save a picture of bound, estimate and error against unknowns. On one rank only."""
    figure, panels = new_figure(3.4, 1, len(PANELS))
    for panel, (scene, title) in zip(panels[0], PANELS.items(), strict=True):
        own = [row for row in rows if row["scene"] == scene]
        for figures, label, style in (
            ([row["error"] * row["bound"] for row in own], "guaranteed bound", "^-"),
            ([row["error"] * row["estimate"] for row in own], "estimate", "s--"),
            ([row["error"] for row in own], "error", "o-"),
        ):
            panel.loglog(
                [row["unknowns"] for row in own], figures, style, ms=4, lw=1.4, label=label
            )
        panel.set_title(title, fontsize=10)
        panel.set_xlabel("unknowns")
    panels[0][0].set_ylabel("relative error, energy norm")
    panels[0][0].legend(frameon=False, fontsize=9)
    save(figure, path)


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the meshes, and the random blocks."""
    for scene, (cell, degree, sizes) in MESHES.items():
        if scene in arguments.scenes:
            for n in arguments.sizes or sizes:
                yield {"scene": scene, "cell": cell, "degree": degree, "n": n}
    for scene, (cell, *_) in RANDOM.items():
        if scene in arguments.scenes:
            yield {"scene": scene, "cell": cell, "degree": 1, "n": arguments.number}


def scene_of(comm: Comm, case: Row) -> Scene:
    """Return the scene of a case. Collective."""
    name, cell, degree, n = (case[key] for key in ("scene", "cell", "degree", "n"))
    if name.startswith("two"):
        return blocks_scene(comm, cell, degree, (n, n))
    if name.startswith("bricks"):
        return two_bricks(comm, n, end=name.removeprefix("bricks_"))
    return block_on_plane(comm, cell, degree, n, "lifts" if name == "lifts" else "slips")


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the row of a case. Collective."""
    if case["scene"] in RANDOM:
        ratios = []
        cell, *limits = RANDOM[case["scene"]]
        for seed in range(case["n"]):
            rng = np.random.default_rng(seed)
            scene = block_on_plane(
                comm,
                cell,
                1,
                2 * int(rng.integers(*limits)),
                rng.choice(["lifts", "slips"]),
                poisson=rng.choice([0.0, 0.3, 0.45]),
                size=rng.choice([0.3, 1.0]),
                distort=rng.uniform(0.0, 0.6),
                seed=seed,
            )
            with scene.problem() as problem:
                solution = problem.solve()
                ratios.append(problem.guaranteed_error().error / scene.data.error(solution.u))
        yield {"least": min(ratios), "median": float(np.median(ratios)), "largest": max(ratios)}
        return
    scene = scene_of(comm, case)
    with scene.problem() as problem:
        seconds = {}
        solution = problem.solve(rtol=1e-7)
        problem.guaranteed_error()  # compiles
        for name, call in (
            ("linear", problem.update_stiffness),
            ("solve", lambda: problem.solve(rtol=1e-7)),
            ("bound", problem.guaranteed_error),
        ):
            problem.forget()
            if name == "bound":
                problem.solve(rtol=1e-7)
            start = time.process_time()
            result = call()
            seconds[f"{name}_seconds"] = time.process_time() - start
        bound = result
        estimate = total(DiscretisationError(scene.a, scene.V).cell_errors(solution.u))
    if case["scene"].startswith("bricks"):
        end = case["scene"].removeprefix("bricks_")
        with two_bricks(comm, REFERENCE, end=end, degree=2).problem() as problem:
            energy = problem.solve(rtol=1e-7).primal_energy
        error = float(np.sqrt(2.0 * (solution.primal_energy - energy)))
    elif case["scene"].startswith("two"):
        error = norm(comm, scene.data.energy(solution.u - scene.data.exact))
    else:
        error = scene.data.error(solution.u)
    yield {
        "unknowns": scene.unknowns,
        "error": error * bound.relative_error / bound.error,
        "estimate": estimate / error,
        "bound": bound.error / error,
        "stress": bound.stress / error,
        "oscillation": bound.oscillation / error,
        "lift": bound.lift / error,
        **seconds,
    }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--scenes", nargs="+", default=[*MESHES, *RANDOM])
    parser.add_argument("--sizes", type=int, nargs="+", help="cells along x; default: by scene")
    parser.add_argument("--number", type=int, default=100, help="random blocks")


COLUMNS = [
    Column("scene", "{scene}", width=22),
    Column("unknowns", "{unknowns:,}", width=9),
    Column("error", "{error:.2%}", width=7),
    Column("estimate over error", "{estimate:.2f}"),
    Column("bound over error", "{bound:.2f}"),
    Column("stress", "{stress:.2f}"),
    Column("oscillation", "{oscillation:.2f}"),
    Column("lift", "{lift:.2f}"),
    Column("processor seconds: K, factored", "{linear_seconds:.2f}"),
    Column("whole solve", "{solve_seconds:.2f}"),
    Column("bound", "{bound_seconds:.2f}"),
]
RANDOM_COLUMNS = [
    Column("cells", "{cell}", width=11),
    Column("scenes", "{n}"),
    Column("least bound over error", "{least:.3f}"),
    Column("median", "{median:.3f}"),
    Column("largest", "{largest:.3f}"),
]
BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "cell", "degree", "n"),
    cases=cases,
    measure=measure,
    options=options,
    shown=COLUMNS,
    draw=draw,
    small={"n": 4},
    tables=[
        Table("guaranteed", COLUMNS, lambda row: row["scene"] not in RANDOM),
        Table("guaranteed_random", RANDOM_COLUMNS, lambda row: row["scene"] in RANDOM),
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
