"""Views: obstacles and magnification show what is there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import Frictionless, RigidCylinder, RigidObstacle, RigidPlane, RigidSphere
from dolfinx_tresca.output.files import Grid, gather_grid
from dolfinx_tresca.output.panels import (
    INVISIBLE,
    SAMPLES,
    draw_obstacle,
    gather_contact,
    magnification,
)
from scenes.blocks import ABOVE, BELOW, block, floor
from scenes.rigid_obstacle import distance_from_ring

pytest.importorskip("pyvista")

KINDS = [
    RigidPlane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    RigidSphere((0.0, 0.0, -40.0), 40.0),
    RigidCylinder((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 15.0, hollow=True),
    RigidObstacle(distance_from_ring),
]
CORNERS = np.array([(x, y, z) for x in (-9.0, 9.0) for y in (-9.0, 9.0) for z in (0.0, 12.0)])


def drawn(obstacle: RigidObstacle) -> list[Any]:
    """Return what is drawn of an obstacle near a box."""
    meshes: list[Any] = []
    plotter: Any = SimpleNamespace(add_mesh=lambda mesh, **_: meshes.append(mesh))
    assert draw_obstacle(plotter, obstacle, CORNERS, False) == bool(meshes)
    return meshes


@pytest.mark.parametrize("obstacle", KINDS, ids=str)
def test_obstacles_are_drawn_where_their_distance_is_zero(obstacle: RigidObstacle) -> None:
    """The surface is off by the square of the grid's spacing, and goes beyond the bodies."""
    surface = drawn(obstacle)[0]
    spacing = 1.3 * (np.prod(np.ptp(CORNERS, axis=0)) / SAMPLES) ** (1.0 / 3.0)
    assert np.abs(obstacle.distance(np.asarray(surface.points))).max() < spacing**2 / 6.0
    assert (np.ptp(surface.points, axis=0)[:2] > 12.0).all()


def test_an_obstacle_whose_function_fails(caplog: pytest.LogCaptureFixture) -> None:
    """A picture without the obstacle is better than none."""

    def table(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise ValueError("out of the table")

    assert not drawn(RigidObstacle(table, name="a rail"))
    assert "a rail" in caplog.text
    assert "out of the table" in caplog.text


@pytest.mark.parametrize(
    ("gap", "down"), [(0.0, 1e-3), (0.003, 0.004), (0.5, 0.501), (-0.003, 0.0), (0.05, 1e-3)]
)
def test_bodies_are_drawn_on_the_obstacles_that_they_touch(gap: float, down: float) -> None:
    """Obstacles are drawn where they are; so displacements are magnified less if gaps close."""
    scene = block(
        MPI.COMM_SELF,
        (4, 4),
        load=(0.0, 0.0, 0.0),
        held=[ABOVE],
        moved=lambda x: np.outer([0.0, -down], np.ones(x.shape[1])),
        friction=Frictionless(),
        obstacles=[(BELOW, floor(2, -gap))],
    )
    with scene.problem() as problem:
        solution = problem.solve()
    volume, contact = gather_grid([solution.u]), gather_contact(solution.surface)
    assert volume is not None and contact is not None
    scale, length = magnification(volume, [contact]), np.sqrt(2.0)
    lowest = (volume.points + scale * volume.values["displacement"])[:, 1].min()
    assert scale >= 1.0
    assert lowest >= -gap - 1.001 * INVISIBLE * length
    if solution.counts.contact:
        assert lowest <= -gap + 1.001 * INVISIBLE * length


@pytest.mark.parametrize(
    ("largest", "wanted"),
    [(0.1, 3.0), (0.33, 1.0), (1e-4, 3000.0), (6e-4, 500.0), (0.0, 1.0), (2.0, 1.0)],
)
def test_displacements_become_visible(largest: float, wanted: float) -> None:
    """Bodies of length 3.7 move by at most a tenth of it, by a round magnification."""
    points = np.array([(0.0, 0.0, 0.0), (3.7, 0.0, 0.0)])
    u = np.array([(0.0, 0.0, 0.0), (largest, 0.0, 0.0)])
    bar = Grid(2, points, np.array([[2, 0, 1]]), np.array([3]), {"u": u}, {})
    assert magnification(bar, []) == pytest.approx(wanted)
