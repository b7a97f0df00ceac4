"""Finite sliding: surfaces are paired where the solution brings them."""

from __future__ import annotations

import logging
from dataclasses import replace
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest
from held_blocks import block_over
from rotations import in_plane

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactStatus,
    ConvergenceError,
    Coulomb,
    Frictionless,
    InputError,
    NewtonOptions,
    NonlinearContactProblem,
    PairingError,
    RigidObstacle,
    RigidSphere,
    SolverOptions,
)
from dolfinx_tresca.contact import finite_sliding
from scenes.blocks import ABOVE, BELOW, block
from scenes.elasticity import fixed
from scenes.large_sliding import RING_GAP, half_ring
from scenes.patches import BOTTOM, TOP, UPPER, patch
from scenes.rubber_block import neo_hookean, rubber_block

#: Accuracy of the configuration in these tests, and of the contact problems.
GEOMETRY, RTOL = 1e-5, 1e-9

OPTIONS = SolverOptions(rtol=RTOL, geometry_accuracy=GEOMETRY)

#: Coefficient of friction.
F = 0.3

#: More Newton steps than Newton's method takes as a rule for a part of the load.
MANY_STEPS = NewtonOptions().max_iterations + 5

#: Strain of a displacement that Newton's method starts from.
START = 0.3

#: Horizontal and vertical motion of a block over a ball of this radius.
PUSH, DOWN, RADIUS = 0.3, 0.08, 1.0


def over_a_ball(comm, shift, friction, ball=None, sliding="finite"):
    """Return a block over a ball that is shifted the other way, and the motion of its top."""
    ball = RigidSphere((0.5 - shift, -RADIUS), RADIUS) if ball is None else ball
    scene, motion = block_over(comm, (10, 4), 0.5, ball, friction, at=(PUSH - shift, -DOWN))
    return scene.but(sliding=sliding).problem(options=OPTIONS), motion


def settled(problem, rounds=15):
    """Return the solution of the loop of solves and updates of the geometry."""
    for _ in range(rounds):
        solution = problem.solve()
        solution.raise_if_failed()
        problem.update_geometry(solution.u)
    return solution


@pytest.mark.parallel
@pytest.mark.parametrize("friction", [Frictionless(), Coulomb(F)], ids=["frictionless", "Coulomb"])
def test_as_the_loop_of_updates(comm, friction):
    """The solution is the fixed point of the loop of solves and updates, for fewer configurations.

    Before the first load step the slip of the loop counts from the undeformed state, too.
    """
    problem, _ = over_a_ball(comm, 0.0, friction)
    with problem:
        solution = problem.solve()
        solution.raise_if_failed()
        loop = settled(problem)
    found, wanted = (one.pair_resultants[0].force for one in (solution, loop))
    assert np.allclose(found, wanted, rtol=0.0, atol=5 * GEOMETRY * np.linalg.norm(wanted))


@pytest.mark.parallel
def test_a_ball_that_is_elsewhere(comm):
    """A block pushed over a ball has the forces of a block pressed on a ball that is there.

    Both are paired where their tops are moved to, so the one needs no more configurations.
    """
    forces, configurations = [], []
    for shift in (0.0, PUSH):
        seen = []
        problem, _ = over_a_ball(comm, shift, Frictionless())
        with problem:
            solution = problem.solve(observer=seen.append)
            solution.raise_if_failed()
        forces.append(solution.pair_resultants[0].force)
        configurations.append(seen[-1].configuration)
    assert np.allclose(*forces, rtol=0.0, atol=5 * GEOMETRY * np.linalg.norm(forces[0]))
    assert configurations[0] == configurations[1]


def test_steps_of_a_process(comm):
    """A block that slips all over has F R N about the ball's centre, in one step or in four."""
    for parts in (1, 4):
        problem, motion = over_a_ball(comm, 0.0, Coulomb(F))
        with problem:
            whole = motion.value.copy()
            for part in range(1, parts + 1):
                motion.value[:] = part / parts * whole
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
        (about,) = solution.resultants((0.5, -RADIUS))
        expected = F * RADIUS * solution.normal_force
        assert solution.counts.contact_stick == 0
        assert abs(about.moment.item()) == pytest.approx(expected, rel=20 * GEOMETRY)


