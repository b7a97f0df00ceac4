"""The view of a contact surface of 3D."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.pictures.canvas import (
    COORDINATES,
    GREY,
    OBLIQUE,
    UPWARDS,
    Camera,
    Colours,
    Drawn,
    skin,
)
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.output.pictures.labels import Range, quantity, scaled
from dolfinx_tresca.output.pictures.legend import mark, patch
from dolfinx_tresca.output.pictures.unrolled import Unrolled, unroll
from dolfinx_tresca.units import Units

OPEN_COLOUR = "gainsboro"
FRONT = (UPWARDS, np.array([0.0, 1.0, 0.0]))  #: view of a plane: towards the viewer, and up
ARROWS = 350  #: approximate number of slip arrows on a surface
#: Least cosine between the normal of a facet and the contact normal; lateral facets have smaller
#: cosines.
FACING = 0.15
COARSE = 150  #: arrows and marks become no larger on a surface with fewer nodes than this


def draw_surface(plotter: Any, aspect: float, contact: Contact, units: Units | None) -> Drawn:
    """Draw the part of a surface that may touch, seen along its mean normal, or unrolled.

    A surface that is nearly a cylinder or a cone is unrolled. Any other surface that is closed, or
    nearly so, is seen obliquely.

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
    surface = _taking_part(_with_normals(skin(grid)), contact)
    how = unroll(surface, ("slip",) if contact.has_friction else ())
    if how is None:
        (normal, up), title, notes = view(surface), "Contact surface", []
        directions = COORDINATES
    else:
        surface = _with_normals(how.surface)
        (normal, up), title, notes = FRONT, "Contact surface, unrolled", _ends(how)
        directions = (("φ", np.array([1.0, 0.0, 0.0])), (how.axis, up))
    light = _light(surface, normal)
    lift = 0.01 * surface.length * normal  # so that marks do not sink into the surface
    colours = Colours(
        f"contact pressure {contact.label}".rstrip(), stress, "YlOrRd", _range(surface)
    )
    legend = _draw_pressure(plotter, surface, colours, lift, light)
    tips: Array = np.empty((0, 3))
    if contact.has_friction:
        tips, arrows = _draw_slip(plotter, surface, lift, length, contact)
        legend += arrows
    _draw_marks(plotter, surface, contact, lift)
    framed = Camera.at if normal is OBLIQUE else Camera.turned
    seen = np.concatenate([surface.points, tips, *(place[None] for place, _, _ in notes)])
    camera = framed(seen, normal, up, aspect)
    for _, _, options in notes:  # these texts run along the sides
        options["rotation"] = 90.0 if camera.axes[1] @ up > 0.5 else 0.0
    legend += contact.legend_of_marks()
    bar = colours if contact.pressed.any() else None
    return Drawn(contact.title(title), legend, camera, bar, notes, directions)


def _with_normals(surface: Any) -> Any:
    """Return a surface with normals of its cells and points, all on one side of the surface."""
    return surface.compute_normals(
        cell_normals=True, point_normals=True, consistent_normals=True, split_vertices=False
    )


def _taking_part(surface: Any, contact: Contact) -> Any:
    """Return the facets with a node that has a multiplier, except lateral facets (`FACING`).

    Other facets, such as the sides and the top of a block whose whole boundary has the tag, would
    hide the facets that may touch.
    """
    normals = np.zeros((len(contact.grid.points), 3))
    normals[contact.nodes] = contact.normals
    nodes = surface.faces.reshape(-1, surface.faces[0] + 1)[:, 1:]
    at_nodes = normals[np.asarray(surface.point_data["node"])[nodes]]
    along = np.einsum("cni,ci->cn", at_nodes, np.asarray(surface.cell_data["Normals"]))
    part = (np.abs(along) > FACING).any(axis=1)
    return surface if part.all() else _with_normals(skin(surface.extract_cells(part)))


def _range(surface: Any) -> Range:
    """Return the range of colours: pressures of pressed nodes, and zero if a part is open."""
    pressure = np.asarray(surface.point_data["pressure"])
    pressed = np.asarray(surface.point_data["pressed"]) > 0.0
    values = pressure[pressed] if pressed.all() else np.append(pressure[pressed], 0.0)
    return Range.of(values, clip=True)


def _ends(how: Unrolled) -> list[tuple[Array, str, dict[str, Any]]]:
    """Return the texts at both ends of an unrolled surface, with their positions."""
    points = np.asarray(how.surface.points)
    low, high = points.min(axis=0), points.max(axis=0)
    size = {"fontsize": 8, "color": GREY, "ha": "center", "va": "center"}
    middle, off = 0.5 * (low + high)[1], 0.06 * (high - low)[0]
    return [
        (np.array([x, middle, 0.0]), end, dict(size))
        for x, end in ((low[0] - off, how.ends[0]), (high[0] + off, how.ends[1]))
    ]


