"""Rigid obstacles that move: forces and slip depend on the relative motion only."""

from __future__ import annotations

from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest
from held_blocks import block_over
from logged import logged

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactStatus,
    Coulomb,
    InputError,
    NewtonOptions,
    NonlinearContactProblem,
    RigidPlane,
    RigidSphere,
    SolverOptions,
    Tresca,
)
from dolfinx_tresca.problem import newton as newtons_method
from scenes.rubber_block import neo_hookean, rubber_block

#: Accuracy of the configuration with finite sliding, and of the contact problems.
GEOMETRY, RTOL = 1e-6, 1e-9
OPTIONS = SolverOptions(rtol=RTOL, geometry_accuracy=GEOMETRY)

#: Accuracy of Newton's method that a single step reaches for a part of the load.
ROUGH = 1e-2

#: Coefficient of friction, overlap at the start, radius of balls.
F, DOWN, RADIUS = 0.3, 0.05, 1.0

#: Motion of the obstacle in the steps of a process, along it.
STEPS = (0.02, 0.06, 0.03, -0.1)


def plane():
    """Return a floor that overlaps the block."""
    return RigidPlane((0.0, DOWN), (0.0, 1.0))


def ball():
    """Return a ball that overlaps the block."""
    return RigidSphere((0.45, DOWN - RADIUS), RADIUS)


def over(comm, obstacle, friction, sliding):
    """Return a block that its top holds over an obstacle, and the motion of the top."""
    scene, top = block_over(comm, (8, 3), 0.4, obstacle, friction)
    return scene.but(sliding=sliding).problem(options=OPTIONS), top


@pytest.mark.parallel
def test_a_ball_that_jumps_into_the_block_is_warned_of(comm, caplog):
    """No node faces the ball any more, as if the bodies had parted."""
    obstacle = ball()
    problem, _ = over(comm, obstacle, Coulomb(F), "finite")
    with problem:
        obstacle.move_to((0.0, 2.5 * RADIUS))
        assert problem.solve().normal_force == 0.0
    assert ("smaller steps" in logged(caplog)) == (comm.rank == 0)


@pytest.mark.parallel
@pytest.mark.parametrize(
    "make, friction, sliding",
    [
        (plane, Coulomb(F), "small"),
        (plane, Tresca(3.0), "small"),
        (plane, Coulomb(F), "finite"),
        (ball, Coulomb(F), "finite"),
    ],
    ids=["plane", "plane, Tresca", "plane, finite", "ball, finite"],
)
def test_moved_obstacle_or_moved_body(comm, make, friction, sliding):
    """A process in which the obstacle moves is the one in which the body moves the other way."""
    results = []
    for moves_obstacle in (True, False):
        obstacle = make()
        problem, top = over(comm, obstacle, friction, sliding)
        rows = []
        with problem:
            for x in STEPS:
                if moves_obstacle:
                    obstacle.move_to((x, 0.0))
                else:
                    top.value[:] = (-x, 0.0)
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
                numbers = solution.total_dissipation, solution.greatest_slip
                force = solution.pair_resultants[0].force
                rows.append([*force, *numbers, solution.greatest_total_slip])
        results.append(np.array(rows))
    # forces at the right, and the dissipation, are relative to the greatest ones
    scale = np.abs(results[0]).max(axis=0)
    accuracy = 100 * RTOL if sliding == "small" else 20 * GEOMETRY
    assert (np.abs(results[0] - results[1]) <= accuracy * scale).all()
    assert (np.sign(results[0][[0, 1, 3], 0]) == [1.0, 1.0, -1.0]).all()  # friction drags the block


