"""A contact surface of 2D: a curve, and what happens along it."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import ContactError
from dolfinx_tresca.pictures.contact import Contact

CURVE_COLOUR = "#c8102e"  #: of the curve and its pressure
TANGENT_COLOUR = "#1f4e9c"  #: of traction and slip
DOTS = 60  #: nodes; the lines of a curve with more have none
BREAK = 0.04  #: of the length: between pieces that do not hang together


@dataclass(frozen=True)
class Curve:
    """A contact curve with its nodes in order.

    Attributes:
        contact: the surface.
        pieces: node numbers along each piece; a closed one runs counterclockwise and ends with its
            first node.
        arcs: arc length [length] at the nodes of each piece, increasing from piece to piece.
    """

    contact: Contact
    pieces: list[npt.NDArray[np.int64]]
    arcs: list[Array]

    @property
    def points(self) -> Array:
        """(n, 3) nodes [length]."""
        return self.contact.grid.points

    @classmethod
    def of(cls, contact: Contact) -> Curve:
        """Put the nodes of a contact surface of 2D in order."""
        grid = contact.grid
        pieces, arcs = _chains(grid.points, grid.cells[:, 1:]), []
        steps = [np.linalg.norm(np.diff(grid.points[piece], axis=0), axis=1) for piece in pieces]
        total, start = float(sum(step.sum() for step in steps)), 0.0
        for step in steps:
            arcs.append(start + np.append(0.0, np.cumsum(step)))
            start = arcs[-1][-1] + BREAK * total
        return cls(contact, pieces, arcs)

    def along(self, name: str, piece: int) -> Array:
        """Return a field at the nodes of a piece; of a vector the part along the curve."""
        nodes = self.pieces[piece]
        values = self.contact.grid.values[name][nodes]
        if values.ndim == 1:
            return values
        points = self.points[nodes]
        if nodes[0] == nodes[-1]:  # closed: both neighbours of the first node count
            points = np.vstack([points[-2], points, points[1]])
            way = points[2:] - points[:-2]
        else:
            way = np.gradient(points, axis=0)
        part: Array = np.sum(values * way, axis=1) / np.linalg.norm(way, axis=1)
        return part


def _chains(points: Array, lines: npt.NDArray[np.int64]) -> list[npt.NDArray[np.int64]]:
    """Return the node numbers along each piece of a curve.

    An open piece begins at its end with the least coordinates, a closed one at its node with the
    least, and pieces with lesser ones come first.
    """
    neighbours: dict[int, list[int]] = {}
    for line in lines:
        first, second = int(line[0]), int(line[1])
        neighbours.setdefault(first, []).append(second)
        neighbours.setdefault(second, []).append(first)
    order = sorted(neighbours, key=lambda node: tuple(np.round(points[node], 12)))
    order = sorted(order, key=lambda node: len(neighbours[node]) != 1)  # ends first, stable
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


def chart(curve: Curve, size: tuple[int, int]) -> Any:
    """Return a chart of pressure, traction and slip over arc length, a `PIL.Image`.

    Not collective.

    Args:
        curve: what to show.
        size: pixels, width and height.

    Raises:
        ContactError: there is no matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ContactError(
            "pictures of 2D need matplotlib: install python3-matplotlib (Debian) or matplotlib "
            "(conda, pip)."
        ) from error
    import PIL.Image

    contact, rubs = curve.contact, curve.contact.has_friction
    figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100, facecolor="white")
    top, bottom = 1.0 - 90 / size[1], 75 / size[1]
    axes = figure.subplots(
        2 if rubs else 1,
        sharex=True,
        squeeze=False,
        gridspec_kw={
            "height_ratios": (3, 2) if rubs else None,
            "left": 0.12, "right": 0.95, "top": top, "bottom": bottom, "hspace": 0.22,
        },
    )[:, 0]  # fmt: skip
    legend = _draw_open(curve, axes)
    _draw_line(curve, axes[0], "pressure", CURVE_COLOUR, fill=True)
    axes[0].set_ylabel("stress" if rubs else "pressure")
    if rubs:
        _draw_line(curve, axes[0], "traction", TANGENT_COLOUR)
        axes[0].legend(loc="best", frameon=False, fontsize=12)
        _draw_line(curve, axes[1], "slip", TANGENT_COLOUR)
        axes[1].set_ylabel("slip")
        legend += _draw_marks(curve, axes[0])
    for one in axes:
        _plain(one)
    axes[-1].set_xlabel("arc length")
    figure.align_ylabels(axes)
    left = 0.05
    figure.text(left, 1.0 - 36 / size[1], f"Contact curve{contact.number}", fontsize=15)
    if rubs:
        legend.append("traction and slip: positive along the curve")
    figure.text(left, 1.0 - 63 / size[1], "    ".join(legend), fontsize=10.5, color="dimgrey")
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=100)
    return PIL.Image.open(image).convert("RGB")


def _plain(axes: Any) -> None:
    """Take away what a chart can do without."""
    axes.axhline(0.0, color="grey", linewidth=0.8, zorder=1)
    axes.margins(x=0.02)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=11)
    axes.xaxis.label.set_size(12)
    axes.yaxis.label.set_size(12)
    axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)


def _draw_line(curve: Curve, axes: Any, name: str, color: str, fill: bool = False) -> None:
    """Draw a field over arc length."""
    count = sum(map(len, curve.pieces))
    for i, s in enumerate(curve.arcs):
        values = curve.along(name, i)
        axes.plot(
            s, values, color=color, linewidth=1.8, label=name if i == 0 else None,
            marker="." if count <= DOTS else None, markersize=5,
        )  # fmt: skip
        if fill:
            axes.fill_between(s, values, color=color, alpha=0.15, linewidth=0)


def _draw_open(curve: Curve, charts: Any) -> list[str]:
    """Shade where the curve is open; return the legend."""
    is_open = ~curve.contact.pressed
    for piece, s in zip(curve.pieces, curve.arcs, strict=True):
        borders = np.concatenate([s[:1], 0.5 * (s[1:] + s[:-1]), s[-1:]])
        part = is_open[piece].astype(int)
        change = np.flatnonzero(np.diff(part, prepend=0, append=0))
        for first, last in change.reshape(-1, 2):
            for axes in charts:
                axes.axvspan(borders[first], borders[last], color="#ebebeb", linewidth=0, zorder=0)
    return ["grey: open"] if is_open.any() else []


def _draw_marks(curve: Curve, axes: Any) -> list[str]:
    """Mark nodes that stick on the line of the traction; return the legend."""
    marks = curve.contact.marks()
    for i, (piece, s) in enumerate(zip(curve.pieces, curve.arcs, strict=True)):
        traction = curve.along("traction", i)
        for pressed, nodes, _ in marks:
            at = np.isin(piece, nodes)
            axes.plot(
                s[at], traction[at], "o", markersize=6, zorder=3, clip_on=False,
                color="black", markerfacecolor="black" if pressed else "white",
            )  # fmt: skip
    return [meaning for _, _, meaning in marks]
