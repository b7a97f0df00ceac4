"""The panels of a picture: views of bodies and of surfaces, and the chart of a contact curve of 2D.

A panel is a `SubFigure` of matplotlib, which draws titles, legends, colour bars and charts.
Positions in it are in inches. pyvista renders the views.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from textwrap import shorten
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, depth_first_order

from dolfinx_tresca._base.arrays import Array, unit
from dolfinx_tresca.output.files import Grid, gather_grid
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.solution.fields import STICKING, ContactState, SurfaceFields

LEFT = 0.15  #: inches between the left end of a panel and its title
HEADER, FOOTER = 0.66, 0.62  #: inches for title and legend, and for a colour bar
CURVE_COLOUR = "#c8102e"  #: colour of a contact curve and its pressure
TANGENT_COLOUR = "#1f4e9c"  #: colour of traction and slip
OPEN_COLOUR = "#e2e2e2"  #: colour of open surfaces
_LOGGER = logging.getLogger("dolfinx_tresca")

DPI = 200  #: pixels per inch of rendered views
OBLIQUE = np.array([-0.38, -0.84, 0.38])  #: direction from which bodies are seen
ALONG_Y, ALONG_Z = np.eye(3)[1:]  #: up in views of 2D; up in views of 3D
OUTLINE, OPEN_LINE = "#6e6e6e", "#202020"  #: colours of undeformed edges, of open curves
OBSTACLE_COLOUR = "#a9b8c6"  #: colour of obstacles

#: VTK's types of Lagrange tetrahedra and hexahedra -> type and number of corners of linear ones.
LINEAR = {71: (10, 4), 72: (12, 8)}

VISIBLE = 0.1  #: largest displacement in the picture, divided by the length of the model
INVISIBLE = 0.004  #: distance that is hardly visible, divided by the length of the model
SAMPLES = 300_000  #: approximate number of points at which the distance of an obstacle is computed


@dataclass(frozen=True)
class Contact:
    """A contact surface, gathered on one rank, with what its panel shows.

    Attributes:
        grid: the fields of the surface. Its "slip" is that of this step, and zero at sticking
            nodes; only pairs with friction have it. "pressed" is 1 at nodes that are drawn as
            touching, 0 at open ones; "sticks" is 1 at nodes that stick.
        title: number and name of the pair after a space, to add to titles; "" for a single pair.
        label: number of the pair; "" for a single pair.
        slip_name: name of the slip: "slip", or "slip of step" after an accepted load step.
        obstacle: the other side, if it is rigid; else None.
    """

    grid: Grid
    title: str = ""
    label: str = ""
    slip_name: str = "slip"
    obstacle: RigidObstacle | None = None


def gather_contact(surface: SurfaceFields, label: str = "") -> Contact | None:
    """Return the surface of a pair, gathered on the first rank; None on others. Collective.

    A node that carries no multiplier, such as the tip of a crack or a prescribed node, is drawn as
    touching if each of its facets has nodes that carry multipliers, and all of these touch.
    """
    grid = gather_grid((*surface.functions, surface.initial_gap))
    if grid is None:
        return None
    values, facets, slip_name = grid.values, grid.cells[:, 1:], "slip"
    # masks of nodes, then of facets whose nodes with multipliers all touch
    carries = values["state"] > ContactState.OUTSIDE
    touches = values["state"] >= ContactState.PRESSED
    closed = (~carries | touches)[facets].all(axis=1) & carries[facets].any(axis=1)
    in_closed_facets = np.ones(len(carries), dtype=np.bool_)
    in_closed_facets[facets[~closed]] = False
    values["pressed"] = np.where(carries, touches, in_closed_facets).astype(float)
    values["sticks"] = np.isin(values["state"], STICKING).astype(float)
    if "slip_increment" in values:  # after an accepted load step
        slip_name, values["slip"] = "slip of step", values["slip_increment"]
    if "slip" in values:
        values["slip"][values["sticks"] > 0.0] = 0.0  # the error of the iteration is removed
    title = f" {label}: {shorten(surface.name, 40, placeholder=' ...')}" if label else ""
    return Contact(grid, title, label, slip_name, surface.obstacle)


def axes_at(panel: Any, left: float, bottom: float, width: float, height: float) -> Any:
    """Add axes that fill a rectangle of a panel [inches], for a chart, view or bar; return them."""
    wide, high = panel.bbox.size / panel.dpi  # inches
    return panel.add_axes((left / wide, bottom / high, width / wide, height / high))


def write_header(panel: Any, title: str, legend: Sequence[Any]) -> None:
    """Write a title and below it the legend, at the top of a panel."""
    width, height = panel.bbox.size / panel.dpi  # inches
    panel.text(LEFT / width, 1.0 - 0.3 / height, title, fontsize=11.0)
    panel.legend(
        handles=legend, ncols=max(len(legend), 1), loc="upper left", labelcolor="#404040",
        bbox_to_anchor=(LEFT / width, 1.0 - 0.36 / height), borderpad=0.0, borderaxespad=0.0,
        handlelength=1.0, handletextpad=0.5, columnspacing=0.9, fontsize=8.5, frameon=False,
    )  # fmt: skip


def handle(label: str, color: str, marker: str = "", **options: Any) -> Any:
    """Return an entry of a legend: matplotlib's `marker`, or a line if it is ""."""
    from matplotlib.lines import Line2D

    style = {"linestyle": "" if marker else "-", "markersize": 5.0, **options}
    return Line2D([], [], color=color, marker=marker, label=label, **style)


