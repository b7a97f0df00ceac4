"""Obstacles are found where their signed distance is zero."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import RigidCylinder, RigidObstacle, RigidPlane, RigidSphere
from dolfinx_tresca.output.pictures.obstacles import SAMPLES, draw_obstacle, sampled
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
    grid = sampled(obstacle, CORNERS, 3)
    spacing = max(grid.spacing)
    surface = grid.contour([0.0], scalars="distance")
    assert np.abs(obstacle.distance(np.asarray(surface.points))).max() < spacing**2 / 6.0
    assert (np.ptp(surface.points, axis=0)[:2] > 12.0).all()


def test_in_the_plane() -> None:
    grid = sampled(RigidPlane((0.0, -0.1), (0.0, 1.0)), np.array([(0, 0, 0), (1, 1, 0)]), 2)
    assert max(grid.dimensions) == SAMPLES[2] + 1
    line = grid.contour([0.0], scalars="distance")
    np.testing.assert_allclose(line.points[:, 1], -0.1, atol=1e-6)


def test_far_away() -> None:
    grid = sampled(RigidPlane((0.0, 0.0, -99.0), (0.0, 0.0, 1.0)), CORNERS, 3)
    assert not grid.contour([0.0], scalars="distance").n_points


def test_functions_without_answers() -> None:
    """What is no number counts as far away."""
    obstacle = RigidObstacle(lambda x: (np.log(x[2]), x))
    found = obstacle.distance(np.array([(0.0, 0.0, 1.0), (0.0, 0.0, np.e), (0.0, 0.0, -1.0)]))
    np.testing.assert_allclose(found, [0.0, 1.0, 1.0], atol=1e-12)


def test_function_that_fails(caplog: pytest.LogCaptureFixture) -> None:
    """A picture without the obstacle is better than none."""

    def table(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise ValueError("out of the table")

    drawn = draw_obstacle(None, RigidObstacle(table, name="a rail"), CORNERS, 3)
    assert len(drawn) == 0
    assert "a rail" in caplog.text
    assert "out of the table" in caplog.text
