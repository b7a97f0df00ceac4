"""Solvers for K compared: degree 2, degree 1 with as many unknowns, and refined meshes.

    tools/fenicsx python3 benchmarks/degree_2.py --sizes 8 12 --repeats 3 --contact \
        --json benchmarks/data/degree_2.json

Two bricks, as in the paper, with N cells along each (2 N for degree 1). The figures are: the time
of the solver's set-up and of one linear solve to 1e-8; iterations; the peak memory of set-up and
solve [bytes per unknown], without K; and the time of the linear problem from forms to displacement.
With --contact they are also the time and the products of the contact problem, solved until its
energy error is bounded by 1e-3, and this time divided by the time of the linear problem with the
same solver. Times are processor seconds of the first rank, which depend less on other work on the
machine than wall-clock times. Figures are medians; one process runs the solvers in turns.

With `--cells adaptive` a mesh of tetrahedra, with 4 cells along each brick, is refined where
displacements are singular: N times for degree 1, and N / 2 times for degree 2. (In the stored rows
the meshes from which a mesh was refined are levels of multigrid; now it is GAMG for degree 1.) The
command for these rows is:

    tools/fenicsx python3 benchmarks/degree_2.py --cells adaptive --sizes 8 12 --solvers multigrid \
        "GAMG of all of K" Cholesky --contact --json benchmarks/data/degree_2.json
"""

from __future__ import annotations

import argparse
import gc
import itertools
import time
from collections.abc import Iterator, Mapping
from statistics import median
from typing import Any

import numpy as np
from harness import DASH, Benchmark, Column, Comm, Row, Table, add_ranks, krylov_iterations
from harness.memory import peak_memory, resident_memory

from dolfinx_tresca import TaggedMesh, refine
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca.stiffness.choice import cholesky, multigrid
from dolfinx_tresca.stiffness.system import LinearSystem
from scenes.scene import Scene
from scenes.two_bricks import on_bricks, two_bricks

#: Name of the solver without levels above GAMG; on unrefined meshes of degree 1 "multigrid" is the
#: same.
OF_ALL = "GAMG of all of K"

#: Name of a solver -> PETSc options in addition to the defaults.
SOLVERS: dict[str, Mapping[str, Any]] = {
    "multigrid": {},
    OF_ALL: {"pc_type": "gamg"},
    "Cholesky": {},
}

