"""Finite sliding: surfaces are paired where the solution brings them."""

from __future__ import annotations

import logging
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from held_blocks import block_over
from scipy.spatial.transform import Rotation

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactPair,
    ContactState,
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
from scenes.patches import BOTTOM, TOP, UPPER, patch
from scenes.rubber_block import neo_hookean, rubber_block

#: Accuracy of the configuration in these tests, and of the contact problems.
GEOMETRY, RTOL = 1e-5, 1e-9

OPTIONS = SolverOptions(rtol=RTOL, geometry_accuracy=GEOMETRY)

#: Coefficient of friction.
F = 0.3

#: Strain of a displacement that Newton's method starts from.
START = 0.3

#: Horizontal and vertical motion of a block over a ball of this radius.
PUSH, DOWN, RADIUS = 0.3, 0.08, 1.0


def over_a_ball(comm, shift, friction, ball=None, sliding="finite"):
    """Return a block over a ball that is shifted the other way, and the motion of its top."""
    ball = RigidSphere((0.5 - shift, -RADIUS), RADIUS) if ball is None else ball
    scene, motion = block_over(comm, (10, 4), 0.5, ball, friction, at=(PUSH - shift, -DOWN))
    return scene.but(sliding=sliding).problem(options=OPTIONS), motion


@pytest.mark.parallel
def test_a_ball_that_is_elsewhere(comm):
    """A block pushed over a ball has the forces of a block pressed on a ball that is there."""
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
    """A block slides slowly over the other one's end, in steps of 1/10 of the coarse cells.

    Where a node passes an edge of a facet or the end, the force has no jump. Its slope has one,
    which is proportional to the size of the cells.
    """
    kinks = []
    for finer in (1, 2):
        problem, motion = over_the_edge(comm, Frictionless(), finer)
        with problem:
            forces = [
                moved_to(problem, motion, x).pair_resultants[0].force[1]
                for x in np.arange(0.0, 0.24, 0.02)
            ]
        changes = np.diff(forces)
        kinks.append(np.abs(np.diff(changes)).max() / abs(changes.mean()))
    assert kinks[0] < 1.0  # in units of the mean change of the force in a step
    assert kinks[1] < 0.7 * kinks[0]  # order 1: a half


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


def test_no_error_where_only_prescribed_nodes_face(comm):
    """Held nodes that face the other side carry nothing; others may come later."""
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
    """The path of slips goes on for nodes that leave the other side and return, and in files."""
    problem, motion = over_the_edge(comm, Coulomb(F))
    with problem:
        for x in (0.0, 0.3, 0.7):
            solution = moved_to(problem, motion, x)
        assert solution.counts.nodes == 0
        assert "no node is paired, coefficient of friction" in str(problem)
        problem.save_state(folder / "state.npz")
    problem, motion = over_the_edge(comm, Coulomb(F))
    with problem:
        problem.load_state(folder / "state.npz")
        for x in (0.3, 0.0):
            solution = moved_to(problem, motion, x)
    assert solution.greatest_slip == pytest.approx(0.3, rel=0.1)
    assert solution.greatest_total_slip == pytest.approx(0.3 + 0.4 + 0.3, rel=0.1)  # with strains


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


def test_configurations_that_do_not_converge(comm, monkeypatch):
    """The status and the error say so, and what to do; observers see all configurations."""
    seen = []
    problem, _ = over_a_ball(comm, 0.0, Coulomb(F))
    with problem:
        problem.solve(observer=seen.append).raise_if_failed()
        numbers = [one.configuration for one in seen]
        assert numbers == sorted(numbers) and numbers[0] == 1 < numbers[-1]
        assert [one.ended for one in seen].index(True) == len(seen) - 1

    def hardly_moved(sliding):  # as Anderson's acceleration may do: forces do not change any more
        newest = sliding._path[-1]
        return newest.w + 1e-7 * (newest.u - newest.w)

    monkeypatch.setattr(finite_sliding.FiniteSliding, "_next", hardly_moved)
    problem, _ = over_a_ball(comm, 0.0, Coulomb(F))
    with problem:
        solution = problem.solve()
        assert solution.status is ContactStatus.MAX_ITERATIONS
        with pytest.raises(ConvergenceError, match=r"In configuration 60 .* smaller load steps"):
            solution.raise_if_failed()
        with pytest.raises(ConvergenceError, match="MAX_ITERATIONS"):
            problem.accept()


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


