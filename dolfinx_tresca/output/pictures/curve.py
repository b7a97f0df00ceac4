"""A chart of the fields along a contact curve of 2D."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.grid import Grid
from dolfinx_tresca.output.pictures.canvas import (
    HEADER,
    Box,
    handle,
    round_ticks,
    scaled,
    write_header,
)
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.units import Units

CURVE_COLOUR = "#c8102e"  #: colour of the curve and its pressure
TANGENT_COLOUR = "#1f4e9c"  #: colour of traction and slip
OPEN_BACKGROUND = "#ebebeb"  #: background of open parts of the curve
DOTS = 60  #: largest number of nodes of a curve with which the nodes are drawn as dots
BREAK = 0.04  #: distance between unconnected pieces in a chart, divided by the curve's length


def chains(grid: Grid) -> list[npt.NDArray[np.int64]]:
    """Return the node numbers along each piece of a curve of 2D.

    An open piece begins at one of its ends, a closed piece at one of its nodes: at the first one if
    they are sorted by x, then by y. A closed piece runs counterclockwise and ends with its first
    node. Pieces are sorted by the lower left corners of their bounding boxes.
    """
    points, neighbours = grid.points, dict[int, list[int]]()
    for begin, end in grid.cells[:, 1:]:
        neighbours.setdefault(int(begin), []).append(int(end))
        neighbours.setdefault(int(end), []).append(int(begin))
    pieces, seen = [], set[int]()
    # ends of open pieces come before all nodes of closed ones
    for start in sorted(
        neighbours, key=lambda node: (len(neighbours[node]) != 1, *np.round(points[node], 12))
    ):
        if start in seen:
            continue
        piece = [start]
        seen.add(start)
        while ahead := [node for node in neighbours[piece[-1]] if node not in seen]:
            piece.append(min(ahead))
            seen.add(piece[-1])
        if len(piece) > 2 and start in neighbours[piece[-1]]:
            piece.append(start)
            x, y, _ = points[piece].T
            if np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) < 0.0:
                piece.reverse()
        pieces.append(np.array(piece))
    return sorted(pieces, key=lambda piece: tuple(points[piece].min(axis=0)))


def arc_lengths(grid: Grid, pieces: Sequence[npt.NDArray[np.int64]]) -> list[Array]:
    """Return arc lengths [length] at the nodes of each piece, increasing from piece to piece."""
    steps = [np.linalg.norm(np.diff(grid.points[piece], axis=0), axis=1) for piece in pieces]
    total, start, arcs = float(sum(step.sum() for step in steps)), 0.0, []
    for step in steps:
        arcs.append(start + np.append(0.0, np.cumsum(step)))
        start = arcs[-1][-1] + BREAK * total
    return arcs


def along(grid: Grid, name: str, piece: npt.NDArray[np.int64]) -> Array:
    """Return a field at the nodes of a piece; for vectors the component along the curve."""
    values, points = grid.values[name][piece], grid.points[piece]
    if values.ndim == 1:
        return values
    if piece[0] == piece[-1]:  # closed: both neighbours of the first node count
        points = np.vstack([points[-2], points, points[1]])
        direction = points[2:] - points[:-2]
    else:
        direction = np.gradient(points, axis=0)
    return np.asarray(np.sum(values * direction, axis=1) / np.linalg.norm(direction, axis=1))


def chart(figure: Any, box: Box, contact: Contact, units: Units | None) -> None:
    """Draw pressure, traction and slip, or its path, against arc length. Not collective.

    Args:
        figure: a figure of matplotlib.
        box: box of the whole picture.
        contact: the contact curve.
        units: units of length and stress.
    """
    length, stress = (units.length, units.stress) if units else ("", "")
    grid, has_friction = contact.grid, contact.has_friction
    slip, slip_of = ("slip_path", "slip path") if contact.has_path else ("slip", contact.slip_of)
    inner = Box(box.left + 0.65, box.bottom + 0.5, box.width - 0.9, box.height - HEADER - 0.55)
    low, gap = (0.36 * inner.height, 0.22) if has_friction else (0.0, 0.0)
    upper = Box(inner.left, inner.bottom + low + gap, inner.width, inner.height - low - gap)
    charts = [(upper.axes(figure), ["pressure"], "contact pressure", stress)]
    legend = []
    if has_friction:
        lower = Box(inner.left, inner.bottom, inner.width, low).axes(figure)
        charts = [
            (charts[0][0], ["traction", "pressure"], "stress", stress),
            (lower, [slip], slip.replace("_", " "), length),
        ]
        legend.append(handle("pressure", CURVE_COLOUR, width=1.8))
        legend.append(handle(f"traction, {slip_of}", TANGENT_COLOUR, width=1.8))
        charts[0][0].tick_params(labelbottom=False)
    pieces = chains(grid)
    arcs = arc_lengths(grid, pieces)
    divisor, arc_label = scaled("arc length", length, float(arcs[-1][-1]))
    marker = "." if sum(map(len, pieces)) <= DOTS else None
    for axes, names, label, unit in charts:
        fields = {name: [along(grid, name, piece) for piece in pieces] for name in names}
        largest = max(float(np.abs(values).max()) for name in names for values in fields[name])
        factor, text = scaled(label, unit, largest)
        for i, piece in enumerate(pieces):
            s = arcs[i] / divisor
            for name in names:
                color = CURVE_COLOUR if name == "pressure" else TANGENT_COLOUR
                style = {"color": color, "linewidth": 1.6, "marker": marker, "markersize": 5}
                axes.plot(s, fields[name][i] / factor, **style)
                if name == "pressure":
                    axes.fill_between(s, fields[name][i] / factor, color=color, alpha=0.15, lw=0)
                if name == "traction":
                    for touches, nodes in contact.marks:
                        shown = np.isin(piece, nodes)
                        axes.plot(
                            s[shown], fields[name][i][shown] / factor, "o", markersize=5, zorder=3,
                            clip_on=False, color="black", mfc="black" if touches else "white",
                        )  # fmt: skip
            borders = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
            change = np.diff((~contact.pressed[piece]).astype(int), prepend=0, append=0)
            for begin, end in np.flatnonzero(change).reshape(-1, 2):
                axes.axvspan(borders[begin], borders[end], color=OPEN_BACKGROUND, lw=0, zorder=0)
        axes.set_ylabel(text)
        axes.sharex(charts[0][0]) if axes is not charts[0][0] else None
        axes.yaxis.set_major_locator(round_ticks())
        axes.xaxis.set_major_locator(round_ticks())
        axes.axhline(0.0, color="grey", linewidth=0.8, zorder=1)
        axes.margins(x=0.02)
        axes.spines[["top", "right"]].set_visible(False)
    charts[-1][0].set_xlabel(arc_label)
    figure.align_ylabels([axes for axes, *_ in charts])
    if not contact.pressed.all():
        legend.append(handle("open", OPEN_BACKGROUND, "s", markersize=8.0))
    title = contact.title("Contact curve")
    if has_friction and not contact.label:
        title += f": traction{'' if contact.has_path else ' and slip'} positive along it"
    write_header(figure, box, title, [*legend, *contact.legend_of_marks()])
