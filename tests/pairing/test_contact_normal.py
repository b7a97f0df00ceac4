"""The contact normal: of two sides the one whose normal turns less over its facets decides."""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI

import gmsh
import numpy as np
import pytest

from dolfinx import fem
from dolfinx.mesh import CellType, create_rectangle, locate_entities_boundary, meshtags

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    RigidSphere,
    contacts,
    read_gmsh,
)
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from scenes.elasticity import elasticity, fixed, no_load
from scenes.machine_parts import dovetail

GAP = 0.03

#: A block, chamfered at its right ends by `depth` at an angle, and a wall beside it.
CHAMFERED = """
SetFactory("OpenCASCADE");
DefineConstant[ angle = 45, h = 0.5 ];
depth = 0.3 * Tan(angle * Pi / 180);
Point(1) = {0, 0, 0, h}; Point(2) = {width - depth, 0, 0, h}; Point(3) = {width, 0.3, 0, h};
Point(4) = {width, height - 0.3, 0, h}; Point(5) = {width - depth, height, 0, h};
Point(6) = {0, height, 0, h}; inner = width + 0.03; outer = inner + thickness;
Point(7) = {inner, -below, 0, h}; Point(8) = {outer, -below, 0, h};
Point(9) = {outer, top, 0, h}; Point(10) = {inner, top, 0, h};
For i In {1:5}
  Line(i) = {i, i + 1};
EndFor
Line(6) = {6, 1}; Line(7) = {7, 8}; Line(8) = {8, 9}; Line(9) = {9, 10}; Line(10) = {10, 7};
Curve Loop(1) = {1:6}; Curve Loop(2) = {7:10};
Plane Surface(1) = {1}; Plane Surface(2) = {2};
"""

CHAMFER = f"""
width = 4.1; height = 10; thickness = 0.6; below = 2; top = 13;
{CHAMFERED}
Physical Surface("block") = {{1}}; Physical Surface("wall") = {{2}};
Physical Curve("side") = {{2, 3, 4}}; Physical Curve("axis") = {{6}};
Physical Curve("inner") = {{10}}; Physical Curve("outer") = {{8}};
"""

#: The same in space, one cell or two deep, so that nearly all facets are at the rim of a surface.
CHAMFERED_SLAB = f"""
width = 2; height = 3; thickness = 0.7; below = 1; top = 4;
{CHAMFERED}
block() = Extrude {{0, 0, 1}} {{ Surface{{1}}; }};
wall() = Extrude {{0, 0, 1}} {{ Surface{{2}}; }};
Physical Volume("block") = {{block(1)}}; Physical Volume("wall") = {{wall(1)}};
Physical Surface("side") = {{block({{3:5}})}}; Physical Surface("axis") = {{block(7)}};
Physical Surface("inner") = {{wall(5)}}; Physical Surface("outer") = {{wall(3)}};
"""

#: Half a ring round a disc with the same radius; the ring ends 4 degrees above the x-axis.
EXACT_FIT = """
R = 15; c = Cos(4 * Pi / 180); s = Sin(4 * Pi / 180);
Point(1) = {0, 0, 0};
Point(2) = {R, 0, 0}; Point(3) = {0, R, 0}; Point(4) = {-R, 0, 0}; Point(5) = {0, -R, 0};
For i In {1:4}
  Circle(i) = {1 + i, 1, i < 4 ? 2 + i : 2};
EndFor
Point(6) = {R * c, R * s, 0}; Point(7) = {0, R, 0}; Point(8) = {-R * c, R * s, 0};
Point(9) = {-(R + 5) * c, (R + 5) * s, 0}; Point(10) = {0, R + 5, 0};
Point(11) = {(R + 5) * c, (R + 5) * s, 0};
Circle(5) = {6, 1, 7}; Circle(6) = {7, 1, 8}; Line(7) = {8, 9};
Circle(8) = {9, 1, 10}; Circle(9) = {10, 1, 11}; Line(10) = {11, 6};
Curve Loop(1) = {1:4}; Curve Loop(2) = {5:10};
Plane Surface(1) = {1}; Plane Surface(2) = {2};
Physical Surface("disc") = {1}; Physical Surface("half ring") = {2};
Physical Curve("outside") = {1:4}; Physical Curve("inside") = {5, 6};
Mesh.MeshSizeMax = Pi * R / 15; Mesh.MeshSizeExtendFromBoundary = 0;
"""

