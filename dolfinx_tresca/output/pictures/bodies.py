"""Drawing of the deformed bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.output.pictures.canvas import OBLIQUE, UPWARDS, Camera, Colours, Drawn, skin
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.output.pictures.curve import CURVE_COLOUR, Curve
from dolfinx_tresca.output.pictures.labels import Range
from dolfinx_tresca.output.pictures.legend import line, mark
from dolfinx_tresca.output.pictures.magnification import magnify
from dolfinx_tresca.output.pictures.obstacles import draw_obstacle, legend_of_obstacles
from dolfinx_tresca.output.revolved import revolved

OUTLINE = "#6e6e6e"
OPEN_COLOUR = "#202020"  #: colour of open parts of a contact curve, and of its start
ALONG_Y = np.array([0.0, 1.0, 0.0])
TO_THE_CUT = np.array([0.42, 0.36, 0.83])  #: direction from which revolved bodies are seen
THIN, THICK = 0.8, 2.8  #: widths in points of a contact curve, and of its pressed parts


def draw_bodies(
    plotter: Any,
    aspect: float,
    volume: Grid,
    contacts: Sequence[Contact],
    curves: Sequence[Curve],
    scale: float | None,
    unit: str,
    angle: float = 0.0,
) -> Drawn:
    """Draw the deformed bodies, and rigid obstacles beside them.

    Args:
        plotter: a plotter of pyvista.
        aspect: width of the view divided by its height.
        volume: the mesh with the displacement.
        contacts: the contact surfaces of all pairs.
        curves: the contact curves of 2D, drawn on the deformed edges.
        scale: magnification of the displacement; None: `magnify` chooses it.
        unit: unit of length, or "".
        angle: angle in degrees by which a meridian is turned about the y axis; 0: not at all.
    """
    drawn, name = magnify(volume, contacts, scale), next(iter(volume.values))
    shift = drawn.shift
    if angle:
        whole = revolved(replace(volume, values={**volume.values, "shift": shift}), angle)
        volume, shift = whole, whole.values["shift"]
    bodies = volume.to_pyvista()
    bodies.point_data["|u|"] = np.linalg.norm(bodies.point_data[name], axis=1)
    normal, up = (UPWARDS, ALONG_Y) if volume.dim == 2 else (OBLIQUE, UPWARDS)
    if angle:
        normal, up = TO_THE_CUT, ALONG_Y
    lift = 4e-3 * bodies.length * normal / np.linalg.norm(normal)
    bodies.points = volume.points + shift
    deformed = bodies.warp_by_vector(name, factor=drawn.scale)
    faces = skin(deformed)
    colours = Colours(
        "displacement", unit, "viridis", Range.of(np.asarray(bodies.point_data["|u|"]))
    )
    white = {"color": "white", "opacity": 0.3, "line_width": 1.0, "lighting": False}
    plotter.add_mesh(
        faces,
        scalars="|u|",
        show_edges=volume.degree == 1 and not angle,
        edge_color=white["color"],
        edge_opacity=white["opacity"],
        lighting=volume.dim == 3,
        ambient=0.35,
        diffuse=0.7,
        **colours.mesh_options,
    )
    if volume.degree > 1:  # edges of cells, not of the pieces into which `skin` cuts their faces
        plotter.add_mesh(_outer_edges(deformed).translate(lift), **white)
    # no creases in 2D: orientations of triangles may differ
    outline = skin(bodies).clean()
    outline = outline.extract_feature_edges(
        feature_angle=40.0,
        feature_edges=volume.dim == 3,
        non_manifold_edges=False,
        manifold_edges=False,
    )
    legend, notes = [], []
    if outline.n_points:
        what = "undeformed" + (", overlap magnified alike" if drawn.shift.any() else "")
        plotter.add_mesh(outline.translate(lift), color=OUTLINE, line_width=1.8, lighting=False)
        legend.append(line(what, OUTLINE))
    seen = [bodies.points, faces.points]
    found = [contact.obstacle for contact in contacts if contact.obstacle]
    obstacles = {(one.signed_distance, one.motion): one for one in found}.values()
    around = [
        draw_obstacle(plotter, obstacle, np.concatenate(seen[:2]), volume.dim, angle > 0.0)
        for obstacle in obstacles
    ]
    if any(len(points) for points in around):
        legend.append(legend_of_obstacles())
    for curve in curves:
        points = curve.moved(drawn.scale)
        _draw_curve(plotter, curve, points + 2.0 * lift)
        notes.append(_start(curve, points))
    if any(curve.contact.pressed.any() for curve in curves):
        legend.append(line("contact", CURVE_COLOUR, THICK))
    if not all(curve.contact.pressed.all() for curve in curves):
        legend.append(line("open", OPEN_COLOUR, THIN))
    if len(curves) == 1:
        legend.append(mark("start", "o", OPEN_COLOUR))
    camera = Camera.at(np.concatenate([*seen, *around]), normal, up, aspect)
    return Drawn(drawn.title, legend, camera, colours, notes)


def _outer_edges(grid: Any) -> Any:
    """Return the edges on the boundary of a grid of degree 2, as curves of three points.

    VTK's own edges would be broken lines.
    """
    import pyvista

    numbered = grid.copy(deep=False)
    numbered.point_data["node"] = np.arange(grid.n_points)
    outer = np.zeros(grid.n_points, dtype=bool)
    outer[skin(numbered).point_data["node"]] = True
    cell = grid.get_cell(0)
    place = {node: i for i, node in enumerate(cell.point_ids)}
    # the middle of an edge comes after its ends in the cell's order, but not always in the edge's
    ends_middle = [sorted(place[node] for node in edge.point_ids) for edge in cell.edges]
    edges = grid.cells.reshape(grid.n_cells, -1)[:, 1:][:, ends_middle].reshape(-1, 3)
    middle, first = np.unique(edges[:, 2], return_index=True)
    first = first[outer[middle]]
    lines = np.insert(edges[first][:, [0, 2, 1]], 0, 3, axis=1)
    return pyvista.PolyData(grid.points, lines=lines.ravel())


def _draw_curve(plotter: Any, curve: Curve, points: Array) -> None:
    """Draw a contact curve through (n, 3) points: thick and red where it is pressed.

    A dot marks the start of the curve, unless its label does (`_start`).
    """
    import pyvista

    pressed = curve.contact.pressed
    for piece in curve.pieces:
        parts = [(piece, OPEN_COLOUR, THIN)]
        ends = np.diff(pressed[piece].astype(int), prepend=0, append=0)
        for first, last in np.flatnonzero(ends).reshape(-1, 2):
            alone = last - first == 1  # a single node is drawn with the facets beside it
            nodes = piece[max(first - alone, 0) : last + alone]
            parts.append((nodes, CURVE_COLOUR, THICK))
        for nodes, colour, width in parts:
            line = pyvista.lines_from_points(points[nodes])
            plotter.add_mesh(line, color=colour, line_width=2.0 * width, lighting=False)
    if not curve.contact.label:
        plotter.add_points(
            points[curve.pieces[0][:1]],
            color=OPEN_COLOUR,
            point_size=14.0,
            render_points_as_spheres=True,
            lighting=False,
        )


def _start(curve: Curve, points: Array) -> tuple[Array, str, dict[str, Any]]:
    """Return an entry of `Drawn.notes`: the start of a curve, its label, and options of text."""
    box = {"facecolor": CURVE_COLOUR, "edgecolor": "none", "pad": 1.5}
    options = {"color": "white", "fontsize": 8.5, "ha": "center", "va": "center"}
    label = curve.contact.label
    return points[curve.pieces[0][0]], label, {**options, "bbox": box} if label else {}