def over_the_edge(comm, friction, finer=1):
    """Return a block at the end of another one, and the motion of its top."""
    scene = patch(
        comm,
        "quadrilateral",
        upper=(4 * finer, 2 * finer),
        lower=(5 * finer, 2 * finer),
        distort=0.0,
        span=[(0.5, 1.0)],
        friction=friction,
    )
    motion = fem.Constant(scene.mesh, np.zeros(2))
    tags = scene.facet_tags
    bcs = [fixed(scene.V, tags.find(TOP), motion), fixed(scene.V, tags.find(BOTTOM))]
    return scene.but(sliding="finite").problem(bcs=bcs, options=OPTIONS), motion


def moved_to(problem, motion, x):
    """Return the solution, which is accepted, with the top moved by x and pressed down."""
    motion.value[:] = x, -0.01
    solution = problem.solve()
    solution.raise_if_failed()
    problem.accept()
    return solution


def test_force_is_smooth_over_edges_of_facets_and_past_the_end(comm):
    """A block slides slowly over the other one's end, in steps of 1/20 of the coarse cells.

    Where a node passes an edge of a facet or the end, the force has no jump. Its slope has one,
    which is proportional to the size of the cells.
    """
    kinks = []
    for finer in (1, 2):
        problem, motion = over_the_edge(comm, Frictionless(), finer)
        with problem:
            forces = [
                moved_to(problem, motion, x).pair_resultants[0].force[1]
                for x in np.arange(0.0, 0.4, 0.01)
            ]
        changes = np.diff(forces)
        kinks.append(np.abs(np.diff(changes)).max() / abs(changes.mean()))
    assert kinks[0] < 1.0  # in units of the mean change of the force in a step
    assert kinks[1] < 0.7 * kinks[0]  # order 1: a half


@pytest.mark.long
def test_dissipation_is_extrapolated_in_time(comm):
    """A block is pushed over a ball: the same force at the end, and dissipations with errors e / n.

    The pressures change along the way. Twice the dissipation of 2 n steps minus the one of n steps
    has no error of first order.
    """
    forces, dissipations = [], []
    for steps in (1, 2, 4):
        problem, motion = over_a_ball(comm, 0.0, Coulomb(F))
        with problem:
            for x in (-PUSH, *np.linspace(-PUSH, PUSH, steps + 1)[1:]):
                motion.value[:] = x, -DOWN
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
                if x == -PUSH:
                    first = solution.total_dissipation
        forces.append(solution.pair_resultants[0].force)
        dissipations.append(solution.total_dissipation - first)
    atol = 10 * GEOMETRY * np.linalg.norm(forces[0])
    assert np.allclose(forces, forces[0], rtol=0.0, atol=atol)
    one, two, four = dissipations
    assert 1.5 < (two - one) / (four - two) < 2.5  # 2 to first order
    coarse, fine = 2.0 * two - one, 2.0 * four - two
    assert abs(fine - coarse) < 0.2 * (fine - two)


@pytest.mark.parallel
def test_over_the_edge_and_back(comm):
    """A block leaves the other one, and its forces return when it comes back."""
    problem, motion = over_the_edge(comm, Frictionless())
    forces = {}
    with problem:
        for x in (0.0, 0.3, 0.7, 0.3, 0.0):
            solution = moved_to(problem, motion, x)
            forces.setdefault(x, []).append(solution.pair_resultants[0].force)
    assert np.array_equal(forces[0.7][0], np.zeros(2))
    assert forces[0.3][0][1] < 0.8 * forces[0.0][0][1]
    for x in (0.0, 0.3):
        size = np.linalg.norm(forces[x][0])
        assert np.allclose(*forces[x], rtol=0.0, atol=10 * GEOMETRY * size)


@pytest.mark.parallel
def test_a_body_that_comes_from_afar(comm, caplog):
    """It starts farther away than its size, and has the forces of a body that was there."""
    forces = []
    for away in (0.0, 5.0):
        scene = patch(
            comm,
            "quadrilateral",
            upper=(2, 1),
            lower=(4, 2),
            distort=0.0,
            span=[(0.2 + away, 0.6 + away)],
        )
        motion = fem.Constant(scene.mesh, np.zeros(2))
        tags = scene.facet_tags
        bcs = [fixed(scene.V, tags.find(TOP), motion), fixed(scene.V, tags.find(BOTTOM))]
        with (
            caplog.at_level(logging.WARNING, "dolfinx_tresca"),
            scene.but(sliding="finite").problem(bcs=bcs, options=OPTIONS) as problem,
        ):
            for x in (0.5 * away, away):
                motion.value[:] = -x, -0.01
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
        forces.append(solution.pair_resultants[0].force)
    assert np.allclose(*forces, rtol=0.0, atol=5 * GEOMETRY * np.linalg.norm(forces[0]))
    assert not any("linear theory" in message for message in caplog.messages)


