"""Sliding over many cells: the gap about the present displacement, and what is carried over to it.

A block that is pushed aside over a ball is a block that rests, and a ball pushed the other way.
"""

from __future__ import annotations

import logging

from mpi4py import MPI

import numpy as np
import pytest
from held_blocks import block_over

from dolfinx import fem

from dolfinx_tresca import ContactState, Coulomb, Frictionless, InputError, RigidSphere
from scenes.blocks import ABOVE, BELOW, block
from scenes.elasticity import fixed
from scenes.hertz import RADIUS as RADIUS_OF_CYLINDER
from scenes.hertz import cylinder_on_plane
from scenes.patches import BOTTOM, TOP, patch
from scenes.rubber_block import rubber_block
from scenes.scene import EPS

PUSH, DOWN, RADIUS = 0.3, 0.08, 1.0

#: Coefficient of friction.
F = 0.3

#: Residual of contact, and what updates of the geometry have left of a change when they end.
RTOL, SETTLED = 1e-9, 1e-5


def pushed(comm, push, shift=0.0, friction=None, height=0.5, n=(10, 4)):
    """Return a block over a ball, the ball's centre, shifted the other way, and the motion."""
    centre = np.array([0.5 - shift, -RADIUS])
    ball = RigidSphere(centre, RADIUS)
    scene, motion = block_over(comm, n, height, ball, friction or Frictionless(), (push, -DOWN))
    return scene.problem(), centre, motion


def settled(problem, most=10):
    """Return the solution whose geometry is its own."""
    force = np.zeros(2)
    for _ in range(most):
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
        change = solution.pair_resultants[0].force - force
        force = force + change
        if np.linalg.norm(change) < SETTLED * np.linalg.norm(force):
            return solution
        problem.update_geometry(solution.u)
    raise AssertionError(f"still changes by {change}")


def test_pushed_over_a_ball(comm):
    """As with the ball pushed instead; small sliding is far off, and its gap is not the ball's."""
    problem, centre, _ = pushed(comm, PUSH)
    with problem:
        small = problem.solve(rtol=RTOL)
        large = settled(problem)
    other, *_ = pushed(comm, 0.0, shift=PUSH)
    with other:
        wanted = settled(other)
    force, right = (one.pair_resultants[0].force for one in (large, wanted))
    assert np.allclose(force, right, rtol=0.0, atol=10 * SETTLED * np.linalg.norm(right))
    assert np.linalg.norm(small.pair_resultants[0].force - right) > 0.2 * np.linalg.norm(right)
    surface = large.surface
    space = surface.gap.function_space
    at = space.tabulate_dof_coordinates()
    at[:, :2] += surface.displacement.x.array.reshape(-1, 2)
    distance = np.linalg.norm(at[:, :2] - centre, axis=1) - RADIUS
    assert np.abs(surface.gap.x.array - distance).max(initial=0.0) < 1e-4 * DOWN
    assert large.u.function_space.mesh.geometry.x.min(initial=0.0) == 0.0  # the mesh is at rest


def test_rubbed_over_a_ball(comm):
    """What slips all over has F R N about the ball's centre, in one step or in two.

    With one solve a step the geometry is a step behind.
    """
    forces, moments = [], []
    for parts, rounds in ((1, 8), (2, 8), (2, 1)):
        problem, centre, motion = pushed(comm, PUSH, friction=Coulomb(F), n=(10, 4))
        with problem:
            whole = motion.value.copy()
            for part in range(1, parts + 1):
                motion.value[:] = part / parts * whole
                solution = settled(problem, rounds) if rounds > 1 else problem.solve(rtol=RTOL)
                problem.accept()
                problem.update_geometry(solution.u)
        (about,) = solution.resultants(centre)
        forces.append(solution.normal_force)
        moments.append(abs(about.moment.item()))
    assert solution.counts.contact_stick == 0
    assert np.allclose(moments[:2], F * RADIUS * forces[0], rtol=20 * SETTLED)
    assert forces[0] == pytest.approx(forces[1], rel=20 * SETTLED)
    assert abs(forces[2] - forces[0]) > 0.1 * forces[0]


@pytest.mark.parallel(degree=[1])
@pytest.mark.parametrize("degree", [1, 2])
def test_two_bodies(comm, degree):
    """A block pushed along another one finds the nodes that it would find if it had begun there."""
    forces = []
    for push, start in ((0.3, 0.1), (0.0, 0.4)):
        scene = patch(comm, "triangle", degree, upper=(3, 3), span=[(start, start + 0.4)])
        ends = {TOP: np.array([push, -0.02]), BOTTOM: np.zeros(2)}
        bcs = [fixed(scene.V, scene.facet_tags.find(tag), value) for tag, value in ends.items()]
        with scene.problem(bcs=bcs) as problem:
            solution = settled(problem)
        forces.append([solution.normal_force, solution.peak_pressure])
    assert np.allclose(*forces, rtol=100 * SETTLED)


def moved_aside(scene, x):
    """Move the upper face down and aside."""
    scene.data.held.interpolate(lambda at: np.stack([0 * at[0] + x, 0 * at[0] - 0.02]))


