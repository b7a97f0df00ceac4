"""Pictures are made without a display, show what they should, and say what is missing."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import PIL.Image
import pytest

from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactProblem,
    ContactSolution,
    ContactState,
    Frictionless,
    InputError,
    RigidPlane,
    Tresca,
    Units,
)
from dolfinx_tresca.output import panels, plot
from dolfinx_tresca.output.files import gather_grid
from dolfinx_tresca.output.panels import CURVE_COLOUR, TANGENT_COLOUR, gather_contact
from dolfinx_tresca.solution.fields import IntegerFunction
from scenes.blocks import ABOVE, block
from scenes.patches import patch
from scenes.scene import EPS
from scenes.two_bricks import two_bricks

pyvista = pytest.importorskip("pyvista")
matplotlib = pytest.importorskip("matplotlib")
matplotlib.style = pytest.importorskip("matplotlib.style")
Text = pytest.importorskip("matplotlib.text").Text


@pytest.fixture(scope="module")
def solution() -> ContactSolution:
    scene = two_bricks(MPI.COMM_WORLD, 5)
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs) as problem:
        return problem.solve(rtol=1e-6)


def on_plane(friction: Any, *, degree: int = 1) -> ContactSolution:
    """A unit square on a rigid plane that it touches in the middle; pressed and pushed."""
    scene = block(
        MPI.COMM_WORLD,
        (8, 4),
        degree=degree,
        load=(0.0, 0.0, 0.0),
        held=[ABOVE],
        moved=lambda x: np.outer([0.02, -0.01], np.ones(x.shape[1])),
        young=1000.0,
        poisson=0.3,
        friction=friction,
    )
    x = scene.mesh.geometry.x
    x[:, 1] += 0.1 * (x[:, 0] - 0.5) ** 2 * (x[:, 1] < 0.9)
    with scene.problem() as problem:
        return problem.solve(rtol=1e-6)


@pytest.fixture(scope="module")
def flat() -> ContactSolution:
    """A solution of 2D with open, sticking and slipping nodes."""
    return on_plane(Tresca(lambda x: 5.0 + 95.0 * (x[0] < 0.5)))


DPI = 100  #: half as fine as usual: time goes into rendering
WIDTH, HEIGHT, ROW = (round(DPI * inches) for inches in (8.8, 3.9, 3.1))
SPLIT = 0.42  #: part of the width that is for the bodies


@pytest.fixture(autouse=True)
def small_and_without_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr(panels, "DPI", DPI)


needs_xvfb = pytest.mark.skipif(
    tuple(pyvista.vtk_version_info)[:2] < (9, 5) and shutil.which("Xvfb") is None,
    reason="VTK needs a display and there is no Xvfb",
)


def image(path: Path) -> np.ndarray:
    """Return (height, width, 3) of a picture, written by the first rank. Collective."""
    MPI.COMM_WORLD.barrier()
    return image_of_one_rank(path)


def image_of_one_rank(path: Path) -> np.ndarray:
    """Return (height, width, 3) of a picture. Not collective."""
    return np.asarray(PIL.Image.open(path).convert("RGB"))


def fraction(part: np.ndarray, kind: str) -> float:
    """Return the part of the pixels that are white, grey, or coloured."""
    low, high = part.min(axis=2).astype(int), part.max(axis=2).astype(int)
    kinds = {"white": low > 250, "grey": (high - low < 8) & (low < 250), "colour": high - low > 25}
    return float(kinds[kind].mean())


@pytest.mark.parallel
@needs_xvfb
def test_picture(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    solution.plot(folder / "new" / "bricks.png")
    picture = image(folder / "new" / "bricks.png")
    assert picture.shape == (HEIGHT, WIDTH, 3)
    left, right = np.split(picture, [int(0.42 * WIDTH)], axis=1)
    for part in (left, right):
        assert fraction(part, "white") > 0.3
        assert fraction(part, "colour") > 0.15
        assert len(np.unique(part.reshape(-1, 3), axis=0)) > 200
    assert fraction(right, "grey") > 0.05  # there is an open part
    assert fraction(picture[:, :8], "white") == 1.0  # nothing is cut off
    assert fraction(picture[:, -8:], "white") == 1.0


@pytest.mark.parallel
@needs_xvfb
def test_picture_without_a_path(comm: MPI.Comm, folder: Path, flat: ContactSolution) -> None:
    """The first rank gets the picture that a file would have; with a path no rank gets one."""
    found = flat.plot()
    assert flat.plot(folder / "flat.png") is None
    if comm.rank == 0:
        np.testing.assert_array_equal(np.asarray(found), image_of_one_rank(folder / "flat.png"))
    else:
        assert found is None


@needs_xvfb
def test_vectors(folder: Path, flat: ContactSolution) -> None:
    """Text and charts are lines, and the view is an image."""
    for name in ("first.svg", "first.pdf"):
        flat.plot(folder / name)
    svg, pdf = ((folder / f"first.{suffix}").read_bytes() for suffix in ("svg", "pdf"))
    assert svg.count(b"<image") == 2  # bodies, and the colours of the bar
    assert svg.count(b"<path") > 50
    assert pdf.startswith(b"%PDF")


def figure_of(solution: ContactSolution, units: Units | None) -> Any:
    """Return the picture as a figure that was drawn, on one rank."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    volume = gather_grid([solution.u])
    contacts = [gather_contact(surface) for surface in solution.surfaces]
    with matplotlib.style.context(plot.STYLE), plot.display_for_pictures():
        figure = plot.compose(volume, contacts, None, units)
        FigureCanvasAgg(figure).draw()
    return figure


