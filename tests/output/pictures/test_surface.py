"""What is drawn on a contact surface is where its nodes are."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dolfinx_tresca import ContactState
from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.output.pictures.surface import draw_surface
from scenes.scene import EPS

QUADRILATERAL = 9


def strip(state: list[ContactState]) -> Contact:
    """Return two squares; their cells name the nodes in another order than that of the nodes."""
    points = np.array([(x, y, 0.0) for x in (0.0, 1.0) for y in (0.0, 1.0, 2.0)])
    cells = np.array([[4, 0, 3, 4, 1], [4, 1, 4, 5, 2]])
    states = np.array(state, dtype=float)
    pressed = states >= ContactState.PRESSED
    sticks = np.isin(states, [ContactState.STICK, ContactState.OPEN_STICK])
    values = {"state": states, "pressure": 1.0 * pressed, "slip": np.zeros((6, 3))}
    grid = Grid(3, 1, points, cells, np.full(2, QUADRILATERAL), values)
    normals = np.broadcast_to([0.0, 0.0, 1.0], (6, 3))
    return Contact(grid, pressed, sticks, np.arange(6), normals, np.zeros(6), None)


@pytest.mark.parametrize("last", [0, 2, 5])
def test_marks_are_where_nodes_stick(last: int) -> None:
    """Of pressed nodes that stick black discs; and the part round an open node is grey."""
    state = [ContactState.SLIP] * 6
    state[3], state[last] = ContactState.STICK, ContactState.OPEN
    contact, drawn = strip(state), []
    plotter: Any = SimpleNamespace(add_mesh=lambda mesh, **how: drawn.append((mesh, how)))
    draw_surface(plotter, 1.0, contact, None)
    (disc,) = [mesh for mesh, how in drawn if how.get("color") == "black"]
    (grey,) = [mesh for mesh, how in drawn if how.get("color") == "gainsboro"]
    np.testing.assert_allclose(disc.center[:2], contact.grid.points[3, :2], atol=64 * EPS)
    assert np.linalg.norm(np.asarray(grey.points) - contact.grid.points[last], axis=1).min() == 0.0


def test_of_a_whole_boundary_what_touches_is_seen() -> None:
    """Of a cube on its bottom: neither its top is in the way, nor its sides."""
    points = np.array([(x, y, z) for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    cells = np.array([(4, *face) for face in faces])
    state = np.repeat([ContactState.SLIP, ContactState.OUTSIDE], 4).astype(float)
    pressed, bottom = state >= ContactState.PRESSED, np.arange(4)
    values = {"state": state, "pressure": 1.0 * pressed}
    grid = Grid(3, 1, points, cells, np.full(6, QUADRILATERAL), values)
    down = np.broadcast_to([0.0, 0.0, -1.0], (4, 3))
    contact = Contact(grid, pressed, ~pressed, bottom, down, np.zeros(4), None)
    drawn: list[Any] = []
    plotter: Any = SimpleNamespace(add_mesh=lambda mesh, **_: drawn.append(mesh))
    how = draw_surface(plotter, 1.0, contact, None)
    np.testing.assert_allclose(how.camera.axes[2], [0.0, 0.0, 1.0], atol=64 * EPS)
    (colours, _) = drawn
    assert colours.n_cells == 1
    np.testing.assert_array_equal(colours.points[:, 2], 0.0)
