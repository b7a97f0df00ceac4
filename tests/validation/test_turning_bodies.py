"""Linear bodies that turn with finite sliding: each has a frame of its own."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactPair,
    ContactProblem,
    ContactStatus,
    Coulomb,
    Frictionless,
    NonlinearContactProblem,
    RigidPlane,
    StiffnessError,
)
from scenes.boxes import Body, boxes, near
from scenes.elasticity import elasticity, lame_constants
from scenes.scene import Scene
from scenes.turning import RATIO, bearing, gears, rolled, torques, turned

YOUNG = 20.8e3
OUTSIDE, HELD = 1, 2
CELLS = 24


def saint_venant_kirchhoff(u: fem.Function) -> Any:
    mu, lame = lame_constants(YOUNG, 0.3)
    F = ufl.Identity(len(u)) + ufl.grad(u)
    E = (F.T * F - ufl.Identity(len(u))) / 2
    energy = (mu * ufl.inner(E, E) + lame / 2 * ufl.tr(E) ** 2) * ufl.dx
    return ufl.derivative(energy, u, ufl.TestFunction(u.function_space))


def sector() -> tuple[Any, Any]:
    """Return the space on 150 degrees of a ring of radii 6 and 10, and tags of its two arcs."""
    ring = Body(
        (5, 60),
        [(6.0, 10.0), (-np.radians(75.0), np.radians(75.0))],
        move=lambda x: x[:, :1] * np.column_stack([np.sin(x[:, 1]), np.cos(x[:, 1])]),
    )
    made = boxes(MPI.COMM_WORLD, "quadrilateral", [ring])
    return made.V, made.tags((OUTSIDE, [0], near(0, 10.0)), (HELD, [0], near(0, 6.0)))


def disc(length: float = 0.0) -> tuple[Any, Any]:
    """Return the space on a disc or a cylinder, and tags of its round side and of one end."""

    def rounded(x: np.ndarray) -> np.ndarray:
        square, size = x[:, :2], np.abs(x[:, :2]).max(axis=1)
        # equal angles along each side of the square: the mesh has the symmetry of a quarter turn
        angle = np.where(
            np.abs(square[:, 0]) >= np.abs(square[:, 1]),
            np.arctan2(0.0, square[:, 0])
            + np.pi / 4 * square[:, 1] / np.where(square[:, 0], square[:, 0], 1.0),
            np.sign(square[:, 1]) * np.pi / 2
            - np.pi / 4 * square[:, 0] / np.where(square[:, 1], square[:, 1], 1.0),
        )
        # a square at the centre, a circle at the rim
        share = size[:, None]
        circle = share * np.column_stack([np.cos(angle), np.sin(angle)])
        return np.hstack([share * circle + (1.0 - share) * 0.8 * square, x[:, 2:]])

    box = [(-1.0, 1.0), (-1.0, 1.0), *([(0.0, length)] if length else [])]
    kind, divisions = ("hexahedron", (8, 4)) if length else ("quadrilateral", (CELLS, CELLS))
    made = boxes(MPI.COMM_WORLD, kind, [Body(divisions, box, move=rounded)])
    marks = [(OUTSIDE, [0], lambda x: np.abs(x[:, :2]).max(axis=1) > 1.0 - 1e-9)]
    return made.V, made.tags(*marks, *([(HELD, [0], near(2, length))] if length else []))


def sector_problem(kind: type, form: Any = None, load: Any = None) -> Any:
    """Return a sector under a plane, its prescribed displacement, and the rows of its solves."""
    V, tags = sector()
    held, u = fem.Function(V), fem.Function(V)
    bcs = [fem.dirichletbc(held, fem.locate_dofs_topological(V, 1, tags.find(HELD)))]
    plane = RigidPlane(point=(0.0, 9.995), normal=(0.0, -1.0))
    pair = ContactPair(tags, OUTSIDE, plane, Frictionless(), sliding="finite")
    if kind is ContactProblem:
        a = form(V) if form else elasticity(V, YOUNG)
        return ContactProblem(a, load and load(V), [pair], bcs), held
    return NonlinearContactProblem(saint_venant_kirchhoff(u), u, [pair], bcs), held


def turn(held: fem.Function, angle: float) -> None:
    held.interpolate(lambda x: np.vstack([turned(angle)(x), 0.0 * x[2:]])[: len(held)])


@pytest.mark.parallel
def test_a_sector_that_turns_back_has_the_same_energy_and_forces() -> None:
    linear, held = sector_problem(ContactProblem)
    nonlinear, held_exactly = sector_problem(NonlinearContactProblem)
    with linear, nonlinear:
        forces, energies = [], []
        for angle in (0.0, 0.2, 0.4, 0.7, 2 * np.pi):
            turn(held, angle)
            solution = linear.solve(rtol=1e-11, geometry_accuracy=1e-10)
            solution.raise_if_failed()
            linear.accept()
            forces.append(solution.pair_resultants[0].force)
            energies.append(solution.primal_energy)
            if angle == 0.7:
                contact = solution.pair_resultants[0].about((0.0, 0.0))
                support = linear.reaction(HELD, (0.0, 0.0))
                strained = np.abs(solution.deformation.x.array).max()
        for angle in (0.0, 0.35, 0.7):
            turn(held_exactly, angle)
            exact = nonlinear.solve()
            exact.raise_if_failed()
            nonlinear.accept()
    assert np.allclose(support.force, -contact.force, atol=1e-8 * np.linalg.norm(contact.force))
    lever = 10.0 * np.linalg.norm(contact.force)
    assert np.allclose(support.moment, -contact.moment, atol=2e-3 * lever)  # strains: up to 1e-3
    assert np.allclose(forces[-1], forces[0], atol=1e-9 * np.linalg.norm(forces[0]))
    assert abs(energies[-1] / energies[0] - 1.0) < 1e-9
    assert linear.comm.allreduce(strained, op=MPI.MAX) < 0.01
    assert abs(exact.normal_force / np.linalg.norm(forces[3]) - 1.0) < 0.005


@pytest.mark.parametrize("held_by", ["springs", "stresses"])
def test_bodies_without_a_frame_leave_linear_theory(held_by: str) -> None:
    def with_springs(V: Any) -> Any:
        spring = 1e-6 * ufl.inner(ufl.TrialFunction(V), ufl.TestFunction(V)) * ufl.dx
        return elasticity(V, YOUNG) + spring

    def stresses(V: Any) -> Any:
        return 1e-3 * ufl.div(ufl.TestFunction(V)) * ufl.dx

    changes = {"springs": {"form": with_springs}, "stresses": {"load": stresses}}
    problem, held = sector_problem(ContactProblem, **changes[held_by])
    with problem:
        turn(held, 0.1)
        assert problem.solve().status is ContactStatus.OUTSIDE_THEORY


def test_a_spring_that_comes_later_is_refused() -> None:
    spring: list[fem.Constant] = []

    def form(V: Any) -> Any:
        spring.append(fem.Constant(V.mesh, 0.0))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        return elasticity(V, YOUNG) + spring[0] * ufl.inner(u, v) * ufl.dx

    problem, held = sector_problem(ContactProblem, form=form)
    with problem:
        turn(held, 0.1)
        problem.solve().raise_if_failed()
        spring[0].value = 1.0
        with pytest.raises(StiffnessError, match="springs"):
            problem.update_stiffness()


@pytest.mark.parallel
def test_a_disc_rolls_by_a_quarter_turn() -> None:
    V, tags = disc()
    below = RigidPlane(point=(0.0, -0.999), normal=(0.0, 1.0))
    above = RigidPlane(point=(0.0, 0.999), normal=(0.0, -1.0))
    pairs = [
        ContactPair(tags, OUTSIDE, plane, Coulomb(0.5), sliding="finite")
        for plane in (below, above)
    ]
    forces = []
    with ContactProblem(elasticity(V, YOUNG), None, pairs) as problem:
        for angle in np.linspace(0.0, np.pi / 2, 13):
            above.move_to((2.0 * angle, 0.0))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            forces.append(solution.normal_force)
    owned = V.dofmap.index_map.size_local
    points = V.tabulate_dof_coordinates()[:owned, :2]
    x = points + solution.u.x.array.reshape(-1, 2)[:owned]
    sums = V.mesh.comm.allreduce(np.array([*x.sum(axis=0), owned]))
    centre = sums[:2] / sums[2]
    assert np.allclose(centre, [np.pi / 2, 0.0], atol=2e-4)
    rotated = np.column_stack([points[:, 1], -points[:, 0]])
    assert np.abs(x - centre - rotated).max(initial=0.0) < 8e-3
    # the mesh is the same after a quarter turn, up to the creep of a contact of two nodes
    assert abs(forces[-1] / forces[0] - 1.0) < 0.02


@pytest.mark.parallel
def test_a_shaft_carries_its_moment_at_its_deformed_place() -> None:
    V, tags = disc(length=4.0)
    results = {}
    for kind in (ContactProblem, NonlinearContactProblem):
        held, u = fem.Function(V), fem.Function(V)
        bcs = [fem.dirichletbc(held, fem.locate_dofs_topological(V, 2, tags.find(HELD)))]
        plane = RigidPlane(point=(0.0, 0.99, 0.0), normal=(0.0, -1.0, 0.0))
        pair = ContactPair(tags, OUTSIDE, plane, Coulomb(0.3), sliding="finite")
        linear = kind is ContactProblem
        with (
            ContactProblem(elasticity(V, YOUNG), None, [pair], bcs)
            if linear
            else NonlinearContactProblem(saint_venant_kirchhoff(u), u, [pair], bcs)
        ) as problem:
            for angle in (0.0, 0.2, 0.4):
                turn(held, angle)
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
            results[linear] = solution
    moments = [
        results[linear].body_resultants[0].about((0.0, 0.0, 4.0)).moment for linear in (True, False)
    ]
    assert np.allclose(*moments, atol=0.01 * np.linalg.norm(moments[1]))
    friction = results[True].tangential_force
    assert abs(abs(moments[0][2]) / (0.99 * friction) - 1.0) < 0.01
    on_pair = results[True].pair_resultants[0].about((0.0, 0.0, 4.0)).moment
    assert np.allclose(on_pair, moments[0], atol=0.003 * np.linalg.norm(moments[0]))


def turned_through(scene: Scene, problem: Any, angles: Any) -> list[Any]:
    """Return the solutions of load steps at angles [degrees], each of them accepted."""
    solutions = []
    for angle in np.radians(angles):
        scene.data.turn(angle)
        solutions.append(problem.solve())
        solutions[-1].raise_if_failed()
        problem.accept()
    return solutions


@pytest.mark.parallel
def test_two_gears_keep_the_ratio_of_their_moments() -> None:
    scene = gears(MPI.COMM_WORLD)
    with scene.problem() as problem:
        moments = [torques(one) for one in turned_through(scene, problem, (0.0, 13.5, 27.0))]
    ratios = [-gear / pinion for pinion, gear in moments]
    assert ratios == pytest.approx([1.5] * 3, rel=0.01)


@pytest.mark.parametrize(
    ("names", "parts", "angles"),
    [
        (("pinion", "gear"), ("flanks", "outline"), (5.0, 6.0)),
        (("gear", "pinion"), ("flanks", "outline"), (7.0, 8.0)),
        (("pinion", "gear"), ("flanks",), (1.0, 2.0)),
        (("gear", "pinion"), ("flanks",), (0.0,)),
    ],
)
def test_gears_whichever_surfaces_are_paired(names, parts, angles):
    """Whole outlines or flanks alone, from either side: the lands beside the tips carry nothing."""
    scene = gears(MPI.COMM_WORLD)
    sides = [[scene.tags[f"{name} {part}"] for part in parts] for name in names]
    pair = ContactPair(scene.facet_tags, *sides, Frictionless(), sliding="finite", geometry={})
    scene = replace(scene, pairs=[pair])
    with scene.problem() as problem:
        moments = [torques(solution) for solution in turned_through(scene, problem, angles)]
    ratios = [-gear / pinion for pinion, gear in moments]
    assert ratios == pytest.approx([1.5] * len(angles), rel=0.01)


@pytest.mark.parallel
def test_rollers_of_a_bearing_go_on_from_a_file(folder: Path) -> None:
    """After the first turn each step begins where the rollers roll on, also after a restart."""
    whole, later = (bearing(MPI.COMM_WORLD, rollers=3) for _ in "ab")
    path = folder / "bearing.npz"
    with whole.problem() as problem:
        first = turned_through(whole, problem, (0.0, 1.0, 2.0))
        problem.save_state(path)
        expected = turned_through(whole, problem, [3.0])[0]
    with later.problem() as problem:
        problem.load_state(path)
        solution = turned_through(later, problem, [3.0])[0]
    assert rolled(whole, expected) == pytest.approx(3.0 * RATIO, rel=0.005)
    assert solution.normal_force == pytest.approx(expected.normal_force, rel=1e-6)
    assert solution.iterations == expected.iterations < first[1].iterations


@pytest.mark.long
def test_sixteen_rollers_roll_through_a_quarter_turn() -> None:
    scene = bearing(MPI.COMM_WORLD)
    with scene.problem() as problem:
        *_, solution = turned_through(scene, problem, np.arange(91.0))
    assert rolled(scene, solution) == pytest.approx(90.0 * RATIO, rel=0.01)