@needs_xvfb
@pytest.mark.parametrize("dim", [2, 3])
def test_text(dim: int, flat: ContactSolution, solution: ContactSolution) -> None:
    """Units are written where there are some, in one font, and no text is on another."""
    scene = flat if dim == 2 else solution
    bare = {text.get_text() for text in figure_of(scene, None).findobj(Text)}
    assert "displacement" in bare
    assert not any("MPa" in text for text in bare)
    figure = figure_of(scene, Units("mm", "MPa"))
    hidden = set()  # ticks beyond the ends of axes
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        beyond = [t for t in axis.get_major_ticks() if not low <= t.get_loc() <= high]
        hidden |= {label for tick in beyond for label in (tick.label1, tick.label2)}
    texts = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    texts = [text for text in texts if text not in hidden]
    written = " ".join(text.get_text() for text in texts)
    assert " mm]" in written or "[mm]" in written
    assert "[MPa]" in written
    assert "1 times" not in written
    assert {text.get_fontname() for text in texts} == {"DejaVu Sans"}
    boxes = [Text.get_window_extent(text) for text in texts]  # without arrows of annotations
    width, height = figure.bbox.size
    for i, box in enumerate(boxes):
        assert 0 <= box.x0 and box.x1 <= width and 0 <= box.y0 and box.y1 <= height
        for other, text in zip(boxes[:i], texts, strict=False):
            assert not box.overlaps(other), (texts[i].get_text(), text.get_text())


@needs_xvfb
def test_scale(folder: Path, solution: ContactSolution) -> None:
    """The bodies move with the scale, and the surface stays."""
    for scale in (0.0, 3000.0):
        solution.plot(folder / f"{scale:g}.png", scale=scale)
    difference = np.any(image(folder / "0.png") != image(folder / "3000.png"), axis=2)
    assert difference[60:310, : int(0.41 * WIDTH)].mean() > 0.05
    assert not difference[:, int(0.43 * WIDTH) :].any()


@needs_xvfb
def test_sticking_nodes_are_marked(folder: Path, solution: ContactSolution) -> None:
    """Pressed and open nodes that stick have discs, slipping nodes have none."""
    fields, dark = solution.surface, []
    no_slip = fem.Function(fields.slip.function_space, name="slip")
    for kind in (ContactState.STICK, ContactState.OPEN_STICK, ContactState.SLIP):
        state = IntegerFunction(fields.state.function_space, name="state")
        state.x.array[:] = np.where(fields.points[:, 1] > 0.1, kind, ContactState.OPEN_SLIP)
        shown = dataclasses.replace(fields, state=state, slip=no_slip, slip_increment=no_slip)
        plot.plot(folder / "marks.png", solution.u, [shown])
        view = image(folder / "marks.png")[70:310, int(0.45 * WIDTH) :]
        dark.append(float((view.max(axis=2) < 60).mean()))
    assert min(dark[:2]) > dark[2] + 0.004