def test_dissipation_is_of_first_order_in_time(comm):
    """The error of the dissipation in n steps is e / n, for a plane that slides and sinks.

    All nodes slip, and pressures and slips are linear in time: then this is exact, with e half the
    dissipation of the change of the pressures.
    """
    dissipations = []
    for parts in (1, 2, 4):
        obstacle = plane()
        problem, _ = over(comm, obstacle, Coulomb(F), "small")
        with problem:
            for x in (0.2, *np.linspace(0.2, 1.2, parts + 1)[1:]):
                obstacle.move_to((x, -0.5 * DOWN * (x - 0.2)))
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
                if x == 0.2:
                    first = solution
        assert solution.counts.contact_stick == 0
        dissipations.append(solution.total_dissipation - first.total_dissipation)
    one, two, four = dissipations
    end = F * (first.normal_force + solution.normal_force) / 2.0  # times 1.0, the way of the plane
    assert (two - one) / (four - two) == pytest.approx(2.0, rel=1e-3)
    assert two + (two - one) == pytest.approx(end, rel=0.05)  # with the shear of the block
    assert one < 0.8 * end


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
@pytest.mark.parametrize("angle", [0.1, -0.1])
def test_a_wheel_drives_what_it_touches(comm, angle, sliding):
    """All nodes slip, so that the moment about the centre is F R times the normal forces."""
    wheel = ball()
    problem, _ = over(comm, wheel, Coulomb(F), sliding)
    with problem:
        problem.solve().raise_if_failed()
        problem.accept()
        products = problem.solve().products
        for k in range(1, 5):
            wheel.move_to(rotation=k * angle)
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            assert sliding == "finite" or solution.products <= products + 8  # B is what it was
    assert solution.counts.contact_stick == 0
    (about,) = solution.resultants((0.45, DOWN - RADIUS))
    assert np.sign(about.moment.item()) == np.sign(angle)
    if sliding == "finite":
        wanted = F * RADIUS * solution.normal_force
        assert abs(about.moment.item()) == pytest.approx(wanted, rel=20 * GEOMETRY)


@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_a_trial_leaves_no_trace(comm, sliding):
    """A solve that is not accepted, with the obstacle elsewhere, changes no later solve."""
    forces = []
    for trial in (False, True):
        obstacle = ball()
        problem, _ = over(comm, obstacle, Coulomb(F), sliding)
        with problem:
            for x in (0.02, 0.03):
                obstacle.move_to((x, 0.0))
                problem.solve().raise_if_failed()
                problem.accept()
            if trial:
                obstacle.move_to((-0.1, 0.01), rotation=0.2)
                problem.solve()
            obstacle.move_to((0.05, 0.0))
            forces.append(problem.solve().pair_resultants[0].force)
    assert np.allclose(*forces, rtol=0.0, atol=20 * GEOMETRY * np.linalg.norm(forces[0]))


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_restart(comm, folder, sliding):
    """A file of the state has the place of the obstacle at the accepted step."""
    forces = []
    for restarts in (False, True):
        problem, _ = over(comm, obstacle := ball(), Coulomb(F), sliding)
        obstacle.move_to((0.05, 0.0))
        problem.solve().raise_if_failed()
        problem.accept()
        if restarts:
            problem.save_state(folder / "state.npz")
            problem.destroy()
            problem, _ = over(comm, obstacle := ball(), Coulomb(F), sliding)
            problem.load_state(folder / "state.npz")
        with problem:
            obstacle.move_to((0.03, 0.0), rotation=0.01)
            solution = problem.solve()
            solution.raise_if_failed()
        forces.append([*solution.pair_resultants[0].force, solution.greatest_total_slip])
    assert np.allclose(*forces, rtol=0.0, atol=20 * GEOMETRY * np.linalg.norm(forces[0]))


def rubber_over(comm, obstacle, sliding):
    """Return a block of rubber that its top holds over an obstacle, and the motion of the top."""
    scene, top = block_over(comm, (8, 3), 0.4, obstacle, Coulomb(F))
    u = fem.Function(scene.V)
    residual = ufl.derivative(neo_hookean(u) * ufl.dx, u, ufl.TestFunction(scene.V))
    pairs = scene.but(sliding=sliding).pairs
    return NonlinearContactProblem(residual, u, pairs, scene.bcs, options=OPTIONS), top


