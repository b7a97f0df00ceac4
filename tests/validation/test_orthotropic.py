"""Friction with two axes: against a conic solver, an analytic block, and what must not matter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import clarabel
import numpy as np
import pytest
from conic import conic_minimum
from rotations import rotation
from scipy.spatial import cKDTree

from dolfinx import fem

from dolfinx_tresca import (
    ContactSolution,
    ContactState,
    ContactStatus,
    Coulomb,
    InputError,
    RigidPlane,
    RigidSphere,
    Tresca,
)
from dolfinx_tresca.scene.friction import Friction
from scenes.assembled import dense_matrix, dual_program
from scenes.blocks import ABOVE, BELOW, FRONT, RIGHT, block, floor
from scenes.blocks import BOUND as BLOCK_BOUND
from scenes.nodal import global_vector, nodal, node_function, surface_nodes_of
from scenes.rubbing import BOUND, YOUNG, rubbing
from scenes.scene import EPS, Scene

#: Slip bound of the rubbing blocks [stress].
G = BOUND * YOUNG

#: Wanted residual, and how many times the tractions' error may be larger, over the largest bound.
RTOL, TRACTION_FACTOR = 1e-9, 1e4


def solved(model: Scene, **options: Any) -> ContactSolution:
    """Return a converged solution."""
    with model.problem() as problem:
        solution = problem.solve(**{"rtol": RTOL, **options})
    solution.raise_if_failed()
    return solution


def rubbed(comm: MPI.Comm, friction: Friction, **arguments: Any) -> Scene:
    return rubbing(comm, "tetrahedron", friction=friction, **arguments)


def node_values(solution: ContactSolution, name: str) -> np.ndarray:
    """Return a field (n,) or (n, 3) at the surface's nodes of all ranks, in the order of places."""
    space = getattr(solution.surface, name).function_space
    points = space.tabulate_dof_coordinates()[: space.dofmap.index_map.size_local]
    return global_vector(space.mesh.comm, points, nodal(getattr(solution.surface, name)))


def axes_of(direction: Sequence[float]) -> np.ndarray:
    """Return the axes (2, 3) on a horizontal surface."""
    first = np.array([direction[0], direction[1], 0.0]) / np.hypot(*direction[:2])
    return np.array([first, np.cross([0.0, 0.0, 1.0], first)])


def conic_tractions(scene: Any, bounds: np.ndarray, direction: Sequence[float]) -> np.ndarray:
    """Return the tractions (n, 3) of nodes with bounds (n, 2), by an interior-point method.

    Nodes are in the order of their places. The operators are those of circles: all that is known of
    ellipses is in the cones.
    """
    with dual_program(scene) as dual:
        jump, (pair,) = dual.jump, dual.jump.pairs
        A, b = dense_matrix(dual), dual.b
        scale, (normal, tangential) = jump.stress_scale, jump.slices[0]
        # in units of stress, and with numbers of size 1
        A, b = A / np.outer(scale, scale), b / scale
        factor = np.abs(np.diag(A)).max()
        rows, right, cones = [], [], []
        rows.append(-np.eye(len(b))[normal])
        right.append(np.zeros(len(rows[-1])))
        cones.append(clarabel.NonnegativeConeT(len(rows[-1])))
        axes = axes_of(direction)
        points = scene.V.tabulate_dof_coordinates()[pair.nodes]
        ordered = global_vector(MPI.COMM_SELF, points, np.arange(len(points)))
        for node, semi_axes in zip(ordered, bounds, strict=True):
            own = np.flatnonzero(pair.tangent_node == node)
            along = np.zeros((2, len(b)))
            along[:, tangential.start + own] = axes @ pair.tangents[own].T
            for axis in np.flatnonzero(semi_axes == 0.0):
                rows.append(along[[axis]])
                right.append(np.zeros(1))
                cones.append(clarabel.ZeroConeT(1))
            kept = semi_axes > 0.0
            cone = -along[kept] / semi_axes[kept, None]
            rows.append(np.vstack([np.zeros(len(b)), cone]))
            right.append(np.append(1.0, np.zeros(kept.sum())))
            cones.append(clarabel.SecondOrderConeT(1 + int(kept.sum())))
        found = conic_minimum(A / factor, -b / factor, rows, right, cones, tolerance=1e-12)
        assert str(found.status) in ("Solved", "AlmostSolved")
        traction = np.zeros((len(pair.nodes), 3))
        np.add.at(traction, pair.tangent_node, np.array(found.x)[tangential, None] * pair.tangents)
    return traction[ordered]


