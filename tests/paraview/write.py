"""Write files of every kind, and what ParaView must find in them: write.py FOLDER.

What must be found comes from the Functions and not from what writes the files.
"""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactSolution, SolutionWriter, Tresca
from scenes.patches import patch
from scenes.two_bricks import two_bricks
from scenes.wall import tower

TIMES = (0.0, 0.5, 2.0)

#: Width of the blocks of a tower, and their names, from below, as a mesh file might have them.
WIDTH, BLOCKS = 0.25, ("sill", "left/stone", "left stone")


def ranges(function: fem.Function) -> list[list[float]]:
    """Return least and largest value of each component as in files. Collective."""
    V = function.function_space
    owned = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
    values = function.x.array[:owned].reshape(-1, V.dofmap.bs)
    all_values = np.concatenate(V.mesh.comm.allgather(values))
    least, largest = all_values.min(axis=0), all_values.max(axis=0)
    found = [[float(a), float(b)] for a, b in zip(least, largest, strict=True)]
    return found + [[0.0, 0.0]] * (3 - len(found)) * (len(found) > 1)


def block(functions: Sequence[fem.Function], cells: Sequence[fem.Function] = ()) -> dict[str, Any]:
    """Return what a block holds. Collective."""
    mesh = functions[0].function_space.mesh
    size = fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * ufl.dx))
    return {
        "cells": mesh.topology.index_map(mesh.topology.dim).size_global,
        "size": mesh.comm.allreduce(size),
        "points": {function.name: ranges(function) for function in functions},
        "values": {function.name: ranges(function) for function in cells},
    }


def blocks(solution: ContactSolution) -> dict[str, Any]:
    """Return the blocks of a solution. Collective."""
    errors = solution.cell_errors
    volume = block([solution.u], [] if errors is None else [errors])
    volume["values"]["body"] = [[1.0, 2.0]]
    return {"volume": volume, "contact": block(solution.surface.functions)}


def tower_blocks(solution: ContactSolution) -> dict[str, Any]:
    """Return the blocks of a tower's solution. Collective."""
    written = {
        re.sub(r"\W+", "_", surface.name).strip("_"): block(surface.functions)
        for surface in solution.surfaces
    }
    written["volume"] = block([solution.u])
    written["volume"]["values"] = {"body": [[1.0, float(len(BLOCKS))]]}
    return written


def main(folder: Path) -> None:
    """Write the files of a run on so many ranks."""
    comm = MPI.COMM_WORLD
    name = f"bricks_{comm.size}"
    expected: dict[str, Any] = {}
    scene = two_bricks(comm, 4)
    writer = SolutionWriter(folder / f"{name}.pvd")
    steps = []
    with scene.problem() as problem:
        for time in TIMES:
            scene.data.load.value[2] = -1.0 - time
            solution = problem.solve()
            writer.write(solution, time)
            steps.append([time, blocks(solution)])
    expected[f"{name}.pvd"] = steps
    for block_name, content in blocks(solution).items():
        expected[f"{name}/0002/{block_name}.vtu"] = [[0.0, {"": content}]]
    for kind in ("quadrilateral", "hexahedron"):
        curved = patch(comm, kind, 2, upper=(2, 1), lower=(3, 1), geometry=2, friction=Tresca(0.1))
        with curved.problem() as problem:
            solution = problem.solve(rtol=1e-6)
        solution.write(folder / f"{kind}_{comm.size}.pvd")
        expected[f"{kind}_{comm.size}.pvd"] = [[0.0, blocks(solution)]]
    with tower(comm, len(BLOCKS), WIDTH).problem() as problem:
        solution = dataclasses.replace(problem.solve(rtol=1e-6), body_names=BLOCKS)
    solution.write(folder / f"tower_{comm.size}.pvd")
    expected[f"tower_{comm.size}.pvd"] = [[0.0, tower_blocks(solution)]]
    if comm.rank == 0:
        (folder / f"{comm.size}.json").write_text(json.dumps(expected))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
