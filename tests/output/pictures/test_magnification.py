"""What touches does so in the picture."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import ContactState, RigidPlane
from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.output.pictures.magnification import INVISIBLE, VISIBLE, magnify
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
@pytest.mark.parametrize("scale", [None, 1.0, 70.0])
def test_pressed_pin_is_not_loose(part: float, scale: float | None) -> None:
    """Both sides of the contact are drawn on one circle, though displacements are magnified."""
    volume, contact = shaft_in_hub(part)
    drawn = magnify(volume, [contact], scale)
    assert drawn.scale == (scale or drawn.scale)
    points = volume.points + drawn.shift + drawn.scale * volume.values["u"]
    n = len(AROUND)
    hub, shaft = np.linalg.norm(points[:n], axis=1), np.linalg.norm(points[3 * n :], axis=1)
    # the circles of shaft and hub, on which the polynomial is found, differ by the overlap
    np.testing.assert_allclose(shaft, hub, atol=2.0 * drawn.scale * OVERLAP**2)
    if scale is None:
        assert drawn.scale > 1.0 / (OVERLAP * 100.0)
    if scale == 1.0:
        assert not drawn.shift.any()
    assert ("magnified" in drawn.title) == (drawn.scale != 1.0)


def test_symmetry_stays() -> None:
    """The shift of the shaft has no part across the planes of symmetry, and none of the hub."""
    volume, contact = shaft_in_hub(0.5)
    shift = magnify(volume, [contact], 100.0).shift
    n = len(AROUND)
    assert not shift[: 2 * n].any()
    first, last = slice(2 * n, None, n), slice(3 * n - 1, None, n)
    rounding = 1e-12 * np.abs(shift).max()
    assert np.abs(shift[first, 1]).max() < rounding
    assert np.abs(shift[last, 0]).max() < rounding


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
    drawn = magnify(volume, [contact], None)
    length = np.sqrt(2.0)
    assert not drawn.shift.any()
    assert (drawn.scale - 1.0) * gap <= INVISIBLE * length
    if not limited:
        assert 0.4 * VISIBLE * length < drawn.scale * 1e-3 <= VISIBLE * length


@pytest.mark.parametrize("gap", [0.02, 0.05, 10.0])
def test_obstacles_that_are_not_met(gap: float) -> None:
    """What is open is not drawn in them."""
    closed = 1e-3
    volume, contact = block_over_plane(gap, closed, closed)
    drawn = magnify(volume, [contact], None)
    assert drawn.scale * closed <= gap + INVISIBLE * np.sqrt(2.0)
    assert drawn.scale > 5.0
    assert magnify(volume, [contact], 500.0).scale == 500.0
