"""Obstacles are found where their signed distance is zero."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dolfinx_tresca import RigidCylinder, RigidObstacle, RigidPlane, RigidSphere
from dolfinx_tresca.output.pictures.bodies import SAMPLES, draw_obstacle, obstacle_near
from dolfinx_tresca.output.pictures.canvas import OBLIQUE, UPWARDS
from scenes.rigid_obstacle import distance_from_ring

pytest.importorskip("pyvista")

KINDS = [
    RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    RigidSphere((0.0, 0.0, -40.0), 40.0),
    RigidCylinder((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 15.0, hollow=True),
    RigidObstacle(distance_from_ring),
]
CORNERS = np.array([(x, y, z) for x in (-9.0, 9.0) for y in (-9.0, 9.0) for z in (0.0, 12.0)])


@pytest.mark.parametrize("obstacle", KINDS, ids=str)
def test_sampled(obstacle: RigidObstacle) -> None:
    """The contour is off by the square of the grid's spacing, and goes beyond the bodies."""
    grid, _ = obstacle_near(obstacle, CORNERS, 3, OBLIQUE)
    spacing = max(grid.spacing)
    surface = grid.contour([0.0], scalars="distance")
    assert np.abs(obstacle.distance(np.asarray(surface.points))).max() < spacing**2 / 6.0
    assert (np.ptp(surface.points, axis=0)[:2] > 12.0).all()


def test_in_the_plane() -> None:
    plane, corners = RigidPlane((0.0, -0.1), (0.0, 1.0)), np.array([(0, 0, 0), (1, 1, 0)])
    grid, _ = obstacle_near(plane, corners, 2, UPWARDS)
    assert max(grid.dimensions) == SAMPLES[2] + 1
    line = grid.contour([0.0], scalars="distance")
    np.testing.assert_allclose(line.points[:, 1], -0.1, atol=1e-6)


def test_far_away() -> None:
    plane = RigidPlane((0.0, 0.0, -99.0), (0.0, 0.0, 1.0))
    assert obstacle_near(plane, CORNERS, 3, OBLIQUE)[0] is None


def test_functions_without_answers() -> None:
    """What is no number counts as far away."""
    obstacle = RigidObstacle(lambda x: (np.log(x[2]), x))
    found = obstacle.distance(np.array([(0.0, 0.0, 1.0), (0.0, 0.0, np.e), (0.0, 0.0, -1.0)]))
    np.testing.assert_allclose(found, [0.0, 1.0, 1.0], atol=1e-12)


def test_function_that_fails(caplog: pytest.LogCaptureFixture) -> None:
    """A picture without the obstacle is better than none."""

    def table(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise ValueError("out of the table")

    rail = RigidObstacle(table, name="a rail")
    assert obstacle_near(rail, CORNERS, 3, OBLIQUE)[0] is None
    assert "a rail" in caplog.text
    assert "out of the table" in caplog.text


def test_solid_obstacles_are_closed() -> None:
    """A plate below the bodies is drawn with all its sides, as large as the part that is near."""
    plate = RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    grid, hidden = obstacle_near(plate, CORNERS, 3, OBLIQUE)
    assert not hidden.any()
    drawn: list[Any] = []
    plotter: Any = SimpleNamespace(add_mesh=lambda mesh, **_: drawn.append(mesh))
    draw_obstacle(plotter, grid, 3, False)
    solid = drawn[0].clean()
    assert solid.n_open_edges == 0
    low, high = grid.bounds[4], 0.0
    area = np.prod(np.array(grid.bounds[1:4:2]) - np.array(grid.bounds[:4:2]))
    assert solid.volume == pytest.approx((high - low) * area, rel=1e-5)


@pytest.mark.parametrize(("normal", "hides"), [((0.0, 1.0, 0.0), True), ((0.0, -1.0, 0.0), False)])
def test_what_hides_the_bodies(normal: tuple[float, float, float], hides: bool) -> None:
    """A wall that bodies touch on the side of the viewer does, not one on the other side."""
    wall = RigidPlane((0.0, -9.0 * normal[1], 0.0), normal)
    assert obstacle_near(wall, CORNERS, 3, OBLIQUE)[1].any() == hides
