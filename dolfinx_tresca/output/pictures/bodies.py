"""The view of the deformed bodies, and of rigid obstacles near them."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.output.pictures.canvas import (
    ALONG_Y,
    OBLIQUE,
    UPWARDS,
    Camera,
    Colours,
    View,
    handle,
    skin,
)
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.output.pictures.curve import CURVE_COLOUR, chains
from dolfinx_tresca.output.revolved import revolved
from dolfinx_tresca.scene.obstacle import RigidObstacle

_LOGGER = logging.getLogger("dolfinx_tresca")

OUTLINE, OPEN_COLOUR = "#6e6e6e", "#202020"  #: colours of undeformed edges, of open curves
OBSTACLE_COLOUR, RIM = "#a9b8c6", "#5b6670"
TO_THE_CUT = np.array([0.42, 0.36, 0.83])  #: direction from which revolved bodies are seen
THIN, THICK = 0.8, 2.8  #: widths in points of a contact curve, and of its pressed parts
VISIBLE = 0.1  #: largest displacement in the picture, divided by the length of the model
INVISIBLE = 0.004  #: distance that is hardly visible, divided by the length of the model
MARGIN = 0.12  #: margin round bodies in which obstacles are drawn, divided by the bodies' length
BAND = 0.04  #: thickness of obstacles in 2D, divided by the length of all that is drawn
SAMPLES = {2: 400, 3: 80}  #: samples of an obstacle along the longest side
#: Obstacles in front of the bodies are drawn as glass if all together hide a larger fraction of the
#: bodies' points. With twice this value they would be solid even if they hide everything.
HIDDEN = 0.5
#: An obstacle is in front of the bodies if it hides a larger fraction of their points. With twice
#: this value small obstacles in front would be solid among others that are glass.
IN_FRONT = 0.05


def draw_bodies(
    plotter: Any,
    aspect: float,
    volume: Grid,
    contacts: Sequence[Contact],
    scale: float | None,
    unit: str,
    angle: float = 0.0,
) -> View:
    """Draw the deformed bodies, the contact curves of 2D, and rigid obstacles.

    Args:
        plotter: a plotter of pyvista.
        aspect: width of the view divided by its height.
        volume: the mesh with the displacement.
        contacts: the contact surfaces of all pairs.
        scale: magnification of the displacement; None: `magnification` chooses it.
        unit: unit of length, or "".
        angle: angle in degrees by which a meridian is turned about the y axis; 0: not at all.
    """
    scale = magnification(volume, contacts) if scale is None else scale
    curves = contacts if volume.dim == 2 else []
    normal, up = (UPWARDS, ALONG_Y) if volume.dim == 2 else (OBLIQUE, UPWARDS)
    if angle:
        volume, normal, up = revolved(volume, angle), TO_THE_CUT, ALONG_Y
    name, bodies = next(iter(volume.values)), volume.to_pyvista()
    length = np.linalg.norm(bodies.point_data[name], axis=1)
    bodies.point_data["|u|"] = length
    lift = 4e-3 * bodies.length * normal / np.linalg.norm(normal)
    deformed = bodies.warp_by_vector(name, factor=scale)
    faces = skin(deformed)
    colours = Colours.from_values(length, "displacement", unit, "viridis")
    light = {"lighting": volume.dim == 3, "ambient": 0.35, "diffuse": 0.7}
    plotter.add_mesh(faces, scalars="|u|", **light, **colours.options)
    if not angle:  # in 3D edges inside are hidden by the faces
        edges = deformed.extract_all_edges().translate(0.4 * lift)
        plotter.add_mesh(edges, color="white", opacity=0.3, line_width=1.0, lighting=False)
    # no creases in 2D: orientations of triangles may differ
    outline = skin(bodies).clean().extract_feature_edges(
        feature_angle=40.0, feature_edges=volume.dim == 3, non_manifold_edges=False,
        manifold_edges=False,
    )  # fmt: skip
    legend, notes = [], []
    if outline.n_points:
        plotter.add_mesh(outline.translate(lift), color=OUTLINE, line_width=1.8, lighting=False)
        legend.append(handle("undeformed", OUTLINE, width=1.2))
    seen = np.concatenate([bodies.points, faces.points])
    obstacles = [contact.obstacle for contact in contacts if contact.obstacle]
    near = [
        obstacle_near(obstacle, seen, volume.dim, normal, angle > 0.0)
        for obstacle in {(key.signed_distance, key.motion): key for key in obstacles}.values()
    ]
    near = [(grid, hidden) for grid, hidden in near if grid is not None]
    glass = np.any([hidden for _, hidden in near], axis=0).mean() > HIDDEN
    around = [
        draw_obstacle(plotter, grid, volume.dim, bool(glass and hidden.mean() > IN_FRONT))
        for grid, hidden in near
    ]
    if around:
        legend.append(handle("obstacle", OBSTACLE_COLOUR, "s", markersize=8.0))
    for curve in curves:
        points = curve.grid.points + scale * curve.grid.values["displacement"]
        _draw_curve(plotter, curve, points + 2.0 * lift)
        box = {"facecolor": CURVE_COLOUR, "edgecolor": "none", "pad": 1.5}
        style = {"color": "white", "fontsize": 8.5, "ha": "center", "va": "center", "bbox": box}
        if curve.label:
            notes.append((points[chains(curve.grid)[0][0]], curve.label, style))
    if any(curve.pressed.any() for curve in curves):
        legend.append(handle("contact", CURVE_COLOUR, width=THICK))
    if not all(curve.pressed.all() for curve in curves):
        legend.append(handle("open", OPEN_COLOUR, width=THIN))
    if len(curves) == 1:
        legend.append(handle("start", OPEN_COLOUR, "o"))
    title = "Displacement" + (f", magnified {scale:,.12g} times" if scale != 1.0 else "")
    camera = Camera.framing(np.concatenate([seen, *around]), normal, up, aspect)
    return View(title, legend, camera, colours, notes)


def magnification(volume: Grid, contacts: Sequence[Contact]) -> float:
    """Return a round magnification of the displacement u, at least 1, that shows the deformation.

    At x + scale u, surfaces whose gap d has closed would overlap by (scale - 1) d, and the sides of
    an initial overlap (a press fit) would be apart. The scale keeps these distances, and overlaps
    of open surfaces, below `INVISIBLE`. If the displacement itself would then be invisible, it is
    drawn without magnification.
    """
    length = float(np.linalg.norm(np.ptp(volume.points, axis=0)))
    largest = float(np.linalg.norm(next(iter(volume.values.values())), axis=1).max(initial=0.0))
    if largest <= np.finfo(float).tiny * length:  # nothing moves
        return 1.0
    scale = VISIBLE * length / largest
    for contact in contacts:
        pressed = contact.touching[contact.nodes]
        gap = np.where(pressed, 0.0, contact.grid.values["gap"][contact.nodes])
        closed = contact.initial_gap - gap
        closed[pressed] = np.abs(closed[pressed])
        limits = closed > 0.0
        room = np.maximum(gap[limits], 0.0) + INVISIBLE * length
        scale = min(scale, 1.0 + float((room / closed[limits]).min(initial=math.inf)))
    if scale * largest < 2.0 * INVISIBLE * length or scale < 1.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(scale))
    return max(digit * power for digit in (1.0, 2.0, 3.0, 5.0) if digit * power <= scale + 1e-9)


def _draw_curve(plotter: Any, curve: Contact, points: Array) -> None:
    """Draw a contact curve through (n, 3) points: thick and red where it is pressed.

    A node that is pressed alone is drawn with the facets beside it. A dot marks the start of the
    curve, unless its label does.
    """
    import pyvista

    facets = curve.grid.cells
    at_ends = curve.pressed[facets[:, 1:]]
    alone = curve.pressed.copy()
    alone[facets[at_ends.all(axis=1), 1:]] = False
    pressed = at_ends.all(axis=1) | alone[facets[:, 1:]].any(axis=1)
    flat = {"lighting": False}
    strokes = ((facets, OPEN_COLOUR, THIN), (facets[pressed], CURVE_COLOUR, THICK))
    for lines, colour, width in strokes:
        if len(lines):
            mesh = pyvista.PolyData(points, lines=lines.ravel())
            plotter.add_mesh(mesh, color=colour, line_width=2.0 * width, **flat)
    if not curve.label:
        dot = {"point_size": 14.0, "render_points_as_spheres": True}
        plotter.add_points(points[chains(curve.grid)[0][:1]], color=OPEN_COLOUR, **dot, **flat)


def obstacle_near(
    obstacle: RigidObstacle, points: Array, dim: int, normal: Array, revolved: bool = False
) -> tuple[Any, Mask]:
    """Return the distance from an obstacle on a grid around points, and which points it hides.

    Args:
        obstacle: the obstacle to draw.
        points: (n, 3) points of the bodies [length].
        dim: dimension of space.
        normal: (3,) direction to the viewer.
        revolved: whether the obstacle is given in the meridian plane and turned about the y axis.

    Returns:
        a grid of pyvista with the field "distance", None if the surface of the obstacle is not near
        the points or its distance cannot be computed; and whether the part of the obstacle in the
        grid is between the viewer and the points, for (k,) of the points.
    """
    import pyvista

    length = float(np.linalg.norm(np.ptp(points, axis=0)))
    margin = MARGIN * length * (np.arange(3) < dim)
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    spacing = float((high - low).max()) / SAMPLES[dim]
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    grid = pyvista.ImageData(dimensions=counts, spacing=3 * (spacing,), origin=low)
    steps = np.linspace(0.05, 1.0, 16)[:, None, None] * length * normal / np.linalg.norm(normal)
    rays = points[:: 1 + len(points) // 500] + steps
    places = np.concatenate([np.array(grid.points), rays.reshape(-1, 3)])
    if revolved:
        radius = np.hypot(places[:, 0], places[:, 2])
        places = np.stack([radius, places[:, 1], 0.0 * radius], axis=1)
    try:
        distance = obstacle.distance(places)
    except Exception as error:  # the user's function may fail away from the surface
        _LOGGER.warning("%s is not in the picture: its signed distance fails: %s", obstacle, error)
        return None, np.empty(0, dtype=bool)
    grid.point_data["distance"] = distance[: grid.n_points]
    drawn = ((rays >= low) & (rays <= high)).all(axis=2)
    inside = distance[grid.n_points :].reshape(rays.shape[:2]) < 0.0
    crossed = grid["distance"].min() < 0.0 <= grid["distance"].max()
    return grid if crossed else None, (inside & drawn).any(axis=0)


def draw_obstacle(plotter: Any, grid: Any, dim: int, glass: bool) -> Array:
    """Draw an obstacle: where its signed distance is not positive.

    In 3D the obstacle is solid, or as glass: then only its surface is drawn, and the sides that are
    seen from within are transparent. In 2D the surface is a line with a grey band behind.

    Args:
        plotter: a plotter of pyvista.
        grid: a grid of pyvista with the signed distance, from `obstacle_near`.
        dim: dimension of space.
        glass: whether the obstacle hides the bodies.

    Returns:
        the points that were drawn.
    """
    solid = grid.clip_scalar(scalars="distance", value=0.0, invert=True)
    surface = grid.contour([0.0], scalars="distance")
    if dim == 2:
        behind = np.array([0.0, 0.0, -0.01 * grid.length])  # behind everything else
        band = solid.clip_scalar(scalars="distance", value=-BAND * grid.length, invert=False)
        flat = {"lighting": False, "show_scalar_bar": False}
        plotter.add_mesh(band.translate(behind), color=OBSTACLE_COLOUR, **flat)
        plotter.add_mesh(surface.translate(0.5 * behind), color=RIM, line_width=3.0, **flat)
        return np.asarray(band.points)
    options = {"color": OBSTACLE_COLOUR, "smooth_shading": True, "ambient": 0.4, "diffuse": 0.6}
    if glass:  # normals point to where distances grow
        sides = {"auto_orient_normals": False, "consistent_normals": False}
        surface = surface.compute_normals(cell_normals=False, **sides)
        plotter.add_mesh(surface, culling="front", **options)
        plotter.add_mesh(surface, culling="back", opacity=0.15, **options)
    else:
        surface = skin(solid).compute_normals(cell_normals=False, split_vertices=True)
        surface.clear_cell_data()
        plotter.add_mesh(surface, **options)
    rim = surface.extract_feature_edges(30.0, non_manifold_edges=False, manifold_edges=False)
    if rim.n_points:
        plotter.add_mesh(rim, color=RIM, line_width=1.5, lighting=False)
    return np.asarray(surface.points)