#: A sleeve on a pole with a clearance of 0.05; its bore is chamfered at an angle.
SLEEVE = """
SetFactory("OpenCASCADE");
DefineConstant[ angle = 45 ];
Cylinder(1) = {0, 0, -4, 0, 0, 20, 10}; Cylinder(2) = {0, 0, 0, 0, 0, 12, 13};
Cylinder(3) = {0, 0, 0, 0, 0, 12, 10.05};
Cone(4) = {0, 0, 0, 0, 0, 1, 10.05 + Tan(angle * Pi / 180), 10.05};
BooleanDifference{ Volume{2}; Delete; }{ Volume{3, 4}; Delete; }
Physical Volume("pole") = {1}; Physical Volume("sleeve") = {2};
inside() = Surface In BoundingBox{-12, -12, -0.1, 12, 12, 12.1};
Physical Surface("inside") = {inside()}; Physical Surface("outside") = {1};
Mesh.MeshSizeMax = 4;
"""


def read(comm, folder, text, **parameters):
    path = folder / "scene.geo"
    if comm.rank == 0:
        path.write_text(text)
    comm.barrier()
    return read_gmsh(path, comm, **parameters)


@pytest.mark.parallel
@pytest.mark.parametrize("swapped", [False, True])
def test_a_plate_slips_under_a_head_at_the_rim_of_its_hole(comm, swapped):
    """The hole has clearance: where its rim is pressed, friction acts along all of the face."""
    occ = gmsh.model.occ
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    head, shank = occ.addCylinder(0, 0, -0.5, 0, 0, 0.5, 2), occ.addCylinder(0, 0, 0, 0, 0, 2, 1)
    occ.fuse([(3, head)], [(3, shank)])
    plate, hole = occ.addBox(-2, -2, 0, 4, 4, 0.8), occ.addCylinder(0, 0, 0, 0, 0, 0.8, 1.2)
    occ.cut([(3, plate)], [(3, hole)])
    occ.synchronize()
    tagged = read_gmsh(gmsh.model, comm, size=0.6)
    gmsh.finalize()
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (3,)))
    faces = (
        locate_entities_boundary(tagged.mesh, 2, lambda x, z=z: np.isclose(x[2], z))
        for z in (-0.5, 0.8)
    )
    bcs = [
        fixed(V, facets, value)
        for facets, value in zip(faces, (np.zeros(3), np.array([0.1, 0.0, -1e-3])), strict=True)
    ]
    pairs = contacts(tagged, friction=Coulomb(0.3), distance=0.3)
    if swapped:
        pairs = [replace(pair, secondary=pair.primary, primary=pair.secondary) for pair in pairs]
    with ContactProblem(elasticity(V, 1000.0), no_load(V), pairs, bcs=bcs) as problem:
        solution = problem.solve()
        solution.raise_if_failed()
        forces = np.abs(sum(pair.force for pair in solution.pair_resultants))
    assert forces[0] == pytest.approx(0.3 * forces[2], rel=5e-3)
    assert forces[0] > 1.0


@pytest.mark.parallel
@pytest.mark.parametrize("exchanged", [False, True])
def test_a_dovetail_slides_along_its_flank(comm, exchanged):
    """Both surfaces have kinks at the ends of the flank: its normal is that of the flat facets."""
    scene = dovetail(comm, 0.8, exchanged)
    scene.data.move(100.0)
    with scene.problem() as problem:
        solution = problem.solve(rtol=1e-10)
        solution.raise_if_failed()
        force = solution.pair_resultants[0].force
    force = -force if exchanged else force
    # the root slips up and outwards: N (cos 45 + 0.3 sin 45) is the load of 400 N
    assert -force[1] == pytest.approx(400.0, rel=1e-8)
    assert -force.sum() / np.sqrt(2.0) == pytest.approx(400.0 * np.sqrt(2.0) / 1.3, rel=1e-6)


@pytest.mark.parallel(angle=[45], size=[0.5])
@pytest.mark.parametrize("sliding", ["small", "finite"])
@pytest.mark.parametrize("angle", [10, 30, 45])
@pytest.mark.parametrize("size", [0.2, 0.5])
def test_a_chamfered_block_moves_along_a_wall(comm, folder, angle, size, sliding):
    """The distance does not change, and nothing is pressed, whichever side is secondary."""
    tagged = read(comm, folder, CHAMFER, angle=angle, h=size)
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (2,)))
    held = [
        fixed(V, tagged.facet_tags.find(tagged.tags["axis"]), (0.0, 3.0 * GAP)),
        fixed(V, tagged.facet_tags.find(tagged.tags["outer"]), (0.0, 0.0)),
    ]
    for sides in (("side", "inner"), ("inner", "side")):
        tags = (tagged.tags[name] for name in sides)
        pair = ContactPair(tagged.facet_tags, *tags, Frictionless(), sliding=sliding)
        with ContactProblem(elasticity(V, 2e5), no_load(V), [pair], held) as problem:
            gap = problem.operators[0].gap
            least = comm.allreduce(gap.min(initial=1.0), MPI.MIN)
            assert least == pytest.approx(GAP, rel=1e-9)
            solution = problem.solve()
            solution.raise_if_failed()
            assert solution.normal_force == 0.0


