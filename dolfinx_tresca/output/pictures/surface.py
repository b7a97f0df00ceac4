"""The view of a contact surface of 3D."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.pictures.canvas import (
    ALONG_Y,
    OBLIQUE,
    UPWARDS,
    Camera,
    Colours,
    View,
    handle,
    quantity,
    scaled,
    skin,
)
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.units import Units

OPEN_COLOUR = "gainsboro"
ARROWS = 350  #: approximate number of slip arrows; twice as many lie on each other
COARSE = 150  #: arrows and marks become no larger on a surface with fewer nodes than this
#: Least cosine between the normal of a facet and the contact normal: facets with less are at the
#: side of a body. With twice this value the edges of rounded surfaces would be left out.
FACING = 0.15


def draw_surface(plotter: Any, aspect: float, contact: Contact, units: Units | None) -> View:
    """Draw the facets that may touch, seen along their mean normal, or obliquely if closed.

    Args:
        plotter: a plotter of pyvista.
        aspect: width of the view divided by its height.
        contact: the contact surface.
        units: units of length and stress.
    """
    length, stress = (units.length, units.stress) if units else ("", "")
    grid = contact.grid.to_pyvista()
    grid.point_data["node"] = np.arange(grid.n_points)  # the skin may renumber nodes
    grid.point_data["pressed"] = contact.pressed.astype(float)
    surface = _facing(_with_normals(skin(grid)), contact)
    normal, up = direction(surface)
    lift = 0.01 * surface.length * normal  # so that marks do not sink into the surface
    pressure, on = surface.point_data["pressure"], surface.point_data["pressed"] > 0.0
    values = pressure[on] if on.all() else np.append(pressure[on], 0.0)
    name = f"contact pressure {contact.label}".rstrip()
    colours = Colours.from_values(values, name, stress, "YlOrRd", clip=True)
    light: dict[str, Any] = {"smooth_shading": True, "ambient": 0.65, "diffuse": 0.4}
    if np.abs(surface.cell_data["Normals"] @ normal).min() > 0.98:  # flat: colours as in the bar
        light = {"lighting": False}
    pressed, opened = surface.clip_scalar(scalars="pressed", value=0.5, invert=False, both=True)
    legend = []
    if pressed.n_points:
        plotter.add_mesh(pressed, scalars="pressure", **colours.options, **light)
    if opened.n_points:
        plotter.add_mesh(opened, color=OPEN_COLOUR, **light)
        legend.append(handle("open", OPEN_COLOUR, "s", markersize=8.0))
    edges = surface.extract_all_edges().translate(0.2 * lift)
    plotter.add_mesh(edges, color="white", opacity=0.5, line_width=1.0, lighting=False)
    seen = [surface.points]
    if contact.has_friction:
        seen.append(_draw_slip(plotter, surface, lift, length, contact, legend))
        _draw_marks(plotter, surface, contact, lift)
    legend += contact.legend_of_marks()
    camera = Camera.framing(np.concatenate(seen), normal, up, aspect, normal is not OBLIQUE)
    bar = colours if on.any() else None
    return View(contact.title("Contact surface"), legend, camera, bar)


def direction(surface: Any) -> tuple[Array, Array]:
    """Return the direction to the viewer, along a surface's mean normal, and the upward direction.

    A closed surface has no mean normal, and is seen obliquely.
    """
    sized = surface.compute_cell_sizes(length=False, volume=False)
    mean = sized.cell_data["Normals"].T @ sized.cell_data["Area"]
    if np.linalg.norm(mean) < 0.1 * surface.area:  # closed, or nearly: no side is better
        return OBLIQUE, UPWARDS
    normal = mean / np.linalg.norm(mean)
    normal = normal * np.sign(normal[np.argmax(np.abs(normal))])
    return normal, UPWARDS if abs(normal[2]) < 0.9 else ALONG_Y


def _with_normals(surface: Any) -> Any:
    """Return a surface with normals of its cells and points, all on one side of the surface."""
    return surface.compute_normals(consistent_normals=True, split_vertices=False)


def _facing(surface: Any, contact: Contact) -> Any:
    """Return the facets with a node that has a multiplier, except lateral facets (`FACING`).

    Other facets, such as the sides and the top of a block whose whole boundary has the tag, would
    hide the facets that may touch.
    """
    normals = np.zeros((len(contact.grid.points), 3))
    normals[contact.nodes] = contact.normals
    nodes = surface.faces.reshape(-1, surface.faces[0] + 1)[:, 1:]
    at_nodes = normals[np.asarray(surface.point_data["node"])[nodes]]
    cosines = np.einsum("cni,ci->cn", at_nodes, surface.cell_data["Normals"])
    kept = (np.abs(cosines) > FACING).any(axis=1)
    return surface if kept.all() else _with_normals(skin(surface.extract_cells(kept)))


def _draw_slip(
    plotter: Any, surface: Any, lift: Array, unit: str, contact: Contact, legend: list[Any]
) -> Array:
    """Draw slip as arrows, write its largest length to the legend, and return the arrows' tips."""
    import pyvista

    slip, on = np.asarray(surface.point_data["slip"]), surface.point_data["pressed"] > 0.0
    lengths = np.linalg.norm(slip, axis=1)
    largest = float(lengths[on if on.any() else slice(None)].max())
    if largest == 0.0:
        return np.empty((0, 3))
    boxes = np.floor(surface.points / (surface.length / math.sqrt(ARROWS)) + 0.5)
    shown = np.unique(boxes, axis=0, return_index=True)[1]
    if len(slip) <= ARROWS:
        shown = np.arange(len(slip))
    shown = shown[lengths[shown] > 0.02 * largest]
    factor = 1.3 * math.sqrt(surface.area / np.clip(len(slip), COARSE, ARROWS)) / largest
    # shorter arrows on open parts, which may have moved by far more
    slip = factor * slip * np.minimum(1.0, largest / np.maximum(lengths, largest))[:, None]
    for touches, color in ((True, "black"), (False, "#707070")):
        nodes = shown[on[shown] == touches]
        if len(nodes):
            arrows = pyvista.PolyData(surface.points[nodes] + 3.0 * lift)
            arrows["slip"] = slip[nodes]
            plotter.add_mesh(arrows.glyph(orient="slip", scale="slip"), color=color, lighting=False)
    text = f"{contact.slip_of}, at most {quantity(largest, unit)}"
    if contact.has_path:
        path = float(surface.point_data["slip_path"].max())
        divisor, _ = scaled("", unit, path)
        both = f"slip ≤ {largest / divisor:.4g}, path ≤ {path / divisor:.4g}"
        text = scaled(both, unit, path)[1]  # short: marks follow
    legend.append(handle(text, "black", "$\u2192$", markersize=9.0, markeredgewidth=0.3))
    return np.asarray(surface.points[shown] + slip[shown])


def _draw_marks(plotter: Any, surface: Any, contact: Contact, lift: Array) -> None:
    """Mark sticking nodes by discs (pressed) and rings (open)."""
    import pyvista

    spacing = math.sqrt(surface.area / max(surface.n_points, COARSE))
    for touches, nodes in contact.marks:
        shown = np.isin(surface.point_data["node"], nodes)
        hole = 0.0 if touches else 0.11 * spacing
        disc = pyvista.Disc(inner=hole, outer=0.17 * spacing, normal=(1.0, 0.0, 0.0), c_res=20)
        marks = pyvista.PolyData(surface.points[shown] + 2.0 * lift)
        if marks.n_points:
            marks["normal"] = surface.point_data["Normals"][shown]
            discs = marks.glyph(orient="normal", scale=False, geom=disc)
            plotter.add_mesh(discs, color="black", lighting=False)
