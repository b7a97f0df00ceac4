"""Rigid obstacles held by forces: their motions are unknowns, and forces are in equilibrium."""

from __future__ import annotations

import gmsh
import numpy as np
import pytest
from logged import logged

import ufl
from dolfinx import fem, mesh

from dolfinx_tresca import (
    ContactForce,
    ContactPair,
    ContactProblem,
    Coulomb,
    Frictionless,
    InputError,
    MechanismError,
    OutsideTheoryError,
    RigidPlane,
    RigidSphere,
    Tresca,
    read_gmsh,
)
from scenes.blocks import ABOVE, BELOW, LEFT, block
from scenes.elasticity import elasticity
from scenes.patches import LOWER, patch
from scenes.pressures import with_pressure
from scenes.revolution import ring_elasticity
from scenes.rubber_block import rubber_block

pytestmark = pytest.mark.parallel

ACCURACY, RTOL = 1e-8, 1e-11

#: Displacements of a ball on a block in successive load steps, and the coefficient of friction.
PATH = [(0, 0, -1e-3), (5e-4, 0, -1.5e-3), (8e-4, 2e-4, -1e-3), (0, 0, -8e-4)]
FRICTION = 0.3


def plane():
    return RigidPlane(point=(0.5, 0.5, 1.0), normal=(0, 0, -1))


def ball():
    return RigidSphere(center=(0.5, 0.5, 3.0), radius=2.0)


def under(comm, tool, n=(4, 4, 3), *, friction=None, **arguments):
    """Return a block that stands on a clamped face, below a tool."""
    law = Coulomb(FRICTION) if friction is None else friction
    return block(
        comm, n, load=(0, 0, 0), held=(BELOW,), obstacles=[(ABOVE, tool)], friction=law, **arguments
    )


def largest(comm, values):
    return comm.allreduce(float(np.abs(values).max(initial=0.0)), op=max)


@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_a_punch_pressed_by_a_force_is_a_punch_moved_to_this_force(comm, stiffness, caplog):
    moved, held = plane(), plane()
    moved.move_to((0, 0, -1e-3))
    scene = under(comm, moved)
    expected = scene.problem().solve(rtol=RTOL)
    force = expected.pair_resultants[0].force
    assert not caplog.records
    held.held_by(force=force, free=("z",))
    solution = scene.but(primary=held).problem(stiffness=stiffness).solve(rtol=RTOL)
    solution.raise_if_failed()
    size = np.abs(force).max()
    assert solution.surface.obstacle.motion.translation == pytest.approx((0, 0, -1e-3), abs=1e-11)
    assert np.abs(solution.pair_resultants[0].force - force).max() < ACCURACY * size
    assert largest(comm, solution.u.x.array - expected.u.x.array) < 3 * ACCURACY * 1e-3
    assert largest(comm, solution.gap.x.array - expected.gap.x.array) < 3 * ACCURACY * 1e-3
    assert solution.dual_energy == pytest.approx(solution.primal_energy, rel=1e-6)
    assert held.motion.translation == pytest.approx((0, 0, 0), abs=0)  # moves with accept()


def test_load_steps_with_a_held_and_a_moved_direction(comm):
    moved, held = ball(), ball()
    scene = under(comm, moved, (6, 6, 4))
    first, second = scene.problem(), scene.but(primary=held).problem()
    for place in PATH:
        moved.move_to(place)
        expected = first.solve(rtol=RTOL)
        first.accept()
        force = expected.pair_resultants[0].force
        held.move_to((*place[:2], held.motion.translation[2]))
        held.held_by(force=(0, 0, force[2]), free=("z",))
        solution = second.solve(rtol=RTOL)
        second.accept()
        assert held.motion.translation == pytest.approx(place, abs=1e-9)
        assert np.abs(solution.pair_resultants[0].force - force).max() < 1e-6 * abs(force[2])
    # normals are those of the place at the start of a step: a difference of second order
    assert solution.total_dissipation == pytest.approx(expected.total_dissipation, rel=1e-6)


@pytest.mark.parametrize(("dim", "mixed"), [(2, False), (3, False), (2, True)])
def test_force_and_moment_are_in_equilibrium(comm, dim, mixed):
    tool = plane() if dim == 3 else RigidPlane(point=(0.5, 1.0), normal=(0, -1))
    about = (0.6, 0.45, 1.0) if dim == 3 else (0.6, 1.0)
    force = (0.05, 0.02, -1.0) if dim == 3 else (0.05, -1.0)
    moment = (0.01, -0.02, 0.005) if dim == 3 else 0.01
    tool.held_by(force=force, moment=moment, about=about)
    scene = under(comm, tool, (4,) * (dim - 1) + (2,), degree=1 + mixed)
    if mixed:  # with an odd number of unknowns
        scene = with_pressure(scene, 1000.0, 0.3)
    solution = scene.problem().solve(rtol=RTOL)
    solution.raise_if_failed()
    contact = solution.pair_resultants[0].about(about)
    assert np.abs(contact.force - force).max() < ACCURACY
    assert np.abs(contact.moment - moment).max() < ACCURACY