@pytest.mark.parallel
@pytest.mark.parametrize("size", [0.5, 1.0])
@pytest.mark.parametrize("angle", [10, 45])
@pytest.mark.parametrize("sides", [("side", "inner"), ("inner", "side")])
def test_a_chamfered_slab_moves_along_a_wall(comm, folder, size, angle, sides):
    """Kinks count at the rim of a surface, too, here where all facets are at the rim."""
    tagged = read(comm, folder, CHAMFERED_SLAB, angle=angle, h=size)
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (3,)))
    held = [
        fixed(V, tagged.facet_tags.find(tagged.tags["axis"]), (0.0, 3.0 * GAP, 0.0)),
        fixed(V, tagged.facet_tags.find(tagged.tags["outer"]), (0.0, 0.0, 0.0)),
    ]
    tags = (tagged.tags[name] for name in sides)
    pair = ContactPair(tagged.facet_tags, *tags, Frictionless())
    with ContactProblem(elasticity(V, 2e5), no_load(V), [pair], held) as problem:
        gap = problem.operators[0].gap
        assert comm.allreduce(gap.min(initial=1.0), MPI.MIN) == pytest.approx(GAP, rel=1e-9)
        solution = problem.solve()
        solution.raise_if_failed()
        assert solution.normal_force == 0.0


@pytest.mark.parallel
@pytest.mark.parametrize("sides", [("inside", "outside"), ("outside", "inside")])
@pytest.mark.parametrize(("angle", "lean"), [(20, 0.02), (45, 1e-5)])
def test_a_chamfered_sleeve_moves_along_its_pole(comm, folder, angle, lean, sides):
    """Both turn round the axis, by 22 degrees a facet, but not along it: so do contact normals."""
    tagged = read(comm, folder, SLEEVE, angle=angle)
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (3,)))
    prescribed = np.zeros(3 * V.dofmap.index_map.size_local, dtype=bool)
    tags = (tagged.tags[name] for name in sides)
    operators = pair_surfaces(V, prescribed, ContactPair(tagged.facet_tags, *tags, Frictionless()))
    assert comm.allreduce(np.abs(operators.normals[:, 2]).max(initial=0.0), MPI.MAX) <= lean
    if angle > 30:  # the chamfer is not paired
        assert np.allclose(operators.gap, 0.05, rtol=1e-3)


@pytest.mark.parallel
@pytest.mark.parametrize("geometry", [None, {}])
@pytest.mark.parametrize("sides", [("inside", "outside"), ("outside", "inside")])
def test_an_exact_fit_has_no_gap_at_its_rims(comm, folder, sides, geometry):
    """Normals there are radial, though the ring ends: the disc goes on."""
    tagged = read(comm, folder, EXACT_FIT)
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (2,)))
    prescribed = np.zeros(2 * V.dofmap.index_map.size_local, dtype=bool)
    tags = (tagged.tags[name] for name in sides)
    pair = ContactPair(tagged.facet_tags, *tags, Frictionless(), geometry=geometry)
    found = pair_surfaces(V, prescribed, pair)
    radial = found.places / np.linalg.norm(found.places, axis=1)[:, None]
    x, y = found.normals.T
    sine = np.abs(x * radial[:, 1] - y * radial[:, 0]).max(initial=0.0)
    sagitta = 15.0 * (1.0 - np.cos(0.5 * np.pi / 15))
    assert comm.allreduce(sine, MPI.MAX) <= 2e-3
    assert comm.allreduce(np.abs(found.gap).max(initial=0.0), MPI.MAX) <= 5e-3 * sagitta


