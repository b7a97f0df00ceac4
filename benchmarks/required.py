"""What a scene needs, beside a full frictional one: unknowns, entries, factorisations, memory.

    tools/fenicsx python3 benchmarks/required.py --size 20 --json FILE

Two equal bricks under a load, N cells along each, and variations with less to them. Columns:
degrees of freedom; multipliers; entries of N and T; sizes of the matrices that two solves factor (K
and one for the bound of the error); peak memory [MB] of the process (VmHWM, Python and mesh in it),
and of one that solves the linear problem of the same mesh. Each is a process of its own.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "demos"))
from cost_runs import linear
from demo_two_bricks import Scene, two_bricks
from memory import peak_memory, reset_peak_memory

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    Bonded,
    ContactPair,
    ContactProblem,
    Frictionless,
    RigidPlane,
    Tresca,
)
from dolfinx_tresca.stiffness.solver import StiffnessSolver


def bricks(N: int, **changes: Any) -> Scene:
    """Return the two bricks with changes of their pair."""
    scene = two_bricks(MPI.COMM_WORLD, N, end="free_end_2")
    return dataclasses.replace(scene, pair=dataclasses.replace(scene.pair, **changes))


def mixed(N: int) -> tuple[Scene, list[ContactPair]]:
    """Return the bricks with friction, and a frictionless plane under the lower one's free end."""
    scene = bricks(N)
    tag = scene.bricks.tags["lower_free_end"]
    plane = RigidPlane((2.1, 0.0, 0.0), (-1.0, 0.0, 0.0))
    wall = ContactPair(scene.bricks.facet_tags, tag, plane, Frictionless())
    return scene, [scene.pair, wall]


def one_body(N: int, dim: int) -> tuple[Scene, list[ContactPair]]:
    """Return a brick of the same cells, or its section, with friction on a rigid plane."""
    comm = MPI.COMM_WORLD
    if dim == 3:
        mesh = dolfinx.mesh.create_box(comm, [[0.0, 0.0, 1.0], [2.0, 1.0, 2.0]], [N, N - 1, N - 1])
    else:
        mesh = dolfinx.mesh.create_rectangle(comm, [[0.0, 1.0], [2.0, 2.0]], [N, N - 1])
    V = fem.functionspace(mesh, ("Lagrange", 1, (dim,)))
    mesh.topology.create_connectivity(dim - 1, dim)
    faces = [
        dolfinx.mesh.locate_entities_boundary(
            mesh, dim - 1, lambda x, h=h: np.isclose(x[dim - 1], h)
        )
        for h in (1.0, 2.0)
    ]
    facets = np.concatenate(faces)
    order = np.argsort(facets)
    values = np.repeat(np.array([1, 2], dtype=np.int32), [len(face) for face in faces])
    tags = dolfinx.mesh.meshtags(mesh, dim - 1, facets[order], values[order])
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)

    def strain(w: Any) -> Any:
        return ufl.sym(ufl.grad(w))

    a = 5e4 * ufl.inner(strain(u), strain(v)) * ufl.dx
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    L = ufl.inner(fem.Constant(mesh, (0.0,) * (dim - 1) + (-1.0,)), v) * ds(2)
    end = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 2.0))
    bcs = [fem.dirichletbc(np.zeros(dim), end, V)]
    up = (0.0,) * (dim - 1) + (1.0,)
    pair = ContactPair(tags, 1, RigidPlane((0.0,) * (dim - 1) + (1.0,), up), Tresca(0.09))
    return Scene(None, V, a, L, bcs, pair, None), [pair]


def alone(scene: Scene) -> tuple[Scene, list[ContactPair]]:
    """Return a scene with its own pair."""
    return scene, [scene.pair]


SCENES: dict[str, Callable[[int], tuple[Scene, list[ContactPair]]]] = {
    "friction, mortar": lambda N: alone(bricks(N, pairing="mortar")),
    "friction, matching nodes": lambda N: alone(bricks(N)),
    "frictionless": lambda N: alone(bricks(N, friction=Frictionless())),
    "bonded": lambda N: alone(bricks(N, friction=Bonded())),
    "friction, and a frictionless plane": mixed,
    "friction, one body on a rigid plane": lambda N: one_body(N, 3),
    "the same in 2D": lambda N: one_body(N, 2),
}


def measure(name: str, N: int) -> dict[str, Any]:
    """Solve a scene twice and count."""
    scene, pairs = SCENES[name](N)
    factored: list[int] = []
    original = StiffnessSolver.__init__

    def counting(self: StiffnessSolver, kind: str, K: Any, *rest: Any, **options: Any) -> None:
        factored.append(K.getSize()[0])
        original(self, kind, K, *rest, **options)

    StiffnessSolver.__init__ = counting  # type: ignore[method-assign]
    gc.collect()
    reset_peak_memory()
    with ContactProblem(scene.a, scene.L, pairs, bcs=scene.bcs, stiffness="cholesky") as problem:
        for _ in range(2):
            problem.solve().raise_if_failed()
        jump = problem._jump
        return {
            "dofs": problem._summary.dofs,
            "multipliers": len(jump.stress_scale),
            "entries": int(jump.matrix.getInfo()["nz_used"]),
            "factored": factored,
            "mb": peak_memory(MPI.COMM_WORLD),
        }


def measure_linear(name: str, N: int) -> dict[str, Any]:
    """Solve the linear problem of the same mesh."""
    scene, _ = SCENES[name](N)
    gc.collect()
    reset_peak_memory()
    linear(scene, "cholesky")
    return {"linear_mb": peak_memory(MPI.COMM_WORLD)}


def main() -> None:
    """Read the arguments; measure each scene in processes of its own, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=20, metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--one", nargs=2, metavar=("SCENE", "PART"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        name, part = arguments.one
        print(json.dumps((measure if part == "contact" else measure_linear)(name, arguments.size)))
        return
    print(
        f"{'scene':<36} {'dofs':>7} {'multipliers':>11} {'entries':>8} {'factored':<16} "
        f"{'MB':>5} {'linear MB':>9}"
    )
    rows = []
    for name in arguments.scenes:
        row: dict[str, Any] = {"scene": name, "N": arguments.size}
        for part in ("contact", "linear"):
            done = subprocess.run(
                [sys.executable, __file__, "--size", str(arguments.size), "--one", name, part],
                check=True,
                capture_output=True,
                text=True,
            )
            row.update(json.loads(done.stdout.splitlines()[-1]))
        rows.append(row)
        factored = ", ".join(str(size) for size in row["factored"])
        print(
            f"{name:<36} {row['dofs']:>7} {row['multipliers']:>11} {row['entries']:>8} "
            f"{factored:<16} {row['mb']:>5.0f} {row['linear_mb']:>9.0f}",
            flush=True,
        )
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