def test_the_force_of_a_whole_ring(comm):
    """A round bar of radius 1 with Poisson's ratio 0: its stress is the force over its area."""
    plate = RigidPlane(point=(0, 2), normal=(0, -1))
    plate.held_by(force=(0, -3.0))
    scene = under(comm, plate, (3, 5), size=(1.0, 2.0), friction=Frictionless())
    a = ring_elasticity(scene.V, 1000.0, 0.0)
    solution = scene.problem(a=a, L=None, axisymmetric=True).solve(rtol=RTOL)
    assert solution.normal_force == pytest.approx(3.0, rel=ACCURACY)
    sinks = solution.surface.obstacle.motion.translation
    assert sinks == pytest.approx((0, -3.0 * 2 / (1000.0 * np.pi), 0), rel=1e-6)


def balls(comm):
    """Return three halves of balls of radius 1, on a clamped plane, and where they stand."""
    places = np.array([(0.0, 0.0), (4.0, 0.0), (1.0, 3.0)])
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        if comm.rank == 0:
            for x, y in places:
                gmsh.model.occ.addSphere(x, y, 0, 1, -1, 0, np.pi / 2)
            gmsh.model.occ.synchronize()
        return read_gmsh(gmsh.model, comm, size=0.4), places
    finally:
        gmsh.finalize()


def test_three_balls_carry_a_plate(comm):
    parts, places = balls(comm)
    V = fem.functionspace(parts.mesh, ("Lagrange", 1, (3,)))
    clamped = fem.locate_dofs_geometrical(V, lambda x: x[2] < 1e-9)
    plate = RigidPlane(point=(0, 0, 1), normal=(0, 0, -1))
    pair = ContactPair(parts.facet_tags, list(parts.facet_tags.names), plate, Frictionless())
    bc = fem.dirichletbc(np.zeros(3), clamped, V)
    problem = ContactProblem(elasticity(V, 1000.0, 0.3), None, [pair], [bc])
    rows = np.vstack([np.ones(3), places.T])
    for x, y in (places.mean(axis=0), (2.0, 0.5), (1.2, 1.7)):
        plate.held_by(force=(0, 0, -6.0), free=("z", "rx", "ry"), about=(x, y, 1))
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        forces = [-resultant.force[2] for resultant in solution.body_resultants]
        expected = np.linalg.solve(rows, 6.0 * np.array([1.0, x, y]))
        assert sorted(forces) == pytest.approx(sorted(expected), abs=0.03)
        assert np.abs(solution.pair_resultants[0].about((x, y, 1.0)).moment[:2]).max() < ACCURACY
        assert sum(forces) == pytest.approx(6.0, abs=ACCURACY)


def test_a_free_sphere_on_a_block(comm):
    tool = ball()
    tool.held_by(force=(0.002, 0, -0.05), moment=(0, 0.002, 0))
    problem = under(comm, tool, (6, 6, 4), friction=Tresca(2.0)).problem()
    solution = problem.solve(rtol=RTOL)
    solution.raise_if_failed()
    contact = solution.pair_resultants[0].about((0.5, 0.5, 3.0))
    assert np.abs(contact.force - (0.002, 0, -0.05)).max() < ACCURACY
    assert np.abs(contact.moment - (0, 0.002, 0)).max() < ACCURACY
    problem.accept()
    assert tool.motion == solution.surface.obstacle.motion
    before, after = solution.u.x.array, problem.solve(rtol=RTOL).u.x.array
    assert largest(comm, after - before) < 1e-2 * largest(comm, after)


def test_one_tool_of_two_pairs(comm):
    """The nodes on the line between two tags belong to both pairs."""
    tool = plane()
    tool.held_by(force=(0.05, 0, -2.0), free=("x", "z", "ry"), about=(0.6, 0.5, 1.0))
    scene = under(comm, tool)
    expected = scene.problem().solve(rtol=RTOL)
    given = scene.pairs[0].facet_tags
    right = mesh.compute_midpoints(scene.mesh, 2, given.indices)[:, 0] > 0.5
    values = np.where((given.values == ABOVE) & right, 99, given.values).astype(np.int32)
    tags = mesh.meshtags(scene.mesh, 2, given.indices, values)
    halves = [ContactPair(tags, tag, tool, Coulomb(FRICTION)) for tag in (ABOVE, 99)]
    solution = scene.problem(pairs=halves).solve(rtol=RTOL)
    force = sum(resultant.force for resultant in solution.pair_resultants)
    assert np.abs(force[[0, 2]] - (0.05, -2.0)).max() < ACCURACY
    places = [surface.obstacle.motion.matrix for surface in solution.surfaces]
    assert np.abs(places[0] - places[1]).max() < 1e-14
    assert np.abs(places[0] - expected.surface.obstacle.motion.matrix).max() < 1e-8


