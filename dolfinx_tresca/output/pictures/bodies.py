"""The view of the deformed bodies, and of rigid obstacles near them."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
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
from dolfinx_tresca.output.pictures.contact import CURVE_COLOUR, Contact
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
BAND = 0.05  #: thickness of obstacles in 2D, divided by the length of the bodies
SAMPLES = {2: 400, 3: 80}  #: samples of an obstacle along the longest side
#: An obstacle is drawn as glass if it hides a larger fraction of the bodies' points. With twice
#: this value even planes in front of the bodies would be solid.
HIDDEN = 0.5


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
    curves = [contact for contact in contacts if volume.dim == 2]
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
        edges = deformed.extract_all_edges().translate(0.1 * lift)
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
    rigid = [contact.obstacle for contact in contacts if contact.obstacle]
    around = [
        draw_obstacle(plotter, obstacle, seen, volume.dim, normal, angle > 0.0)
        for obstacle in {(rigid.signed_distance, rigid.motion): rigid for rigid in rigid}.values()
    ]
    if any(map(len, around)):
        legend.append(handle("obstacle", OBSTACLE_COLOUR, "s", markersize=8.0))
    for curve in curves:
        points = curve.grid.points + scale * curve.grid.values["displacement"]
        _draw_curve(plotter, curve, points + 2.0 * lift)
        box = {"facecolor": CURVE_COLOUR, "edgecolor": "none", "pad": 1.5}
        style = {"color": "white", "fontsize": 8.5, "ha": "center", "va": "center", "bbox": box}
        if curve.label:
            notes.append((points[curve.pieces[0][0]], curve.label, style))
    if any(curve.pressed.any() for curve in curves):
        legend.append(handle("contact", CURVE_COLOUR, width=THICK))
    if any(curve.is_open.any() for curve in curves):
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

    A dot marks the start of the curve, unless its label does.
    """
    import pyvista

    for piece in curve.pieces:
        strokes = [(piece, OPEN_COLOUR, THIN)]
        ends = np.diff(curve.pressed[piece].astype(int), prepend=0, append=0)
        for begin, end in np.flatnonzero(ends).reshape(-1, 2):
            alone = end - begin == 1  # a single node is drawn with the facets beside it
            strokes.append((piece[max(begin - alone, 0) : end + alone], CURVE_COLOUR, THICK))
        for nodes, colour, width in strokes:
            line = pyvista.lines_from_points(points[nodes])
            plotter.add_mesh(line, color=colour, line_width=2.0 * width, lighting=False)
    if not curve.label:
        dot = {"point_size": 14.0, "render_points_as_spheres": True, "lighting": False}
        plotter.add_points(points[curve.pieces[0][:1]], color=OPEN_COLOUR, **dot)


def draw_obstacle(
    plotter: Any,
    obstacle: RigidObstacle,
    points: Array,
    dim: int,
    normal: Array,
    revolved: bool = False,
) -> Array:
    """Draw an obstacle round points: where its signed distance is not positive.

    In 3D the obstacle is solid, unless it hides the bodies (`HIDDEN`): then only its surface is
    drawn, and the sides that are seen from within are transparent. In 2D the surface is a line with
    a grey band behind.

    Args:
        plotter: a plotter of pyvista.
        obstacle: the obstacle to draw.
        points: (n, 3) points of the bodies [length].
        dim: dimension of space.
        normal: (3,) direction to the viewer.
        revolved: whether the obstacle is given in the meridian plane and turned about the y axis.

    Returns:
        the points that were drawn; none if the obstacle is not near the bodies.
    """
    import pyvista

    def distance(at: Array) -> Array:
        radius = np.stack([np.hypot(at[:, 0], at[:, 2]), at[:, 1], 0.0 * at[:, 0]], axis=1)
        return obstacle.distance(radius if revolved else at)

    length = float(np.linalg.norm(np.ptp(points, axis=0)))
    in_space = np.arange(3) < dim
    low = points.min(axis=0) - MARGIN * length * in_space
    high = points.max(axis=0) + MARGIN * length * in_space
    spacing = float((high - low).max()) / SAMPLES[dim]
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    grid = pyvista.ImageData(dimensions=counts, spacing=3 * (spacing,), origin=low)
    steps = np.linspace(0.05, 1.0, 16)[:, None, None] * length * normal / np.linalg.norm(normal)
    towards_viewer = points[:: 1 + len(points) // 500] + steps
    try:
        grid.point_data["distance"] = distance(np.array(grid.points))
        inside = distance(towards_viewer.reshape(-1, 3)).reshape(towards_viewer.shape[:2]) < 0.0
    except Exception as error:  # the user's function may fail away from the surface
        _LOGGER.warning("%s is not in the picture: its signed distance fails: %s", obstacle, error)
        return np.empty((0, 3))
    surface = grid.contour([0.0], scalars="distance")
    if not surface.n_points:
        return np.empty((0, 3))
    solid = grid.clip_scalar(scalars="distance", value=0.0, invert=True)
    if dim == 2:
        behind = np.array([0.0, 0.0, -0.01 * length])  # behind everything else
        band = solid.clip_scalar(scalars="distance", value=-BAND * length, invert=False)
        flat = {"lighting": False, "show_scalar_bar": False}
        plotter.add_mesh(band.translate(behind), color=OBSTACLE_COLOUR, **flat)
        plotter.add_mesh(surface.translate(0.5 * behind), color=RIM, line_width=3.0, **flat)
        return np.asarray(band.points)
    drawn = ((towards_viewer >= low) & (towards_viewer <= high)).all(axis=2)
    options = {"color": OBSTACLE_COLOUR, "smooth_shading": True, "ambient": 0.4, "diffuse": 0.6}
    if (inside & drawn).any(axis=0).mean() <= HIDDEN:
        surface = skin(solid).compute_normals(cell_normals=False, split_vertices=True)
        surface.clear_cell_data()
        plotter.add_mesh(surface, **options)
    else:  # normals point to where distances grow
        sides = {"auto_orient_normals": False, "consistent_normals": False}
        surface = surface.compute_normals(cell_normals=False, **sides)
        plotter.add_mesh(surface, culling="front", **options)
        plotter.add_mesh(surface, culling="back", opacity=0.15, **options)
    rim = surface.extract_feature_edges(30.0, non_manifold_edges=False, manifold_edges=False)
    if rim.n_points:
        plotter.add_mesh(rim, color=RIM, line_width=1.5, lighting=False)
    return np.asarray(surface.points)
