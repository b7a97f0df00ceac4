"""Scenes that leave linear theory get a status, near its end a warning, and inside no word."""

from __future__ import annotations

import dataclasses
import logging
import re

import numpy as np
import pytest
from logged import logged

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    ContactStatus,
    ConvergenceError,
    Coulomb,
    Frictionless,
    OutsideTheoryError,
    RigidSphere,
    read_gmsh,
)
from scenes.blocks import ABOVE, BELOW, block
from scenes.elasticity import elasticity, fixed, no_load
from scenes.patches import BOTTOM, TOP, patch

#: Of a pin in a ring, that are meshed apart: the coefficient of friction, the radius of the hole
#: and the length of the ring [mm].
FRICTION, RADIUS, LENGTH = 0.15, 10.0, 12.0

PIN_IN_RING = f"""
SetFactory("OpenCASCADE");
Cylinder(1) = {{0, 0, 0, 0, 0, 20, {RADIUS + 0.02}}};
Cylinder(2) = {{0, 0, 4, 0, 0, {LENGTH}, 18}};
Cylinder(3) = {{0, 0, 4, 0, 0, {LENGTH}, {RADIUS}}};
BooleanDifference{{ Volume{{2}}; Delete; }}{{ Volume{{3}}; Delete; }}
inner[] = Surface In BoundingBox{{-10.01, -10.01, 3.9, 10.01, 10.01, 16.1}};
whole[] = Surface In BoundingBox{{-18.1, -18.1, 3.9, 18.1, 18.1, 16.1}};
outer[] = {{}};
For i In {{0 : #whole[] - 1}}
  box[] = BoundingBox Surface{{whole[i]}};
  If (box[5] - box[2] > 1 && box[3] > 17)
    outer[] += whole[i];
  EndIf
EndFor
Physical Volume("pin") = {{1}};
Physical Volume("ring") = {{2}};
Physical Surface("hole") = {{inner[]}};
Physical Surface("outside") = {{outer[]}};
Physical Surface("side") = {{1}};
Mesh.MeshSizeMax = 5;
Mesh.MeshSizeFromCurvature = 20;
"""


def read_pin_in_ring(comm, folder):
    """Return the mesh of the pin in the ring."""
    path = folder / "pin.geo"
    if comm.rank == 0:
        path.write_text(PIN_IN_RING)
    comm.barrier()
    return read_gmsh(path, comm)


def pin_without_friction(comm, folder) -> tuple[ContactProblem, fem.Constant]:
    """Return the problem and the displacement [mm] that is prescribed on the axis of the pin."""
    fit = read_pin_in_ring(comm, folder)
    V = fem.functionspace(fit.mesh, ("Lagrange", 1, (3,)))
    pull = fem.Constant(fit.mesh, np.zeros(3))
    ends = fem.locate_dofs_geometrical(
        V, lambda x: np.isclose(x[2], 0.0) & (np.hypot(x[0], x[1]) < RADIUS / 2.0)
    )
    held = [fem.dirichletbc(pull, ends, V), fixed(V, fit.facet_tags.find(fit.tags["outside"]))]
    pair = ContactPair(
        fit.facet_tags, fit.tags["hole"], fit.tags["side"], Frictionless(), name="the fit"
    )
    return ContactProblem(elasticity(V, 2e5), no_load(V), [pair], held), pull


def pin_in_ring(comm, folder, *, twist: bool) -> tuple[ContactProblem, fem.Constant, float]:
    """Return the problem, its load, and about the load [N or N mm] that friction can carry.

    Nothing but friction holds the pin against the load, a force along the axis or a torque.
    """
    fit = read_pin_in_ring(comm, folder)
    V = fem.functionspace(fit.mesh, ("Lagrange", 1, (3,)))
    load, v, x = fem.Constant(fit.mesh, 0.0), ufl.TestFunction(V), ufl.SpatialCoordinate(fit.mesh)
    dx = ufl.Measure("dx", domain=fit.mesh, subdomain_data=fit.cell_tags)(fit.tags["pin"])
    density = fem.Constant(fit.mesh, 1.0)
    if twist:
        work, size = -x[1] * v[0] + x[0] * v[1], x[0] ** 2 + x[1] ** 2
    else:
        work, size = v[2], density
    whole = comm.allreduce(fem.assemble_scalar(fem.form(size * dx)))
    outside = fixed(V, fit.facet_tags.find(fit.tags["outside"]))
    pair = ContactPair(
        fit.facet_tags, fit.tags["hole"], fit.tags["side"], Coulomb(FRICTION), name="the fit"
    )
    problem = ContactProblem(elasticity(V, 2e5), load / whole * work * dx, [pair], [outside])
    fitted = problem.solve()
    fitted.raise_if_failed()
    problem.accept()
    return problem, load, FRICTION * fitted.normal_force * (RADIUS if twist else 1.0)