@pytest.mark.parametrize(
    "bounds", [(1.0, 0.3), (0.1, 1.0), (1.0, 0.0), (0.0, 0.5)], ids=lambda pair: f"{pair}"
)
def test_tractions_are_those_of_a_conic_solver(bounds):
    direction = (1.0, 0.4, 0.2)
    g = G * np.array(bounds)
    solution = solved(rubbed(MPI.COMM_SELF, Tresca(tuple(g), direction=direction)))
    scene = rubbing(MPI.COMM_SELF, "tetrahedron", friction=Tresca(G))
    expected = conic_tractions(scene, np.tile(g, (solution.counts.nodes, 1)), direction)
    error = np.abs(node_values(solution, "traction") - expected).max()
    assert error <= TRACTION_FACTOR * RTOL * g.max()
    assert solution.energy_error_bound <= 1e-6
    # the first has what friction takes: the sum of |(g1 s1, g2 s2)|
    assert solution.primal_energy == pytest.approx(solution.dual_energy, rel=1e-9)


@pytest.mark.parametrize("seed", [0, 7])
def test_tractions_with_bounds_that_vary_from_node_to_node(seed):
    """By factors of 10^4, and some are zero."""
    rng, direction = np.random.default_rng(seed), (0.2, 1.0, 0.0)
    scene = rubbing(MPI.COMM_SELF, "tetrahedron", friction=Tresca(G))
    points, _ = surface_nodes_of(solved(scene))
    points = global_vector(MPI.COMM_SELF, points, points)
    bounds = 10.0 ** rng.uniform(-3.0, 1.0, (len(points), 2)) * G
    bounds *= rng.random(bounds.shape) < 0.8
    nearest = cKDTree(points)
    law = Tresca(
        (lambda x: bounds[nearest.query(x.T)[1], 0], lambda x: bounds[nearest.query(x.T)[1], 1]),
        direction=direction,
    )
    solution = solved(rubbed(MPI.COMM_SELF, law))
    assert 0 < solution.counts.stick < solution.counts.nodes
    error = np.abs(
        node_values(solution, "traction") - conic_tractions(scene, bounds, direction)
    ).max()
    assert error <= TRACTION_FACTOR * RTOL * G


def test_coulomb_tractions_are_those_of_a_conic_solver_with_their_own_bounds():
    direction, coefficients = (1.0, -0.5, 0.0), np.array([0.6, 0.2])
    law = Coulomb(tuple(coefficients), direction=direction, limit=0.5 * G)
    solution = solved(rubbed(MPI.COMM_SELF, law))
    pressure = np.maximum(node_values(solution, "pressure"), 0.0)
    largest = coefficients.max()
    bounds = np.minimum(largest * pressure, 0.5 * G)[:, None] * coefficients / largest
    assert (bounds.max(axis=1) == 0.5 * G).any()  # the limit matters
    scene = rubbing(MPI.COMM_SELF, "tetrahedron", friction=Tresca(G))
    expected = conic_tractions(scene, bounds, direction)
    error = np.abs(node_values(solution, "traction") - expected).max()
    assert error <= TRACTION_FACTOR * RTOL * bounds.max()


