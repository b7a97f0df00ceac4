"""Pictures of results, with pyvista, also where there is no display."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dolfinx import fem

from dolfinx_tresca._parallel import errors_on_all_ranks
from dolfinx_tresca.display import virtual_display
from dolfinx_tresca.dual.feasible_set import Array, Mask
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.fields import ContactState, SurfaceFields
from dolfinx_tresca.grid import ROOT, Grid, gather_grid

SUFFIXES = (".png", ".jpg", ".tif")
SIZE = (1600, 700)  #: pixels of the picture with one pair
VISIBLE = 0.1  #: of the length of the model: the displacement in the picture
OBLIQUE = np.array([-0.38, -0.84, 0.38])  #: from where bodies are seen
ARROWS = 350  #: slip arrows on a surface, about
COARSE = 150  #: nodes; arrows and marks on a surface with fewer are as small as on this


def plot(
    path: str | Path,
    u: fem.Function,
    surfaces: Sequence[SurfaceFields],
    *,
    scale: float | None = None,
) -> None:
    """Save a picture: the deformed bodies, and beside them each contact surface along its normal.

    Bodies: displacement u, magnified, with its length as colour and the undeformed edges as lines.
    Surfaces: pressure as colour, slip of the secondary side against the primary as arrows, nodes
    that stick as dots (black: pressed, white: open), open parts in grey.

    Needs pyvista on the first rank, and no display.

    Collective.

    Args:
        path: `.png`, `.jpg` or `.tif`; that of the first rank counts.
        u: displacement [length], of degree 1.
        surfaces: the fields of each pair.
        scale: magnification of u, 0 or more; None chooses one that shows the deformation.

    Raises:
        InputError: unknown suffix, scale not a number of 0 or more, or the file cannot be written.
        ContactError: there is no pyvista, or VTK would need a display.
    """
    comm = u.function_space.mesh.comm
    path = Path(comm.bcast(str(path), root=ROOT))
    if path.suffix not in SUFFIXES:
        raise InputError(f"plot writes {', '.join(SUFFIXES)}, found '{path}'.")
    if scale is not None and not (math.isfinite(scale) and scale >= 0.0):
        raise InputError(f"scale must be a number of 0 or more, found {scale}.")
    volume = gather_grid([u])
    contacts = [_gather_contact(surface) for surface in surfaces]
    with errors_on_all_ranks(comm):
        if volume is not None:
            picture = _draw(volume, [contact for contact in contacts if contact is not None], scale)
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                picture.save(path)
            except OSError as error:
                raise InputError(
                    f"cannot write '{path}': {error}. Choose another folder or name."
                ) from error


@dataclass(frozen=True)
class _Contact:
    """A surface and its nodes, gathered."""

    grid: Grid
    points: Array
    touching: Mask
    sticking: Mask


def _gather_contact(surface: SurfaceFields) -> _Contact | None:
    """Return a surface on the first rank, None on others. Collective."""
    grid = gather_grid(surface.functions)
    parts = surface.mesh.comm.gather(
        (surface.points, surface.touching, surface.sticking), root=ROOT
    )
    if grid is None:
        return None
    return _Contact(grid, *(np.concatenate(column) for column in zip(*parts, strict=True)))


def _draw(volume: Grid, contacts: list[_Contact], scale: float | None) -> Any:
    """Return the picture, a `PIL.Image`. Not collective."""
    bodies = volume.to_pyvista()  # says it if there is no pyvista
    import PIL.Image
    import pyvista

    count = len(contacts)
    with virtual_display():
        plotter = pyvista.Plotter(
            off_screen=True,
            shape=f"1|{count}" if count else (1, 1),
            splitting_position=0.42 if count else None,
            border=False,
            window_size=[SIZE[0], SIZE[1] if count < 2 else 520 * count],
        )
        try:
            plotter.set_background("white", all_renderers=True)
            _draw_bodies(plotter, bodies, scale)
            for i, contact in enumerate(contacts):
                plotter.subplot(i + 1)
                _draw_contact(plotter, contact, f" {i + 1}" if count > 1 else "")
            plotter.enable_anti_aliasing("msaa", multi_samples=8)
            return PIL.Image.fromarray(plotter.screenshot(return_img=True))
        finally:
            plotter.close()


def _skin(grid: Any) -> Any:
    """Return the outer faces. Newer versions of pyvista want to know how, older ones do not."""
    if "algorithm" in inspect.signature(grid.extract_surface).parameters:
        return grid.extract_surface(algorithm="dataset_surface")
    return grid.extract_surface()


def _bar(title: str) -> dict[str, Any]:
    """Return how a colour bar looks."""
    return {
        "title": f"{title}\n",  # the line keeps it off the labels
        "color": "black",
        "title_font_size": 20,
        "label_font_size": 17,
        "n_labels": 4,
        "fmt": "%.3g",
        "width": 0.6,
        "height": 0.09,
        "position_x": 0.2,
        "position_y": 0.02,
    }


def _title(plotter: Any, title: str, legend: str) -> None:
    """Write title and legend above the current part of the picture."""
    plotter.add_text(title, position=(0.05, 0.945), viewport=True, font_size=10, color="black")
    plotter.add_text(legend, position=(0.05, 0.905), viewport=True, font_size=7, color="dimgrey")


def _draw_bodies(plotter: Any, bodies: Any, scale: float | None) -> None:
    """Draw the deformed bodies into the current part of the picture."""
    name = bodies.point_data.keys()[0]
    bodies.point_data["|u|"] = np.linalg.norm(bodies.point_data[name], axis=1)
    if scale is None:
        scale = _visible_scale(bodies.length, float(bodies.point_data["|u|"].max()))
    deformed = _skin(bodies.warp_by_vector(name, factor=scale))
    plotter.add_mesh(
        deformed,
        scalars="|u|",
        cmap="viridis",
        show_edges=True,
        edge_color="white",
        edge_opacity=0.3,
        ambient=0.35,
        diffuse=0.7,
        scalar_bar_args=_bar("displacement |u|"),
    )
    outline = _skin(bodies).extract_feature_edges(feature_angle=40.0)
    if outline.n_points:
        plotter.add_mesh(outline, color="grey", line_width=1.5)
    _title(plotter, f"Displacement, magnified {scale:,.12g} times", "lines: undeformed edges")
    points = np.concatenate([bodies.points, deformed.points])
    _look(plotter, points, OBLIQUE, np.array([0.0, 0.0, 1.0]))


def _visible_scale(length: float, largest: float) -> float:
    """Return 1, 2, 3 or 5 times a power of ten that makes the largest displacement visible."""
    wanted = VISIBLE * length / largest if largest > 0.0 else 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(
        digit * power for digit in (1.0, 2.0, 3.0, 5.0) if digit * power <= wanted * (1.0 + 1e-9)
    )


def _draw_contact(plotter: Any, contact: _Contact, number: str) -> None:
    """Draw a contact surface along its normal into the current part of the picture."""
    import pyvista

    surface = _skin(contact.grid.to_pyvista())
    normal, up = _view(surface)
    lift = 0.01 * surface.length * normal  # what is drawn on the surface must not sink into it
    spacing = math.sqrt(surface.area / max(surface.n_points, COARSE))
    legend = _draw_pressure(plotter, surface, lift, number)
    tips, arrows = _draw_slip(plotter, surface, lift)
    legend += arrows
    marks = ((True, 0.0, "discs: nodes that stick"), (False, 0.11, "rings: open nodes that stick"))
    for pressed, inner, meaning in marks:
        nodes = contact.points[contact.sticking & (contact.touching == pressed)]
        if len(nodes):
            disc = pyvista.Disc(
                inner=spacing * inner, outer=spacing * 0.17, normal=normal, c_res=20
            )
            discs = pyvista.PolyData(nodes + 2.0 * lift).glyph(orient=False, scale=False, geom=disc)
            plotter.add_mesh(discs, color="black", lighting=False)
            legend.append(meaning)
    _title(plotter, f"Contact surface{number}", "    ".join(legend))
    _look(plotter, np.concatenate([surface.points, tips]), normal, up)


def _draw_pressure(plotter: Any, surface: Any, lift: Array, number: str) -> list[str]:
    """Draw the pressed part in colours and the open part in grey; return the legend."""
    touching = np.asarray(surface.point_data["state"]) >= ContactState.STICK
    surface.point_data["touching"] = touching.astype(float)
    pressed, open_part = surface.clip_scalar(scalars="touching", value=0.5, invert=False, both=True)
    if pressed.n_points:
        plotter.add_mesh(
            pressed,
            scalars="pressure",
            cmap="YlOrRd",
            clim=(0.0, float(surface.point_data["pressure"].max()) or 1.0),
            lighting=False,
            scalar_bar_args=_bar(f"contact pressure{number}"),
        )
    if open_part.n_points:
        plotter.add_mesh(open_part, color="gainsboro", lighting=False)
    edges = surface.extract_all_edges().translate(0.2 * lift)
    plotter.add_mesh(edges, color="white", opacity=0.5, line_width=1.0, lighting=False)
    return ["grey: open"] if open_part.n_points else []


def _draw_slip(plotter: Any, surface: Any, lift: Array) -> tuple[Array, list[str]]:
    """Draw slip as arrows; return their tips and the legend."""
    import pyvista

    slip = np.asarray(surface.point_data["slip"])
    length = np.linalg.norm(slip, axis=1)
    largest = float(length.max())
    if largest == 0.0:
        return np.empty((0, 3)), []
    shown = _thinned(surface.points, surface.length)
    shown = shown[length[shown] > 0.02 * largest]
    spacing = math.sqrt(surface.area / np.clip(len(slip), COARSE, ARROWS))
    factor = 1.3 * spacing / largest
    touching = np.asarray(surface.point_data["touching"])[shown] > 0.0
    for nodes, color in ((shown[touching], "black"), (shown[~touching], "grey")):
        if len(nodes):
            arrows = pyvista.PolyData(surface.points[nodes] + 3.0 * lift)
            arrows["slip"] = slip[nodes]
            glyphs = arrows.glyph(orient="slip", scale="slip", factor=factor)
            plotter.add_mesh(glyphs, color=color, lighting=False)
    tips: Array = np.asarray(surface.points)[shown] + factor * slip[shown]
    return tips, [f"arrows: slip, at most {largest:.2g}"]


def _look(plotter: Any, points: Array, normal: Array, up: Array) -> None:
    """Look at points against `normal`, as large as fits between title and colour bar."""
    right = np.cross(up, normal)
    axes = np.array([right / np.linalg.norm(right), np.zeros(3), normal / np.linalg.norm(normal)])
    axes[1] = np.cross(axes[2], axes[0])
    seen = points @ axes.T
    spans, middle = np.ptp(seen, axis=0), 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    width, height = plotter.renderer.GetSize()
    half = 0.5 * max(spans[1] / 0.68, spans[0] / 0.84 * height / width)
    middle[1] -= 0.06 * half  # the bar is higher than the title
    centre = middle @ axes
    distance = float(np.linalg.norm(spans))
    plotter.enable_parallel_projection()
    plotter.camera_position = [tuple(centre + distance * axes[2]), tuple(centre), tuple(axes[1])]
    plotter.camera.parallel_scale = half
    plotter.renderer.reset_camera_clipping_range()


def _view(surface: Any) -> tuple[Array, Array]:
    """Return from where a surface is seen best, its mean normal, and what is up there."""
    sized = surface.compute_normals(
        cell_normals=True, point_normals=False, consistent_normals=True
    ).compute_cell_sizes(length=False, volume=False)
    mean = np.asarray(sized.cell_data["Normals"]).T @ np.asarray(sized.cell_data["Area"])
    if np.linalg.norm(mean) < 0.1 * surface.area:  # closed, or nearly: no side is better
        return OBLIQUE, np.array([0.0, 0.0, 1.0])
    normal = mean / np.linalg.norm(mean)
    if normal[np.argmax(np.abs(normal))] < 0.0:
        normal = -normal
    up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    return normal, up


def _thinned(points: Array, length: float) -> Any:
    """Return the indices of about `ARROWS` points, evenly spread."""
    if len(points) <= ARROWS:
        return np.arange(len(points))
    boxes = np.floor(points / (length / math.sqrt(ARROWS)) + 0.5)
    return np.unique(boxes, axis=0, return_index=True)[1]