@pytest.mark.parallel
def test_bending_counts_once(comm):
    """The gap before a plane that is compared with N u knows the curved surface as it was made.

    What u bends edges of degree 2 by is in N u, and would be in their height once more.
    """
    scene = cylinder_on_plane(comm, 0.5, degree=2)
    with scene.problem() as problem:
        before = problem.operators[0].gap.copy()
        first = problem._contact.surfaces.jump.pairs[0]
        raised = comm.allreduce(first.secondary_sagitta.max(initial=0.0), op=MPI.MAX)
        u = fem.Function(scene.V)
        u.interpolate(lambda x: np.stack([0.0 * x[0], 0.05 * x[0] ** 2]))
        problem.update_geometry(u)
        change = np.abs(problem.operators[0].gap - before).max(initial=0.0)
    assert change <= 1e3 * EPS * RADIUS_OF_CYLINDER
    assert raised > 1e-4 * RADIUS_OF_CYLINDER


def test_nothing_changes_on_a_plane(comm):
    """Before a plane small sliding is exact, and Coulomb's law knows forces, not areas."""
    scene = block(comm, (4, 3), boxes=True, held=(ABOVE,), friction=Coulomb(0.3))
    answers = []
    for update in (False, True):
        with scene.problem() as problem:
            for x in (0.01, 0.03, 0.01):
                moved_aside(scene, x)
                solution = problem.solve(rtol=RTOL)
                problem.accept()
                if update:
                    problem.update_geometry(solution.u)
        answers.append(solution)
    one, other = answers
    assert one.dissipation > 0.0
    for name in ("normal_force", "tangential_force", "dissipation", "total_dissipation"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e3 * RTOL)


def test_an_update_alone_lets_nothing_slip(comm):
    """The same load again, after a step and an update."""
    scene = block(comm, (4, 3), boxes=True, held=(ABOVE,), friction=Coulomb(0.3))
    moved_aside(scene, 0.03)
    with scene.problem() as problem:
        first = problem.solve(rtol=RTOL)
        problem.accept()
        problem.update_geometry(first.u)
        again = problem.solve(rtol=RTOL)
    assert first.counts.slip > 0
    assert abs(again.dissipation) < 1e3 * RTOL * first.dissipation


def test_nonlinear_bodies(comm):
    """The same for rubber, which slides over a ball."""
    forces = []
    for push, shift in ((PUSH, 0.0), (0.0, PUSH)):
        ball = RigidSphere((0.5 - shift, -RADIUS), RADIUS)
        scene = rubber_block(comm, (6, 3), size=(1.0, 0.5), clamped=True, obstacle=ball)
        scene.push.value[:] = push, -DOWN
        with scene.problem() as problem:
            for _ in range(6):
                solution = problem.solve()
                solution.raise_if_failed()
                problem.update_geometry()
        forces.append(solution.pair_resultants[0].force)
    assert np.allclose(*forces, rtol=0.0, atol=1e-3 * np.linalg.norm(forces[0]))


def test_large_slip_is_noticed(comm, caplog):
    """Once for each problem; not before a plane, whose normal is constant, or after an update."""
    with caplog.at_level(logging.WARNING, "dolfinx_tresca"):
        problem, *_ = pushed(comm, PUSH)
        with problem:
            problem.solve()
            solution = problem.solve()
            found = sum("have slid by" in message for message in caplog.messages)
            assert found == (comm.rank == 0)  # which is the one that logs
            caplog.clear()
            problem.update_geometry(solution.u)
            problem.solve()
            assert not caplog.messages
        other, *_ = pushed(comm, 0.0)
        with other:
            other.solve()
        across = np.array([[-1.0], [-0.01]])
        scene = block(comm, (4, 3), boxes=True, held=(ABOVE,), moved=lambda x: 0 * x[:2] + across)
        with scene.problem() as problem:
            problem.solve()
    assert not caplog.messages


def test_nodes_that_are_open_may_slide_far(comm, caplog):
    """A block that rocks about its right end: the left one is open, and moves by three cells."""
    scene = block(
        comm,
        (8, 4),
        boxes=True,
        held=(ABOVE,),
        moved=lambda x: np.array([0.3 * x[0] - 0.3, 0.1 - 0.11 * x[0]]),
        obstacles=[(BELOW, RigidSphere((0.5, -1e3), 1e3))],
    )
    with scene.problem() as problem, caplog.at_level(logging.WARNING, "dolfinx_tresca"):
        solution = problem.solve()
    state, slip = solution.state.x.array, solution.slip.x.array.reshape(-1, 2)
    length = np.linalg.norm(slip, axis=1)
    assert comm.allreduce(length.max(initial=0.0), MPI.MAX) > 1.5 / 8
    pressed = comm.allreduce(length[state >= ContactState.PRESSED].max(initial=0.0), MPI.MAX)
    assert solution.greatest_slip == pytest.approx(pressed)
    assert pressed < 1.0 / 8
    assert not caplog.messages


def test_slip_of_nodes_at_the_rim_of_the_other_side(comm, caplog):
    """Not beyond the facets there, but more than the part of them that is in contact: noticed."""
    scene = patch(
        comm,
        "quadrilateral",
        upper=(2, 1),
        lower=(2, 1),
        distort=0.0,
        span=[(0.9, 1.9)],
        young=(1000.0, 100.0),
        pressure=30.0,
        friction=Coulomb(0.1),
    )
    with scene.problem() as problem, caplog.at_level(logging.WARNING, "dolfinx_tresca"):
        solution = problem.solve()
        one = problem.operators[0]
        part = comm.allreduce(one.weights.min(initial=1.0), MPI.MIN)
        assert part < solution.greatest_slip < 0.25
    assert sum("have slid by" in message for message in caplog.messages) == (comm.rank == 0)


def test_wrong_displacement(comm):
    scene = block(comm, (2, 2))
    with (
        scene.problem() as problem,
        pytest.raises(InputError, match="displacement u of the surfaces must be a disp"),
    ):
        problem.update_geometry(None)
