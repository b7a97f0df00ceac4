"""Friction with two axes: against an analytic block, and what must not matter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
from dolfinx import fem

from dolfinx_tresca import ContactSolution, ContactStatus, Coulomb, InputError, RigidSphere, Tresca
from dolfinx_tresca.scene.friction import Friction
from scenes.blocks import ABOVE, BELOW, block
from scenes.blocks import BOUND as BLOCK_BOUND
from scenes.nodal import global_vector, nodal, node_function, surface_nodes_of
from scenes.rubbing import BOUND, YOUNG, rubbing
from scenes.scene import EPS, Scene

#: Slip bound of the rubbing blocks [stress].
G = BOUND * YOUNG

#: Wanted residual.
RTOL = 1e-9


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


def numbers(solution: ContactSolution) -> np.ndarray:
    """Return energies, forces, peaks and counts: what does not depend on axes or ranks."""
    names = ("primal_energy", "dual_energy", "normal_force", "tangential_force", "peak_pressure")
    values = [getattr(solution, name) for name in (*names, "greatest_slip")]
    return np.array([*values, solution.counts.contact, solution.counts.stick], dtype=float)


def same(one: np.ndarray, other: np.ndarray, tolerance: float) -> bool:
    return bool((np.abs(one - other) <= tolerance * np.abs(other)).all())


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
    """A change of the ratio or of the direction in place is seen by the next solve."""
    model = rubbed(comm, Tresca(G))
    mesh = model.V.mesh
    second, direction = fem.Constant(mesh, 0.5 * G), fem.Constant(mesh, [1.0, 0.0, 0.0])
    law = Tresca((G, second), direction=direction)
    with model.but(friction=law).problem() as problem:
        problem.solve(rtol=RTOL)
        for bound, towards in ((0.1 * G, (1, 0, 0)), (0.1 * G, (1, 1, 0)), (0.0, (0, 1, 0))):
            second.value, direction.value = bound, towards
            fresh = solved(model.but(friction=Tresca((G, bound), direction=towards)))
            found = problem.solve(rtol=RTOL)
            assert found.status is ContactStatus.CONVERGED
            assert same(numbers(found), numbers(fresh), 1e-6)
            assert problem.solve(rtol=RTOL).products <= 2  # nothing has changed: all is kept


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


def pushed(x: np.ndarray, by: Sequence[float]) -> np.ndarray:
    """Return displacements of the upper face: down, and along the floor."""
    u = np.zeros_like(x)
    u[0], u[1], u[2] = by[0], by[1], -1e-2
    return u


@pytest.mark.parallel
@pytest.mark.parametrize("angle", [0.3, 1.2])
def test_a_stiff_block_slides_as_the_associated_rule_says(comm, angle):
    """The slip of a block on springs is normal to the friction ellipse: k s = F - R."""
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
    """A block slides beyond the coefficient of each axis; adhesions keep the ratio of the axes."""
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


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
def test_on_a_curved_obstacle_the_direction_is_projected(comm, degree):
    """On a sphere each node has the axes of the projected direction."""
    sphere = RigidSphere(center=(0.5, 0.5, -4.0), radius=4.0)
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
    towards = np.array([0.5, 0.5, -4.0]) - points
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


@pytest.mark.parametrize("ratio", [0.25, 0.0])
@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)])
def test_where_one_tangent_is_prescribed_the_bound_is_the_semi_diameter(direction, ratio):
    """A block that cannot move along y is dragged along x: the bound is the ellipse's along x."""
    law = Tresca((BLOCK_BOUND, ratio * BLOCK_BOUND), direction=direction)
    model = block(
        MPI.COMM_SELF, held=(ABOVE,), moved=lambda x: pushed(x, (2e-2, 0.0)), friction=law
    )
    across = model.V.sub(1)
    everywhere = dolfinx.mesh.locate_entities(model.mesh, 3, lambda x: x[0] > -1.0)
    model.mesh.topology.create_connectivity(3, 3)
    dofs = fem.locate_dofs_topological(across, 3, everywhere)
    model.bcs.append(fem.dirichletbc(dolfinx.default_scalar_type(0.0), dofs, across))
    x = axes_of(direction)[:, 0] / [1.0, ratio or 1e-100]
    semi_diameter = BLOCK_BOUND / np.linalg.norm(x)
    _, fields = surface_nodes_of(solved(model))
    assert np.abs(fields["slip"][:, 0]).min() > 0.0
    traction = np.abs(fields["traction"][:, 0])
    assert np.abs(traction - semi_diameter).max() <= 64 * EPS * BLOCK_BOUND


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("direction", "text"),
    [
        ((0.0, 0.0, 2.0), "is normal to the surface: found .0, 0, 2. at "),
        ((0.0, 0.0, 0.0), "is zero: found"),
        ((np.nan, 0.0, 1.0), "is not finite: found .nan, 0, 1. at"),
    ],
)
def test_a_direction_without_a_tangential_part_is_an_error(comm, direction, text):
    """The direction is wrong at a single node, whose position the error names."""

    def wrong_at_a_corner(x):
        corner = np.isclose(x.T, (1.0, 1.0, 0.0)).all(axis=1)
        return np.where(corner, np.reshape(direction, (3, 1)), [[1.0], [0.0], [0.0]])

    law = Tresca((1.0, 0.5), direction=wrong_at_a_corner)
    with block(comm, held=(ABOVE,), friction=law).problem() as problem:
        with pytest.raises(InputError, match=f"{text}.*1, 1, 0.*normal .0, 0, -1.*at 1 of"):
            problem.solve()
