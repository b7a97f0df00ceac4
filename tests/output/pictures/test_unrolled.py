"""Surfaces round an axis are unrolled without stretching."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca.output.pictures.unrolled import unroll

pyvista = pytest.importorskip("pyvista")

RADIUS, HEIGHT = 2.0, 3.0


def sheet(first: float, last: float, axis: int = 2, taper: float = 0.0) -> object:
    """Return a part of a cylinder or cone between two angles, with vectors along it."""
    closed = last - first > 2.0 * np.pi - 1e-9
    around, up = 25, 7
    angle, z = np.meshgrid(
        np.linspace(first, last, around)[: around - closed], np.linspace(0.0, HEIGHT, up)
    )
    radius = RADIUS - taper * z
    local = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    east = np.stack([-np.sin(angle), np.cos(angle), 0.0 * z], axis=-1).reshape(-1, 3)
    columns = angle.shape[1]
    cells = []
    for row in range(up - 1):
        for i in range(columns if closed else columns - 1):
            j = (i + 1) % columns
            a, b = row * columns, (row + 1) * columns
            cells += [[3, a + i, a + j, b + j], [3, a + i, b + j, b + i]]
    order = [(k - axis - 1) % 3 for k in range(3)]
    surface = pyvista.PolyData(local[:, order], np.concatenate(cells))
    surface.point_data["east"] = east[:, order]
    return surface.compute_normals(consistent_normals=True, split_vertices=False)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("last", "ends"), [(0.5, (0, 1)), (1.0, (0, 2)), (2.0, (1, 1))])
def test_unrolled(axis: int, last: float, ends: tuple[int, int]) -> None:
    """Its width is the arc, vectors turn with it, and its ends are where they were."""
    how = unroll(sheet(0.0, last * np.pi, axis), ("east",))
    assert how is not None
    width, height, depth = np.ptp(how.surface.points, axis=0)
    cell = last * np.pi * RADIUS / 24.0
    assert abs(width - last * np.pi * RADIUS) < (1.01 * cell if last == 2.0 else 1e-9)
    assert (height, depth) == (pytest.approx(HEIGHT), 0.0)
    assert how.surface.area == pytest.approx(last * np.pi * RADIUS * HEIGHT, rel=1e-6)
    np.testing.assert_allclose(
        how.surface.point_data["east"], [[1, 0, 0]] * len(how.source), atol=1e-12
    )
    assert how.axis == "xyz"[axis]
    first, second = "xyz"[(axis + 1) % 3], "xyz"[(axis + 2) % 3]
    names = (f"{first} side", f"{second} side", f"−{first} side")
    assert how.ends == tuple(names[end] for end in ends)


def test_cones() -> None:
    """They keep their width at each height."""
    how = unroll(sheet(0.0, np.pi, taper=0.1), ())
    assert how is not None
    points = np.asarray(how.surface.points)
    for z, radius in ((0.0, RADIUS), (HEIGHT, RADIUS - 0.1 * HEIGHT)):
        row = points[np.abs(points[:, 1] - z) < 1e-9]
        assert np.ptp(row[:, 0]) == pytest.approx(np.pi * radius)


@pytest.mark.parametrize(
    "shape", [pyvista.Plane(), pyvista.Sphere(), pyvista.Sphere(end_phi=30.0), pyvista.Box()]
)
def test_what_cannot_be_unrolled(shape: object) -> None:
    surface = shape.triangulate().clean().compute_normals(split_vertices=False)
    assert unroll(surface, ()) is None


@pytest.mark.parametrize("sides", [2, 4])
def test_edges(sides: int) -> None:
    """Neither two planes at right angles nor all sides of a box are a cylinder."""
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1)], dtype=float)[: sides + 1]
    bottom, top = (np.column_stack([corners, np.full(len(corners), z)]) for z in (0.0, 1.0))
    n = len(corners)
    cells = [[4, i, i + 1, n + i + 1, n + i] for i in range(n - 1)]
    surface = pyvista.PolyData(np.concatenate([bottom, top]), np.concatenate(cells))
    assert unroll(surface.compute_normals(split_vertices=False), ()) is None


def test_flat_enough() -> None:
    """What is bent a little is better seen from the front."""
    assert unroll(sheet(0.0, 0.3), ()) is None