def numbers(solution: ContactSolution) -> np.ndarray:
    """Return energies, forces, peaks and counts: what does not depend on axes or ranks."""
    counts = solution.counts
    return np.array(
        [
            solution.primal_energy,
            solution.dual_energy,
            solution.normal_force,
            solution.tangential_force,
            solution.peak_pressure,
            solution.greatest_slip,
            counts.contact,
            counts.stick,
        ],
        dtype=float,
    )


def same(one: np.ndarray, other: np.ndarray, tolerance: float) -> bool:
    return bool((np.abs(one - other) <= tolerance * np.abs(other)).all())


@pytest.mark.parametrize("method", ["projected_newton", "gimssn", "imssn", "mssn", "ssn"])
def test_all_algorithms_find_the_same(method):
    law = Tresca((G, 0.5 * G), direction=(1.0, 0.3, 0.0))
    expected = numbers(solved(rubbed(MPI.COMM_SELF, law)))
    rtol = 1e-6
    found = solved(rubbed(MPI.COMM_SELF, law), method=method, rtol=rtol, max_iterations=300)
    assert same(numbers(found), expected, 100 * rtol)
    assert found.energy_error_bound <= 100 * rtol


@pytest.mark.parallel
@pytest.mark.parametrize("kind", ["mortar", "tetrahedron"])
@pytest.mark.parametrize("stiffness", ["cholesky", "multigrid"])
def test_ranks_pairings_and_solvers(comm, kind, stiffness):
    """Frames follow from the surface and the direction, not from the partition."""
    arguments = {"pairing": "mortar"} if kind == "mortar" else {}

    def found(comm, stiffness):
        law = Tresca((G, 0.2 * G), direction=lambda x: np.stack([1.0 + x[0], x[1], x[2]]))
        model = rubbed(comm, law, **arguments)
        with model.problem(stiffness=stiffness) as problem:
            return numbers(problem.solve(rtol=1e-8))

    assert same(found(comm, stiffness), found(MPI.COMM_SELF, "cholesky"), 1e-5)


@pytest.mark.parallel
def test_turned_with_the_scene(comm):
    R = rotation(3)
    direction = np.array([1.0, 0.7, 0.0])
    law = Tresca((G, 0.2 * G), direction=tuple(direction))
    turned = Tresca((G, 0.2 * G), direction=tuple(R @ direction))
    one, other = solved(rubbed(comm, law)), solved(rubbed(comm, turned, turn=R))
    assert same(numbers(other), numbers(one), 1e-6)


@pytest.mark.parallel
def test_bounds_swapped_and_the_direction_turned_by_a_right_angle(comm):
    one = solved(rubbed(comm, Tresca((G, 0.3 * G), direction=(1.0, 0.2, 0.0))))
    other = solved(rubbed(comm, Tresca((0.3 * G, G), direction=(-0.2, 1.0, 5.0))))
    assert same(numbers(other), numbers(one), 1e-6)


@pytest.mark.parametrize("law", [Tresca, Coulomb])
def test_equal_bounds_are_a_circle(law):
    bound = G if law is Tresca else 0.3
    circle = numbers(solved(rubbed(MPI.COMM_SELF, law(bound))))
    equal = law((bound, bound), direction=(1.0, 0.4, 0.0))
    assert same(numbers(solved(rubbed(MPI.COMM_SELF, equal))), circle, 1e-12)
    # turned tangents, and stretched by rounding
    almost = law((bound, (1.0 - 1e-12) * bound), direction=(1.0, 0.4, 0.0))
    assert same(numbers(solved(rubbed(MPI.COMM_SELF, almost))), circle, 1e-7)