@pytest.mark.parametrize(
    "held, message",
    [
        ({"force": (0, 0, -1)}, "motion along x, motion along y, rotation about z, and no"),
        ({"force": (0, 0, 1), "free": ("z",)}, "no contact forces balance .* motion along z"),
        ({"force": (0, 0, -1), "free": ("z", "ry"), "about": (2, 0, 1)}, "balance .* about y"),
    ],
)
def test_a_tool_that_nothing_holds(comm, held, message):
    tool = plane()
    tool.held_by(**held)
    problem = under(comm, tool, friction=Frictionless()).problem()
    with pytest.raises(MechanismError, match=message) as caught:
        problem.solve()
    assert "a rigid plane through (0.5, 0.5, 1)" in str(caught.value)
    tool.held_by(free=())
    problem.solve().raise_if_failed()


def test_a_block_that_is_lifted_beside_a_tool(comm):
    """The lower block carries the tool: it is not the tool that nothing holds."""
    tool = RigidPlane((0, 1), (0, -1))
    tool.held_by(force=(0, -1), free=("y",))
    scene = patch(comm, "triangle", span=[(0.0, 0.4)], friction=Coulomb(0.3))
    lift = ufl.inner(fem.Constant(scene.mesh, (0.0, 1.0)), ufl.TestFunction(scene.V)) * ufl.dx
    pairs = [*scene.pairs, ContactPair(scene.facet_tags, LOWER, tool, Frictionless())]
    with pytest.raises(MechanismError, match=r"the loads on body \d of 2.*along y"):
        scene.problem(pairs=pairs, bcs=scene.bcs[1:], L=lift).solve()


@pytest.mark.parametrize(
    "held", [{"free": "z"}, {"free": ("a",)}, {"force": (1, np.nan, 0)}, {"moment": (1, 2)}]
)
def test_wrong_arguments(held):
    with pytest.raises(InputError):
        plane().held_by(**held)


def test_refused_where_it_is_not_known(comm):
    tool = plane()
    tool.held_by(force=(0, 0, -1), free=("z",))
    problem = under(comm, tool, friction=Tresca(1.0)).problem()
    with pytest.raises(InputError, match="method='projected_newton'"):
        problem.solve(method="imssn")
    problem.solve()
    for call in (
        lambda: problem.goal_value(ContactForce((0, 0, 1))),
        lambda: problem.goal_error(ContactForce((0, 0, 1))),
        lambda: problem.guaranteed_error(),
        lambda: problem.gradient(ContactForce((0, 0, 1)), []),
    ):
        with pytest.raises(InputError, match="held by forces"):
            call()
    with pytest.raises(InputError, match="small sliding"):
        under(comm, tool).but(sliding="finite").problem().solve()
    floor = RigidPlane(point=(0, 0, 0), normal=(0, 0, 1))
    floor.held_by(force=(0, 0, 1), free=("z",))
    with pytest.raises(InputError, match="need a ContactProblem"):
        rubber_block(comm, (2, 2, 2), obstacle=floor).problem().solve()
    flat = RigidPlane(point=(0.5, 1.0), normal=(0, -1))
    flat.held_by(free=("z",))
    with pytest.raises(InputError, match="x, y, rz"):
        under(comm, flat, (3, 3)).problem().solve()


def test_a_tool_that_turns_far(comm):
    tool = plane()
    tool.held_by(force=(0, 0, -1e3), about=(0.55, 0.5, 1), free=("z", "ry"))
    with pytest.raises(OutsideTheoryError, match="turns by"):
        under(comm, tool).problem().solve().raise_if_failed()


def test_a_tool_that_sinks_into_held_nodes_is_warned_of(comm, caplog):
    """They have no pressure that could stop it; the depth is that of the tool's own motion."""
    tool = plane()
    tool.held_by(force=(0, 0, -0.1), free=("z",))
    scene = under(comm, tool, (3, 3, 3), friction=Frictionless())
    normal = scene.V.sub(2)
    at_left = fem.locate_dofs_topological(normal, 2, scene.facet_tags.find(LEFT))
    with scene.problem(bcs=[*scene.bcs, fem.dirichletbc(0.0, at_left, normal)]) as problem:
        surface = problem.solve(rtol=RTOL).surface
        depth = -surface.obstacle.motion.translation[2]
        held = (surface.points[:, 0] < 1e-9) & (surface.state.x.array >= 0)
        assert surface.gap.x.array[held] == pytest.approx(-depth, rel=ACCURACY)
    assert depth > 0.0
    assert (f"overlaps by up to {depth:.3g}, at (" in logged(caplog)) == (comm.rank == 0)