@pytest.mark.parallel
@pytest.mark.parametrize("twist", [False, True])
def test_beyond_friction(comm, folder, caplog, twist):
    """Nothing holds a pin that is pulled too hard; one that is turned leaves linear theory.

    Contact normals are those of a cylinder, without a part along the axis. Below the limit of
    friction the pin hardly moves, and nothing is said.
    """
    problem, load, limit = pin_in_ring(comm, folder, twist=twist)
    with problem:
        caplog.clear()
        for share in (0.5, 0.8):
            load.value = share * limit
            assert problem.solve().status is ContactStatus.CONVERGED
        assert not any(record.levelno >= logging.WARNING for record in caplog.records)
        for share in (1.1, 2.0):
            load.value = share * limit
            solution = problem.solve()
            # normals of other directions than the cylinder's, if rounding leaves any, are told
            wedged = solution.status is ContactStatus.OUTSIDE_THEORY
            assert wedged or (not twist and solution.status is ContactStatus.NO_FIXED_POINT)
            said = ["(pin), between"] if twist else ["pressed nodes have slid", "along z"]
            assert any(text in solution.sliding for text in said)
            assert solution.sliding in solution.failure
            with pytest.raises(ConvergenceError) as caught:
                solution.raise_if_failed()
            assert isinstance(caught.value, OutsideTheoryError) == wedged
            with pytest.raises(ConvergenceError, match=solution.status.name):
                problem.accept()
        problem.accept(unconverged=True)


def warnings(caplog) -> int:
    """Return the number of warnings that the first rank has logged."""
    return sum(record.levelno >= logging.WARNING for record in caplog.records)


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("angle", "status", "warned"),
    [
        (0.008, ContactStatus.CONVERGED, 0),
        (0.045, ContactStatus.CONVERGED, 1),
        (0.055, ContactStatus.OUTSIDE_THEORY, 2),
    ],
)
def test_block_that_tips_on_a_plane(comm, caplog, angle, status, warned):
    """The moment 0.15 N m of the loads about the centre turns a block on soft springs.

    A lifted block turns by the moment divided by the springs' stiffness of rotation, k / 6. Within
    the limits the log is silent or warns in the first of two solves; beyond them it warns in both.
    """
    stiffness, load = 6.0 * 0.15 / angle, (0.3, 0.0, 1.0)
    scene = block(comm, (4, 4), spring=stiffness, load=load, friction=Coulomb(FRICTION))
    with scene.problem() as problem:
        for _ in range(2):
            solution = problem.solve()
    assert solution.status is status
    assert warnings(caplog) == warned * (comm.rank == 0)
    if warned and comm.rank == 0:
        shown = float(re.search(r"turns by ([0-9.]+) rad", logged(caplog)).group(1))
        assert shown == pytest.approx(angle, rel=0.02)  # bodies deform, too
    if status is ContactStatus.OUTSIDE_THEORY:
        assert f"turns by {angle:.2g}"[:13] in solution.sliding
        assert "NonlinearContactProblem" in solution.sliding


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_pressed_block_that_turns_on_a_plane(comm, sliding):
    """The top of the block is turned, which presses a corner; with finite sliding it has a frame.

    Only in linear theory the corner is pressed at 0.06 rad: a turned block is shorter below its top
    by its height times 0.06^2 / 2, more than the 0.001 by which the top is lowered.
    """
    turned = {0.04: ContactStatus.CONVERGED, 0.06: ContactStatus.OUTSIDE_THEORY}
    for angle, status in turned.items():
        scene = block(
            comm,
            (3, 3),
            held=(ABOVE,),
            moved=lambda x, angle=angle: angle * np.array([0.5 - x[1], x[0]]) - 0.001,
            friction=Coulomb(FRICTION),
        ).but(sliding=sliding)
        with scene.problem() as problem:
            solution = problem.solve(rtol=1e-8)
            if sliding == "finite":
                status = ContactStatus.CONVERGED
            assert solution.status is status
            assert (solution.normal_force > 0.0) == (sliding == "small" or angle < 0.002**0.5)


