"""A contact surface of 2D: a curve, and the fields along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.pictures.canvas import HEADER, Box, write_header
from dolfinx_tresca.output.pictures.contact import Contact
from dolfinx_tresca.output.pictures.labels import locator, scaled
from dolfinx_tresca.output.pictures.legend import line, patch
from dolfinx_tresca.units import Units

CURVE_COLOUR = "#c8102e"  #: colour of the curve and its pressure
TANGENT_COLOUR = "#1f4e9c"  #: colour of traction and slip
DOTS = 60  #: largest number of nodes of a curve with which the nodes are drawn as dots
OPEN_BACKGROUND = "#ebebeb"  #: background of open parts of the curve
BREAK = 0.04  #: distance between unconnected pieces in a chart, divided by the curve's length


@dataclass(frozen=True)
class Curve:
    """A contact curve with its nodes in order.

    Attributes:
        contact: the surface.
        pieces: node numbers along each piece; a closed piece runs counterclockwise and ends with
            its first node.
        arcs: arc length [length] at the nodes of each piece, increasing from piece to piece.
    """

    contact: Contact
    pieces: list[npt.NDArray[np.int64]]
    arcs: list[Array]

    def moved(self, scale: float) -> Array:
        """Return the nodes (n, 3) moved by `scale` times their displacement [length]."""
        grid = self.contact.grid
        points: Array = grid.points + scale * grid.values["displacement"]
        return points

    @classmethod
    def of(cls, contact: Contact) -> Curve:
        """Put the nodes of a contact surface of 2D in order, and compute their arc lengths."""
        grid = contact.grid
        pieces, arcs = _chains(grid.points, grid.cells[:, 1:]), []
        steps = [np.linalg.norm(np.diff(grid.points[piece], axis=0), axis=1) for piece in pieces]
        total, start = float(sum(step.sum() for step in steps)), 0.0
        for step in steps:
            arcs.append(start + np.append(0.0, np.cumsum(step)))
            start = arcs[-1][-1] + BREAK * total
        return cls(contact, pieces, arcs)

    def along(self, name: str, piece: int) -> Array:
        """Return a field at the nodes of a piece; for vectors the part along the curve."""
        nodes = self.pieces[piece]
        values = self.contact.grid.values[name][nodes]
        if values.ndim == 1:
            return values
        points = self.contact.grid.points[nodes]
        if nodes[0] == nodes[-1]:  # closed: both neighbours of the first node count
            points = np.vstack([points[-2], points, points[1]])
            direction = points[2:] - points[:-2]
        else:
            direction = np.gradient(points, axis=0)
        part: Array = np.sum(values * direction, axis=1) / np.linalg.norm(direction, axis=1)
        return part


def _chains(points: Array, lines: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
    """Return the node numbers along each piece of a curve.

    An open piece begins at one of its ends, a closed piece at one of its nodes: at the first one if
    they are sorted by x, then by y. Pieces are sorted by the lower left corners of their bounding
    boxes.
    """
    neighbours: dict[int, list[int]] = {}
    for ends in lines:
        first, second = int(ends[0]), int(ends[1])
        neighbours.setdefault(first, []).append(second)
        neighbours.setdefault(second, []).append(first)
    order = sorted(neighbours, key=lambda node: tuple(np.round(points[node], 12)))
    order = sorted(order, key=lambda node: len(neighbours[node]) != 1)  # ends of pieces first
    chains, seen = [], set[int]()
    for start in order:
        if start in seen:
            continue
        chain = [start]
        seen.add(start)
        while ahead := [node for node in neighbours[chain[-1]] if node not in seen]:
            chain.append(min(ahead))
            seen.add(chain[-1])
        if len(chain) > 2 and start in neighbours[chain[-1]]:
            chain.append(start)
            x, y, _ = points[chain].T
            if np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) < 0.0:
                chain.reverse()
        chains.append(np.array(chain))
    return sorted(chains, key=lambda chain: tuple(points[chain].min(axis=0)))


def chart(figure: Any, box: Box, curve: Curve, units: Units | None) -> None:
    """Draw pressure, traction and slip, or its path, against arc length. Not collective.

    Args:
        figure: a figure of matplotlib.
        box: box of the whole picture.
        curve: the contact curve.
        units: units of length and stress.
    """
    length, stress = (units.length, units.stress) if units else ("", "")
    contact, has_friction = curve.contact, curve.contact.has_friction
    slip, slip_of = ("slip_path", "slip path") if contact.has_path else ("slip", contact.slip_of)
    inner = Box(box.left + 0.65, box.bottom + 0.5, box.width - 0.9, box.height - HEADER - 0.55)
    if has_friction:
        slip_height = 0.36 * inner.height
        lower = Box(inner.left, inner.bottom, inner.width, slip_height)
        rest = inner.height - slip_height - 0.22
        upper = Box(inner.left, inner.bottom + slip_height + 0.22, inner.width, rest)
        axes = [upper.axes(figure), lower.axes(figure)]
        axes[1].sharex(axes[0])
        axes[0].tick_params(labelbottom=False)
    else:
        axes = [inner.axes(figure)]
    names = ("pressure", "traction") if has_friction else ("pressure",)
    label = "stress" if has_friction else "contact pressure"
    factors = [_label_axis(curve, axes[0], names, label, stress)]
    if has_friction:
        factors.append(_label_axis(curve, axes[1], (slip,), slip.replace("_", " "), length))
    along = _along_arc(curve, axes[-1], length)
    legend = _draw_open(curve, axes, along)
    if has_friction:
        legend = [
            line("pressure", CURVE_COLOUR, 1.8),
            line(f"traction, {slip_of}", TANGENT_COLOUR, 1.8),
            *legend,
        ]
        _draw_line(curve, axes[0], "traction", TANGENT_COLOUR, (along, factors[0]))
        _draw_line(curve, axes[1], slip, TANGENT_COLOUR, (along, factors[1]))
        _draw_marks(curve, axes[0], (along, factors[0]))
    _draw_line(curve, axes[0], "pressure", CURVE_COLOUR, (along, factors[0]), fill=True)
    for one in axes:
        _plain(one)
    figure.align_ylabels(axes)
    title = contact.title("Contact curve")
    if has_friction and not contact.label:
        signed = "traction" if contact.has_path else "traction and slip"
        title += f": {signed} positive along it"
    write_header(figure, box, title, [*legend, *contact.legend_of_marks()])


def _label_axis(curve: Curve, axes: Any, names: tuple[str, ...], label: str, unit: str) -> float:
    """Label the axis of the fields `names`; return the divisor of their values."""
    pieces = range(len(curve.pieces))
    values = [curve.along(name, piece) for name in names for piece in pieces]
    how = scaled(label, unit, float(np.abs(np.concatenate(values)).max(initial=0.0)))
    axes.set_ylabel(how.label)
    axes.yaxis.set_major_locator(locator())
    return how.factor


def _along_arc(curve: Curve, axes: Any, unit: str) -> float:
    """Label the axis of arc length; return the divisor of arc lengths."""
    how = scaled("arc length", unit, float(curve.arcs[-1][-1]))
    axes.set_xlabel(how.label)
    axes.xaxis.set_major_locator(locator())
    return how.factor


def _plain(axes: Any) -> None:
    """Draw the line of zero in a chart, and remove its upper and right border."""
    axes.axhline(0.0, color="grey", linewidth=0.8, zorder=1)
    axes.margins(x=0.02)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_line(
    curve: Curve, axes: Any, name: str, color: str, over: tuple[float, float], fill: bool = False
) -> None:
    """Draw a field against arc length; `over` are the divisors of arc length and field."""
    count = sum(map(len, curve.pieces))
    for i, arc in enumerate(curve.arcs):
        s, values = arc / over[0], curve.along(name, i) / over[1]
        axes.plot(
            s, values, color=color, linewidth=1.6, marker="." if count <= DOTS else None,
            markersize=5,
        )  # fmt: skip
        if fill:
            axes.fill_between(s, values, color=color, alpha=0.15, linewidth=0)


def _draw_open(curve: Curve, charts: Any, over: float) -> list[Any]:
    """Shade the open parts of the curve; return the legend. Arc lengths are divided by `over`."""
    is_open = ~curve.contact.pressed
    for piece, arc in zip(curve.pieces, curve.arcs, strict=True):
        s = arc / over
        borders = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
        part = is_open[piece].astype(int)
        change = np.flatnonzero(np.diff(part, prepend=0, append=0))
        for first, last in change.reshape(-1, 2):
            for axes in charts:
                axes.axvspan(
                    borders[first], borders[last], color=OPEN_BACKGROUND, linewidth=0, zorder=0
                )
    return [patch("open", OPEN_BACKGROUND)] if is_open.any() else []


def _draw_marks(curve: Curve, axes: Any, over: tuple[float, float]) -> None:
    """Mark sticking nodes by discs (pressed) and rings (open) on the line of the traction."""
    for i, (piece, arc) in enumerate(zip(curve.pieces, curve.arcs, strict=True)):
        traction = curve.along("traction", i)
        for pressed, nodes in curve.contact.marks():
            at = np.isin(piece, nodes)
            axes.plot(
                arc[at] / over[0], traction[at] / over[1], "o", markersize=5, zorder=3,
                clip_on=False, color="black", markerfacecolor="black" if pressed else "white",
            )  # fmt: skip
