"""The view of a contact surface of 3D."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.pictures.canvas import OBLIQUE, UPWARDS, bar, look, skin, title
from dolfinx_tresca.pictures.contact import Contact

ARROWS = 350  #: slip arrows on a surface, about
COARSE = 150  #: nodes; arrows and marks on a surface with fewer are as small as on this


def draw_surface(plotter: Any, contact: Contact) -> None:
    """Draw a contact surface along its normal into the current part of the picture."""
    surface = skin(contact.grid.to_pyvista()).compute_normals(
        cell_normals=True, point_normals=True, consistent_normals=True, split_vertices=False
    )
    normal, up = view(surface)
    light = _light(surface, normal)
    lift = 0.01 * surface.length * normal  # what is drawn on the surface must not sink into it
    legend = _draw_pressure(plotter, surface, contact, lift, light)
    tips: Array = np.empty((0, 3))
    if contact.has_friction:
        tips, arrows = _draw_slip(plotter, surface, lift)
        legend += arrows
    legend += _draw_marks(plotter, surface, contact, lift)
    title(plotter, f"Contact surface{contact.number}", "    ".join(legend))
    look(plotter, np.concatenate([surface.points, tips]), normal, up)


def _light(surface: Any, normal: Array) -> dict[str, Any]:
    """Return how to light a surface: not at all if flat, so that colours are those of the bar."""
    facing = np.abs(np.asarray(surface.cell_data["Normals"]) @ normal)
    if facing.min() > 0.98 * np.linalg.norm(normal):
        return {"lighting": False}
    return {"lighting": True, "smooth_shading": True, "ambient": 0.65, "diffuse": 0.4}


def _draw_pressure(
    plotter: Any, surface: Any, contact: Contact, lift: Array, light: dict[str, Any]
) -> list[str]:
    """Draw the pressed part in colours and the open part in grey; return the legend."""
    surface.point_data["touching"] = contact.pressed.astype(float)
    pressed, open_part = surface.clip_scalar(scalars="touching", value=0.5, invert=False, both=True)
    if pressed.n_points:
        pressure = surface.point_data["pressure"]
        plotter.add_mesh(
            pressed,
            scalars="pressure",
            cmap="YlOrRd",
            # below zero where bodies that are bonded pull at each other
            clim=(min(float(pressure.min()), 0.0), max(float(pressure.max()), 0.0) or 1.0),
            scalar_bar_args=bar(f"contact pressure{contact.number}"),
            **light,
        )
    if open_part.n_points:
        plotter.add_mesh(open_part, color="gainsboro", **light)
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


def _draw_marks(plotter: Any, surface: Any, contact: Contact, lift: Array) -> list[str]:
    """Mark nodes that stick; return the legend."""
    import pyvista

    spacing = math.sqrt(surface.area / max(surface.n_points, COARSE))
    for pressed, nodes, _ in contact.marks():
        if len(nodes):
            points = contact.grid.points[nodes]
            inner = 0.0 if pressed else 0.11
            disc = pyvista.Disc(
                inner=spacing * inner, outer=spacing * 0.17, normal=(1.0, 0.0, 0.0), c_res=20
            )
            marks = pyvista.PolyData(points + 2.0 * lift)
            nearest = [surface.find_closest_point(point) for point in points]
            marks["normal"] = np.asarray(surface.point_data["Normals"])[nearest]
            discs = marks.glyph(orient="normal", scale=False, geom=disc)
            plotter.add_mesh(discs, color="black", lighting=False)
    return [meaning for _, _, meaning in contact.marks()]


def view(surface: Any) -> tuple[Array, Array]:
    """Return from where a surface is seen best, its mean normal, and what is up there."""
    sized = surface.compute_normals(
        cell_normals=True, point_normals=False, consistent_normals=True
    ).compute_cell_sizes(length=False, volume=False)
    mean = np.asarray(sized.cell_data["Normals"]).T @ np.asarray(sized.cell_data["Area"])
    if np.linalg.norm(mean) < 0.1 * surface.area:  # closed, or nearly: no side is better
        return OBLIQUE, UPWARDS
    normal = mean / np.linalg.norm(mean)
    if normal[np.argmax(np.abs(normal))] < 0.0:
        normal = -normal
    up = UPWARDS if abs(normal[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    return normal, up


def _thinned(points: Array, length: float) -> Any:
    """Return the indices of about `ARROWS` points, evenly spread."""
    if len(points) <= ARROWS:
        return np.arange(len(points))
    boxes = np.floor(points / (length / math.sqrt(ARROWS)) + 0.5)
    return np.unique(boxes, axis=0, return_index=True)[1]