def test_no_error_where_only_prescribed_nodes_face(comm):
    """A held node that faces the other side carries nothing; the others come later."""
    scene = patch(comm, "quadrilateral", upper=(2, 1), lower=(4, 2), distort=0.0, span=[(0.9, 1.9)])
    tags, V = scene.facet_tags, scene.V
    motion = fem.Constant(scene.mesh, np.zeros(2))
    x = V.tabulate_dof_coordinates()
    corner = np.flatnonzero(np.isclose(x[:, 0], 0.9) & (x[:, 1] > 0.9)).astype(np.int32)
    bcs = [
        fixed(V, tags.find(TOP), motion),
        fem.dirichletbc(motion, corner, V),
        fixed(V, tags.find(BOTTOM)),
    ]
    with pytest.raises(PairingError, match="1 are prescribed"):
        scene.problem(bcs=bcs)
    with scene.but(sliding="finite").problem(bcs=bcs, options=OPTIONS) as problem:
        for shift, pressed in ((0.0, False), (-0.6, True)):
            motion.value[:] = shift, -0.01
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            assert (solution.normal_force > 0.0) == pressed
    everything = [fixed(V, tags.find(tag)) for tag in (TOP, UPPER, BOTTOM)]
    with pytest.raises(PairingError, match="no node of the secondary side"):
        scene.but(sliding="finite").problem(bcs=everything)


def test_the_path_of_nodes_that_leave(comm, folder):
    """The path of all slips of a node that leaves the other side and returns; in files, too."""
    problem, motion = over_the_edge(comm, Coulomb(F))
    with problem:
        for x in (0.0, 0.3, 0.7):
            solution = moved_to(problem, motion, x)
        assert solution.counts.nodes == 0
        problem.save_state(folder / "state.npz")
    problem, motion = over_the_edge(comm, Coulomb(F))
    with problem:
        problem.load_state(folder / "state.npz")
        for x in (0.3, 0.0):
            solution = moved_to(problem, motion, x)
    assert solution.greatest_slip == pytest.approx(0.3, rel=0.1)
    assert solution.greatest_total_slip == pytest.approx(0.3 + 0.4 + 0.3, rel=0.1)  # with strains


def two_rubber_blocks(comm):
    """Return a rubber scene of two blocks, its displacement, and Functions at its two ends."""
    scene = patch(
        comm, "quadrilateral", upper=(3, 2), lower=(4, 2), distort=0.0, friction=Coulomb(F)
    )
    u, v = fem.Function(scene.V), ufl.TestFunction(scene.V)
    residual = ufl.derivative(neo_hookean(u) * ufl.dx, u, v)
    motion = fem.Function(scene.V)
    ends = np.concatenate([scene.facet_tags.find(tag) for tag in (TOP, BOTTOM)])
    held = fem.dirichletbc(motion, fem.locate_dofs_topological(scene.V, 1, np.sort(ends)))
    problem = NonlinearContactProblem(
        residual, u, scene.but(sliding="finite").pairs, [held], options=OPTIONS
    )
    return problem, motion


@pytest.mark.parallel
def test_a_rotation_of_all_changes_nothing(comm):
    """Blocks in frictional contact are turned by 90 degrees in 5 steps; forces turn with them."""
    problem, motion = two_rubber_blocks(comm)

    def displaced(x, angle):
        height = x[1] > 0.5 * x[1].max(initial=0.0)
        moved = np.array([x[0] + 0.05 * height, x[1] - 0.05 * height])
        return in_plane(angle) @ moved - x[:2]

    forces = []
    with problem:
        for angle in np.linspace(0.0, np.pi / 2, 6):
            motion.interpolate(lambda x, angle=angle: displaced(x, angle))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            forces.append(in_plane(-angle) @ solution.pair_resultants[0].force)
    size = np.linalg.norm(forces[0])
    assert np.abs(forces[0]).min() > 0.01 * size
    assert np.allclose(forces, forces[0], rtol=0.0, atol=10 * len(forces) * GEOMETRY * size)