CELLS = ("tetrahedra", "hexahedra")
ADAPTIVE = "adaptive"


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield meshes of degree 2."""
    for ranks, cells, N in itertools.product(arguments.ranks, arguments.cells, arguments.sizes):
        given = {name: getattr(arguments, name) for name in ("solvers", "repeats", "contact")}
        yield {"ranks": ranks, "cells": cells, "N": N, **given}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Yield a row for each solver with degree 2, then with degree 1. Collective."""
    adaptive = case["cells"] == ADAPTIVE
    coarse, fine = (case["N"] // 2, case["N"]) if adaptive else (case["N"], 2 * case["N"])
    runs = [(2, coarse, solver) for solver in case["solvers"]]
    runs += [(1, fine, solver) for solver in case["solvers"] if adaptive or solver != OF_ALL]
    scenes = {
        (degree, N): on_bricks(refined(comm, N), degree=degree)
        if adaptive
        else two_bricks(comm, N, hexahedra=case["cells"] == "hexahedra", degree=degree)
        for degree, N, _ in runs
    }
    found: dict[tuple[int, int, str], list[Row]] = {run: [] for run in runs}
    for _ in range(case["repeats"]):
        for degree, N, solver in runs:
            row = linear(comm, scenes[degree, N], solver)
            if case["contact"]:
                row.update(contact(scenes[degree, N], solver))
                row["linear_problems"] = row["contact"] / row["linear"]
            found[degree, N, solver].append(row)
    for (degree, N, solver), rows in found.items():
        yield {
            "degree": degree,
            "N": N,
            "solver": solver,
            "unknowns": scenes[degree, N].unknowns,
            "repeats": case["repeats"],
            **{figure: median(row[figure] for row in rows) for figure in rows[0]},
        }


def refined(comm: Comm, times: int) -> TaggedMesh:
    """Return the bricks, refined towards the edges of their common plane. Collective."""
    scene = two_bricks(comm, 4)
    bricks = TaggedMesh(scene.mesh, scene.cell_tags, scene.facet_tags, scene.tags)
    for _ in range(times):
        mesh = bricks.mesh
        owned = mesh.topology.index_map(3).size_local
        x = mesh.geometry.x[geometry_dofmap(mesh)[:owned]]
        size = np.cbrt(np.abs(np.linalg.det(x[:, 1:] - x[:, :1])))
        middle = x.mean(axis=1)
        aside = np.minimum(middle[:, :2], 1.0 - middle[:, :2]).min(axis=1)
        distance = np.hypot(aside, middle[:, 2] - 1.0)
        bricks = refine(bricks, size**2.5 / np.maximum(distance, size))
    return bricks


def linear(comm: Comm, scene: Scene, name: str) -> Row:
    """Return seconds, iterations and bytes per unknown of the linear problem. Collective."""
    gc.collect()
    began = time.process_time()
    with LinearSystem(scene.a, scene.L, scene.bcs) as system:
        system.assemble_stiffness()
        system.assemble_load()
        f = system.f.x.petsc_vec
        u = f.duplicate()
        before, start = resident_memory(comm), time.process_time()
        options = {"ksp_rtol": 1e-8, **SOLVERS[name]}
        with (
            cholesky(system.K, {}, None)
            if name == "Cholesky"
            else multigrid(system.K, system.V, system.prescribed, options, None)
        ) as solver:
            ready = time.process_time()
            solver.solve(f, u)
            done = time.process_time()
            row = {
                "set_up": ready - start,
                "solve": done - ready,
                "krylov_iterations": solver.krylov_iterations,
                "bytes": (peak_memory(comm) - before) * 2**20 / f.size,
                "linear": done - began,
            }
        u.destroy()
    return row


def contact(scene: Scene, name: str) -> Row:
    """Return the seconds and the products of the contact problem. Collective."""
    gc.collect()
    start = time.process_time()
    stiffness = "cholesky" if name == "Cholesky" else "multigrid"
    with scene.problem(stiffness=stiffness, petsc_options=SOLVERS[name]) as problem:
        solution = problem.solve(accuracy=1e-3)
    solution.raise_if_failed()
    return {"contact": time.process_time() - start, "products": solution.products}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--sizes", type=int, nargs="+", default=[5, 9], metavar="N")
    parser.add_argument("--cells", nargs="+", default=list(CELLS), choices=[*CELLS, ADAPTIVE])
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS)[:2])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--contact", action="store_true", help="the contact problem, too")
    add_ranks(parser)


COLUMNS = [
    Column("cells", "{cells}", width=10),
    Column("degree", "{degree}"),
    Column("unknowns", "{unknowns:,}"),
    Column("solver", "{solver}", width=16),
    Column("set-up", "{set_up:.2f}"),
    Column("solve", "{solve:.2f}"),
    Column("iterations", krylov_iterations),
    Column("bytes", "{bytes:.0f}"),
    Column("linear", "{linear:.2f}"),
    Column("contact", "{contact:.2f}", missing=DASH),
    Column("products", "{products:.0f}", missing=DASH),
    Column("linear problems", "{linear_problems:.2f}", missing=DASH),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("cells", "degree", "N", "solver", "ranks"),
    cases=cases,
    measure=measure,
    small={"N": 3, "repeats": 1},
    options=options,
    shown=COLUMNS,
    tables=[Table("degree_2", COLUMNS, chosen=lambda row: row["ranks"] == 1 and "bytes" in row)],
)

if __name__ == "__main__":
    BENCHMARK.main()