def colour_range(values: Array, *, clip: bool = False) -> tuple[float, float, float]:
    """Return the ends of a colour bar for values (n,) >= 0, and the largest value.

    The bar begins at zero, unless all values exceed half of the largest. With `clip` it may end, at
    a round number, below a few values that are much larger.
    """
    least, largest = float(values.min(initial=math.inf)), float(values.max(initial=0.0))
    usual = float(np.percentile(values, 85.0)) if clip and len(values) else 0.0
    if 0.0 < 2.5 * usual < largest:  # without a cut, 85 % of the values would look the same
        step = 0.5 * 10.0 ** math.floor(math.log10(usual))
        return 0.0, step * math.ceil(usual / step - 1e-9), largest
    is_far_from_zero = 0.5 * largest < least < (1.0 - 1e-6) * largest
    return least if is_far_from_zero else 0.0, largest or 1.0, largest


def draw_bar(panel: Any, name: str, unit_name: str, cmap: str, limits: Sequence[float]) -> None:
    """Draw a colour bar for `limits`, a `colour_range`; arrow and text show a peak beyond it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high, largest = limits
    width, _ = panel.bbox.size / panel.dpi  # inches
    axes = axes_at(panel, 0.27 * width, 0.42, 0.58 * width, 0.12)
    label, extend = labelled(name, unit_name), "neither"
    if largest > high:
        label, extend = f"{label}, at most {largest:.3g}", "max"
    colours = ScalarMappable(Normalize(low, high), cmap)
    panel.colorbar(colours, cax=axes, label=label, orientation="horizontal", extend=extend)
    axes.tick_params(width=0.6, length=2.5, pad=2.0)
    axes.locator_params(nbins=5)
    axes.xaxis.labelpad = 1.5


def labelled(name: str, unit_name: str) -> str:
    """Return a label such as "slip [mm]", or the name alone without a unit."""
    return f"{name} [{unit_name}]" if unit_name else name


def unrolled(grid: Grid) -> list[tuple[npt.NDArray[np.int32], Array, Array]]:
    """Return the pieces of a curve of 2D, sorted by the nodes at which they begin.

    An open piece begins at one of its ends, a closed piece at one of its nodes: at the least one if
    they are sorted by x, then by y. A closed piece runs counterclockwise and ends where it begins.

    Returns:
        for each piece: its k nodes; (k,) arc lengths [length], which go on from piece to piece with
        a gap of 4 % of the length so far; and (k, 3) unit vectors along the curve.
    """
    points, lines = grid.points, grid.cells[:, 1:]
    neighbours = coo_array((np.ones(len(lines)), lines.T), shape=2 * (len(points),)).tocsr()
    count = np.bincount(lines.ravel(), minlength=len(points))
    x, y, _ = np.round(points.T, 12)
    # each piece starts at its first node in this order: the ends of open pieces, then the others
    order = np.lexsort((y, x, count != 1))
    _, piece_of = connected_components(neighbours, directed=False)
    _, first_of_piece = np.unique(piece_of[order], return_index=True)
    starts = order[first_of_piece]
    start_of_arc, curves = 0.0, []
    for start in starts[np.lexsort((y[starts], x[starts]))]:
        nodes = depth_first_order(neighbours, start, directed=False, return_predecessors=False)
        closed = count[start] == 2
        if closed:
            nodes = np.append(nodes, start)
            a, b = points[nodes[:-1], :2].T, points[nodes[1:], :2].T
            twice_area = np.sum(a[0] * b[1] - b[0] * a[1])
            if not twice_area > 0.0:  # clockwise
                nodes = nodes[::-1]
        positions = points[nodes]
        directions = np.gradient(positions, axis=0)
        if closed:  # both neighbours of the node count
            directions[[0, -1]] = positions[1] - positions[-2]
        steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
        arc_lengths = start_of_arc + np.append(0.0, np.cumsum(steps))
        curves.append((nodes, arc_lengths, unit(directions)))
        start_of_arc = 1.04 * arc_lengths[-1]
    return curves


def draw_curve(panel: Any, contact: Contact, length: str, stress: str) -> None:
    """Draw charts of pressure, traction and slip of a contact curve against its arc length.

    Traction and slip are their components along the curve. `length` and `stress` name the units.
    """
    values, title, legend = contact.grid.values, f"Contact curve{contact.title}", []
    charts = [(["pressure"], "contact pressure", stress)]
    if "slip" in values:
        charts = [(["traction", "pressure"], "stress", stress), (["slip"], "slip", length)]
        legend.append(handle("pressure", CURVE_COLOUR))
        legend.append(handle(f"traction, {contact.slip_name}", TANGENT_COLOUR))
        title += "" if contact.label else ": traction and slip positive along it"
    if values["sticks"].any():
        legend.append(handle("sticks", "black", "o"))
    width, height = panel.bbox.size / panel.dpi  # inches
    margins = {"left": 0.65 / width, "right": 1.0 - 0.25 / width, "hspace": 0.14}
    margins |= {"bottom": 0.5 / height, "top": 1.0 - (HEADER + 0.05) / height}
    rows = {"height_ratios": (0.64, 0.36)[: len(charts)], "gridspec_kw": margins}
    all_axes = panel.subplots(len(charts), sharex=True, squeeze=False, **rows)[:, 0]
    for axes, (names, label, axis_unit) in zip(all_axes, charts, strict=True):
        for nodes, s, directions in unrolled(contact.grid):
            sticks = values["sticks"][nodes] > 0.0
            for name in names:
                y = values[name][nodes]
                y = y if y.ndim == 1 else np.sum(y * directions, axis=1)
                colour = CURVE_COLOUR if name == "pressure" else TANGENT_COLOUR
                axes.plot(s, y, color=colour, linewidth=1.6, marker=".", markersize=5)
                if name == "pressure":
                    axes.fill_between(s, y, color=colour, alpha=0.15, lw=0)
                elif name == "traction":
                    axes.plot(s[sticks], y[sticks], "o", color="black", markersize=5, zorder=3)
        axes.set_ylabel(labelled(label, axis_unit))
        axes.locator_params(nbins=5)
        axes.axhline(0.0, color="grey", linewidth=0.8, zorder=1)
        axes.margins(x=0.02)
        axes.spines[["top", "right"]].set_visible(False)
    all_axes[-1].set_xlabel(labelled("arc length", length))
    panel.align_ylabels(all_axes)
    write_header(panel, title, legend)


@contextmanager
def view_in(panel: Any, normal: Array, up: Array) -> Iterator[Any]:
    """Yield a plotter of pyvista, and at the end of the block put its view into a panel.

    The view is as large as possible, without perspective, and arrows show the coordinate
    directions. The normal (3,) points to the viewer, and `up` (3,) upward in the view.
    """
    import pyvista

    theme = pyvista.themes.DocumentTheme()
    theme.allow_empty_mesh, theme.show_scalar_bar = True, False
    with closing(pyvista.Plotter(off_screen=True, theme=theme)) as plotter:
        yield plotter
        # half the height of a view that has all points in it, with a margin
        right = np.cross(up, normal)
        directions = unit(np.array([right, np.cross(normal, right)]))
        points = np.concatenate([mesh.points for mesh in plotter.meshes])
        sideways, upward = np.abs((points - plotter.center) @ directions.T).max(axis=0)
        width, height = panel.bbox.size / panel.dpi  # inches
        height -= HEADER + FOOTER
        plotter.enable_parallel_projection()
        plotter.view_vector(normal, viewup=up)
        plotter.camera.parallel_scale = max(upward / 0.96, sideways / 0.92 * height / width) or 1.0
        plotter.enable_anti_aliasing("msaa", multi_samples=8)
        pixels = [round(DPI * width), round(DPI * height)]
        image = plotter.screenshot(return_img=True, window_size=pixels)
    # the image, and arrows of 21 points for the coordinate axes, except those seen end on
    view = axes_at(panel, 0.0, FOOTER, width, height)
    view.imshow(image, aspect="auto", interpolation="none")
    view.set_axis_off()
    shape = {"arrowstyle": "<|-", "mutation_scale": 5, "lw": 0.8, "shrinkA": 1, "shrinkB": 0}
    arrow = {"ha": "center", "va": "center", "fontsize": 8, "arrowprops": shape}
    arrow |= {"xycoords": "subfigure points", "textcoords": "offset points"}
    start = 16.0 - 21.0 * np.minimum(directions.min(axis=1), 0.0)
    for name, end in zip("xyz", 21.0 * directions.T, strict=True):
        if np.linalg.norm(end) > 4.0:
            view.annotate(name, start, end, annotation_clip=False, **arrow)


def skin(grid: Any) -> Any:
    """Return the outer faces of a grid, those of degree 2 cut into pieces of half the length."""
    import pyvista

    # `extract_surface` of newer pyvista requires an argument that older versions do not have
    surface = import_module("vtkmodules.vtkFiltersGeometry").vtkDataSetSurfaceFilter()
    surface.SetInputData(grid)
    surface.Update()
    return pyvista.wrap(surface.GetOutput())


def draw_bodies(
    panel: Any, volume: Grid, contacts: Sequence[Contact], scale: float | None, length: str
) -> None:
    """Draw bodies with a magnified displacement, contact curves of 2D, and rigid obstacles.

    Without a `scale` of displacements, `magnification` chooses it. `length` names the unit.
    """
    scale = magnification(volume, contacts) if scale is None else scale
    flat = volume.dim == 2
    normal, up = (ALONG_Z, ALONG_Y) if flat else (OBLIQUE, ALONG_Z)
    name, bodies = next(iter(volume.values)), volume.to_pyvista()
    bodies.point_data["|u|"] = np.linalg.norm(bodies.point_data[name], axis=1)
    limits = colour_range(bodies.point_data["|u|"])
    deformed = bodies.warp_by_vector(name, factor=scale)
    faces, lift = skin(deformed), 4e-3 * bodies.length * normal
    # edges are those of cells that have no nodes but corners: if two cells of degree 2 have the
    # nodes of their common face in different orders, VTK takes it for an outer face of both
    kind, count = LINEAR.get(volume.cell_types[0], (volume.cell_types[0], volume.cells[0, 0]))
    cells = np.insert(volume.cells[:, 1 : 1 + count], 0, count, axis=1)
    corner_grid = replace(volume, cells=cells, cell_types=np.full(len(cells), kind))
    # orientations of cells may differ: no creases in 2D, oriented faces in 3D
    surface = skin(corner_grid.to_pyvista())
    surface = surface.clean() if flat else surface.compute_normals(split_vertices=False)
    kinds = {"feature_edges": not flat, "non_manifold_edges": False, "manifold_edges": False}
    outline = surface.extract_feature_edges(40.0, **kinds)
    near = np.concatenate([bodies.points, faces.points])
    # an obstacle of several pairs is drawn once
    of_pairs = [contact.obstacle for contact in contacts if contact.obstacle]
    obstacles = {(obstacle.signed_distance, obstacle.motion): obstacle for obstacle in of_pairs}
    legend = [handle("undeformed", OUTLINE, linewidth=1.2)] if outline.n_points else []
    with view_in(panel, normal, up) as plotter:
        light = {"lighting": not flat, "ambient": 0.35, "diffuse": 0.7}
        plotter.add_mesh(faces, scalars="|u|", cmap="viridis", clim=limits[:2], **light)
        edges = deformed.extract_all_edges().translate(0.4 * lift)
        plotter.add_mesh(edges, color="white", opacity=0.3, line_width=1.0, lighting=False)
        plotter.add_mesh(outline.translate(lift), color=OUTLINE, line_width=1.8, lighting=False)
        drawn = [draw_obstacle(plotter, obstacle, near, flat) for obstacle in obstacles.values()]
        if any(drawn):
            legend.append(handle("obstacle", OBSTACLE_COLOUR, "s", markersize=8.0))
        if flat and contacts:
            dot = {"point_size": 14.0, "render_points_as_spheres": True, "lighting": False}
            box = {"shape_color": CURVE_COLOUR, "shape_opacity": 1.0, "always_visible": True}
            text = {"text_color": "white", "font_size": 24, "bold": False, "show_points": False}
            for contact in contacts:
                # the contact curve on the deformed bodies, thick where pressed, and its start
                curve = contact.grid.to_pyvista().warp_by_vector("displacement", factor=scale)
                curve = curve.translate(2.0 * lift)
                pressed = curve.clip_scalar(scalars="pressed", value=0.5, invert=False)
                plotter.add_mesh(curve, color=OPEN_LINE, line_width=1.6, lighting=False)
                plotter.add_mesh(pressed, color=CURVE_COLOUR, line_width=5.6, lighting=False)
                nodes, _, _ = unrolled(contact.grid)[0]
                start = curve.points[nodes[:1]]
                plotter.add_points(start, color=OPEN_LINE, **dot)
                if contact.label:
                    plotter.add_point_labels(start, [contact.label], **text, **box)
            legend.append(handle("contact", CURVE_COLOUR, linewidth=2.8))
            legend.append(handle("open", OPEN_LINE, linewidth=0.8))
            legend.append(handle("start", OPEN_LINE, "o"))
    draw_bar(panel, "displacement", length, "viridis", limits)
    title = "Displacement" + (f", magnified {scale:,.12g} times" if scale != 1.0 else "")
    write_header(panel, title, legend)


def magnification(volume: Grid, contacts: Sequence[Contact]) -> float:
    """Return a round magnification of the displacement u, at least 1, that shows the deformation.

    At x + scale u, surfaces whose gap d has closed would overlap by (scale - 1) d, and the sides of
    an initial overlap (a press fit) would be apart. The scale keeps these distances, and overlaps
    of open surfaces, below `INVISIBLE`; it is 1 if the displacement would then be invisible.
    """
    length = float(np.linalg.norm(np.ptp(volume.points, axis=0)))
    displacement = next(iter(volume.values.values()))
    largest = float(np.linalg.norm(displacement, axis=1).max(initial=0.0))
    if largest <= np.finfo(float).tiny * length:  # nothing moves
        return 1.0
    scale = VISIBLE * length / largest
    for contact in contacts:
        values = contact.grid.values
        pressed = values["pressed"] > 0.0
        gap = np.where(pressed, 0.0, values["gap"])
        closing = values["initial_gap"] - gap
        closing = np.where(pressed, np.abs(closing), closing)
        # gap - (scale - 1) closing >= -INVISIBLE length, where the gap of pressed nodes is zero
        limits = INVISIBLE * length + np.maximum(gap, 0.0)
        closes = closing > 0.0
        added = limits[closes] / closing[closes]
        scale = min(scale, 1.0 + float(added.min(initial=math.inf)))
    if scale < max(1.0, 2.0 * INVISIBLE * length / largest):  # hardly visible
        return 1.0
    power = 10.0 ** math.floor(math.log10(scale))
    return max(digit * power for digit in (1.0, 2.0, 3.0, 5.0) if digit * power <= scale + 1e-9)


def draw_obstacle(plotter: Any, obstacle: RigidObstacle, points: Array, flat: bool) -> bool:
    """Draw an obstacle near points (n, 3) of the bodies, and return whether any of it is there.

    In 2D (`flat`) its inside is drawn, in 3D its surface; where this is seen from within the
    obstacle, it is transparent, so that it does not hide the bodies.
    """
    import pyvista

    dim = 2 if flat else 3
    length = float(np.linalg.norm(np.ptp(points, axis=0)))
    margin = 0.08 * length * (np.arange(3) < dim)
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    spacing = float(np.prod((high - low)[:dim]) / SAMPLES) ** (1.0 / dim)
    counts = np.ceil((high - low) / spacing).astype(int) + 1
    grid = pyvista.ImageData(dimensions=counts, spacing=3 * (spacing,), origin=low)
    try:
        distance = obstacle.distance(np.array(grid.points))
    except Exception as error:  # the user's function may fail away from the surface
        _LOGGER.warning("%s is not in the picture: its signed distance fails: %s", obstacle, error)
        return False
    if not distance.min() < 0.0 <= distance.max():
        return False
    grid.point_data["distance"] = distance
    if flat:
        inside = grid.clip_scalar(scalars="distance", value=0.0, invert=True)
        below = inside.translate((0.0, 0.0, -0.01 * length))
        plotter.add_mesh(below, color=OBSTACLE_COLOUR, lighting=False)
        return True
    # triangles are wound such that their front is seen from within the obstacle
    sides = {"auto_orient_normals": False, "consistent_normals": False}
    surface = grid.contour([0.0]).compute_normals(cell_normals=False, **sides)
    light = {"color": OBSTACLE_COLOUR, "smooth_shading": True, "ambient": 0.4, "diffuse": 0.6}
    plotter.add_mesh(surface, culling="front", **light)
    plotter.add_mesh(surface, culling="back", opacity=0.15, **light)
    return True


def draw_surface(panel: Any, contact: Contact, length: str, stress: str) -> None:
    """Draw a contact surface: pressures as colours, slips as arrows, sticking nodes as discs.

    It is seen along its mean normal or, if it is closed, obliquely. Facets that face nothing, such
    as the sides of a block whose whole boundary has the tag, would hide the others, and are absent.
    """
    import pyvista

    one_side = {"consistent_normals": True, "split_vertices": False}  # for all normals
    surface = skin(contact.grid.to_pyvista()).compute_normals(**one_side)
    contact_normals = surface.point_data_to_cell_data()["normal"]
    # less than this cosine is at the side of a body; edges of rounded surfaces have more
    facing = np.abs(np.sum(contact_normals * surface.cell_data["Normals"], axis=1)) > 0.15
    surface = skin(surface.extract_cells(facing)).compute_normals(**one_side)
    normal, up = direction(surface)
    lift = 0.01 * surface.length * normal  # so that marks do not sink into the surface
    values, pressed = surface.point_data, surface.point_data["pressed"] > 0.0
    shown = values["pressure"][pressed]
    if not pressed.all():
        shown = np.append(shown, 0.0)
    limits = colour_range(shown, clip=True)
    light: dict[str, Any] = {"smooth_shading": True, "ambient": 0.65, "diffuse": 0.4}
    if np.abs(surface.cell_data["Normals"] @ normal).min() > 0.98:  # flat: colours as in the bar
        light = {"lighting": False}
    least, most = 150, 350  # nodes for which arrows have their largest and least size
    spacing = math.sqrt(surface.area / np.clip(surface.n_points, least, most))
    closed, opened = surface.clip_scalar(scalars="pressed", value=0.5, invert=False, both=True)
    legend = [handle("open", OPEN_COLOUR, "s", markersize=8.0)] if opened.n_points else []
    with view_in(panel, normal, up) as plotter:
        if closed.n_points:
            colours = {"scalars": "pressure", "cmap": "YlOrRd", "clim": limits[:2]}
            plotter.add_mesh(closed, **colours, **light)
        plotter.add_mesh(opened, color=OPEN_COLOUR, **light)
        edges = surface.extract_all_edges().translate(0.2 * lift)
        plotter.add_mesh(edges, color="white", opacity=0.5, line_width=1.0, lighting=False)
        lengths = np.linalg.norm(values.get("slip", np.zeros((surface.n_points, 3))), axis=1)
        largest = float(lengths[pressed if pressed.any() else slice(None)].max())
        if largest > 0.0:
            # shorter arrows on open parts, which may have moved by far more
            values["slip"] *= np.minimum(1.0, largest / np.maximum(lengths, largest))[:, None]
            apart = 0.9 * spacing / surface.length if surface.n_points > most else None
            scale = {"scale": "slip", "factor": 1.3 * spacing / largest, "tolerance": apart}
            arrows = surface.translate(3.0 * lift).glyph(orient="slip", **scale)
            colours = {"scalars": "pressed", "cmap": ["#707070", "black"], "clim": (0.0, 1.0)}
            plotter.add_mesh(arrows, lighting=False, **colours)
            text = f"{contact.slip_name}, at most {largest:.3g} {length}".rstrip()
            legend.append(handle(text, "black", "$\u2192$", markersize=9.0, markeredgewidth=0.3))
        if (values["sticks"] > 0.0).any():
            centres = pyvista.PolyData(surface.points[values["sticks"] > 0.0] + 2.0 * lift)
            radius = 0.17 * math.sqrt(surface.area / max(surface.n_points, least))
            disc = pyvista.Disc(inner=0.0, outer=radius, normal=normal, c_res=20)
            discs = centres.glyph(geom=disc, orient=False, scale=False)
            plotter.add_mesh(discs, color="black", lighting=False)
            legend.append(handle("sticks", "black", "o"))
    if pressed.any():
        draw_bar(panel, f"contact pressure {contact.label}".rstrip(), stress, "YlOrRd", limits)
    write_header(panel, f"Contact surface{contact.title}", legend)


def direction(surface: Any) -> tuple[Array, Array]:
    """Return the direction to the viewer, along a surface's mean normal, and the upward direction.

    The viewer is on the positive side of the axis nearest to the normal. Upward is z, or y if the
    normal is near z; a surface that is more than 1.5 times as high as wide is turned by 90 degrees.
    """
    sized = surface.compute_cell_sizes(length=False, volume=False)
    mean = sized.cell_data["Normals"].T @ sized.cell_data["Area"]
    if np.linalg.norm(mean) < 0.1 * surface.area:  # closed, or nearly: seen obliquely
        return OBLIQUE, ALONG_Z
    normal = mean / np.linalg.norm(mean)
    normal = normal * np.sign(normal[np.argmax(np.abs(normal))])
    up = ALONG_Z if abs(normal[2]) < 0.9 else ALONG_Y
    right = np.cross(up, normal)
    up = up - (up @ normal) * normal
    is_high = np.ptp(surface.points @ up) > 1.5 * np.ptp(surface.points @ right)
    return normal, -right if is_high else up
