"""Rigid obstacles: signed distances, errors in them, and bodies pressed against obstacles."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from logged import logged
from rotations import rotation

from dolfinx_tresca import (
    ContactPair,
    ContactStatus,
    Frictionless,
    InputError,
    PairingError,
    RigidCylinder,
    RigidObstacle,
    RigidPlane,
    RigidSphere,
    Tresca,
)
from scenes.hertz import RADIUS, cylinder_on_plane, sphere_on_plane
from scenes.patches import KINDS, POISSON, UPPER, dim_of, patch
from scenes.scene import EPS

RTOL = 1e-8
TOLERANCE = 100 * RTOL

OBSTACLES = {
    "plane": RigidPlane((1.0, 2.0, 0.5), (3.0, -1.0, 2.0)),
    "sphere": RigidSphere((0.3, 0.1, -0.2), 1.5),
    "hollow sphere": RigidSphere((0.3, 0.1, -0.2), 1.5, hollow=True),
    "cylinder": RigidCylinder((0.3, 0.1, -0.2), (1.0, 1.0, 0.5), 0.7),
    "hollow cylinder": RigidCylinder((0.3, 0.1, -0.2), (1.0, 1.0, 0.5), 0.7, hollow=True),
    "line": RigidPlane((1.0, 2.0), (3.0, -1.0)),
    "disc": RigidSphere((0.3, 0.1), 1.5),
}


@pytest.mark.parametrize("name", OBSTACLES)
@settings(max_examples=20)
@given(seed=st.integers(0, 10**6))
def test_normals_are_gradients_of_the_distance(name, seed):
    """The point at the distance back along the normal is on the surface."""
    points = np.random.default_rng(seed).standard_normal((20, 3))
    if name in ("line", "disc"):
        points[:, 2] = 0.0
    obstacle = OBSTACLES[name]
    distance, normal = obstacle.at(points)
    step = 1e-6
    for i in range(2 if name in ("line", "disc") else 3):
        way = step * np.eye(3)[i]
        slope = (obstacle.at(points + way)[0] - obstacle.at(points - way)[0]) / (2 * step)
        away = np.linalg.norm(normal, axis=1) > 0.0
        clear = away & (np.abs(distance) < 1.4)  # off the centre, where the normal is not unique
        assert np.allclose(slope[clear], normal[clear, i], atol=1e-4)
    surface, _ = obstacle.at(points - distance[:, None] * normal)
    assert np.abs(surface).max() <= 100 * EPS


@pytest.mark.parametrize("hollow", [False, True])
def test_centre_of_round_obstacles_has_a_unit_normal(hollow):
    for obstacle in (
        RigidSphere((1, 2, 3), 2.0, hollow=hollow),
        RigidCylinder((1, 2, 3), (0, 0, 1), 2.0, hollow=hollow),
    ):
        distance, normal = obstacle.at(np.array([[1.0, 2.0, 3.0]]))
        assert distance[0] == (2.0 if hollow else -2.0)
        assert np.linalg.norm(normal) == 1.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RigidPlane((0, 0, 0), (0, 0, 0)), "normal must have a direction"),
        (lambda: RigidPlane((0,), (0, 0, 1)), "point must be 2 or 3 finite numbers"),
        (lambda: RigidSphere((0,), 1.0), "center must be 2 or 3 finite numbers"),
        (lambda: RigidCylinder((0, 0, 0), (0, 0, 1), 0), "radius must be a positive number"),
        (lambda: RigidCylinder((0, 0, 0), (0, 0, 0), 1.0), "axis must have a direction"),
        (lambda: RigidCylinder((0, 0), (0, 1), 1.0), "axis must be 3 finite numbers"),
        *(
            (lambda point=point: RigidPlane(point, (0, 0, 1)), "point must be 2 or 3 ")
            for point in ((1j, 0, 0), ("1", "2", "3"), None, "abc", (np.nan, 0, 0))
        ),
        *(
            (lambda radius=radius: RigidSphere((0, 0, 0), radius), "radius must be a positive")
            for radius in (0, -1, np.nan, np.inf, None, "1", 1j)
        ),
        (lambda: RigidObstacle(3.0), r"needs a function of points, found 3\.0"),
        (lambda: RigidObstacle(None), "needs a function of points, found None"),
    ],
)
def test_invalid_obstacle_is_an_error(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_a_folded_surface_is_no_fault_of_the_obstacle():
    with pytest.raises(PairingError, match="surface that faces a rigid plane"):
        OBSTACLES["plane"].at(np.array([[0.0, np.nan, 0.0]]))


UP = np.array([[0.0], [0.0], [1.0]])

FAULTS = {
    "only distances": (lambda x: x[2], "must return two arrays"),
    "None": (lambda x: None, "must return two arrays"),
    "three things": (lambda x: (x[0], x, x), "must return two arrays"),
    "text": (lambda x: ("a", "b"), "must return two arrays"),
    "a single distance": (lambda x: (1.0, x), r"found shapes \(\) and"),
    "distances in a row": (lambda x: (x[:1], UP + 0 * x), r"distances of shape"),
    "normals with points in rows": (lambda x: (x[2], (UP + 0 * x).T), r"normals of shape \(3, "),
    "two components": (lambda x: (x[2], (UP + 0 * x)[:2]), r"normals of shape \(3, "),
    "long normals": (lambda x: (x[2], 2 * UP + 0 * x), "length 1.*length 2"),
    "no normals": (lambda x: (x[2], 0 * x), "length 1.*length 0"),
    "complex": (lambda x: (x[2] + 0j, UP + 0 * x), "expected real numbers, found complex128"),
    "NaN at a point": (lambda x: (np.where(x[0] < 0.1, np.nan, x[2]), UP + 0 * x), "distance nan"),
    "inf at a point": (lambda x: (np.where(x[0] < 0.1, np.inf, x[2]), UP + 0 * x), "distance inf"),
    "NaN normals": (lambda x: (x[2], UP + np.nan * x), "length nan"),
}


@pytest.mark.parallel(name=["only distances", "NaN at a point"])
@pytest.mark.parametrize("name", FAULTS)
def test_invalid_signed_distance_raises_on_all_ranks(comm, name):
    """The error names the obstacle; a problem without the fault can be created afterwards."""
    function, message = FAULTS[name]
    scene = patch(comm, "tetrahedron")
    pair = ContactPair(scene.facet_tags, UPPER, RigidObstacle(function, "my hill"), Frictionless())
    with pytest.raises(InputError, match=f"(?s)signed distance of my hill.*{message}"):
        scene.problem(pairs=[pair])
    assert comm.allreduce(1) == comm.size
    with scene.problem() as problem:
        assert problem.contact_nodes > 0


def floor(scene, friction=None, *, away: float = 0.0, flip: float = 1.0) -> ContactPair:
    """Return the plane to which the lower block's face moves, so that uniform stress is exact."""
    modulus = 1000.0 / (1.0 if scene.mesh.geometry.dim == 3 else 1.0 - POISSON**2)
    place = scene.data.move(np.array([0.0, 0.0, 0.0]) + (1.0 - 2.5 / modulus - away) * np.eye(3)[
        scene.mesh.geometry.dim - 1
    ])  # fmt: skip
    plane = RigidPlane(place, flip * scene.data.axis)
    return ContactPair(scene.facet_tags, UPPER, plane, friction or Frictionless())