@pytest.mark.parametrize(
    "given, message",
    [
        ({"translation": 1.0}, "translation must be 2 or 3"),
        ({"translation": (np.nan, 0.0)}, "translation must be 2 or 3 finite"),
        ({"rotation": (0.0, 1.0)}, "rotation must be 3 finite numbers"),
        ({"rotation": np.inf}, "rotation must be a finite number"),
        ({"about": "centre"}, "about must be 2 or 3 finite numbers"),
    ],
)
def test_motions_that_are_wrong(given, message):
    """Wrong motions are refused, and the obstacle stays where it was."""
    obstacle = ball()
    before = obstacle.motion
    with pytest.raises(InputError, match=message):
        obstacle.move_to(**given)
    assert obstacle.motion == before


@pytest.mark.parallel
def test_newton_moves_an_obstacle_in_parts(comm):
    """Where Newton steps are too few the way of the obstacle is halved, also after a failure."""
    forces, parts, released = [], [], []
    for newton in (NewtonOptions(), NewtonOptions(accuracy=ROUGH, max_iterations=1)):
        wheel = ball()
        problem, _ = rubber_over(comm, wheel, "small")
        with problem:
            problem.solve().raise_if_failed()
            wheel.move_to((0.1, 0.05))
            failed = problem.solve(newton=NewtonOptions(max_iterations=1, max_halvings=0))
            assert failed.status is ContactStatus.NO_EQUILIBRIUM
            started = problem.solve(newton=newton)
            again = problem.solve().newton  # with the same load: nothing moves
            assert abs(again.released) <= ROUGH * started.dissipation and not again.snaps
            released.append(started.newton.released)
            problem.accept()
            wheel.move_to((-0.2, 0.1))
            problem.solve().raise_if_failed()  # a trial
            wheel.move_to((0.05, 0.08), rotation=0.1)
            place = wheel.motion
            solution = problem.solve(newton=newton)
            solution.raise_if_failed()
            assert wheel.motion == place
        parts.append(len({step.fraction for step in solution.newton.steps}))
        forces.append(solution.pair_resultants[0].force)
    assert parts[0] == 1 < parts[1]
    assert np.allclose(*forces, rtol=0.0, atol=ROUGH * np.linalg.norm(forces[0]))
    assert released[0] == pytest.approx(released[1], abs=ROUGH * started.dissipation)


@pytest.mark.parallel
def test_other_nodes_face_an_obstacle_on_its_way(comm, monkeypatch):
    """A part that fails leaves neither tractions nor the obstacle where it had moved it."""
    monkeypatch.setattr(newtons_method, "MAX_ITERATIONS_FACTOR", 1)
    forces, failed = [], []
    for limit in (30, 8):
        pin = RigidSphere((1.0, -0.3), 0.3)
        scene = rubber_block(comm, (24, 3), size=(6.0, 0.5), clamped=True, obstacle=pin)
        options = SolverOptions(rtol=1e-7)
        with scene.but(sliding="finite").problem(options=options) as problem:
            pin.move_to((0.0, 0.02))
            problem.solve().raise_if_failed()
            problem.accept()
            facing = (problem.solve().state.x.array >= 0).sum()
            pin.move_to((0.4, 0.15))
            solution = problem.solve(newton=NewtonOptions(1e-8, limit, 8))
            solution.raise_if_failed()
        fractions = [step.fraction for step in solution.newton.steps]
        failed.append(any(after < before for before, after in pairwise(fractions)))
        forces.append(solution.pair_resultants[0].force)
        changed = (solution.state.x.array >= 0).sum() != facing
        assert comm.allreduce(bool(changed), op=MPI.LOR)
    assert failed == [False, True]
    assert np.allclose(*forces, rtol=0.0, atol=1e-4 * np.linalg.norm(forces[0]))