@pytest.mark.parallel
@needs_xvfb
def test_curved_surface_and_several_pairs(folder: Path, solution: ContactSolution) -> None:
    """A surface bent to a half cylinder is seen from above."""
    scene = two_bricks(MPI.COMM_WORLD, 5)
    x = scene.mesh.geometry.x
    angle, radius = 0.5 * np.pi * (x[:, 0] - 1.0), 1.0 + x[:, 2] / 2
    x[:, 0], x[:, 2] = radius * np.sin(angle), radius * np.cos(angle)
    with ContactProblem(scene.a, scene.L, [scene.pair], bcs=scene.bcs) as problem:
        bent = problem.solve(rtol=1e-6)
    plot.plot(folder / "bent.png", bent.u, [bent.surface, solution.surface])
    picture = image(folder / "bent.png")
    assert picture.shape == (2 * ROW, WIDTH, 3)
    for row in np.split(picture[:, int(0.45 * WIDTH) :], 2):
        assert fraction(row, "colour") > 0.1
    grid = gather_grid(bent.surface.functions)
    if grid is not None:
        normal, up = panels.direction(panels.skin(grid.to_pyvista()).compute_normals())
        np.testing.assert_allclose(normal, (0.0, 0.0, 1.0), atol=0.05)
        assert abs(normal @ up) < 0.1


def near(part: np.ndarray, colour: str) -> float:
    """Return the part of the pixels with almost this colour."""
    wanted = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
    return float((np.abs(part.astype(int) - wanted).max(axis=2) < 40).mean())