@pytest.mark.parallel
@pytest.mark.parametrize(("turned", "wall"), [(20.0, 0.9), (35.0, 0.9), (20.0, 0.3)])
def test_a_sharp_corner_pushes_along_the_normal_of_a_flat_side(comm, folder, turned, wall):
    """Both smooth patches of the corner face the plate, one of them at 55 or 70 degrees."""
    text = """
    SetFactory("OpenCASCADE");
    DefineConstant[ angle = 20, wall = 1 ];
    Rectangle(1) = {0, 0, 0, 1, 1};
    Rotate { {0, 0, 1}, {0, 0, 0}, angle * Pi / 180 } { Surface{1}; }
    x() = {-2, 2, 2, -wall, -wall, -2}; y() = {-1, -1, 0, 0, 1, 1};
    For i In {0:5}
      Point(11 + i) = {x(i), y(i), 0};
    EndFor
    For i In {0:5}
      Line(11 + i) = {11 + i, i < 5 ? 12 + i : 11};
    EndFor
    Curve Loop(2) = {11:16}; Plane Surface(2) = {2};
    Physical Surface("block") = {1}; Physical Surface("plate") = {2};
    Physical Curve("tip") = {1, 4}; Physical Curve("back") = {2, 3};
    Physical Curve("top") = {13, 14}; Physical Curve("bottom") = {11};
    Mesh.MeshSizeMax = 0.15;
    """
    tagged = read(comm, folder, text, angle=turned, wall=wall)
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (2,)))
    held = [
        fixed(V, tagged.facet_tags.find(tagged.tags["back"]), (0.02, -0.04)),
        fixed(V, tagged.facet_tags.find(tagged.tags["bottom"]), (0.0, 0.0)),
    ]
    tags = (tagged.tags[name] for name in ("tip", "top"))
    pair = ContactPair(tagged.facet_tags, *tags, Frictionless())
    with ContactProblem(elasticity(V, 1e3), no_load(V), [pair], held) as problem:
        solution = problem.solve(rtol=1e-8)
        solution.raise_if_failed()
        force = solution.pair_resultants[0].force
        assert abs(force[1]) > 1.0 and abs(force[0]) <= 1e-3 * abs(force[1])


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_normals_lean_out_of_their_body(comm, folder, degree):
    """A round tip ends over a coarse fillet, where dual means of normals point into the body."""
    text = """
    Point(1) = {0, -3, 0}; Point(2) = {3, -3, 0}; Point(3) = {3, 0, 0}; Point(4) = {0.2, 0, 0};
    Point(5) = {0, -0.2, 0}; Point(6) = {0.2, -0.2, 0}; Point(7) = {-1.04, -0.9467, 0};
    Point(8) = {0.4912118, 0.3843998, 0}; Point(9) = {0.56, 0.5353417, 0};
    Point(10) = {0.36, 0.5353417, 0}; Point(11) = {0.56, 3, 0}; Point(12) = {-1.04, 3, 0};
    Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Circle(4) = {4, 6, 5}; Line(5) = {5, 1};
    Line(6) = {7, 8}; Circle(7) = {8, 10, 9}; Line(8) = {9, 11}; Line(9) = {11, 12};
    Line(10) = {12, 7}; Curve Loop(1) = {1:5}; Curve Loop(2) = {6:10};
    Plane Surface(1) = {1}; Plane Surface(2) = {2}; Physical Surface("bodies") = {1, 2};
    Physical Curve("block") = {3:5}; Physical Curve("tip") = {6, 7};
    Mesh.MeshSizeMax = 0.6; Mesh.MeshSizeMin = 0.6;
    """
    tagged = read(comm, folder, text)
    V = fem.functionspace(tagged.mesh, ("Lagrange", degree, (2,)))
    tags = (tagged.tags[name] for name in ("block", "tip"))
    pair = ContactPair(tagged.facet_tags, *tags, Frictionless())
    with ContactProblem(elasticity(V, 1e3), no_load(V), [pair]) as problem:
        operators = problem.operators[0]
        assert comm.allreduce(operators.normals[:, 1].min(initial=1.0), MPI.MIN) > 0.0


@pytest.mark.parallel
@pytest.mark.parametrize("sides", [("bottom", "steps"), ("steps", "bottom")])
def test_a_step_far_below_is_another_surface(comm, folder, sides):
    """A facet faces the end of one plate, near it, and another plate far below, and no force."""
    text = """
    SetFactory("OpenCASCADE");
    Rectangle(1) = {-2, 0.03, 0, 4, 1}; Rectangle(2) = {-2, -1, 0, 2.2, 1};
    Rectangle(3) = {-2, -6, 0, 4, 1};
    Physical Surface("block") = {1}; Physical Surface("near") = {2}; Physical Surface("far") = {3};
    Physical Curve("bottom") = {1}; Physical Curve("steps") = {7, 11};
    Physical Curve("back") = {3}; Physical Curve("held") = {5, 9};
    Mesh.MeshSizeMax = 0.5;
    """
    tagged = read(comm, folder, text)
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (2,)))
    held = [
        fixed(V, tagged.facet_tags.find(tagged.tags["back"]), (GAP, 0.0)),
        fixed(V, tagged.facet_tags.find(tagged.tags["held"]), (0.0, 0.0)),
    ]
    tags = (tagged.tags[name] for name in sides)
    pair = ContactPair(tagged.facet_tags, *tags, Frictionless(), sliding="finite")
    with ContactProblem(elasticity(V, 1e3), no_load(V), [pair], held) as problem:
        solution = problem.solve()
        solution.raise_if_failed()
        gap = solution.surface.initial_gap.x.array[solution.surface.weights > 0.0]
        assert comm.allreduce(gap.min(initial=1.0), MPI.MIN) >= GAP - 1e-9
        assert solution.normal_force == 0.0


