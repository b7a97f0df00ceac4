"""Views: obstacles and magnification show what is there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dolfinx_tresca import RigidCylinder, RigidObstacle, RigidPlane, RigidSphere
from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.output.panels import Contact
from dolfinx_tresca.output.views import (
    INVISIBLE,
    SAMPLES,
    VISIBLE,
    draw_obstacle,
    magnification,
)
from scenes.rigid_obstacle import distance_from_ring

pytest.importorskip("pyvista")

AROUND = np.linspace(0.0, 0.5 * np.pi, 7)  #: a quarter
OVERLAP = 1e-3

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


def circle(radius: float) -> np.ndarray:
    """Return nodes of a quarter of a circle."""
    return radius * np.stack([np.cos(AROUND), np.sin(AROUND), 0.0 * AROUND], axis=1)


def ring_of(inner: np.ndarray, outer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points and quadrilaterals between two quarters."""
    n = len(inner)
    first = np.arange(n - 1)
    cells = np.stack([np.full(n - 1, 4), first, first + 1, first + n + 1, first + n], axis=1)
    return np.concatenate([inner, outer]), cells


def shaft_in_hub(part: float) -> tuple[Grid, Contact]:
    """Return a hub that opens by a part of the overlap, and a shaft that gives the rest."""
    hub, cells = ring_of(circle(1.0), circle(2.0))
    shaft, others = ring_of(circle(0.2), circle(1.0 + OVERLAP))
    others[:, 1:] += len(hub)
    points = np.concatenate([hub, shaft])
    outwards = points / np.linalg.norm(points, axis=1, keepdims=True)
    radius = np.concatenate([np.full(len(hub), part), np.full(len(shaft), part - 1.0)])
    u = OVERLAP * radius[:, None] * outwards
    kinds = np.full(len(cells) + len(others), 9)
    volume = Grid(2, points, np.concatenate([cells, others]), kinds, {"u": u})
    return volume, contact_at(circle(1.0), np.full(len(AROUND), -OVERLAP))


def contact_at(points: np.ndarray, initial_gap: np.ndarray, gap: float = 0.0) -> Contact:
    """Return a curve whose nodes have these gaps, and are pressed if the gap is zero."""
    n = len(points)
    cells = np.stack([np.full(n - 1, 2), np.arange(n - 1), np.arange(1, n)], axis=1)
    values = {"initial_gap": initial_gap, "gap": np.full(n, gap), "pressed": np.full(n, gap == 0.0)}
    return Contact(Grid(1, points, cells, np.full(n - 1, 3), values))


@pytest.mark.parametrize("part", [0.0, 0.4, 1.0])
def test_pressed_pin_is_not_loose(part: float) -> None:
    """Both sides of the contact are drawn on one circle, as near as one sees."""
    volume, contact = shaft_in_hub(part)
    scale = magnification(volume, [contact])
    points = volume.points + scale * volume.values["u"]
    n, length = len(AROUND), np.linalg.norm(np.ptp(volume.points, axis=0))
    hub, shaft = np.linalg.norm(points[:n], axis=1), np.linalg.norm(points[3 * n :], axis=1)
    np.testing.assert_allclose(shaft, hub, atol=INVISIBLE * length)
    assert scale >= 1.0


def block_over_plane(gap: float, closed: float, sink: float) -> tuple[Grid, Contact]:
    """Return a square at a distance of a plane, part of which it closes while its top sinks."""
    x = np.linspace(0.0, 1.0, 5)
    bottom = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
    points, cells = ring_of(bottom, bottom + np.array([0.0, 1.0, 0.0]))
    n = len(x)
    u = np.zeros_like(points)
    u[:n, 1], u[n:, 1] = -closed, -sink
    volume = Grid(2, points, cells, np.full(n - 1, 9), {"u": u})
    return volume, contact_at(bottom, np.full(n, gap), gap - closed)


@pytest.mark.parametrize(("gap", "limited"), [(0.0, False), (0.003, True), (0.5, True)])
def test_obstacles_that_are_met(gap: float, limited: bool) -> None:
    """They stay where they are, so the scale is limited by gaps that have closed."""
    volume, contact = block_over_plane(gap, gap, max(gap, 1e-3))
    scale, length = magnification(volume, [contact]), np.sqrt(2.0)
    assert (scale - 1.0) * gap <= INVISIBLE * length
    if not limited:
        assert 0.4 * VISIBLE * length < scale * 1e-3 <= VISIBLE * length


def test_obstacles_that_are_not_met() -> None:
    """What is open is not drawn in them."""
    gap, closed = 0.05, 1e-3
    volume, contact = block_over_plane(gap, closed, closed)
    scale = magnification(volume, [contact])
    assert 1.0 < scale and scale * closed <= gap + INVISIBLE * np.sqrt(2.0)


@pytest.mark.parametrize(
    ("largest", "wanted"),
    [(0.1, 3.0), (0.33, 1.0), (1e-4, 3000.0), (6e-4, 500.0), (0.0, 1.0), (2.0, 1.0)],
)
def test_displacements_become_visible(largest: float, wanted: float) -> None:
    """Bodies of length 3.7 move by at most a tenth of it, by a round magnification."""
    points = np.array([(0.0, 0.0, 0.0), (3.7, 0.0, 0.0)])
    u = np.array([(0.0, 0.0, 0.0), (largest, 0.0, 0.0)])
    bar = Grid(2, points, np.array([[2, 0, 1]]), np.array([3]), {"u": u})
    assert magnification(bar, []) == pytest.approx(wanted)