def rubber_over_a_ball(comm, divisions):
    """Return a rubber block that is pressed on a ball and pushed over it."""
    ball = RigidSphere((0.5, -RADIUS), RADIUS)
    scene = rubber_block(
        comm, divisions, size=(1.0, 0.5), clamped=True, obstacle=ball, friction=Coulomb(F)
    )
    scene.push.value[:] = PUSH, -DOWN
    return scene


@pytest.mark.parallel
def test_newtons_method_and_the_configuration_converge_together(comm):
    """A rubber block over a ball has the forces of the loop, in a few Newton steps."""
    scene = rubber_over_a_ball(comm, (6, 3))
    with scene.but(sliding="finite").problem(options=OPTIONS) as problem:
        solution = problem.solve()
        solution.raise_if_failed()
    scene.u.x.array[:] = 0.0
    with scene.problem(options=OPTIONS) as problem:
        loop = settled(problem)
    found, wanted = (one.pair_resultants[0].force for one in (solution, loop))
    assert np.allclose(found, wanted, rtol=0.0, atol=5 * GEOMETRY * np.linalg.norm(wanted))
    assert len(solution.newton.steps) <= 12


def test_goes_on_while_the_configuration_converges(comm, monkeypatch):
    """The load is not applied in parts while the error of the configuration falls.

    Newton's residual, which is the one of a single pairing, does not fall any more at that time.
    """
    observe = finite_sliding.FiniteSliding.observe

    def slowly(sliding, u, start):
        observe(sliding, u, start)
        left = MANY_STEPS - sliding.configurations
        sliding.error = max(sliding.error, GEOMETRY * 1.5**left)

    monkeypatch.setattr(finite_sliding.FiniteSliding, "observe", slowly)
    scene = rubber_over_a_ball(comm, (6, 3))
    with scene.but(sliding="finite").problem(options=OPTIONS) as problem:
        solution = problem.solve()
    solution.raise_if_failed()
    assert [step.fraction for step in solution.newton.steps] == [1.0] * MANY_STEPS


def test_slender_bodies_to_a_tight_accuracy(comm):
    """A half ring on a block takes no load step in parts, at a tenth of the default tolerance.

    Its forces are sensitive to the residuals of the contact problems in each configuration.
    """
    ring = half_ring(comm, 32, Coulomb(0.5))
    ring.problem.options = ring.problem.options.with_changes(geometry_accuracy=GEOMETRY)
    with ring.problem:
        for depth in (0.0, 2.0, 4.0, 6.0):
            ring.motion.value[1] = -RING_GAP - depth
            solution = ring.problem.solve()
            solution.raise_if_failed()
            ring.problem.accept()
            assert {step.fraction for step in solution.newton.steps} == {1.0}


def test_a_first_configuration_that_cannot_be_paired(comm, monkeypatch):
    """The load is applied in parts."""
    pair = finite_sliding.FiniteSliding.pair_first_configuration
    tried = []

    def refuse_once(sliding):
        tried.append(sliding)
        if len(tried) == 1:
            raise PairingError("a facet has no area.")
        pair(sliding)

    monkeypatch.setattr(finite_sliding.FiniteSliding, "pair_first_configuration", refuse_once)
    scene = rubber_over_a_ball(comm, (6, 3))
    with scene.but(sliding="finite").problem(options=OPTIONS) as problem:
        solution = problem.solve()
    solution.raise_if_failed()
    assert [step.fraction for step in solution.newton.steps if step.number == 1] == [0.5, 1.0]


def test_a_process_that_is_interrupted(comm, folder):
    """The second half of a process from a file has the forces of the whole process."""
    forces = []
    for interrupted in (False, True):
        problem, motion = over_a_ball(comm, 0.0, Coulomb(F))
        with problem:
            motion.value[:] = 0.5 * PUSH, -DOWN
            problem.solve()
            problem.accept()
            if interrupted:
                problem.save_state(folder / "state.npz")
            else:
                motion.value[:] = PUSH, -DOWN
                forces.append(problem.solve().pair_resultants[0].force)
    problem, motion = over_a_ball(comm, 0.0, Coulomb(F))
    with problem:
        problem.load_state(folder / "state.npz")
        motion.value[:] = PUSH, -DOWN
        forces.append(problem.solve().pair_resultants[0].force)
    assert np.allclose(*forces, rtol=0.0, atol=5 * GEOMETRY * np.linalg.norm(forces[0]))