def moved_aside(scene, x):
    """Move the upper face down and aside."""
    scene.data.held.interpolate(lambda at: np.stack([0 * at[0] + x, 0 * at[0] - 0.02]))


def test_nothing_changes_on_a_plane(comm):
    """Before a plane small sliding is exact: updates change no force and no dissipation."""
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
    """The same load after a step and an update dissipates nothing."""
    scene = block(comm, (4, 3), boxes=True, held=(ABOVE,), friction=Coulomb(0.3))
    moved_aside(scene, 0.03)
    with scene.problem() as problem:
        with pytest.raises(ContactError, match="there is no solution for update_geometry"):
            problem.update_geometry()
        first = problem.solve(rtol=RTOL)
        problem.accept()
        problem.update_geometry()
        again = problem.solve(rtol=RTOL)
    assert first.counts.slip > 0
    assert abs(again.dissipation) < 1e3 * RTOL * first.dissipation


def test_large_slip_is_noticed(comm, caplog):
    """The log says once that nodes have slid far, but not before a plane, nor after an update."""
    with caplog.at_level(logging.WARNING, "dolfinx_tresca"):
        problem, motion = over_a_ball(comm, 0.0, Frictionless(), sliding="small")
        with problem:
            problem.solve()
            solution = problem.solve()
            found = sum("have slid by" in message for message in caplog.messages)
            assert found == (comm.rank == 0)  # which is the one that logs
            caplog.clear()
            problem.update_geometry(solution.u)
            problem.solve()
            assert not caplog.messages
        problem, motion = over_a_ball(comm, 0.0, Frictionless(), sliding="small")
        with problem:
            motion.value[0] = 0.0
            problem.solve()
        across = np.array([[-1.0], [-0.01]])
        scene = block(comm, (4, 3), boxes=True, held=(ABOVE,), moved=lambda x: 0 * x[:2] + across)
        with scene.problem() as problem:
            problem.solve()
    assert not caplog.messages


def test_nodes_that_are_open_may_slide_far(comm, caplog):
    """Nodes that are open may move by three cells without a warning."""
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


@pytest.mark.parallel(steps=[2])
@pytest.mark.parametrize("steps", [2, pytest.param(10, marks=pytest.mark.long)])
def test_a_rotation_of_all_changes_nothing(comm, steps):
    """A block of rubber that rubs on a ball is turned with it, by 90 degrees in 10 steps.

    The ball and the top of the block turn about the same axis, oblique to the contact. Forces turn
    with them, nothing slips and nothing is dissipated.
    """
    axis, about = np.array([0.6, 0.0, 0.8]), np.array([0.2, 0.1, -0.3])
    ball = RigidSphere((0.5, 0.45, -0.95), 1.0)
    scene = block(
        comm, (2, 2, 1), size=(1.0, 1.0, 0.5), friction=Coulomb(F), obstacles=[(BELOW, ball)]
    )
    u, motion = fem.Function(scene.V), fem.Function(scene.V)
    residual = ufl.derivative(neo_hookean(u) * ufl.dx, u, ufl.TestFunction(scene.V))
    top = fem.locate_dofs_topological(scene.V, 2, scene.facet_tags.find(ABOVE))
    pairs = scene.but(sliding="finite").pairs
    bcs = [fem.dirichletbc(motion, top)]
    forces, slips = [], []
    with NonlinearContactProblem(residual, u, pairs, bcs, options=OPTIONS) as problem:
        for angle in np.pi / 20 * np.arange(steps + 1):
            turn = Rotation.from_rotvec(angle * axis)
            R = turn.as_matrix()
            ball.move_to(rotation=angle * axis, about=about)

            def moved(x, R=R):
                pushed_top = x + np.array([[0.04], [0.02], [-0.03]])
                return R @ (pushed_top - about[:, None]) + about[:, None] - x

            motion.interpolate(moved)
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            forces.append(turn.inv().apply(solution.pair_resultants[0].force))
            slips.append(solution.greatest_slip)
    size = np.linalg.norm(forces[0])
    assert np.abs(forces[0]).min() > 0.01 * size
    assert np.allclose(forces, forces[0], rtol=0.0, atol=10 * len(forces) * GEOMETRY * size)
    assert max(slips[1:]) <= 10 * GEOMETRY * slips[0]
