"""Pictures are made without a display, show what they should, and say what is missing."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from demo_two_bricks import two_bricks

from dolfinx_tresca import ContactError, ContactProblem, ContactSolution, InputError, display, plot

pyvista = pytest.importorskip("pyvista")


@pytest.fixture(scope="module")
def solution() -> ContactSolution:
    scene = two_bricks(MPI.COMM_WORLD, 5)
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs) as problem:
        return problem.solve()


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)


needs_xvfb = pytest.mark.skipif(
    tuple(pyvista.vtk_version_info)[:2] < (9, 5) and shutil.which("Xvfb") is None,
    reason="VTK needs a display and there is no Xvfb",
)


def image(path: Path) -> np.ndarray:
    """Return (height, width, 3) of a picture."""
    MPI.COMM_WORLD.barrier()
    pixels = np.asarray(pyvista.read(path).point_data.active_scalars)
    width, height, _ = pyvista.read(path).dimensions
    return pixels.reshape(height, width, -1)[::-1, :, :3]


def fraction(part: np.ndarray, kind: str) -> float:
    """Return the part of the pixels that are white, grey, or coloured."""
    low, high = part.min(axis=2).astype(int), part.max(axis=2).astype(int)
    kinds = {
        "white": low > 250,
        "grey": (high - low < 8) & (low < 250),
        "colour": high - low > 25,
    }
    return float(kinds[kind].mean())


@needs_xvfb
def test_picture(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    solution.plot(folder / "new" / "bricks.png")
    picture = image(folder / "new" / "bricks.png")
    assert picture.shape == (plot.SIZE[1], plot.SIZE[0], 3)
    left, right = np.split(picture, [int(0.42 * plot.SIZE[0])], axis=1)
    for part in (left, right):
        assert fraction(part, "white") > 0.3
        assert fraction(part, "colour") > 0.15
        assert len(np.unique(part.reshape(-1, 3), axis=0)) > 200
    assert fraction(right, "grey") > 0.05  # there is an open part
    assert fraction(picture[:, :8], "white") == 1.0  # nothing is cut off
    assert fraction(picture[:, -8:], "white") == 1.0


@needs_xvfb
def test_same_picture_again_and_on_all_ranks(folder: Path, solution: ContactSolution) -> None:
    solution.plot(folder / "first.png")
    solution.plot(folder / "second.png")
    np.testing.assert_array_equal(image(folder / "first.png"), image(folder / "second.png"))


@needs_xvfb
def test_scale(folder: Path, solution: ContactSolution) -> None:
    """The bodies move with the scale, and the surface stays."""
    for scale in (0.0, 3000.0):
        solution.plot(folder / f"{scale:g}.png", scale=scale)
    difference = np.any(image(folder / "0.png") != image(folder / "3000.png"), axis=2)
    assert difference[100:550, : int(0.41 * plot.SIZE[0])].mean() > 0.05
    assert not difference[:, int(0.43 * plot.SIZE[0]) :].any()


def marked(surface: Any, *, touching: bool, sticking: bool) -> Any:
    """Return a surface whose nodes all have the same state."""
    count = len(surface.points)
    return dataclasses.replace(
        surface, touching=np.full(count, touching), sticking=np.full(count, sticking)
    )


@needs_xvfb
def test_sticking_nodes_are_marked(folder: Path, solution: ContactSolution) -> None:
    """Discs are filled, rings on open nodes are not, and slipping nodes have no mark."""
    dark = {}
    for name, touching, sticking in (
        ("slip", True, False),
        ("stick", True, True),
        ("open", False, True),
    ):
        surface = marked(solution.surface, touching=touching, sticking=sticking)
        plot.plot(folder / f"{name}.png", solution.u, [surface])
        part = image(folder / f"{name}.png")[120:530, int(0.45 * plot.SIZE[0]) :]
        dark[name] = float((part.max(axis=2) < 60).mean())
    assert dark["stick"] > dark["open"] + 0.002 > dark["slip"] + 0.004


@needs_xvfb
def test_curved_surface_and_several_pairs(folder: Path, solution: ContactSolution) -> None:
    """A surface bent to a half cylinder is seen from above."""
    scene = two_bricks(MPI.COMM_WORLD, 5)
    x = scene.bricks.mesh.geometry.x
    angle, radius = 0.5 * np.pi * (x[:, 0] - 1.0), 1.0 + x[:, 2] / 2
    x[:, 0], x[:, 2] = radius * np.sin(angle), radius * np.cos(angle)
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs) as problem:
        bent = problem.solve()
    plot.plot(folder / "bent.png", bent.u, [bent.surface, solution.surface])
    picture = image(folder / "bent.png")
    assert picture.shape == (2 * 520, plot.SIZE[0], 3)
    for row in np.split(picture[:, int(0.45 * plot.SIZE[0]) :], 2):
        assert fraction(row, "colour") > 0.1
    grid = plot.gather_grid(bent.surface.functions)
    if grid is not None:
        normal, up = plot._view(plot._skin(grid.to_pyvista()))
        np.testing.assert_allclose(normal, (0.0, 0.0, 1.0), atol=0.05)
        assert abs(normal @ up) < 0.1


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (-0.8, 0.6, 0.0)])
def test_view_is_along_the_normal(direction: tuple[float, float, float]) -> None:
    """From the side of the larger coordinate, however the facets are oriented."""
    normal, up = plot._view(pyvista.Plane(direction=direction).triangulate())
    np.testing.assert_allclose(normal, np.sign(sum(direction)) * np.array(direction), atol=1e-6)
    assert abs(normal @ up) < 1e-6


def test_view_of_a_closed_surface() -> None:
    np.testing.assert_array_equal(plot._view(pyvista.Sphere())[0], plot.OBLIQUE)


@pytest.mark.parametrize(
    ("largest", "wanted"),
    [(0.1, 3.0), (0.33, 1.0), (1e-4, 3000.0), (6e-4, 500.0), (0.0, 1.0)],
)
def test_scale_is_chosen(largest: float, wanted: float) -> None:
    assert plot._visible_scale(3.7, largest) == pytest.approx(wanted)


def test_no_display(
    folder: Path, solution: ContactSolution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where VTK wants an X server and there is no Xvfb the error says so, on all ranks."""
    monkeypatch.setattr(display, "needs_display", lambda: True)
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(ContactError, match="install xvfb"):
        solution.plot(folder / "bricks.png")


def test_broken_xvfb(
    comm: MPI.Comm, folder: Path, solution: ContactSolution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(display, "needs_display", lambda: True)
    monkeypatch.setattr(shutil, "which", lambda name: "/bin/false")
    with pytest.raises(ContactError, match="did not start"):
        solution.plot(folder / "bricks.png")


def test_no_pyvista(
    folder: Path, solution: ContactSolution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ContactError, match="pyvista"):
        solution.plot(folder / "bricks.png")


@pytest.mark.parametrize("scale", [-1.0, float("nan"), float("inf")])
def test_wrong_scale(folder: Path, solution: ContactSolution, scale: float) -> None:
    with pytest.raises(InputError, match="scale"):
        solution.plot(folder / "bricks.png", scale=scale)


def test_wrong_suffix_or_folder(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    with pytest.raises(InputError, match=r"\.png"):
        solution.plot(folder / "bricks.pdf")
    (folder / "taken").touch()
    comm.barrier()
    with pytest.raises(InputError, match="cannot write"):
        solution.plot(folder / "taken" / "bricks.png")


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts a Python of its own")
def test_package_does_not_import_pyvista() -> None:
    code = "import sys, dolfinx_tresca; sys.exit('pyvista' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=120).returncode == 0