@pytest.mark.parallel
@needs_xvfb
def test_picture_of_2d(folder: Path, flat: ContactSolution) -> None:
    """Bodies with the red curve, and a chart of pressure, traction, slip and marks."""
    counts = flat.counts
    assert 0 < counts.contact_stick < counts.contact < counts.nodes
    flat.plot(folder / "flat.png")
    picture = image(folder / "flat.png")
    assert picture.shape == (HEIGHT, WIDTH, 3)
    left, right = np.split(picture, [round(SPLIT * WIDTH)], axis=1)
    assert fraction(left, "colour") > 0.15
    assert fraction(right, "white") > 0.3
    assert near(left, CURVE_COLOUR) > 0.001
    assert near(left, panels.OBSTACLE_COLOUR) > 0.01
    assert near(right, CURVE_COLOUR) > 0.001
    upper, lower = np.split(right, [HEIGHT * 6 // 10])
    for part in (upper, lower):
        assert near(part, TANGENT_COLOUR) > 0.0005
    for edge in (picture[:, :4], picture[:, -4:], picture[:4], picture[-4:]):
        assert fraction(edge, "white") == 1.0


@needs_xvfb
def test_picture_without_friction(folder: Path, comm: MPI.Comm) -> None:
    """In 2D there is no traction and no slip, in 3D neither arrows nor marks."""
    flat = on_plane(Frictionless(), degree=2)
    flat.plot(folder / "flat.png")
    right = image(folder / "flat.png")[:, round(SPLIT * WIDTH) :]
    assert near(right, CURVE_COLOUR) > 0.001
    assert near(right, TANGENT_COLOUR) == 0.0

    blocks = patch(comm, "tetrahedron", 2, upper=(2, 1), lower=(3, 1))
    with blocks.problem() as problem:
        problem.solve(rtol=1e-6).plot(folder / "blocks.png")
    picture = image(folder / "blocks.png")
    left, right = np.split(picture, [round(SPLIT * WIDTH)], axis=1)
    assert fraction(left, "colour") > 0.15
    assert fraction(right, "colour") > 0.15
    assert (right[60:310].max(axis=2) < 60).sum() == 0


@pytest.mark.parallel
@needs_xvfb
def test_planes_round_a_body_do_not_hide_it(comm: MPI.Comm, folder: Path) -> None:
    """Planes on all six sides of a block: most of the block that one sees without them is seen."""
    with block(comm, (2, 2, 2)).problem() as problem:
        solution = problem.solve(rtol=1e-6)
    x = solution.u.function_space.mesh.geometry.x
    low, high = np.empty(3), np.empty(3)
    comm.Allreduce(x.min(axis=0), low, op=MPI.MIN)
    comm.Allreduce(x.max(axis=0), high, op=MPI.MAX)
    planes = [
        RigidPlane(tuple(point), tuple(sign * normal))
        for point, sign in ((low, 1.0), (high, -1.0))
        for normal in np.eye(3)
    ]
    boxed = [dataclasses.replace(solution.surface, obstacle=plane) for plane in planes]
    alone = [dataclasses.replace(solution.surface, obstacle=None)]
    plot.plot(folder / "boxed.png", solution.u, boxed, scale=0.0)
    plot.plot(folder / "alone.png", solution.u, alone, scale=0.0)
    sizes = []
    for name in ("boxed", "alone"):
        picture = image(folder / f"{name}.png").astype(int)
        edge = round(DPI * panels.HEADER)
        height = min(len(picture), 2 * ROW)
        view = picture[edge : height - edge, : round(SPLIT * WIDTH)]
        body = np.ptp(view, axis=2) > 45  # obstacles are grey
        assert body.any(), name
        sizes.append((np.ptp(np.flatnonzero(body.any(axis=1))), body.sum()))
    assert len(image(folder / "boxed.png")) == 6 * ROW
    # pixels are compared for the same height of the block in the picture
    assert sizes[0][1] / sizes[0][0] ** 2 > 0.6 * sizes[1][1] / sizes[1][0] ** 2


@pytest.mark.parallel
def test_slip_of_earlier_steps_where_nodes_stick(comm) -> None:
    """Files have the increment as well; pictures and tables show the slip of the step."""
    model = block(comm, (3, 3, 2))
    with model.problem() as problem:
        before = problem.solve(rtol=1e-9)
        problem.accept()
        model.data.load.value[:2] *= 0.9
        after = problem.solve(rtol=1e-9)
    assert after.counts.stick > before.counts.stick
    assert "slip_increment" in [function.name for function in after.surface.functions]
    first, second = gather_contact(before.surface), gather_contact(after.surface)
    if first is None or second is None:
        return
    slip, now = (contact.grid.values["slip"] for contact in (first, second))
    sticks, stuck = (contact.grid.values["sticks"] > 0.0 for contact in (second, first))
    assert (np.linalg.norm(slip[sticks & ~stuck], axis=1) > 0.0).all()
    assert not now[sticks].any()
    assert (first.slip_name, second.slip_name) == ("slip", "slip of step")
    for contact, solution in ((first, before), (second, after)):
        touching = contact.grid.values["state"] >= ContactState.PRESSED
        shown = np.linalg.norm(contact.grid.values["slip"][touching], axis=1).max()
        assert shown == pytest.approx(solution.greatest_slip, rel=64 * EPS)
    total = np.linalg.norm(slip[touching], axis=1).max()
    assert after.greatest_total_slip >= (1.0 - 64 * EPS) * total > after.greatest_slip


@pytest.fixture
def no_window(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is no display, and VTK cannot load EGL."""
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv(plot.WINDOW, raising=False)
    monkeypatch.setattr(plot, "find_library", lambda name: None)


@pytest.mark.usefixtures("no_window")
def test_no_display(folder, solution, monkeypatch):
    """Where VTK wants an X server and there is no Xvfb the error says so, on all ranks."""
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(ContactError, match="install xvfb"):
        solution.plot(folder / "bricks.png")


@pytest.mark.usefixtures("no_window")
def test_broken_xvfb(folder, solution, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: "/bin/false")
    with pytest.raises(ContactError, match="did not start"):
        solution.plot(folder / "bricks.png")


def test_a_picture_without_a_display_prints_nothing() -> None:
    """VTK would complain of a missing X server on stderr, beside all that Python sees."""
    code = (
        "import pyvista\n"
        "from dolfinx_tresca.output.plot import display_for_pictures\n"
        "with display_for_pictures():\n"
        "    plotter = pyvista.Plotter(off_screen=True, window_size=(50, 40))\n"
        "    plotter.add_mesh(pyvista.Sphere())\n"
        "    assert plotter.screenshot().std() > 0.0\n"
        "    plotter.close()\n"
    )
    environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_a_missing_library_is_named(folder: Path, solution, flat, monkeypatch) -> None:
    for plotted, module in ((solution, "pyvista"), (flat, "matplotlib.style")):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(ContactError, match=module.split(".")[0]):
            plotted.plot(folder / "bricks.png")
        monkeypatch.undo()


@pytest.mark.parametrize("scale", [-1.0, float("nan"), float("inf")])
def test_wrong_scale(folder: Path, solution: ContactSolution, scale: float) -> None:
    with pytest.raises(InputError, match="scale"):
        solution.plot(folder / "bricks.png", scale=scale)


@pytest.mark.parallel
def test_wrong_suffix_or_folder(comm: MPI.Comm, folder: Path, solution: ContactSolution) -> None:
    with pytest.raises(InputError, match=r"\.png"):
        solution.plot(folder / "bricks.gif")
    (folder / "taken").touch()
    comm.barrier()
    with pytest.raises(InputError, match="cannot write"):
        solution.plot(folder / "taken" / "bricks.png")
