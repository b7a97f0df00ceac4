"""The deformed bodies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.grid import Grid
from dolfinx_tresca.pictures.canvas import OBLIQUE, UPWARDS, bar, look, skin, title
from dolfinx_tresca.pictures.curve import CURVE_COLOUR, Curve

VISIBLE = 0.1  #: of the length of the model: the displacement in the picture


def draw_bodies(plotter: Any, volume: Grid, curves: Sequence[Curve], scale: float | None) -> None:
    """Draw the deformed bodies into the current part of the picture.

    Args:
        plotter: of pyvista.
        volume: the displacement.
        curves: the contact curves of 2D, drawn on the undeformed edges.
        scale: magnification; None chooses one.
    """
    bodies = volume.to_pyvista()
    name = next(iter(volume.values))
    bodies.point_data["|u|"] = np.linalg.norm(bodies.point_data[name], axis=1)
    if scale is None:
        scale = visible_scale(bodies.length, float(bodies.get_data_range("|u|")[1]))
    normal, up = (UPWARDS, np.array([0.0, 1.0, 0.0])) if volume.dim == 2 else (OBLIQUE, UPWARDS)
    lift = 4e-3 * bodies.length * normal / np.linalg.norm(normal)
    deformed = bodies.warp_by_vector(name, factor=scale)
    faces = skin(deformed)
    least, largest = bodies.get_data_range("|u|")
    white = {"color": "white", "opacity": 0.3, "line_width": 1.0, "lighting": False}
    plotter.add_mesh(
        faces,
        scalars="|u|",
        cmap="viridis",
        clim=(least if least > 1e-3 * largest else 0.0, largest or 1.0),
        show_edges=volume.degree == 1,
        edge_color=white["color"],
        edge_opacity=white["opacity"],
        lighting=volume.dim == 3,
        ambient=0.35,
        diffuse=0.7,
        scalar_bar_args=bar("length of displacement"),
    )
    if volume.degree > 1:  # the edges of the pieces are not those of the mesh
        plotter.add_mesh(_outer_edges(deformed).translate(lift), **white)
    # no creases in 2D: any two triangles may be turned against each other
    outline = skin(bodies).clean()
    outline = outline.extract_feature_edges(
        feature_angle=40.0,
        feature_edges=volume.dim == 3,
        non_manifold_edges=False,
        manifold_edges=False,
    )
    if outline.n_points:
        plotter.add_mesh(outline.translate(lift), color="grey", line_width=1.5, lighting=False)
    for curve in curves:
        _draw_curve(plotter, curve, 2.0 * lift)
    legend = ["lines: undeformed edges"]
    if curves:
        start = "number" if len(curves) > 1 else "dot"
        legend.append(f"red: contact, from the {start} on")
    title(plotter, f"Displacement, magnified {scale:,.12g} times", "    ".join(legend))
    look(plotter, np.concatenate([bodies.points, faces.points]), normal, up)


def visible_scale(length: float, largest: float) -> float:
    """Return 1, 2, 3 or 5 times a power of ten that makes the largest displacement visible."""
    wanted = VISIBLE * length / largest if largest > 0.0 else 1.0
    power = 10.0 ** math.floor(math.log10(wanted))
    return max(
        digit * power for digit in (1.0, 2.0, 3.0, 5.0) if digit * power <= wanted * (1.0 + 1e-9)
    )


def _outer_edges(grid: Any) -> Any:
    """Return the edges outside of cells of degree 2, lines of three points. VTK breaks them."""
    import pyvista

    numbered = grid.copy(deep=False)
    numbered.point_data["node"] = np.arange(grid.n_points)
    outer = np.zeros(grid.n_points, dtype=bool)
    outer[skin(numbered).point_data["node"]] = True
    cell = grid.get_cell(0)
    place = {node: i for i, node in enumerate(cell.point_ids)}
    # the middle is the last in the cell, though not in the edges of all kinds of cells
    ends_middle = [sorted(place[node] for node in edge.point_ids) for edge in cell.edges]
    edges = grid.cells.reshape(grid.n_cells, -1)[:, 1:][:, ends_middle].reshape(-1, 3)
    middle, first = np.unique(edges[:, 2], return_index=True)
    first = first[outer[middle]]
    lines = np.insert(edges[first][:, [0, 2, 1]], 0, 3, axis=1)
    return pyvista.PolyData(grid.points, lines=lines.ravel())


def _draw_curve(plotter: Any, curve: Curve, lift: Array) -> None:
    """Draw a contact curve, and a dot or its number where its arc length begins."""
    import pyvista

    for piece in curve.pieces:
        line = pyvista.lines_from_points(curve.points[piece] + lift)
        plotter.add_mesh(line, color=CURVE_COLOUR, line_width=4.0, lighting=False)
    start = curve.points[curve.pieces[0][:1]] + 1.5 * lift
    if curve.contact.number:
        plotter.add_point_labels(
            start,
            [curve.contact.number.strip()],
            show_points=False,
            shape_color=CURVE_COLOUR,
            text_color="white",
            font_size=16,
            bold=False,
            always_visible=True,
        )
    else:
        plotter.add_points(
            start,
            color=CURVE_COLOUR,
            point_size=13.0,
            render_points_as_spheres=True,
            lighting=False,
        )
