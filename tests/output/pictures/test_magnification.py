"""What touches does so in the picture."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import ContactState, RigidPlane
from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.output.pictures.bodies import INVISIBLE, VISIBLE, magnification
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.scene.obstacle import RigidObstacle

AROUND = np.linspace(0.0, 0.5 * np.pi, 7)  #: a quarter
OVERLAP = 1e-3


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
    volume = Grid(2, 1, points, np.concatenate([cells, others]), kinds, {"u": u})
    return volume, contact_at(circle(1.0), -circle(1.0), np.full(len(AROUND), -OVERLAP), None)


def contact_at(
    points: np.ndarray, normals: np.ndarray, gap: np.ndarray, obstacle: RigidObstacle | None
) -> Contact:
    """Return a curve that is pressed everywhere."""
    n = len(points)
    cells = np.stack([np.full(n - 1, 2), np.arange(n - 1), np.arange(1, n)], axis=1)
    state = np.full(n, float(ContactState.STICK))
    values = {"state": state, "gap": np.zeros(n)}
    grid = Grid(1, 1, points, cells, np.full(n - 1, 3), values)
    pressed = np.ones(n, dtype=bool)
    return Contact(grid, pressed, pressed, np.arange(n), normals, gap, obstacle)


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
    volume = Grid(2, 1, points, cells, np.full(n - 1, 9), {"u": u})
    plane = RigidPlane((0.0, -gap), (0.0, 1.0))
    contact = contact_at(bottom, np.tile([0.0, -1.0, 0.0], (n, 1)), np.full(n, gap), plane)
    if closed < gap:
        contact.grid.values["gap"][:] = gap - closed
        contact.touching[:] = False
    return volume, contact


@pytest.mark.parametrize(("gap", "limited"), [(0.0, False), (0.003, True), (0.5, True)])
def test_obstacles_that_are_met(gap: float, limited: bool) -> None:
    """They stay where they are, so the scale is limited by gaps that have closed."""
    volume, contact = block_over_plane(gap, gap, max(gap, 1e-3))
    scale, length = magnification(volume, [contact]), np.sqrt(2.0)
    assert (scale - 1.0) * gap <= INVISIBLE * length
    if not limited:
        assert 0.4 * VISIBLE * length < scale * 1e-3 <= VISIBLE * length


@pytest.mark.parametrize("gap", [0.02, 0.05, 10.0])
def test_obstacles_that_are_not_met(gap: float) -> None:
    """What is open is not drawn in them."""
    closed = 1e-3
    volume, contact = block_over_plane(gap, closed, closed)
    scale = magnification(volume, [contact])
    assert scale * closed <= gap + INVISIBLE * np.sqrt(2.0)
    assert scale > 5.0


@pytest.mark.parametrize(
    ("largest", "wanted"),
    [(0.1, 3.0), (0.33, 1.0), (1e-4, 3000.0), (6e-4, 500.0), (0.0, 1.0), (2.0, 1.0)],
)
def test_displacements_become_visible(largest: float, wanted: float) -> None:
    """Bodies of length 3.7 move by at most a tenth of it, by a round magnification."""
    points = np.array([(0.0, 0.0, 0.0), (3.7, 0.0, 0.0)])
    u = np.array([(0.0, 0.0, 0.0), (largest, 0.0, 0.0)])
    bar = Grid(2, 1, points, np.array([[2, 0, 1]]), np.array([3]), {"u": u})
    assert magnification(bar, []) == pytest.approx(wanted)
