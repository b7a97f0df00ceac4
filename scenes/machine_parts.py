"""Machine parts for which statics or a formula gives the right answer; mm, N, MPa.

The `data.move(load)` of each scene sets its next load step. Scenes in a plane have strain in it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import (
    ContactPair,
    Coulomb,
    Frictionless,
    NonlinearContactProblem,
    Preload,
    RigidCylinder,
    RigidPlane,
    TaggedMesh,
    contacts,
    read_gmsh,
)
from dolfinx_tresca.scene.pair import Sliding
from scenes.elasticity import by_body, elasticity, fixed, no_load
from scenes.pressures import mixed_space
from scenes.reported import Process, facets_at, tagged
from scenes.revolution import ring_elasticity
from scenes.scene import Scene

#: Young's modulus of steel [MPa], and Poisson's ratio of all parts.
STEEL, POISSON = 2.1e5, 0.3


@contextmanager
def gmsh_model(**options: float) -> Iterator[Any]:
    """Open Gmsh with an empty model; `options` are options of its meshes."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    for name, value in options.items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
    try:
        yield gmsh.model
    finally:
        gmsh.finalize()


def polygons(
    comm: MPI.Comm,
    outlines: Mapping[str, Sequence[Sequence[float]]],
    edges: Mapping[str, Sequence[int]],
    size: float,
) -> TaggedMesh:
    """Return a mesh of triangles of bodies in a plane. Collective.

    Args:
        comm: communicator of the mesh.
        outlines: name of a body -> its corners, anticlockwise.
        edges: name of a surface -> numbers of its edges, counted through all bodies.
        size: size of the cells.
    """
    with gmsh_model() as model:
        lines = []
        for name, corners in outlines.items():
            ids = [model.geo.addPoint(x, y, 0.0, size) for x, y in corners]
            outline = [model.geo.addLine(*ends) for ends in pairwise([*ids, ids[0]])]
            body = model.geo.addPlaneSurface([model.geo.addCurveLoop(outline)])
            model.geo.synchronize()
            model.addPhysicalGroup(2, [body], name=name)
            lines += outline
        for name, numbers in edges.items():
            model.addPhysicalGroup(1, [lines[number] for number in numbers], name=name)
        model.mesh.generate(2)
        return read_gmsh(model, comm)


#: Radius of the drum, thickness of the belt, its angle of wrap [rad], and friction.
DRUM, BELT, WRAP, WRAPPED = 10.0, 0.2, np.radians(120.0), 0.3


def belt(comm: MPI.Comm, cells: int, sliding: Sliding = "small") -> Scene:
    """Return a belt round a drum; its ends are pulled by 1 MPa and by a displacement. Collective.

    Args:
        comm: communicator of the mesh.
        cells: cells along the belt.
        sliding: that of the pair.
    """
    corners = [(np.pi / 2.0, DRUM), (np.pi / 2.0 + WRAP, DRUM + BELT)]
    domain = mesh.create_rectangle(comm, corners, (cells, 2), mesh.CellType.quadrilateral)
    tags = tagged(domain, {1: (1, DRUM), 2: (0, corners[0][0]), 3: (0, corners[1][0])})
    angle, radius = domain.geometry.x[:, :2].T.copy()
    domain.geometry.x[:, :2] = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    pull, end = fem.Constant(domain, 0.0), np.pi / 2.0 + WRAP
    ds = ufl.Measure("ds", domain, subdomain_data=tags)
    along = ufl.as_vector([-np.sin(end), np.cos(end)])
    L = fem.Constant(domain, 1.0) * ufl.inner(along, ufl.TestFunction(V)) * ds(3)
    drum = RigidCylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), DRUM)
    pair = ContactPair(tags, 1, drum, Coulomb(WRAPPED), sliding=sliding)
    data = SimpleNamespace(young=1e3, move=setter(pull))
    held = [fixed(V, tags.find(2), pull, component=0)]
    return Scene(V, elasticity(V, data.young, POISSON), L, held, [pair], tags, data=data)


