"""Pressures at the rim of partial overlaps: which side is secondary, and how fine the mesh is.

    tools/fenicsx python3 benchmarks/rims.py --json benchmarks/data/rims.json

A block is pressed on a plate that it covers in part (scenes/rims.py), without friction. Cells are
triangles or tetrahedra of degree 1 or 2, and have the same size in both bodies; the nodes match
only if the name of the rim says so. Each case is solved twice: either body is the secondary side.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator

import numpy as np
from harness import Benchmark, Column, Comm, Row, Table

from scenes.rims import BLOCK, PLATE, RIMS, block_on_plate

#: Kind of cells and degree -> number of cells along the plate; and residual at which solves end.
SIZES = {("triangle", 1): 24, ("triangle", 2): 24, ("tetrahedron", 1): 12, ("tetrahedron", 2): 6}
RTOL = 1e-5

MESHES = ("h", "h/2")


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield kinds of cells, degrees, rims, meshes and secondary sides."""
    for kind in arguments.kinds:
        for degree in arguments.degrees:
            for name in arguments.rims:
                if name == "corners" and kind == "triangle":
                    continue  # in 2D the corners are the edges
                for mesh in MESHES:
                    n = arguments.n or SIZES[kind, degree]
                    for side in ("block", "plate"):
                        case = {"kind": kind, "degree": degree, "rim": name, "mesh": mesh}
                        yield {**case, "n": n * (1 + MESHES.index(mesh)), "side": side}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield the peak and the root mean square of the pressure, both divided by its mean."""
    sides = {"block": (BLOCK, PLATE), "plate": (PLATE, BLOCK)}[case["side"]]
    scene = block_on_plate(comm, case["kind"], case["rim"], case["n"], case["degree"])
    with scene.but(secondary=sides[0], primary=sides[1]).problem() as problem:
        solution = problem.solve(rtol=RTOL)
        weights, pressure = solution.surface.weights, solution.surface.pressure.x.array
        owned = solution.surface.pressure.function_space.dofmap.index_map.size_local
        area, force, square = comm.allreduce(
            np.array([(weights * pressure**k)[:owned].sum() for k in range(3)])
        )
    yield {
        "peak": float(solution.peak_pressure * area / force),
        "norm": float(np.sqrt(square * area) / force),
        "force": float(force),
    }


def side_by_side(figure: str, mesh: str, text: str) -> Callable[[list[Row]], str]:
    """Return a function that writes the ratio of a figure for the two secondary sides.

    The figure with the plate as secondary side is divided by the figure with the block.

    Args:
        figure: field of the rows.
        mesh: name of the mesh.
        text: template for the ratio.
    """

    def cell(rows: list[Row]) -> str:
        found = {row["side"]: row[figure] for row in rows if row["mesh"] == mesh}
        return text.format(found["plate"] / found["block"]) if len(found) == 2 else ""

    return cell


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--kinds", nargs="+", default=["triangle", "tetrahedron"])
    parser.add_argument("--degrees", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--rims", nargs="+", default=list(RIMS), choices=RIMS)
    parser.add_argument("--n", type=int, help="cells along the plate, a multiple of 6")


BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("kind", "degree", "rim", "mesh", "side"),
    cases=cases,
    measure=measure,
    options=options,
    small={"n": 6},
    shown=[
        Column("cells", "{kind}", width=11),
        Column("degree", "{degree}"),
        Column("rim", "{rim}", width=18),
        Column("n", "{n}", width=3),
        Column("secondary", "{side}"),
        Column("peak", "{peak:.3f}"),
        Column("norm", "{norm:.4f}"),
        Column("force", "{force:.4g}"),
    ],
    tables=[
        Table(
            "rims",
            [
                Column("cells", "{kind}"),
                Column("degree", "{degree}"),
                Column("rim", "{rim}"),
                *(
                    Column(f"{side}, {mesh}", "{peak:.2f}", {"side": side, "mesh": mesh})
                    for side in ("block", "plate")
                    for mesh in MESHES
                ),
                *(
                    Column(f"peaks, {mesh}", side_by_side("peak", mesh, "{:.2f}"))
                    for mesh in MESHES
                ),
                *(
                    Column(f"norms, {mesh}", side_by_side("norm", mesh, "{:.3f}"))
                    for mesh in MESHES
                ),
            ],
            line=["kind", "degree", "rim"],
        )
    ],
)

if __name__ == "__main__":
    BENCHMARK.main()
