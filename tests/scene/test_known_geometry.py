"""The curved surfaces of a mesh from Gmsh are used without being asked for."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from dolfinx_tresca import ContactPair, ContactProblem, Frictionless, read_gmsh, refine
from scenes.elasticity import elasticity

RADIUS, INTERFERENCE = 10.0, 0.02  # mm

#: A pin, longer than the ring into which it is pressed, in the usual mesh of OpenCASCADE and Gmsh.
PIN_IN_RING = f"""
SetFactory("OpenCASCADE");
Cylinder(1) = {{0, 0, -5, 0, 0, 26, {RADIUS + INTERFERENCE}}};
Cylinder(2) = {{0, 0, 0, 0, 0, 16, 18}};
Cylinder(3) = {{0, 0, 0, 0, 0, 16, {RADIUS}}};
BooleanDifference{{ Volume{{2}}; Delete; }}{{ Volume{{3}}; Delete; }}
Physical Volume("pin") = {{1}}; Physical Volume("ring") = {{2}};
Physical Surface("of ring", 2) = {{Abs(Boundary{{ Volume{{2}}; }})}};
Physical Surface("of pin", 1) = {{Abs(Boundary{{ Volume{{1}}; }})}};
Mesh.MeshSizeMax = 4; Mesh.MeshSizeFromCurvature = 24;
"""

#: A half ring on a disc of the same radius.
HALF_RING = f"""
SetFactory("OpenCASCADE");
Disk(1) = {{0, 0, 0, 15}};
Disk(2) = {{0, 0, 0, 20}}; Disk(3) = {{0, 0, 0, 15}};
BooleanDifference{{ Surface{{2}}; Delete; }}{{ Surface{{3}}; Delete; }}
Rectangle(4) = {{-50, 1, 0, 100, 50}};
ring() = BooleanIntersection{{ Surface{{2}}; Delete; }}{{ Surface{{4}}; Delete; }};
Physical Surface("disc") = {{1}}; Physical Surface("ring") = {{ring()}};
inner() = Curve In BoundingBox{{-15.1, 0.9, -1, 15.1, 15.1, 1}};
Physical Curve("edge", 11) = {{Abs(Boundary{{ Surface{{1}}; }})}};
Physical Curve("inner", 12) = {{inner()}};
Mesh.MeshSizeMax = {np.pi / 2};
"""


def mesh_of(comm, folder, text):
    """The mesh of a `.geo` file with the given text."""
    path = folder / "scene.geo"
    if comm.rank == 0:
        path.write_text(text)
    comm.barrier()
    return read_gmsh(path, comm)


@pytest.fixture
def folder(comm, tmp_path):
    return comm.bcast(tmp_path, root=0)


def problem_of(tagged, *tags, **options):
    """Contact of two bodies that are held at their middle and far away from it."""
    dim = tagged.mesh.geometry.dim
    V = fem.functionspace(tagged.mesh, ("Lagrange", 1, (dim,)))
    far = 17.9 if dim == 3 else 19.9
    held = fem.locate_dofs_geometrical(
        V, lambda x: (np.hypot(x[0], x[1]) < RADIUS / 2) | (np.hypot(x[0], x[1]) > far)
    )
    pair = ContactPair(tagged.facet_tags, *tags, Frictionless(), **options)
    bcs = [fem.dirichletbc(np.zeros(dim), held, V)]
    return ContactProblem(elasticity(V, 1e5), None, [pair], bcs)


def worst(comm, values) -> float:
    return comm.allreduce(float(np.abs(values).max(initial=0.0)), op=MPI.MAX)


@pytest.mark.parallel
def test_cylinders_are_exact(comm, folder, caplog):
    """Also if one tag has the whole boundary of a body: each facet has the surface it lies on.

    Radial normals have no axial part, with which pins would be wedged.
    """
    tagged = mesh_of(comm, folder, PIN_IN_RING)
    for tags in ((2, 1), (1, 2)):
        operators = problem_of(tagged, *tags).operators[0]
        assert worst(comm, operators.gap + INTERFERENCE) <= 0.01 * INTERFERENCE
        assert worst(comm, operators.normals[:, 2]) <= 1e-4
    operators = problem_of(tagged, 2, 1, geometry={}).operators[0]
    assert worst(comm, operators.gap + INTERFERENCE) > 0.1 * INTERFERENCE
    assert "not used" not in caplog.text


@pytest.mark.parallel
def test_an_exact_fit_transmits_nothing(comm, folder):
    """The rims of the half ring have radial normals and no overlap."""
    tagged = mesh_of(comm, folder, HALF_RING)
    exact, facets = (problem_of(tagged, 12, 11, **options) for options in ({}, {"geometry": {}}))
    sagitta = 15.0 * (1.0 - np.cos(np.pi / 60))
    operators = exact.operators[0]
    radial = operators.points[:, :2] / np.linalg.norm(operators.points[:, :2], axis=1)[:, None]
    sine = radial[:, 0] * operators.normals[:, 1] - radial[:, 1] * operators.normals[:, 0]
    assert worst(comm, operators.gap) <= 1e-6 * sagitta
    assert worst(comm, sine) <= 1e-3 * np.pi / 60
    forces = [problem.solve().normal_force for problem in (exact, facets)]
    assert abs(forces[0]) <= 1e-4 * abs(forces[1])


@pytest.mark.parallel
def test_a_refined_mesh_knows_it(comm, folder):
    tagged = mesh_of(comm, folder, HALF_RING)
    cells = tagged.mesh.topology.index_map(2).size_local
    finer = refine(tagged, np.ones(cells), 1.0)
    assert worst(comm, problem_of(finer, 12, 11).operators[0].gap) <= 1e-8 * RADIUS


def moved(tagged):
    tagged.mesh.geometry.x[:, 0] += 0.003


def scaled(tagged):
    tagged.mesh.geometry.x[:] *= 1.01


def gone(tagged):
    if tagged.mesh.comm.rank == 0:
        tagged.geometry.path.unlink()
    tagged.mesh.comm.barrier()


def another(tagged):
    if tagged.mesh.comm.rank == 0:
        tagged.geometry.path.write_text(HALF_RING.replace("0, 15}", "0, 15.3}"))
    tagged.mesh.comm.barrier()


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("change", "figure"),
    [
        (moved, "a corner is 0.003 away"),
        (scaled, "a corner is 0.15 away"),
        (gone, "there is no file"),
        (another, "a corner is 0.3 away"),
    ],
)
def test_facets_take_its_place_with_a_warning(comm, folder, caplog, change, figure):
    """Not in silence, and with the answer of a user who does without it."""
    tagged = mesh_of(comm, folder, HALF_RING)
    change(tagged)
    found = problem_of(tagged, 12, 11).operators[0]
    text = " ".join(caplog.text.split())
    assert (figure in text and "ContactPair(geometry={})" in text) == (comm.rank == 0)
    caplog.clear()
    wanted = problem_of(tagged, 12, 11, geometry={}).operators[0]
    assert "not used" not in caplog.text
    assert np.array_equal(found.gap, wanted.gap)


def test_a_model_of_the_user_stays_current(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    tagged = mesh_of(MPI.COMM_SELF, tmp_path, HALF_RING)
    gmsh.initialize(interruptible=False)
    try:
        gmsh.model.add("mine")
        gmsh.model.occ.addPoint(1, 2, 3)
        problem_of(tagged, 12, 11)
        assert gmsh.model.getCurrent() == "mine"
        gmsh.model.occ.synchronize()
        assert len(gmsh.model.getEntities(0)) == 1
    finally:
        gmsh.finalize()


def test_arcs_that_meet_where_their_circle_begins(caplog):
    """Of a disc with a flat: OpenCASCADE's search for the nearest point misses an end of an arc."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    occ = gmsh.model.occ
    discs = [(2, occ.addDisk(0, 0, 0, radius, radius)) for radius in (10, 10, 20)]
    bodies = occ.cut(discs[:1], [(2, occ.addRectangle(-9, 9, 0, 18, 3))])[0]
    bodies += occ.cut(discs[2:], discs[1:2])[0]
    occ.synchronize()
    for tag, body in enumerate(bodies, start=1):
        gmsh.model.addPhysicalGroup(2, [body[1]], tag)
        curves = gmsh.model.getBoundary([body], oriented=False)
        gmsh.model.addPhysicalGroup(1, [curve for _, curve in curves], 10 + tag)
    gmsh.model.mesh.generate(2)
    operators = problem_of(read_gmsh(gmsh.model, MPI.COMM_SELF), 11, 12).operators[0]
    gmsh.finalize()
    assert "not used" not in caplog.text
    on_arc = operators.points[:, 1] < 8.5
    assert np.abs(operators.gap[on_arc]).max() <= 1e-5
