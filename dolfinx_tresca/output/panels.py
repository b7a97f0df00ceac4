"""The panels of a picture: titles, legends, colour bars, and the chart of a contact curve of 2D.

A panel is a `SubFigure` of matplotlib, which draws all text; places in it are in inches. The views
that pyvista renders are in `views.py`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, depth_first_order

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.grid import Grid, gather_grid
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.solution.fields import STICKING, ContactState, SurfaceFields
from dolfinx_tresca.units import Units

LEFT = 0.15  #: inches between the left end of a panel and its title
HEADER, FOOTER = 0.66, 0.62  #: inches for title and legend, and for a colour bar
CURVE_COLOUR = "#c8102e"  #: colour of a contact curve and its pressure
TANGENT_COLOUR = "#1f4e9c"  #: colour of traction and slip
OPEN_COLOUR = "#e2e2e2"  #: colour of open surfaces


@dataclass(frozen=True)
class Contact:
    """A contact surface, gathered on one rank.

    Attributes:
        grid: the fields of the surface. Its "slip" is the slip of this step, and zero at sticking
            nodes; only pairs with friction have it. "pressed" is 1 at nodes that are drawn as
            touching, 0 at open ones; "sticks" is 1 at nodes that stick.
        title: name of the pair with its number; "" for a single pair.
        label: number of the pair; "" for a single pair.
        slip_name: name of the slip in titles and labels: "slip", or "slip of step" after an
            accepted load step.
        obstacle: the other side, if it is rigid; else None.
    """

    grid: Grid
    title: str = ""
    label: str = ""
    slip_name: str = "slip"
    obstacle: RigidObstacle | None = None


def gather_contact(surface: SurfaceFields, label: str = "") -> Contact | None:
    """Return a whole surface on the first rank, None on other ranks. Collective.

    A node that carries no multiplier, such as the tip of a crack or a prescribed node, is drawn as
    touching if all nodes beside it touch, provided that each of its facets has a node that carries
    one. Nodes farther beyond the primary side are open.
    """
    grid = gather_grid((*surface.functions, surface.initial_gap))
    if grid is None:
        return None
    values, facets, slip_name = grid.values, grid.cells[:, 1:], "slip"
    carries = values["state"] > ContactState.OUTSIDE
    touches = values["state"] >= ContactState.PRESSED
    closed = (~carries | touches)[facets].all(axis=1) & carries[facets].any(axis=1)
    beside = np.ones(len(carries), dtype=np.bool_)
    beside[facets[~closed]] = False
    values["pressed"] = np.where(carries, touches, beside).astype(float)
    values["sticks"] = np.isin(values["state"], STICKING).astype(float)
    if "slip_increment" in values:
        slip_name, values["slip"] = "slip of step", values["slip_increment"]
    if "slip" in values:
        values["slip"][values["sticks"] > 0.0] = 0.0  # the error of the iteration is removed
    title = f" {label}: {shorten(surface.name, 40, placeholder=' ...')}" if label else ""
    return Contact(grid, title, label, slip_name, surface.obstacle)


def size_of(panel: Any) -> tuple[float, float]:
    """Return width and height of a panel [inches]."""
    width, height = panel.bbox.size / panel.dpi
    return float(width), float(height)


def axes_at(panel: Any, left: float, bottom: float, width: float, height: float) -> Any:
    """Return axes that fill a rectangle of a panel [inches]."""
    wide, high = size_of(panel)
    return panel.add_axes((left / wide, bottom / high, width / wide, height / high))


def write_header(panel: Any, title: str, legend: Sequence[Any]) -> None:
    """Write a title and below it the legend, at the top of a panel."""
    width, height = size_of(panel)
    panel.text(LEFT / width, 1.0 - 0.3 / height, title, fontsize=11.0)
    panel.legend(
        handles=legend, ncols=max(len(legend), 1), loc="upper left", labelcolor="#404040",
        bbox_to_anchor=(LEFT / width, 1.0 - 0.36 / height), borderpad=0.0, borderaxespad=0.0,
        handlelength=1.0, handletextpad=0.5, columnspacing=0.9, fontsize=8.5, frameon=False,
    )  # fmt: skip


def handle(label: str, color: str, marker: str = "", **options: Any) -> Any:
    """Return an entry of a legend: a marker as in matplotlib, or a line."""
    from matplotlib.lines import Line2D

    style = {"linestyle": "" if marker else "-", "markersize": 5.0, **options}
    return Line2D([], [], color=color, marker=marker, label=label, **style)


def colour_range(values: Array, *, clip: bool = False) -> tuple[float, float, float]:
    """Return the values of the first and the last colour, and the largest value, for values >= 0.

    Colours begin at zero, unless all values are far from zero. With `clip` they may end, at a round
    number, below a few values that are much larger than the others.
    """
    least, largest = float(values.min(initial=math.inf)), float(values.max(initial=0.0))
    most = float(np.percentile(values, 85.0)) if clip and len(values) else 0.0
    if 0.0 < 2.5 * most < largest:  # otherwise most values would have one colour
        step = 0.5 * 10.0 ** math.floor(math.log10(most))
        return 0.0, step * math.ceil(most / step - 1e-9), largest
    far = 0.5 * largest < least < (1.0 - 1e-6) * largest
    return least if far else 0.0, largest or 1.0, largest


def draw_bar(panel: Any, name: str, unit: str, cmap: str, limits: Sequence[float]) -> None:
    """Draw a colour bar at the bottom of a panel; an arrow and a text show a peak beyond it.

    Args:
        panel: the panel.
        name: name of the quantity.
        unit: unit of the values, or "".
        cmap: matplotlib's name of the colours.
        limits: see `colour_range`.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high, largest = limits
    width, _ = size_of(panel)
    axes = axes_at(panel, 0.27 * width, 0.42, 0.58 * width, 0.12)
    label, extend = labelled(name, unit), "neither"
    if largest > high:
        label, extend = f"{label}, at most {largest:.3g}", "max"
    colours = ScalarMappable(Normalize(low, high), cmap)
    panel.colorbar(colours, cax=axes, label=label, orientation="horizontal", extend=extend)
    axes.tick_params(width=0.6, length=2.5, pad=2.0)
    axes.locator_params(nbins=5)
    axes.xaxis.labelpad = 1.5


