"""Costs of scenes with less than full friction: unknowns, entries, factorisations and memory.

    tools/fenicsx python3 benchmarks/required.py --size 20 --json FILE

Two equal bricks under a load, with N cells along each, and simpler variants of this scene. Columns:
degrees of freedom; multipliers; entries of N and T; number of matrices that two solves factor (K,
and for the bound of the error a matrix of the size of the multipliers); peak memory [MB] of the
process (VmHWM, including Python and the mesh); and peak memory of a process that solves the linear
problem on the same mesh.
"""

from __future__ import annotations

import argparse
import gc
import itertools
from collections.abc import Callable, Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
from cost import linear
from harness import Benchmark, Column, Comm, Row, Table
from harness.factorisations import Factorisations
from harness.memory import peak_memory, reset_peak_memory

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
from scenes.scene import Scene
from scenes.two_bricks import two_bricks


def bricks(N: int, **changes: Any) -> Scene:
    """Return the two bricks; `changes` are arguments of their contact pair."""
    return two_bricks(MPI.COMM_WORLD, N, end="free_end_2").but(**changes)


def mixed(N: int) -> tuple[Scene, list[ContactPair]]:
    """Return the bricks with friction, and a frictionless plane at the lower one's free end."""
    scene = bricks(N)
    tag = scene.tags["lower_free_end"]
    plane = RigidPlane((2.1, 0.0, 0.0), (-1.0, 0.0, 0.0))
    wall = ContactPair(scene.facet_tags, tag, plane, Frictionless())
    return scene, [scene.pair, wall]


def one_body(N: int, dim: int) -> tuple[Scene, list[ContactPair]]:
    """Return one brick of the same size, or its section in 2D, with friction on a rigid plane."""
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
    return Scene(V, a, L, bcs, [pair], tags), [pair]


def alone(scene: Scene) -> tuple[Scene, list[ContactPair]]:
    """Return a scene and the list of its only pair."""
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


def cases(arguments: argparse.Namespace) -> Iterator[Row]:
    """Yield the contact problem and the linear problem of each scene."""
    for scene, part in itertools.product(arguments.scenes, ("contact", "linear")):
        yield {"scene": scene, "N": arguments.size, "part": part}


def measure(comm: Comm, case: Row) -> Iterator[Row]:
    """Solve the contact problem twice, or the linear problem once; yield the costs."""
    scene, pairs = SCENES[case["scene"]](case["N"])
    gc.collect()
    reset_peak_memory()
    if case["part"] == "linear":
        linear(scene, "cholesky")
        yield {"linear_mb": peak_memory(comm)}
        return
    with (
        Factorisations() as factored,
        ContactProblem(scene.a, scene.L, pairs, bcs=scene.bcs, stiffness="cholesky") as problem,
    ):
        for _ in range(2):
            problem.solve().raise_if_failed()
        jump = problem._contact.surfaces.jump
        yield {
            "dofs": problem._contact.surfaces.summary.dofs,
            "multipliers": len(jump.stress_scale),
            "entries": int(jump.matrix.getInfo()["nz_used"]),
            "factored": factored.count,
            "mb": peak_memory(comm),
        }


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the cases."""
    parser.add_argument("--size", type=int, default=20, metavar="N")
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)


COLUMNS = [
    Column("scene", "{scene}", width=35),
    Column("dofs", "{dofs}", width=7),
    Column("multipliers", "{multipliers}"),
    Column("entries of N, T", "{entries}"),
    Column("factorisations", "{factored}"),
    Column("MB", "{mb:.0f}", width=5),
    Column("linear MB", "{linear_mb:.0f}"),
]

BENCHMARK = Benchmark(
    script=__file__,
    about=__doc__,
    key=("scene", "N"),
    cases=cases,
    measure=measure,
    options=options,
    shown=COLUMNS,
    tables=[Table("required", COLUMNS)],
)

if __name__ == "__main__":
    BENCHMARK.main()