@pytest.mark.parallel
@pytest.mark.parametrize("place", [0.0, 0.25, 0.45])
def test_a_small_ball_pushes_along_the_normal_of_a_coarse_facet(comm, folder, place):
    """The ball is smaller than a cell; the nodes beside it do not see its tilted normals."""
    text = """
    SetFactory("OpenCASCADE");
    Rectangle(1) = {-4, 0, 0, 8, 3};
    Physical Surface("block") = {1};
    Physical Curve("bottom") = {1}; Physical Curve("top") = {3};
    Transfinite Curve {1, 3} = 9; Transfinite Curve {2, 4} = 4; Transfinite Surface {1};
    Recombine Surface {1};
    """
    tagged = read(comm, folder, text)
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (2,)))
    held = [fixed(V, tagged.facet_tags.find(tagged.tags["top"]), (0.0, -0.6))]
    ball = RigidSphere(center=(place, -0.8), radius=0.8)
    pair = ContactPair(tagged.facet_tags, tagged.tags["bottom"], ball, Frictionless())
    with ContactProblem(elasticity(V, 1e3), no_load(V), [pair], held) as problem:
        solution = problem.solve(rtol=1e-8)
        solution.raise_if_failed()
        (resultant,) = solution.pair_resultants
        assert resultant.force[1] > 10.0
        assert abs(resultant.force[0]) <= 1e-3 * resultant.force[1]


def block(comm, cell):
    """Return the space and the tagged top of a block of 8 x 2, and the condition at its bottom."""
    shape = round(8.0 / cell), round(2.0 / cell)
    mesh = create_rectangle(comm, [(0.0, 0.0), (8.0, 2.0)], shape, CellType.quadrilateral)
    top = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 2.0))
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    bottom = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[1], 0.0))
    return V, meshtags(mesh, 1, top, np.full(len(top), 7, dtype=np.int32)), [fixed(V, bottom)]


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_an_obstacle_smaller_than_facets_is_seen_between_nodes(comm, sliding):
    """Its force hardly varies as it slides from node to node, and goes through the place it is at.

    The force on a fine mesh is 0.00913 times Young's modulus. With cells of 4/3 of the radius nodes
    alone see 0 to 1.35 times this force.
    """
    V, tags, held = block(comm, 0.4)
    ball = RigidSphere(center=(4.0, 2.28), radius=0.3)
    pair = ContactPair(tags, 7, ball, Frictionless(), sliding=sliding)
    forces = []
    with ContactProblem(elasticity(V, 1.0), no_load(V), [pair], held) as problem:
        for x in (0.0, 0.1, 0.2, 0.35):
            ball.move_to(translation=(x, 0.0))
            solution = problem.solve(rtol=1e-6)
            solution.raise_if_failed()
            (resultant,) = solution.pair_resultants
            lever = resultant.about((4.0 + x, 2.0)).moment / resultant.force[1]
            assert abs(lever) <= 0.05
            forces.append(solution.normal_force)
    assert np.ptp(forces) <= 0.15 * np.mean(forces)
    assert np.allclose(forces, 0.00913, rtol=0.3)


@pytest.mark.parallel
@pytest.mark.parametrize(("radius", "warned"), [(0.5, True), (1.5, True), (4.0, False)])
def test_what_the_mesh_does_not_see_of_an_obstacle_is_told(comm, caplog, radius, warned):
    V, tags, held = block(comm, 1.0)
    ball = RigidSphere(center=(3.5, 2.0 + radius - 0.1), radius=radius)
    with ContactProblem(
        elasticity(V, 1.0), no_load(V), [ContactPair(tags, 7, ball, Frictionless())], held
    ):
        text = " ".join(caplog.text.split())
    told = "enters facets by up to 0.1, and the mesh does not see 0.0" in text
    assert told == (warned and comm.rank == 0)