@pytest.mark.parallel
def test_what_changes_in_place_counts(comm):
    """Both the ratio and the direction, one after the other, from the last solution."""
    model = rubbed(comm, Tresca(G))
    mesh = model.V.mesh
    second, direction = fem.Constant(mesh, 0.5 * G), fem.Constant(mesh, [1.0, 0.0, 0.0])
    law = Tresca((G, second), direction=direction)
    with model.but(friction=law).problem() as problem:
        problem.solve(rtol=RTOL)
        for bound, towards in (
            (0.1 * G, (1.0, 0.0, 0.0)),
            (0.1 * G, (1.0, 1.0, 0.0)),
            (0.0, (0, 1, 0)),
        ):
            second.value, direction.value = bound, towards
            fresh = solved(model.but(friction=Tresca((G, bound), direction=towards)))
            found = problem.solve(rtol=RTOL)
            assert found.status is ContactStatus.CONVERGED
            assert same(numbers(found), numbers(fresh), 1e-6)
            again = problem.solve(rtol=RTOL)  # nothing has changed: products and start are kept
            assert again.products <= 2


@pytest.mark.parallel
def test_the_last_tractions_are_the_next_start_along_other_axes(comm):
    """The same ellipse, described by other axes: nothing is left to do."""
    model = rubbed(comm, Tresca(G))
    mesh = model.V.mesh
    bounds = [fem.Constant(mesh, value) for value in (G, 0.3 * G)]
    direction = fem.Constant(mesh, (1.0, 0.2, 0.0))
    with model.but(friction=Tresca(tuple(bounds), direction=direction)).problem() as problem:
        first = problem.solve(rtol=1e-6)
        bounds[0].value, bounds[1].value, direction.value = 0.3 * G, G, (-0.2, 1.0, 0.0)
        again = problem.solve(rtol=2e-6)
        assert first.iterations > again.iterations == 0
        assert same(numbers(again), numbers(first), 1e-9)


@pytest.mark.parallel
def test_fields_of_all_kinds_are_the_same_law(comm):
    model = rubbed(comm, Tresca(G))
    mesh = model.V.mesh
    towards = fem.Function(model.V)
    towards.interpolate(lambda x: np.stack([1.0 + x[0], 2.0 * x[0], x[2]]))
    bound = node_function(mesh, lambda x: 0.2 * G * (1.0 + x[0]))
    laws = [
        Tresca((G, bound), direction=towards),
        Tresca((lambda x: G, 1.0 * bound), direction=-2.0 * towards),
        Tresca(
            (fem.Constant(mesh, G), lambda x: 0.2 * G * (1.0 + x[0])),
            direction=lambda x: np.stack([1.0 + x[0], 2.0 * x[0], x[2]]),
        ),
    ]
    first, *others = [numbers(solved(model.but(friction=law))) for law in laws]
    assert all(same(other, first, 1e-6) for other in others)


@pytest.mark.parallel
def test_slip_is_normal_to_the_ellipse(comm):
    """At each node that slips: s_i ~ t_i / g_i^2, and the traction is on the ellipse."""
    g, direction = G * np.array([1.0, 0.3]), (1.0, 0.5, 0.0)
    solution = solved(rubbed(comm, Tresca(tuple(g), direction=direction)))
    axes = axes_of(direction)
    slip, traction = (node_values(solution, name) @ axes.T for name in ("slip", "traction"))
    length = np.linalg.norm(slip, axis=1)
    moves = length > 1e-2 * solution.greatest_slip
    assert moves.any()
    on_ellipse = np.linalg.norm(traction / g, axis=1)
    assert np.abs(on_ellipse[moves] - 1.0).max() <= 1e-6
    assert on_ellipse.max() <= 1.0 + 1e-12
    normal = traction / g**2
    sine = (slip[:, 0] * normal[:, 1] - slip[:, 1] * normal[:, 0])[moves]
    assert np.abs(sine / (length * np.linalg.norm(normal, axis=1))[moves]).max() <= 1e-5
    assert (np.einsum("ni,ni->n", slip, normal)[moves] > 0.0).all()