def _light(surface: Any, normal: Array) -> dict[str, Any]:
    """Return options for the light: none on a flat surface, so that colours match the bar."""
    facing = np.abs(np.asarray(surface.cell_data["Normals"]) @ normal)
    if facing.min() > 0.98 * np.linalg.norm(normal):
        return {"lighting": False}
    return {"lighting": True, "smooth_shading": True, "ambient": 0.65, "diffuse": 0.4}


def _draw_pressure(
    plotter: Any, surface: Any, colours: Colours, lift: Array, light: dict[str, Any]
) -> list[Any]:
    """Draw the pressed part in colours and the open part in grey; return the legend."""
    pressed, open_part = surface.clip_scalar(scalars="pressed", value=0.5, invert=False, both=True)
    if pressed.n_points:
        plotter.add_mesh(pressed, scalars="pressure", **colours.mesh_options, **light)
    if open_part.n_points:
        plotter.add_mesh(open_part, color=OPEN_COLOUR, **light)
    edges = surface.extract_all_edges().translate(0.2 * lift)
    plotter.add_mesh(edges, color="white", opacity=0.5, line_width=1.0, lighting=False)
    return [patch("open", OPEN_COLOUR)] if open_part.n_points else []


def _draw_slip(
    plotter: Any, surface: Any, lift: Array, unit: str, contact: Contact
) -> tuple[Array, list[Any]]:
    """Draw slip as arrows; return their tips and the legend, with the longest path of the slip."""
    import pyvista

    slip = np.asarray(surface.point_data["slip"])
    length = np.linalg.norm(slip, axis=1)
    counts = np.asarray(surface.point_data["pressed"]) > 0.0
    largest = float(length[counts if counts.any() else slice(None)].max())
    if largest == 0.0:
        return np.empty((0, 3)), []
    # shorter arrows on open parts, which may have moved by far more
    slip = slip * np.minimum(1.0, largest / np.where(length > 0.0, length, largest))[:, None]
    shown = _thinned(surface.points, surface.length)
    shown = shown[length[shown] > 0.02 * largest]
    spacing = math.sqrt(surface.area / np.clip(len(slip), COARSE, ARROWS))
    factor = 1.3 * spacing / largest
    pressed = np.asarray(surface.point_data["pressed"])[shown] > 0.0
    for nodes, color in ((shown[pressed], "black"), (shown[~pressed], "#707070")):
        if len(nodes):
            arrows = pyvista.PolyData(surface.points[nodes] + 3.0 * lift)
            arrows["slip"] = slip[nodes]
            glyphs = arrows.glyph(orient="slip", scale="slip", factor=factor)
            plotter.add_mesh(glyphs, color=color, lighting=False)
    tips: Array = np.asarray(surface.points)[shown] + factor * slip[shown]
    text = f"{contact.slip_of}, at most {quantity(largest, unit)}"
    if contact.has_path:
        path = float(np.asarray(surface.point_data["slip_path"]).max())
        divisor = scaled("", unit, path).factor
        both = f"slip ≤ {largest / divisor:.4g}, path ≤ {path / divisor:.4g}"
        text = scaled(both, unit, path).label  # short: marks follow
    return tips, [mark(text, "$\u2192$")]


def _draw_marks(plotter: Any, surface: Any, contact: Contact, lift: Array) -> None:
    """Mark sticking nodes by discs (pressed) and rings (open)."""
    import pyvista

    spacing = math.sqrt(surface.area / max(surface.n_points, COARSE))
    node = np.asarray(surface.point_data["node"])
    for pressed, nodes in contact.marks():
        here = np.flatnonzero(np.isin(node, nodes))
        inner = 0.0 if pressed else 0.11
        disc = pyvista.Disc(
            inner=spacing * inner, outer=spacing * 0.17, normal=(1.0, 0.0, 0.0), c_res=20
        )
        marks = pyvista.PolyData(np.asarray(surface.points)[here] + 2.0 * lift)
        marks["normal"] = np.asarray(surface.point_data["Normals"])[here]
        discs = marks.glyph(orient="normal", scale=False, geom=disc)
        plotter.add_mesh(discs, color="black", lighting=False)


def view(surface: Any) -> tuple[Array, Array]:
    """Return the direction to the viewer, along a surface's mean normal, and the upward direction.

    A closed surface has no mean normal, and is seen obliquely.
    """
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