@pytest.mark.parallel
@pytest.mark.parametrize("law", [Coulomb(FRICTION), Frictionless()])
@pytest.mark.parametrize("deformable", [False, True])
@pytest.mark.parametrize(
    ("shift", "status", "warned"),
    [
        (0.2, ContactStatus.CONVERGED, 0),
        (0.5, ContactStatus.CONVERGED, 1),
        (2.0, ContactStatus.OUTSIDE_THEORY, 1),
    ],
)
def test_slip_over_the_size_of_the_contact(comm, caplog, shift, status, warned, deformable, law):
    """A block of width 1 slides on a large ball or on another block, with facets of at most 1/3."""
    if deformable:
        scene = patch(
            comm,
            "quadrilateral",
            upper=(3, 1),
            lower=(3, 1),
            distort=0.0,
            friction=law,
        )
        moved = fixed(scene.V, scene.facet_tags.find(TOP), (-shift, -0.001))
        bcs = [moved, fixed(scene.V, scene.facet_tags.find(BOTTOM))]
    else:
        motion = np.array([[-shift], [-0.001]])
        ball = [(BELOW, RigidSphere((0.5, -1e3), 1e3))]
        scene = block(
            comm,
            (3, 3),
            boxes=True,
            held=(ABOVE,),
            moved=lambda x: 0.0 * x[:2] + motion,
            obstacles=ball,
            friction=law,
        )
        bcs = scene.bcs
    caplog.clear()
    with scene.problem(bcs=bcs) as problem:
        solution = problem.solve(rtol=1e-8)
    assert solution.status is status
    assert warnings(caplog) == warned * (comm.rank == 0)
    if status is ContactStatus.OUTSIDE_THEORY:
        assert f"contact pair {solution.surface.name}: pressed nodes have slid by {shift:.2g}" in (
            solution.sliding
        )
        assert 'sliding="finite"' in solution.sliding


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron", "tetrahedron"])
@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("outwards", [True, False])
def test_a_block_leaves_the_rim_of_another_one(comm, caplog, kind, again, outwards):
    """Both overlap by 0.2 at first: the upper block slides off the lower one, or farther onto it.

    In 3D the contact is so long that this slip is small for its size. A pairing in the displaced
    position has other overlaps, 0.1 and 0.3, of which it may slide off.
    """
    slip, half = 0.4 if outwards else -0.4, 0.1 if outwards else -0.1
    deep = [] if kind == "quadrilateral" else [(0.0, 1.0)]
    scene = patch(comm, kind, upper=(10, 1), lower=(10, 1), distort=0.0, span=[(0.8, 1.8), *deep])
    down = np.zeros(scene.mesh.geometry.dim)
    down[-1] = -0.001
    value = fem.Constant(scene.mesh, down)
    held = [fixed(scene.V, scene.facet_tags.find(TOP), value)]
    held += [fixed(scene.V, scene.facet_tags.find(BOTTOM))]
    with scene.problem(bcs=held) as problem:
        if again:
            value.value[0] = half
            problem.update_geometry(problem.solve(rtol=1e-8).u)
        caplog.clear()
        value.value[0] += slip
        solution = problem.solve(rtol=1e-8)
    assert solution.normal_force > 0.0
    off = re.search(r"and ([0-9]+) % of the contact force", solution.sliding)
    if outwards:
        assert solution.status is ContactStatus.OUTSIDE_THEORY
        assert float(off.group(1)) == 100.0
    else:
        assert off is None
        assert "of the contact force" not in logged(caplog)


@pytest.mark.parallel
def test_a_pin_without_friction_is_pulled_out_of_its_hole(comm, folder, caplog):
    """The hole is 12 mm long, and 4 mm from the end of the pin: after 20 mm they have parted."""
    problem, pull = pin_without_friction(comm, folder)
    caplog.clear()
    with problem:
        pull.value[2] = 0.05
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED
        assert not warnings(caplog)
        pull.value[2] = 20.0
        solution = problem.solve(rtol=1e-6)
    assert solution.status is ContactStatus.OUTSIDE_THEORY
    assert "contact pair the fit: pressed nodes have slid by 20" in solution.sliding
    assert "100 % of the contact force is at nodes" in solution.sliding


@pytest.mark.parallel
def test_plate_on_three_balls(comm):
    """A load between the balls is carried, one beyond them tips the plate far from its place.

    Nodes beside the top of a ball then carry the plate, since small sliding keeps the gaps that
    they had.
    """
    size, balls = (20.0, 20.0, 1.0), ((4.0, 4.0), (16.0, 4.0), (10.0, 16.0))
    scene = block(
        comm,
        (5, 5, 1),
        size=size,
        boxes=True,
        young=2e5,
        obstacles=[(BELOW, RigidSphere((*centre, -10.0), 10.0)) for centre in balls],
        friction=Coulomb(0.3),
    )
    x, v = ufl.SpatialCoordinate(scene.mesh), ufl.TestFunction(scene.V)
    edge = fem.Constant(scene.mesh, 12.0)
    load = ufl.conditional(ufl.lt(x[1], edge), 1.0, 0.0) / edge
    L = -load * v[2] * ufl.Measure("ds", scene.mesh, subdomain_data=scene.facet_tags)(ABOVE)
    with dataclasses.replace(scene, L=L).problem() as problem:
        assert problem.solve(rtol=1e-6).status is ContactStatus.CONVERGED
        edge.value = 2.0
        solution = problem.solve(rtol=1e-6)
    # what carries the tipped plate is a fixed point that the iteration may miss
    assert solution.status in (ContactStatus.OUTSIDE_THEORY, ContactStatus.NO_FIXED_POINT)


@pytest.mark.parallel
@pytest.mark.parametrize("modulus", [1e3, 1e-3])
def test_deformation_beyond_the_size_of_the_body(comm, modulus):
    """As with a modulus in GPa beside loads in Pa."""
    with block(comm, (3, 3), young=modulus).problem() as problem:
        solution = problem.solve()
    if modulus > 1.0:
        assert solution.status is ContactStatus.CONVERGED
    else:
        assert solution.status is ContactStatus.OUTSIDE_THEORY
        assert "units of moduli and loads" in solution.sliding