@pytest.mark.parallel
def test_no_bound_across_lets_slide_freely(comm):
    law = Tresca((G, 0.0), direction=(1.0, 0.0, 0.0))
    solution = solved(rubbed(comm, law))
    slip, traction = (node_values(solution, name) for name in ("slip", "traction"))
    assert np.abs(traction[:, 1]).max() <= 32 * EPS * G
    assert np.abs(traction[:, 0]).max() <= G * (1.0 + 32 * EPS)
    frictionless = node_values(solved(rubbed(comm, Tresca(0.0))), "slip")
    assert np.abs(slip[:, 1]).max() >= 0.5 * np.abs(frictionless[:, 1]).max()
    state = node_values(solution, "state")
    sticks = np.isin(state, [ContactState.STICK, ContactState.OPEN_STICK])
    assert sticks.any() and (~sticks).any()  # as the other direction does
    assert np.abs(slip[sticks, 0]).max() <= 1e-6 * solution.greatest_slip
    none = solved(rubbed(comm, Tresca((0.0, 0.0), direction=(1.0, 0.0, 0.0))))
    assert same(numbers(none), numbers(solved(rubbed(comm, Tresca(0.0)))), 1e-9)


@pytest.mark.parallel
def test_on_a_symmetry_plane_the_bound_is_the_section_of_the_ellipse(comm):
    g, direction = np.array([1.0, 0.2]), np.array([0.6, 0.8, 0.0])
    law = Tresca(tuple(g), direction=tuple(direction))
    model = block(
        comm, held=(ABOVE,), across=(FRONT,), friction=law, moved=lambda x: pushed(x, (4e-3, 0.0))
    )
    solution = solved(model)
    section = 1.0 / np.linalg.norm(direction[:2] * [1.0, -1.0] / g)
    points, fields = surface_nodes_of(solution)
    edge = fields["traction"][np.abs(points[:, 1]) < 1e-9]
    edge = np.concatenate(comm.allgather(edge))
    assert len(edge) == 4 and np.abs(edge[:, 1:]).max() <= EPS
    assert np.abs(edge[:, 0]).max() == pytest.approx(section, rel=1e-9)


def pushed(x: np.ndarray, by: Sequence[float]) -> np.ndarray:
    """Return displacements of the upper face: down, and along the floor."""
    u = np.zeros_like(x)
    u[0], u[1], u[2] = by[0], by[1], -1e-2
    return u


@pytest.mark.parallel
@pytest.mark.parametrize("angle", [0.3, 1.2])
def test_a_stiff_block_slides_as_the_associated_rule_says(comm, angle):
    """Held by springs k: k s = F - R, where the force of friction R has its normal along s."""
    young, spring, bounds, direction = 1e5, 3.0, np.array([0.3, 0.1]), (1.0, 2.0, 0.0)
    force = 0.6 * np.array([np.cos(angle), np.sin(angle)])
    axes = axes_of(direction)
    load = force @ axes
    model = block(
        comm,
        load=(load[0], load[1], -10.0),
        young=young,
        spring=spring,
        friction=Tresca(tuple(bounds), direction=direction),
    )
    solution = solved(model)
    slip = node_values(solution, "slip") @ axes.T
    # s_i = F_i / (k + c g_i^2) with the c for which R_i = c g_i^2 s_i is on the ellipse
    low, high = 0.0, 1e6
    for _ in range(100):
        c = 0.5 * (low + high)
        s = force / (spring + c * bounds**2)
        outside = np.linalg.norm(c * bounds * s) > 1.0
        low, high = (low, c) if outside else (c, high)
    # stresses of up to 10 strain the block
    assert np.abs(slip - s).max() <= 10.0 / young