def labelled(name: str, unit: str) -> str:
    """Return a label such as "slip [mm]", or the name alone without a unit."""
    return f"{name} [{unit}]" if unit else name


def unrolled(grid: Grid) -> list[tuple[npt.NDArray[np.int32], Array, Array]]:
    """Return the pieces of a curve of 2D.

    An open piece begins at one of its ends, a closed piece at one of its nodes: at the least one if
    they are sorted by x, then by y. A closed piece runs counterclockwise and ends with the node
    with which it begins. Pieces are sorted by the nodes at which they begin.

    Returns:
        for each piece: its k nodes; (k,) arc lengths [length], which increase from piece to piece,
        with a gap of 4 %; and (k, 3) unit vectors along the curve.
    """
    points, lines = grid.points, grid.cells[:, 1:]
    neighbours = coo_array((np.ones(len(lines)), lines.T), shape=2 * (len(points),)).tocsr()
    count = np.bincount(lines.ravel(), minlength=len(points))
    x, y, _ = np.round(points.T, 12)
    order = np.lexsort((y, x, count != 1))  # the ends of open pieces come before other nodes
    _, piece_of = connected_components(neighbours, directed=False)
    starts = order[np.unique(piece_of[order], return_index=True)[1]]
    start_of_arc, curves = 0.0, []
    for start in starts[np.lexsort((y[starts], x[starts]))]:
        nodes = depth_first_order(neighbours, start, directed=False, return_predecessors=False)
        closed = count[start] == 2
        if closed:
            nodes = np.append(nodes, start)
            a, b = points[nodes[:-1], :2].T, points[nodes[1:], :2].T
            nodes = nodes if np.sum(a[0] * b[1] - b[0] * a[1]) > 0.0 else nodes[::-1]
        places = points[nodes]
        directions = np.gradient(places, axis=0)
        if closed:  # both neighbours of the node count
            directions[[0, -1]] = places[1] - places[-2]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        curves.append((nodes, start_of_arc + np.append(0.0, np.cumsum(steps)), directions))
        start_of_arc = 1.04 * curves[-1][1][-1]
    return curves


def draw_curve(panel: Any, contact: Contact, units: Units | None) -> None:
    """Draw pressure, traction and slip against arc length. Not collective.

    Args:
        panel: the panel of the picture.
        contact: the contact curve.
        units: units of length and stress.
    """
    length, stress = (units.length, units.stress) if units else ("", "")
    values, title, legend = contact.grid.values, f"Contact curve{contact.title}", []
    charts = [(["pressure"], "contact pressure", stress)]
    if "slip" in values:
        charts = [(["traction", "pressure"], "stress", stress), (["slip"], "slip", length)]
        legend.append(handle("pressure", CURVE_COLOUR))
        legend.append(handle(f"traction, {contact.slip_name}", TANGENT_COLOUR))
        title += "" if contact.label else ": traction and slip positive along it"
    if values["sticks"].any():
        legend.append(handle("sticks", "black", "o"))
    width, height = size_of(panel)
    places = {"left": 0.65 / width, "right": 1.0 - 0.25 / width, "hspace": 0.14}
    places |= {"bottom": 0.5 / height, "top": 1.0 - (HEADER + 0.05) / height}
    rows = {"height_ratios": (0.64, 0.36)[: len(charts)], "gridspec_kw": places}
    all_axes = panel.subplots(len(charts), sharex=True, squeeze=False, **rows)[:, 0]
    for axes, (names, label, unit) in zip(all_axes, charts, strict=True):
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
        axes.set_ylabel(labelled(label, unit))
        axes.locator_params(nbins=5)
        axes.axhline(0.0, color="grey", linewidth=0.8, zorder=1)
        axes.margins(x=0.02)
        axes.spines[["top", "right"]].set_visible(False)
    all_axes[-1].set_xlabel(labelled("arc length", length))
    panel.align_ylabels(all_axes)
    write_header(panel, title, legend)
