"""Assemblies from CAD files to forces without a tag typed, against pairs with tags by hand."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    Coulomb,
    SolverOptions,
    contacts,
    read_gmsh,
)
from scenes.elasticity import elasticity

gmsh = pytest.importorskip("gmsh")

Where = Callable[[np.ndarray], np.ndarray]

FRICTION = Coulomb(0.2)


def cylinder(radius: float, x: float = 0.0, y: float = 0.0) -> tuple[Where, Any]:
    """Where points (3, n) are on a cylinder along z, and the projection onto it."""
    middle = np.array([x, y, 0.0])[:, None]

    def project(points):
        away = points - middle
        away[:2] *= radius / np.hypot(away[0], away[1])
        return middle + away

    return lambda p: abs(np.hypot(p[0] - x, p[1] - y) - radius) < 1e-6, project


def sphere(radius: float, z: float) -> tuple[Where, Any]:
    middle = np.array([0.0, 0.0, z])[:, None]

    def project(points):
        away = points - middle
        return middle + away * radius / np.linalg.norm(away, axis=0)

    return lambda p: abs(np.linalg.norm(p - middle, axis=0) - radius) < 1e-6, project


def plane(*normal_and_height: float) -> tuple[Where, None]:
    *normal, height = normal_and_height
    return lambda p: abs(np.tensordot(normal, p, 1) - height) < 1e-6, None


@dataclass(frozen=True)
class Assembly:
    """Shapes of an assembly, what is by hand in its contacts, and how it is loaded.

    `shapes` makes the bodies with OpenCASCADE. `faces` has for each number the body's position in
    the file and where its nodes are. `held` and `pushed` are
    where nodes are fixed, and are moved by `move`.
    """

    shapes: Callable[[Any], None]
    faces: dict[int, tuple[int, tuple[Where, Any]]]
    pairs: list[tuple[int, int]]
    held: Where
    pushed: Where
    move: tuple[float, ...]
    size: Any = None


def cut(occ, body, *tools):
    occ.cut([(3, body)], [(3, tool) for tool in tools])
    return body


def press_fit(occ):
    cut(occ, occ.addCylinder(0, 0, 0, 0, 0, 16, 18), occ.addCylinder(0, 0, 0, 0, 0, 16, 10))
    occ.addCylinder(0, 0, -5, 0, 0, 26, 10.02)


def hub_and_key(occ):
    cut(occ, occ.addCylinder(0, 0, -4, 0, 0, 20, 10), occ.addBox(-2, 6, -5, 4, 10, 30))
    hub = cut(occ, occ.addCylinder(0, 0, 0, 0, 0, 12, 20), occ.addCylinder(0, 0, 0, 0, 0, 12, 10.1))
    cut(occ, hub, occ.addBox(-2, 0, -1, 4, 13, 30))
    occ.addBox(-2, 6, 0, 4, 6.5, 12)


def ball_in_groove(occ):
    block = occ.addBox(-10, -6, -12, 20, 12, 12)
    wedge = occ.addBox(0, -6, 0, 20, 12, 20)
    occ.rotate([(3, wedge)], 0, 0, 0, 0, 1, 0, -np.pi / 4)
    occ.translate([(3, wedge)], 0, 0, -8)
    cut(occ, block, wedge)
    ball = occ.addSphere(0, 0, 4 * np.sqrt(2) - 8, 4)
    box = occ.addBox(-5, -5, -10, 10, 10, 10 + 4 * np.sqrt(2) - 6)
    occ.intersect([(3, ball)], [(3, box)])


def bearing(occ):
    occ.addDisk(0, 0, 0, 6, 6)
    for k in range(4):
        angle = 0.5 * np.pi * k
        occ.addDisk(8 * np.cos(angle), 8 * np.sin(angle), 0, 2, 2)
    occ.cut([(2, occ.addDisk(0, 0, 0, 14, 14))], [(2, occ.addDisk(0, 0, 0, 10, 10))])


ROOT2 = np.sqrt(0.5)
ROLLERS = [(8 * np.cos(0.5 * np.pi * k), 8 * np.sin(0.5 * np.pi * k)) for k in range(4)]
ASSEMBLIES = {
    "press fit": Assembly(
        press_fit,
        {1: (0, cylinder(10)), 2: (1, cylinder(10.02))},
        [(1, 2)],
        lambda p: np.hypot(p[0], p[1]) > 17.9,
        lambda p: p[2] > 20.9,
        (0.0, 0.0, 0.001),
        9,
    ),
    "hub and key": Assembly(
        hub_and_key,
        {
            **{1: (0, plane(1, 0, 0, -2)), 2: (0, plane(1, 0, 0, 2)), 3: (0, plane(0, 1, 0, 6))},
            **{4: (1, plane(1, 0, 0, -2)), 5: (1, plane(1, 0, 0, 2)), 9: (1, cylinder(10.1))},
            **{6: (2, plane(1, 0, 0, -2)), 7: (2, plane(1, 0, 0, 2)), 8: (2, plane(0, 1, 0, 6))},
            10: (0, cylinder(10)),
        },
        [(1, 6), (2, 7), (3, 8), (9, 10), (4, 6), (5, 7)],
        lambda p: np.hypot(p[0], p[1]) > 19.9,
        lambda p: p[2] < -3.9,
        (0.02, 0.0, 0.0),
        9,
    ),
    "bearing": Assembly(
        bearing,
        {
            **{1: (0, cylinder(6)), 6: (5, cylinder(10))},
            **{2 + k: (1 + k, cylinder(2, *at)) for k, at in enumerate(ROLLERS)},
        },
        [(1, 2), (1, 3), (1, 4), (1, 5), (2, 6), (3, 6), (4, 6), (5, 6)],
        lambda p: np.hypot(p[0], p[1]) > 13.9,
        lambda p: np.hypot(p[0], p[1]) < 3,
        (0.01, 0.0),
        1.0,
    ),
    "ball in a groove": Assembly(
        ball_in_groove,
        {
            1: (0, plane(ROOT2, 0, -ROOT2, 8 * ROOT2)),
            2: (0, plane(-ROOT2, 0, -ROOT2, 8 * ROOT2)),
            3: (1, sphere(4, 4 * np.sqrt(2) - 8)),
        },
        [(3, 1), (3, 2)],
        lambda p: p[2] < -11.9,
        lambda p: p[2] > 4 * np.sqrt(2) - 6.01,
        (0.0, 0.0, -0.02),
        {"body 1": 5, "body 2": 3},
    ),
}


def write(shapes, path):
    """Write bodies as a CAD file, on one rank."""
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        shapes(gmsh.model.occ)
        gmsh.model.occ.synchronize()
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def read(comm, folder, shapes, **options):
    path = comm.bcast(folder / "assembly.brep", root=0)
    if comm.rank == 0:
        write(shapes, path)
    comm.barrier()
    return read_gmsh(path, comm, **options)


def solve(tagged, pairs, assembly):
    """The solution of the assembly with pairs."""
    dim = tagged.mesh.geometry.dim
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (dim,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = elasticity(V, 2e5) + 1e-3 * ufl.inner(u, v) * ufl.dx
    bcs = [
        fem.dirichletbc(np.array(value), fem.locate_dofs_geometrical(V, where), V)
        for where, value in ((assembly.held, (0.0,) * dim), (assembly.pushed, assembly.move))
    ]
    problem = ContactProblem(a, None, pairs, bcs, options=SolverOptions(rtol=1e-11))
    return problem, problem.solve()


def tags_by_hand(tagged, assembly):
    """Plain tags of facets whose nodes are at the places of the assembly's faces, per body."""
    mesh = tagged.mesh
    dim = mesh.topology.dim - 1
    mesh.topology.create_connectivity(dim, dim + 1)
    to_cell = mesh.topology.connectivity(dim, dim + 1)
    of_cell = np.zeros(tagged.cell_tags.indices.max() + 1, dtype=np.int32)
    of_cell[tagged.cell_tags.indices] = tagged.cell_tags.values
    found, values = [], []
    for number, (body, (where, _)) in assembly.faces.items():
        facets = dolfinx.mesh.locate_entities_boundary(mesh, dim, where)
        own = [f for f in facets if of_cell[to_cell.links(f)[0]] == body + 1]
        found += own
        values += [number] * len(own)
    order = np.argsort(found, kind="stable")
    return dolfinx.mesh.meshtags(
        mesh, dim, np.array(found, np.int32)[order], np.array(values, np.int32)[order]
    )


@pytest.mark.parallel(name=["press fit", "ball in a groove"])
@pytest.mark.parametrize("name", ASSEMBLIES)
def test_forces_are_those_of_tags_by_hand(comm, tmp_path, name):
    assembly = ASSEMBLIES[name]
    tagged = read(comm, tmp_path, assembly.shapes, size=assembly.size)
    found = contacts(tagged, friction=FRICTION, distance=0.3)
    tags = tags_by_hand(tagged, assembly)
    secondary = {tuple(re.findall(r"body (\d+)", str(pair))) for pair in found}
    ordered = [
        both if tuple(str(1 + assembly.faces[k][0]) for k in both) in secondary else both[::-1]
        for both in assembly.pairs
    ]
    geometry = {k: project for k, (_, (_, project)) in assembly.faces.items() if project}
    by_hand = [ContactPair(tags, *both, FRICTION, geometry=geometry) for both in ordered]
    (_, solution), (_, wanted) = (solve(tagged, pairs, assembly) for pairs in (found, by_hand))
    solution.raise_if_failed()
    forces = np.array([one.normal_force for one in (solution, wanted)])
    assert forces[1] > 1.0
    assert abs(forces[0] - forces[1]) <= 1e-8 * forces[1]