@pytest.mark.parallel
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("limit", "adhesion"), [(None, 0.0), (10.0, 0.0), (10.0, 0.15)])
def test_a_block_starts_to_slide_at_its_coefficient_along_each_axis(comm, axis, limit, adhesion):
    """An adhesion is a part of the longer semi-axis, and the ratio stays."""
    coefficients, direction = (0.3, 0.1), (2.0, 1.0, 0.0)
    greatest = (0.3 + adhesion) * np.array([1.0, 1.0 / 3.0])[axis]
    towards = axes_of(direction)[axis] * greatest
    law = Coulomb(coefficients, limit, direction, adhesion)

    def pushed_block(part: float):
        return block(comm, load=(*(part * towards[:2]), -1.0), friction=law)

    solution = solved(pushed_block(0.99), rtol=1e-6)
    assert solution.tangential_force == pytest.approx(0.99 * greatest, rel=1e-6)
    with pushed_block(1.01).problem() as problem, pytest.raises(InputError, match="balance"):
        problem.solve()


def test_no_traction_exceeds_the_limit_of_an_ellipse():
    law = Coulomb((0.2, 0.8), direction=(0.0, 1.0, 0.0), limit=0.1 * G)
    traction = node_values(solved(rubbed(MPI.COMM_SELF, law)), "traction")
    assert np.abs(traction[:, 0]).max() >= 0.09 * G
    inside = np.linalg.norm(traction / (0.1 * G * np.array([1.0, 0.25, 1.0])), axis=1)
    assert inside.max() <= 1.0 + 1e-9


def test_open_nodes_carry_nothing_where_friction_is_in_contact_only():
    law = Tresca((G, 0.3 * G), only_in_contact=True, direction=(1.0, 0.0, 0.0))
    solution = solved(rubbed(MPI.COMM_SELF, law))
    pressure, traction = node_values(solution, "pressure"), node_values(solution, "traction")
    assert (traction[pressure == 0.0] == 0.0).all() and (pressure == 0.0).any()
    bounds = np.minimum(10.0 * pressure, G)[:, None] * [1.0, 0.3]
    inside = np.linalg.norm(traction[:, :2] / np.maximum(bounds, 1e-30), axis=1)
    assert inside.max() == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parallel
@pytest.mark.parametrize("spring", [0.0, 1e-3])
def test_bodies_that_contact_holds_feel_what_changes(comm, spring):
    """Free and softly held ones; the direction is wrong in between."""
    model = block(comm, load=(0.25, 0.0, -1.0), spring=spring)
    direction = fem.Constant(model.V.mesh, (1.0, 0.0, 0.0))
    with model.but(friction=Coulomb((0.3, 0.1), direction=direction)).problem() as problem:
        first = numbers(problem.solve(rtol=1e-8))
        direction.value = (0.0, 0.0, 1.0)
        with pytest.raises(InputError, match="normal to the surface"):
            problem.solve()
        direction.value = (0.0, 1.0, 0.0)
        if spring == 0.0:
            with pytest.raises(InputError, match="overcome friction"):
                problem.solve()
        else:
            slides = problem.solve(rtol=1e-8)
            assert slides.status is ContactStatus.CONVERGED
            assert slides.tangential_force == pytest.approx(0.1, rel=1e-3)
        direction.value = (-2.0, 0.0, 1.0)
        again = problem.solve(rtol=1e-8)
        assert again.status is ContactStatus.CONVERGED
        assert same(numbers(again), first, 1e-6)


