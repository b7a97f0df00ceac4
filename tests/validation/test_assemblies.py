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

from dolfinx_tresca import ContactPair, ContactProblem, Coulomb, SolverOptions, contacts, read_gmsh
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


def bored(occ, body, *tools):
    """Cut copies of tools: in OpenCASCADE a cut shares its new faces with a tool that stays."""
    return occ.cut([(3, body)], occ.copy([(3, tool) for tool in tools]))[0]


def hinge(occ):
    pin = occ.addCylinder(0, 0, -1, 0, 0, 11, 3)
    for heights, spaces, side in (((0, 6), (3,), 1), ((3,), (0, 6), -1)):
        leaf = occ.addBox(min(0, 24 * side), -6, 0, 24, 4, 9)
        knuckles = [(3, occ.addCylinder(0, 0, z, 0, 0, 3, 6)) for z in heights]
        cut(occ, leaf, *(occ.addCylinder(0, 0, z, 0, 0, 3, 6.5) for z in spaces))
        bored(occ, occ.fuse([(3, leaf)], knuckles)[0][0][1], pin)


def clamp(occ):
    frame = cut(occ, occ.addBox(0, 0, 0, 40, 12, 50), occ.addBox(12, -1, 12, 40, 14, 26))
    bored(occ, frame, occ.addCylinder(28, 6, 22, 0, 0, 32, 4))
    occ.addBox(16, 0, 12, 24, 12, 10)


def flange(occ):
    for z in (0, 10):
        holes = [occ.addCylinder(x, 0, z, 0, 0, 10, 5) for x in (-18, 18)]
        cut(occ, occ.addCylinder(0, 0, z, 0, 0, 10, 30), *holes)
    for x in (-18, 18):
        shank, nut, head = (
            (3, occ.addCylinder(x, 0, z, 0, 0, height, radius))
            for z, height, radius in ((-5, 30, 4), (-5, 5, 8), (20, 5, 8))
        )
        occ.fuse([shank], [nut, head])


def snap_fit(occ):
    occ.fuse([(3, occ.addBox(0, 0, 0, 40, 4, 10))], [(3, occ.addBox(34, 4, 0, 6, 3, 10))])
    occ.addBox(20, 4.05, -3, 14, 10, 16)


def pin_with_clearance(occ):
    cut(occ, occ.addBox(-10, -10, 0, 20, 20, 5), occ.addCylinder(0, 0, 0, 0, 0, 5, 5))
    occ.addCylinder(0, 0, -2, 0, 0, 9, 4.98)


def lattice(occ):
    for layer in range(5):
        for k in range(4):
            if layer % 2:
                occ.addBox(0, 12 * k, 4 * layer, 40, 4, 4)
            else:
                occ.addBox(12 * k, 0, 4 * layer, 4, 40, 4)


def between(low: float, high: float, face: tuple[Where, Any]) -> tuple[Where, Any]:
    """The part of a face between two heights."""
    return lambda p: face[0](p) & (p[2] > low - 1e-6) & (p[2] < high + 1e-6), face[1]


def level(z: float) -> tuple[Where, None]:
    return plane(0, 0, 1, z)


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
        (0.01, 0.01),
        0.5,
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
    "hinge": Assembly(
        hinge,
        {
            **{1: (0, cylinder(3)), 2: (1, between(0, 3, cylinder(3)))},
            **{3: (1, between(6, 9, cylinder(3))), 4: (2, cylinder(3))},
            **{5: (1, level(3)), 6: (1, level(6)), 7: (2, level(3)), 8: (2, level(6))},
        },
        [(1, 2), (1, 3), (1, 4), (5, 7), (6, 8)],
        lambda p: p[0] < -23.9,
        lambda p: p[0] > 23.9,
        (0.0, 0.02, 0.0),
        9,
    ),
    "clamp": Assembly(
        clamp,
        {
            **{1: (0, cylinder(4, 28, 6)), 2: (1, cylinder(4, 28, 6)), 3: (1, level(22))},
            **{4: (2, level(22)), 5: (2, level(12)), 6: (0, level(12))},
        },
        [(1, 2), (3, 4), (5, 6)],
        lambda p: p[0] < 0.1,
        lambda p: p[2] > 53.9,
        (0.0, 0.0, -0.02),
        9,
    ),
    "flange": Assembly(
        flange,
        {
            **{1: (0, level(0)), 2: (0, level(10)), 3: (1, level(10)), 4: (1, level(20))},
            **{5: (2, level(0)), 6: (2, level(20)), 7: (3, level(0)), 8: (3, level(20))},
        },
        [(2, 3), (1, 5), (1, 7), (4, 6), (4, 8)],
        lambda p: (np.hypot(p[0], p[1]) > 29.9) & (p[2] < 0.1),
        lambda p: (np.hypot(p[0], p[1]) > 29.9) & (p[2] > 19.9),
        (0.0, 0.0, 0.02),
        12,
    ),
    "snap-fit": Assembly(
        snap_fit,
        {
            **{1: (0, plane(1, 0, 0, 34)), 2: (1, plane(1, 0, 0, 34))},
            **{3: (0, plane(0, 1, 0, 4)), 4: (1, plane(0, 1, 0, 4.05))},
        },
        [(1, 2), (3, 4)],
        lambda p: p[0] < 0.1,
        lambda p: p[1] > 14.0,
        (0.05, 0.0, 0.0),
        5,
    ),
    "pin with clearance": Assembly(
        pin_with_clearance,
        {1: (0, cylinder(5)), 2: (1, cylinder(4.98))},
        [(1, 2)],
        lambda p: abs(p[0]) > 9.9,
        lambda p: abs(p[2] - 2.5) > 4.4,
        (0.03, 0.0, 0.0),
        6,
    ),
    "lattice of 20 parts": Assembly(
        lattice,
        {
            **{1 + bar: (bar, level(4 * (bar // 4))) for bar in range(20)},
            **{21 + bar: (bar, level(4 + 4 * (bar // 4))) for bar in range(20)},
        },
        [(21 + 4 * n + i, 5 + 4 * n + k) for n in range(4) for i in range(4) for k in range(4)],
        lambda p: p[2] < 0.1,
        lambda p: p[2] > 19.9,
        (0.0, 0.0, -0.01),
        12,
    ),
}


#: They take 5 to 40 seconds of processor time, or are much like others.
SLOW = ("hinge", "clamp", "flange", "snap-fit", "pin with clearance", "lattice of 20 parts")


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
    problem = ContactProblem(a, None, pairs, bcs, options=SolverOptions(rtol=1e-9))
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
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.long] * (name in SLOW)) for name in ASSEMBLIES]
)
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