def setter(constant: fem.Constant) -> Callable[[float], None]:
    """Return a function that sets the value of a constant."""

    def move(value: float) -> None:
        constant.value = value

    return move


#: Length and height of the beam over a former, radius of the former, Young's modulus.
BEAM, DEPTH, FORMER, SOFT = 100.0, 1.0, 2000.0, 1e3


def beam_on_former(comm: MPI.Comm, cells: int) -> Scene:
    """Return a cantilever without friction on a round former; the load is at its end. Collective.

    A load of 1 gives the clamped end the curvature of the former, which touches from there on.
    """
    corners = [(0.0, 0.0), (BEAM, DEPTH)]
    domain = mesh.create_rectangle(comm, corners, (cells, 2), mesh.CellType.quadrilateral)
    tags = tagged(domain, {1: (1, 0.0), 2: (0, 0.0), 3: (0, BEAM)})
    V = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    load, ds = fem.Constant(domain, 0.0), ufl.Measure("ds", domain, subdomain_data=tags)
    # bending stiffness over radius, length and height
    unit = SOFT / (1.0 - POISSON**2) * DEPTH**2 / 12.0 / FORMER / BEAM
    former = RigidCylinder((0.0, -FORMER, 0.0), (0.0, 0.0, 1.0), FORMER)
    return Scene(
        V,
        elasticity(V, SOFT, POISSON),
        -unit * load * ufl.TestFunction(V)[1] * ds(3),
        [fixed(V, tags.find(2))],
        [ContactPair(tags, 1, former, Frictionless())],
        tags,
        data=SimpleNamespace(move=setter(load)),
    )


#: Half the angle of the cone, and its friction; it would slide off beyond an angle of 8.5 degrees.
CONE, ON_CONE = np.radians(3.0), 0.15


def taper(comm: MPI.Comm, size: float) -> Scene:
    """Return a hub on a conical shaft, axisymmetric; its lower face moves along the axis."""

    def radius(z: float) -> float:
        return float(10.0 - np.tan(CONE) * z)

    parts = polygons(
        comm,
        {
            "shaft": [(2.0, -5.0), (radius(-5.0), -5.0), (radius(35.0), 35.0), (2.0, 35.0)],
            "hub": [(radius(0.0), 0.0), (20.0, 0.0), (20.0, 30.0), (radius(30.0), 30.0)],
        },
        {"foot": [0], "cone": [1], "hub's foot": [4], "bore": [7]},
        size,
    )
    V = fem.functionspace(parts.mesh, ("Lagrange", 2, (2,)))
    facets, tags, push = parts.facet_tags, parts.tags, fem.Constant(parts.mesh, 0.0)
    pair = ContactPair(facets, tags["bore"], tags["cone"], Coulomb(ON_CONE))
    held = [
        fixed(V, facets.find(tags["foot"]), component=1),
        fixed(V, facets.find(tags["hub's foot"]), push, component=1),
    ]
    data = SimpleNamespace(move=setter(push))
    a = ring_elasticity(V, STEEL, POISSON)
    return Scene(V, a, no_load(V), held, [pair], facets, tags=tags, data=data)


#: Half the width of the root's neck; friction on its flank, whose angle is 45 degrees.
ROOT, ON_FLANK = 4.0, 0.3