@pytest.mark.parallel(kind=["triangle", "hexahedron"], degree=[2])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("friction", [Frictionless(), Tresca(0.4)])
def test_a_plane_passes_a_uniform_stress(comm, kind, degree, friction):
    """The scenes are rotated; with friction the exact solution has no tangential displacement."""
    dim = dim_of(kind)
    scene = patch(comm, kind, degree, turn=rotation(2, dim))
    with scene.problem(pairs=[floor(scene, friction)]) as problem:
        assert "rigid plane" in str(problem) and "obstacle" in str(problem)
        solution = problem.solve(rtol=RTOL)
        size = comm.allreduce(len(solution.multipliers))
        assert size == problem.contact_nodes * (1 if isinstance(friction, Frictionless) else dim)
    assert solution.status is ContactStatus.CONVERGED
    if isinstance(friction, Frictionless):
        pressure = solution.pressure.x.array[solution.state.x.array >= 0]
        assert np.abs(pressure - 2.5).max(initial=0.0) <= TOLERANCE * 2.5
        assert solution.normal_force == pytest.approx(2.5, rel=TOLERANCE)
    else:
        assert solution.normal_force == pytest.approx(2.5, rel=0.3)
        assert solution.tangential_force <= 0.4


@pytest.mark.parametrize("kind", KINDS)
def test_plane_with_the_opposite_normal_is_an_error(comm, kind):
    scene = patch(comm, kind)
    with pytest.raises(PairingError, match=r"do not face each other.*rigid plane.*Reverse it"):
        scene.problem(pairs=[floor(scene, flip=-1.0)])


@pytest.mark.parallel
def test_opposite_normal_is_warned_of_with_finite_sliding(comm, caplog):
    """The surfaces need not face each other before they move."""
    scene = patch(comm, "quadrilateral")
    for flip, expected in ((1.0, False), (-1.0, comm.rank == 0)):
        caplog.clear()
        pair = dataclasses.replace(floor(scene, flip=flip), sliding="finite")
        with scene.problem(pairs=[pair]):
            assert ("points into the body" in logged(caplog)) == expected


@pytest.mark.parallel
def test_search_distance_bounds_the_gap(comm):
    scene = patch(comm, "hexahedron")
    pair = floor(scene, away=0.5)
    for distance, carries in ((0.6, True), (0.4, False)):
        near = ContactPair(
            scene.facet_tags, UPPER, pair.primary, Frictionless(), search_distance=distance
        )
        if carries:
            assert comm.allreduce(len(scene.operators(near).nodes)) == 16
        else:
            with pytest.raises(PairingError, match=r"within 0\.4.*search distance"):
                scene.operators(near)


FITTING = {  # function that builds the body, and the size of cells [mm]
    "circle": (cylinder_on_plane, 0.4),
    "sphere": (sphere_on_plane, 0.4),
}


@pytest.mark.parallel
@pytest.mark.parametrize("body", FITTING)
def test_round_bodies_of_degree_2_fit_into_a_hollow_as_round(comm, body):
    """Without the sagitta over straight edges gaps would be too large by two thirds of it.

    They still are next to the border of the tagged surface.
    """
    build, h = FITTING[body]
    scene = build(comm, h, degree=2)
    across = scene.mesh.geometry.dim - 1
    hollow = RigidSphere([0.0] * across + [RADIUS], RADIUS, hollow=True)
    found = scene.but(primary=hollow).operators()
    inner = np.linalg.norm(found.places[:, :across], axis=1) < 1.0
    assert comm.allreduce(inner.sum()) > 2
    largest = comm.allreduce(np.abs(found.gap[inner]).max(initial=0.0), op=MPI.MAX)
    assert largest <= 0.1 * 2.0 / 3.0 * h**2 / (8.0 * RADIUS)


def test_repr_of_primary_tag_and_obstacle(comm):
    scene = patch(comm, "triangle")
    with pytest.raises(InputError, match="or a RigidObstacle, found 'floor'"):
        ContactPair(scene.facet_tags, UPPER, "floor", Frictionless())
    assert str(floor(scene)).startswith("tag 1 on a rigid plane through")