@pytest.mark.parallel
def test_one_pair_of_two_has_a_direction(comm):
    """A block between the floor and a wall: only the floor has grooves."""
    wall = RigidPlane(point=(1.0, 0.0, 0.0), normal=(-1.0, 0.0, 0.0))
    model = block(
        comm,
        held=(ABOVE,),
        moved=lambda x: pushed(x, (2e-3, 4e-3)),
        obstacles=[(BELOW, floor(3)), (RIGHT, wall)],
    )
    grooved, smooth = model.pairs
    towards = (1.0, 1.0, 0.0)
    law = Tresca((BLOCK_BOUND, 0.3 * BLOCK_BOUND), direction=towards)
    pairs = [replace(grooved, friction=law), smooth]
    found = solved(replace(model, pairs=pairs))
    swapped = solved(replace(model, pairs=pairs[::-1]))
    assert same(numbers(swapped), numbers(found), 1e-6)
    for surface, bounds in zip(found.surfaces, ((1.0, 0.3, 1.0), (1.0, 1.0, 1.0)), strict=True):
        axes = np.vstack([axes_of(towards), [[0.0, 0.0, 1.0]]])
        traction = nodal(surface.traction) @ axes.T / (BLOCK_BOUND * np.array(bounds))
        largest = np.linalg.norm(traction, axis=1).max(initial=0.0)
        assert comm.allreduce(largest, op=MPI.MAX) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_on_a_curved_obstacle_the_direction_is_projected(comm, degree):
    """On a sphere each node has axes of its own."""
    sphere = RigidSphere(center=(0.5, 0.5, -2.0), radius=2.0)
    bounds, direction = BLOCK_BOUND * np.array([1.0, 0.2]), np.array([1.0, 0.5, 0.3])
    model = block(
        comm,
        degree=degree,
        held=(ABOVE,),
        moved=lambda x: pushed(x, (6e-3, 4e-3)),
        obstacles=[(BELOW, sphere)],
        friction=Tresca(tuple(bounds), direction=tuple(direction)),
    )
    places, fields = surface_nodes_of(solved(model))
    points, normals, slip, traction = (
        global_vector(comm, places, values)
        for values in (places, fields["normal"], fields["slip"], fields["traction"])
    )
    towards = np.array([0.5, 0.5, -2.0]) - points
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    assert np.abs(normals - towards).max() <= 0.1
    first = direction - (normals @ direction)[:, None] * normals
    first /= np.linalg.norm(first, axis=1)[:, None]
    axes = np.stack([first, np.cross(normals, first)], axis=1)
    s, t = (np.einsum("nai,ni->na", axes, values) for values in (slip, traction))
    assert np.abs(np.einsum("ni,ni->n", traction, normals)).max() <= 32 * EPS * BLOCK_BOUND
    on_ellipse = np.linalg.norm(t / bounds, axis=1)
    assert on_ellipse.max() == pytest.approx(1.0, abs=1e-9)
    sliding = np.linalg.norm(s * bounds, axis=1)
    # where slip is normal to the ellipse the power is the largest that any traction in it has
    power = np.einsum("na,na->n", s, t)
    assert np.abs(power - sliding).max() <= 1e-6 * sliding.max()
    assert sliding.max() > 0.0


@pytest.mark.parallel
@pytest.mark.parametrize("law", [Tresca, Coulomb])
def test_slip_counts_from_the_last_step_along_other_axes_too(comm, law):
    """The same ellipse, described by other axes in the second step, changes nothing."""
    large, small = (G, 0.3 * G) if law is Tresca else (0.5, 0.2)
    found = []
    for swapped in (False, True):
        model = rubbed(comm, Tresca(G))
        mesh = model.V.mesh
        bounds = [fem.Constant(mesh, value) for value in (large, small)]
        direction = fem.Constant(mesh, (1.0, 0.2, 0.0))
        friction = law(tuple(bounds), direction=direction)
        with model.but(friction=friction).problem() as problem:
            problem.solve(rtol=RTOL)
            problem.accept()
            model.data.exact.x.array[:] *= 0.5
            if swapped:
                bounds[0].value, bounds[1].value = small, large
                direction.value = (-0.2, 1.0, 0.0)
            second = problem.solve(rtol=RTOL)
            assert second.status is ContactStatus.CONVERGED
            problem.accept()
            third = problem.solve(rtol=1e-6)
            assert third.iterations == 0 and third.dissipation <= 1e-6 * second.total_dissipation
        found.append(np.append(numbers(second), [second.dissipation, second.total_dissipation]))
    assert same(found[1], found[0], 1e-6)