def dovetail(comm: MPI.Comm, size: float, exchanged: bool = False) -> Scene:
    """Return half of a blade's root in its slot, pulled out by a traction [MPa]. Collective.

    Args:
        comm: communicator of the mesh.
        size: size of the cells.
        exchanged: whether the slot is the secondary side.
    """
    root = [(0.0, 0.0), (10.0, 0.0), (10.0, 4.0), (ROOT, 10.0), (ROOT, 25.0), (0.0, 25.0)]
    disc = [(10.5, -5.0), (30.0, -5.0), (30.0, 12.0), (4.3, 12.0), (4.3, 9.7), (10.5, 3.5)]
    parts = polygons(
        comm,
        {"blade": root, "disc": disc},
        {"root": range(4), "top": [4], "axis": [5], "slot": [6, 8, 9, 10, 11], "outer": [7]},
        size,
    )
    V = fem.functionspace(parts.mesh, ("Lagrange", 1, (2,)))
    facets, tags, pull = parts.facet_tags, parts.tags, fem.Constant(parts.mesh, 0.0)
    ds = ufl.Measure("ds", parts.mesh, subdomain_data=facets)
    pair = ContactPair(facets, tags["root"], tags["slot"], Coulomb(ON_FLANK))
    if exchanged:
        pair = replace(pair, secondary=pair.primary, primary=pair.secondary)
    return Scene(
        V,
        elasticity(V, STEEL, POISSON),
        pull * ufl.TestFunction(V)[1] * ds(tags["top"]),
        [
            fixed(V, facets.find(tags["axis"]), component=0),
            fixed(V, facets.find(tags["outer"])),
        ],
        [pair],
        facets,
        tags=tags,
        data=SimpleNamespace(move=setter(pull)),
    )


#: Radius and Young's modulus of the crossed cylinders.
CROSSED, SOFT_CYLINDER = 10.0, 1e4


def crossed_cylinders(comm: MPI.Comm, size: float) -> Scene:
    """Return two equal cylinders, crossed at a right angle, moved to each other. Collective."""
    with gmsh_model(MeshSizeExtendFromBoundary=0) as model:
        occ = model.occ
        for sign in (-1.0, 1.0):
            cylinder = occ.addCylinder(-4.0, 0.0, sign * CROSSED, 8.0, 0.0, 0.0, CROSSED)
            if sign > 0.0:
                occ.rotate([(3, cylinder)], 0.0, 0.0, CROSSED, 0.0, 0.0, 1.0, np.pi / 2.0)
            cap = occ.addBox(-20.0, -20.0, min(4.0 * sign, -1e-4 * sign), 40.0, 40.0, 4.0001)
            occ.intersect([(3, cylinder)], [(3, cap)])
        occ.synchronize()
        field = model.mesh.field
        near = field.add("Ball")
        values = {"Radius": 1.4, "Thickness": 6.0, "VIn": size, "VOut": 2.0}
        for name, value in values.items():
            field.setNumber(near, name, value)
        field.setAsBackgroundMesh(near)
        bodies = read_gmsh(model, comm)
    V = fem.functionspace(bodies.mesh, ("Lagrange", 1, (3,)))
    approach = fem.Constant(bodies.mesh, np.zeros(3))

    def move(distance: float) -> None:
        approach.value[2] = -distance

    held = [
        fixed(V, facets_at(bodies.mesh, 2, -4.0)),
        fixed(V, facets_at(bodies.mesh, 2, 4.0), approach),
    ]
    pairs = contacts(bodies, friction=Frictionless(), distance=0.2)
    a = elasticity(V, SOFT_CYLINDER, POISSON)
    data = SimpleNamespace(move=move)
    return Scene(V, a, no_load(V), held, pairs, bodies.facet_tags, data=data)


def cube_on_table(comm: MPI.Comm, cells: int, friction: float) -> Scene:
    """Return a free cube that lies on a table and is pushed along it, by volume forces. Collective.

    The load is the push divided by the weight.
    """
    domain = mesh.create_box(comm, [(-0.5, -0.5, 0.0), (0.5, 0.5, 1.0)], (cells,) * 3)
    tags = tagged(domain, {1: (2, 0.0)})
    V = fem.functionspace(domain, ("Lagrange", 1, (3,)))
    force = fem.Constant(domain, np.array([0.0, 0.0, -1.0]))

    def move(push: float) -> None:
        force.value[0] = push

    table = RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    pair = ContactPair(tags, 1, table, Coulomb(friction))
    L = ufl.inner(force, ufl.TestFunction(V)) * ufl.dx
    data = SimpleNamespace(move=move)
    return Scene(V, elasticity(V, 1e5, POISSON), L, [], [pair], tags, data=data)


#: Weight of a unit of area of the blocks, pressure on the top block, and friction.
BLOCK_WEIGHT, ON_TOP, ON_JOINT = 0.01, 1.0, 0.2


