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
    return Contact(grid, pressed, sticks, "", np.arange(6), normals, np.zeros(6), None)


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