class MovingBall:
    """The signed distance of a disc whose centre may change."""

    def __init__(self, x):
        self.x = x

    def __call__(self, points):
        """Return distances and normals at points (3, n)."""
        offset = points - np.array([[self.x], [-RADIUS], [0.0]])
        length = np.linalg.norm(offset, axis=0)
        return length - RADIUS, offset / length


@pytest.mark.parallel
@pytest.mark.parametrize("sliding", ["small", "finite"])
def test_a_distance_that_has_changed_is_noticed(comm, caplog, sliding):
    """The forces are those at the new place; with friction the log says what it cannot know."""
    forces = []
    for friction in (Frictionless(), Coulomb(F)):
        for start in (0.4, 0.5):
            ball = MovingBall(start)
            problem, _ = over_a_ball(comm, 0.0, friction, RigidObstacle(ball), sliding)
            with problem:
                problem.solve().raise_if_failed()
                problem.accept()
                ball.x = 0.5
                with caplog.at_level(logging.WARNING, "dolfinx_tresca"):
                    forces.append(problem.solve().pair_resultants[0].force)
    assert np.allclose(*forces[:2], rtol=0.0, atol=5 * GEOMETRY * np.linalg.norm(forces[0]))
    found = sum("move the obstacle by its move_to()" in one for one in caplog.messages)
    assert found == (comm.rank == 0)  # which is the rank that logs
    with pytest.raises(AttributeError):
        RigidSphere((0.5, -RADIUS), RADIUS).center = (0.0, 0.0)


def test_a_trial_solve_leaves_no_trace(comm):
    """A solve with another motion that is not accepted does not change the next solve.

    Early contact problems are solved inaccurately, and better with the products of the trial.
    """
    forces = []
    for trial in (False, True):
        problem, motion = over_a_ball(comm, 0.0, Coulomb(F))
        with problem:
            motion.value[:] = 0.3 * PUSH, -DOWN
            problem.solve()
            problem.accept()
            if trial:
                motion.value[:] = PUSH, -DOWN
                problem.solve()
            motion.value[:] = 0.4 * PUSH, -DOWN
            forces.append(problem.solve().pair_resultants[0].force)
    assert np.allclose(*forces, rtol=0.0, atol=GEOMETRY * np.linalg.norm(forces[0]))


def test_configurations_that_do_not_converge(comm, monkeypatch):
    """The status and the error say so, and what to do; observers see all configurations."""
    seen = []
    problem, _ = over_a_ball(comm, 0.0, Coulomb(F))
    with problem:
        problem.solve(observer=seen.append).raise_if_failed()
        numbers = [one.configuration for one in seen]
        assert numbers == sorted(numbers) and numbers[0] == 1 < numbers[-1]
        assert [one.ended for one in seen].index(True) == len(seen) - 1
    monkeypatch.setattr(finite_sliding, "MAX_CONFIGURATIONS", 2)
    problem, _ = over_a_ball(comm, 0.0, Coulomb(F))
    with problem:
        solution = problem.solve()
        assert solution.status is ContactStatus.MAX_ITERATIONS
        with pytest.raises(ConvergenceError, match=r"In configuration 2 .* smaller load steps"):
            solution.raise_if_failed()
        with pytest.raises(ConvergenceError, match="MAX_ITERATIONS"):
            problem.accept()


@pytest.mark.parametrize(("residual", "small"), [(1e-7, True), (1e-2, False)])
def test_a_change_that_is_small_by_chance(residual, small):
    """Forces that hardly change are no sign of convergence while the residual u - w stays."""

    def function(values):
        return SimpleNamespace(x=SimpleNamespace(array=np.array(values)))

    surfaces = SimpleNamespace(
        comm=MPI.COMM_SELF,
        gaps_at_nodes=lambda u: np.zeros((1, 1)),
        normal_forces_at_nodes=lambda: np.zeros((1, 1)),
        linear=SimpleNamespace(prescribed_displacements=np.zeros(1, dtype=np.bool_)),
        obstacles=SimpleNamespace(extent=1.0),
        rounding_forces=lambda: np.zeros(1),
        state=SimpleNamespace(
            configuration=function([0.0]), accepted=SimpleNamespace(displacement=None)
        ),
    )
    sliding = finite_sliding.FiniteSliding(surfaces)
    for force, distance in ((2.0, 1.0), (1.1, 1e-1), (1.0, 1e-2), (1.0 + 1e-5, residual)):
        surfaces.contact_forces = lambda force=force: np.array([force])
        sliding.observe(function([distance]), 1.0)
    assert sliding.change == pytest.approx(1e-5, rel=1e-3)
    assert (sliding.error < GEOMETRY) is small