def triple_junction(comm: MPI.Comm, size: float) -> Scene:
    """Return a block on two blocks side by side on a base, whole outlines as one pair. Collective.

    The load is the shear traction on the top block, which lies over the joint of the two.
    """
    boxes = [(-2.0, -1.0, 2.0, 0.0), (-1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)]
    boxes.append((-1.0, 1.0, 1.0, 2.0))
    blocks = polygons(
        comm,
        {
            f"block {number}": [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
            for number, (x0, y0, x1, y1) in enumerate(boxes)
        },
        {"base": [0], "outlines": [*range(1, 14), 15], "top": [14]},
        size,
    )
    V = fem.functionspace(blocks.mesh, ("Lagrange", 1, (2,)))
    facets, tags, v = blocks.facet_tags, blocks.tags, ufl.TestFunction(V)
    ds = ufl.Measure("ds", blocks.mesh, subdomain_data=facets)
    shear = fem.Constant(blocks.mesh, 0.0)
    outlines = [tags["outlines"], tags["top"]]
    return Scene(
        V,
        elasticity(V, 1e4, POISSON),
        (shear * v[0] - ON_TOP * v[1]) * ds(tags["top"]) - BLOCK_WEIGHT * v[1] * ufl.dx,
        [fixed(V, facets.find(tags["base"]))],
        [ContactPair(facets, outlines, outlines, Coulomb(ON_JOINT))],
        facets,
        tags=tags,
        data=SimpleNamespace(move=setter(shear)),
    )


def wavy_plank(comm: MPI.Comm, size: float, exchanged: bool = False) -> Scene:
    """Return a stiff block with a round face that passes along a soft wavy plank. Collective.

    Args:
        comm: communicator of the mesh.
        size: size of the cells.
        exchanged: whether the plank is the secondary side.
    """
    x = np.linspace(0.0, 10.0, round(10.0 / size) + 1)[::-1]
    angle = np.linspace(np.pi, 2.0 * np.pi, round(0.8 * np.pi / size) + 1)
    wave = [(0.0, -2.0), (10.0, -2.0), *np.column_stack([x, 0.25 * np.sin(0.4 * np.pi * x)])]
    arc = np.column_stack([2.0 + 0.8 * np.cos(angle), 1.5 + 0.8 * np.sin(angle)])
    start, number = len(wave), len(arc)
    parts = polygons(
        comm,
        {"plank": wave, "block": [*arc, (2.8, 2.3), (1.2, 2.3)]},
        {
            "floor": [0],
            "wave": range(2, start - 1),
            "round": range(start, start + number - 1),
            "grip": [start + number],
        },
        size,
    )
    V = fem.functionspace(parts.mesh, ("Lagrange", 1, (2,)))
    facets, tags, place = parts.facet_tags, parts.tags, fem.Constant(parts.mesh, np.zeros(2))

    def move(time: float) -> None:
        place.value[:] = 0.2 * time, -0.55 + 0.1 * np.sin(0.5 * time)

    pair = ContactPair(facets, tags["round"], tags["wave"], Coulomb(0.4), sliding="finite")
    if exchanged:
        pair = replace(pair, secondary=pair.primary, primary=pair.secondary)
    held = [fixed(V, facets.find(tags["floor"])), fixed(V, facets.find(tags["grip"]), place)]
    a = elasticity(V, by_body(parts, {"plank": 1e3, "block": 1e5}), POISSON)
    data = SimpleNamespace(move=move)
    return Scene(V, a, no_load(V), held, [pair], facets, tags=tags, data=data)


#: Diameter of the rubber cord, and its Young's modulus.
CORD, RUBBER = 10.0, 3.0


def cord(comm: MPI.Comm, size: float, friction: float) -> Process:
    """Return a quarter of an incompressible rubber cord between two plates, in plane strain.

    The place of the process is the part of the cord's diameter by which the plates approach each
    other. The form has displacement and pressure. Collective.
    """
    angle = np.linspace(0.0, np.pi / 2.0, round(CORD / 4.0 * np.pi / size) + 1)
    arc = CORD / 2.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    number = len(arc)
    quarter = polygons(
        comm,
        {"cord": [*arc, (0.0, 0.0)]},
        {"round": range(number - 1), "left": [number - 1], "lower": [number]},
        size,
    )
    domain, facets, tags = quarter.mesh, quarter.facet_tags, quarter.tags
    W = mixed_space(domain, ("Lagrange", 1))
    w = fem.Function(W)
    u, p = ufl.split(w)
    F = ufl.Identity(2) + ufl.grad(u)
    energy = RUBBER / 6.0 * (ufl.inner(F, F) - 2.0 - 2.0 * ufl.ln(ufl.det(F)))
    energy -= p * (ufl.det(F) - 1.0)
    held = []
    for axis, side in enumerate(("left", "lower")):
        space, _ = W.sub(0).sub(axis).collapse()
        dofs = fem.locate_dofs_topological((W.sub(0).sub(axis), space), 1, facets.find(tags[side]))
        held.append(fem.dirichletbc(fem.Function(space), dofs, W.sub(0).sub(axis)))
    plate = RigidPlane((0.0, CORD / 2.0), (0.0, -1.0))
    law = Coulomb(friction) if friction else Frictionless()
    problem = NonlinearContactProblem(
        ufl.derivative(energy * ufl.dx, w, ufl.TestFunction(W)),
        w,
        [ContactPair(facets, tags["round"], plate, law, sliding="finite")],
        held,
    )
    return Process(problem, lambda part: plate.move_to((0.0, -part * CORD / 2.0)))


#: Preload of the bolt, clearance of its hole on each side, and friction of the lap joint.
PRELOAD, CLEARANCE, JOINT = 20e3, 0.5, 0.2


def lap_joint(comm: MPI.Comm, size: float) -> Scene:
    """Return two plates that a bolt in holes with clearance presses together; one is pulled.

    The bolt is cut, and its faces are pulled together. The load is the displacement of the end of a
    plate. Collective.
    """
    with gmsh_model() as model:
        occ = model.occ
        for x, z in ((-20.0, 0.0), (-40.0, 6.0)):
            hole = occ.addCylinder(0.0, 0.0, z, 0.0, 0.0, 6.0, 5.0 + CLEARANCE)
            occ.cut([(3, occ.addBox(x, -15.0, z, 60.0, 30.0, 6.0))], [(3, hole)])
        shank, head, nut = (
            occ.addCylinder(0.0, 0.0, z, 0.0, 0.0, height, radius)
            for z, height, radius in ((0.0, 12.0, 5.0), (12.0, 6.0, 9.0), (-6.0, 6.0, 9.0))
        )
        (bolt, *_), _ = occ.fuse([(3, shank)], [(3, head), (3, nut)])
        below, above = (occ.addBox(-50.0, -50.0, z, 100.0, 100.0, 100.0) for z in (-92.0, 8.0))
        occ.intersect([bolt], [(3, below)], removeObject=False)
        occ.intersect([bolt], [(3, above)])
        occ.synchronize()
        parts = read_gmsh(model, comm, size=size)
    pairs = [
        replace(pair, friction=Preload(PRELOAD), name="bolt")
        if {pair.side("secondary")[:6], pair.side("primary")[:6]} == {"body 3", "body 4"}
        else pair
        for pair in contacts(parts, friction=Coulomb(JOINT), distance=0.8)
    ]
    V = fem.functionspace(parts.mesh, ("Lagrange", 1, (3,)))
    pull = fem.Constant(parts.mesh, np.zeros(3))

    def move(distance: float) -> None:
        pull.value[0] = -distance

    held = [
        fixed(V, facets_at(parts.mesh, 0, 40.0)),
        fixed(V, facets_at(parts.mesh, 0, -40.0), pull),
    ]
    a = elasticity(V, STEEL, POISSON)
    data = SimpleNamespace(move=move)
    return Scene(V, a, no_load(V), held, pairs, parts.facet_tags, data=data)