def slides_far_and_near(comm):
    """Return a block between a ball with finite sliding and one with small; and its motion."""
    scene = block(comm, (6, 3), boxes=True)
    motion = fem.Constant(scene.mesh, (0.05, -0.02))
    top = fixed(scene.V, scene.facet_tags.find(ABOVE), motion)
    below, beside = RigidSphere((0.5, -RADIUS), RADIUS), RigidSphere((-5.0, 0.25), 4.5)
    far = ContactPair(scene.facet_tags, BELOW, below, Coulomb(F), sliding="finite")
    near = ContactPair(scene.facet_tags, 3, beside, Frictionless())
    return scene.problem(bcs=[top], pairs=[far, near], options=OPTIONS), motion


def test_only_pairs_that_slide_far_are_paired_anew(comm):
    """A pair with small sliding keeps its normals beside one with finite sliding."""
    problem, _ = slides_far_and_near(comm)
    with pytest.raises(InputError, match="sliding must be one of small, finite, found 'large'"):
        replace(problem.pairs[0], sliding="large")
    with problem:
        before = [one.normals.copy() for one in problem.operators]
        problem.solve().raise_if_failed()
        after = [one.normals for one in problem.operators]
    changes = [np.abs(a - b).max(initial=0.0) for a, b in zip(before, after, strict=True)]
    moved = [comm.allreduce(float(change), op=MPI.MAX) for change in changes]
    assert moved[0] > 1e-3
    assert moved[1] == 0.0


@pytest.mark.parallel
def test_a_restart_pairs_each_surface_where_it_was(comm, folder):
    """A file knows the configuration of both kinds of sliding, and that of the accepted step."""

    def second(problem, motion):
        motion.value[0] = 0.1
        solution = problem.solve()
        solution.raise_if_failed()
        return np.array([one.force for one in solution.pair_resultants])

    problem, motion = slides_far_and_near(comm)
    with problem:
        problem.solve().raise_if_failed()
        problem.accept()
        motion.value[0] = 0.3  # a trial leaves the surfaces paired elsewhere
        problem.solve()
        problem.save_state(folder / "state.npz", step=1)
        normals = problem.operators[1].normals.copy()
        expected = second(problem, motion)
    for ranks in (comm, MPI.COMM_SELF):
        problem, motion = slides_far_and_near(ranks)
        with problem:
            for value in (0.0, 0.2):  # another process, which leaves no trace
                motion.value[0] = value
                problem.solve()
                problem.accept()
            assert problem.load_state(folder / "state.npz") == 1
            if ranks is comm:
                assert np.array_equal(problem.operators[1].normals, normals)
            found = second(problem, motion)
        assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_gaps_where_nothing_touches(comm):
    """Gaps are those of where the bodies are, although no force tells when the pairing is right."""
    centre = np.array([0.5, -1.3 * RADIUS])
    scene = rubber_block(
        comm, (6, 3), size=(1.0, 0.5), clamped=True, obstacle=RigidSphere(centre, RADIUS)
    )
    with scene.but(sliding="finite").problem(options=OPTIONS) as problem:
        problem.u.interpolate(lambda x: START * (0.5 - x[1]) * np.array([1.0 + 0.0 * x[0], x[0]]))
        solution = problem.solve(newton=NewtonOptions(accuracy=0.1))
        solution.raise_if_failed()
    surface = solution.surface
    x = surface.points[:, :2] + surface.displacement.x.array.reshape(-1, 2)
    error = surface.gap.x.array - (np.linalg.norm(x - centre, axis=1) - RADIUS)
    assert solution.normal_force == 0.0
    assert np.abs(error).max() <= GEOMETRY * START
