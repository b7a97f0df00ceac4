"""A figure of matplotlib with views that pyvista renders; matplotlib draws all text."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array

OBLIQUE = np.array([-0.38, -0.84, 0.38])  #: direction from which bodies are seen
UPWARDS = np.array([0.0, 0.0, 1.0])  #: up in the oblique view; direction from which 2D is seen
ALONG_Y = np.array([0.0, 1.0, 0.0])

DPI = 200  #: pixels per inch of rendered views
TURN = 0.75  #: views are turned if this enlarges what they show by more than 1 / TURN
LEFT = 0.15  #: inches between the left end of a panel and its title
HEADER, FOOTER = 0.66, 0.62  #: inches for title and legend, and for a colour bar
GREY = "#404040"  #: colour of legends and other small text

#: A range of colours ends below its largest value if this value is more than `PEAK` times the value
#: at the percentile `PEAK_PERCENTILE`: otherwise most values would have one colour. With twice
#: `PEAK` the colours of the two bricks end at the pressure of their edge.
PEAK, PEAK_PERCENTILE = 2.5, 85.0

#: Settings of matplotlib in place of the user's own.
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 11.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "axes.unicode_minus": True,
    "svg.hashsalt": "dolfinx_tresca",
}


@dataclass(frozen=True)
class Box:
    """A rectangle of a figure [inches], from its lower left corner."""

    left: float
    bottom: float
    width: float
    height: float

    def axes(self, figure: Any) -> Any:
        """Return axes that fill the rectangle."""
        width, height = figure.get_size_inches()
        return figure.add_axes(
            (self.left / width, self.bottom / height, self.width / width, self.height / height)
        )


@dataclass(frozen=True)
class Camera:
    """A view without perspective.

    Attributes:
        centre: (3,) the point in the middle [length].
        axes: (3, 3) unit vectors to the right, up, and to the viewer.
        half: half the height of the view [length].
    """

    centre: Array
    axes: Array
    half: float

    @classmethod
    def framing(
        cls, points: Array, normal: Array, up: Array, aspect: float, may_turn: bool = False
    ) -> Camera:
        """Return the largest view of all points, seen from the direction `normal`.

        Args:
            points: (n, 3) points to show [length].
            normal: (3,) direction to the viewer.
            up: (3,) direction that is upward in the view.
            aspect: width of the view divided by its height.
            may_turn: whether `up` may point to the right, if points are then much larger.
        """
        right = np.cross(up, normal)
        axes = np.array([right, np.cross(normal, right), normal])
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        cameras = []
        for turned in (axes, np.array([axes[1], -axes[0], axes[2]])):
            seen = points @ turned.T
            spans, middle = np.ptp(seen, axis=0), 0.5 * (seen.min(axis=0) + seen.max(axis=0))
            half = 0.5 * max(float(spans[1]) / 0.96, float(spans[0]) / 0.92 / aspect) or 1.0
            cameras.append(cls(middle @ turned, turned, half))
        return cameras[may_turn and cameras[1].half < TURN * cameras[0].half]


@dataclass(frozen=True)
class Colours:
    """A field that is shown as colour.

    Attributes:
        name: name of the quantity.
        unit: unit of the values, or "".
        cmap: matplotlib's name of the colours.
        low: value of the first colour.
        high: value of the last colour, also used for larger values.
        peak: the largest value, if colours end below it, else None.
    """

    name: str
    unit: str
    cmap: str
    low: float
    high: float
    peak: float | None = None

    @classmethod
    def from_values(
        cls, values: Array, name: str, unit: str, cmap: str, *, clip: bool = False
    ) -> Colours:
        """Return colours that show how values of 0 or more vary.

        Colours begin at zero, unless all values are far from zero. With `clip` they may end, at a
        round number, below a few values that are much larger than the others.
        """
        least, largest = float(values.min(initial=math.inf)), float(values.max(initial=0.0))
        most = float(np.percentile(values, PEAK_PERCENTILE)) if clip and len(values) else 0.0
        if 0.0 < PEAK * most < largest:
            step = 0.5 * 10.0 ** math.floor(math.log10(most))
            return cls(name, unit, cmap, 0.0, step * math.ceil(most / step - 1e-9), largest)
        far = 0.5 * largest < least < (1.0 - 1e-6) * largest
        return cls(name, unit, cmap, least if far else 0.0, largest or 1.0)

    @property
    def options(self) -> dict[str, Any]:
        """Options of pyvista's `add_mesh`."""
        return {"cmap": self.cmap, "clim": (self.low, self.high), "show_scalar_bar": False}


@dataclass(frozen=True)
class View:
    """The camera of a drawing, and what is written in and beside the view.

    Attributes:
        title: text above the view.
        legend: handles of matplotlib with labels.
        camera: camera of the view.
        colours: field that the colour bar explains; None: there is no colour bar.
        notes: texts in the view: for each its place (3,) [length], the text, and matplotlib's
            options of the text.
    """

    title: str
    legend: Sequence[Any]
    camera: Camera
    colours: Colours | None = None
    notes: Sequence[tuple[Array, str, dict[str, Any]]] = ()


def render(figure: Any, box: Box, draw: Callable[[Any, float], View]) -> None:
    """Render a view and put it into a box of a figure, with title, legend and colour bar.

    Args:
        figure: a figure of matplotlib.
        box: box of the whole picture.
        draw: function (plotter, aspect) -> view. It draws with a plotter of pyvista; `aspect` is
            the width of the view divided by its height.
    """
    import pyvista

    inner = Box(box.left, box.bottom + FOOTER, box.width, box.height - HEADER - FOOTER)
    pixels = [round(DPI * inner.width), round(DPI * inner.height)]
    plotter = pyvista.Plotter(off_screen=True, window_size=pixels)
    try:
        plotter.set_background("white")
        view = draw(plotter, pixels[0] / pixels[1])
        camera = view.camera
        eye = camera.centre + 2.0 * max(plotter.length, camera.half) * camera.axes[2]
        plotter.enable_parallel_projection()
        plotter.camera_position = [tuple(eye), tuple(camera.centre), tuple(camera.axes[1])]
        plotter.camera.parallel_scale = camera.half
        plotter.renderer.reset_camera_clipping_range()
        plotter.enable_anti_aliasing("msaa", multi_samples=8)
        image = plotter.screenshot(return_img=True)
    finally:
        plotter.close()
    axes, half = inner.axes(figure), camera.half
    wide = half * pixels[0] / pixels[1]
    axes.imshow(image, extent=(-wide, wide, -half, half), aspect="auto", interpolation="none")
    axes.set_axis_off()
    for place, text, options in view.notes:
        axes.text(*(camera.axes[:2] @ (place - camera.centre)), text, **options)
    _draw_directions(figure, box, camera)
    write_header(figure, box, view.title, view.legend)
    if view.colours is not None:
        _draw_bar(figure, box, view.colours)


def write_header(figure: Any, box: Box, title: str, legend: Sequence[Any]) -> None:
    """Write a title and below it the legend, at the top of a box."""
    width, height = figure.get_size_inches()
    left, top = box.left + LEFT, box.bottom + box.height
    figure.text(left / width, (top - 0.3) / height, title, fontsize=11.0)
    narrow = 0.6 if len(legend) > 3 else 1.0  # four entries may be wider than half a picture
    spacing = {"handlelength": 1.6 * narrow, "handletextpad": 0.5, "columnspacing": 1.4 * narrow}
    figure.legend(
        handles=list(legend), ncols=max(len(legend), 1), loc="upper left", labelcolor=GREY,
        bbox_to_anchor=(left / width, (top - 0.36) / height), borderpad=0.0, borderaxespad=0.0,
        **spacing,
    )  # fmt: skip


def _draw_bar(figure: Any, box: Box, colours: Colours) -> None:
    """Draw a colour bar at the bottom of a box; an arrow and a text show a peak beyond it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    factor, label = scaled(colours.name, colours.unit, colours.high)
    axes = Box(box.left + 0.27 * box.width, box.bottom + 0.42, 0.58 * box.width, 0.12).axes(figure)
    peak = "" if colours.peak is None else f", at most {quantity(colours.peak, colours.unit)}"
    bar = figure.colorbar(
        ScalarMappable(Normalize(colours.low / factor, colours.high / factor), colours.cmap),
        cax=axes, orientation="horizontal", ticks=round_ticks(), label=label + peak,
        extend="max" if peak else "neither",
    )  # fmt: skip
    bar.outline.set_linewidth(0.5)
    bar.ax.tick_params(width=0.6, length=2.5, pad=2.0)
    bar.ax.xaxis.labelpad = 1.5


def _draw_directions(figure: Any, box: Box, camera: Camera) -> None:
    """Draw the visible coordinate directions as arrows, left of the colour bar."""
    size, length, beyond = 0.7, 0.22, 0.08  # inches
    axes = Box(box.left + LEFT, box.bottom + 0.06, size, size).axes(figure)
    axes.set(xlim=(0.0, size), ylim=(0.0, size))
    axes.set_axis_off()
    ends = length * camera.axes[:2].T
    start = np.array([0.1, 0.1]) - np.minimum(ends.min(axis=0), 0.0)
    for name, end in zip("xyz", ends, strict=True):
        if np.linalg.norm(end) > 0.2 * length:
            arrow = {"arrowstyle": "-|>", "mutation_scale": 5, "lw": 0.8, "color": GREY}
            axes.annotate("", start + end, start, arrowprops={**arrow, "shrinkA": 0, "shrinkB": 0})
            place = start + end * (1.0 + beyond / np.linalg.norm(end))
            axes.text(*place, name, fontsize=8, color=GREY, ha="center", va="center")


def handle(label: str, color: str, marker: str = "", width: float = 0.0, **options: Any) -> Any:
    """Return an entry of a legend: a line of some width, or a marker as in matplotlib."""
    from matplotlib.lines import Line2D

    style = {"linestyle": "-" if width else "", "linewidth": width, "markersize": 5.0, **options}
    return Line2D([], [], color=color, marker=marker, label=label, **style)


def scaled(name: str, unit: str, largest: float) -> tuple[float, str]:
    """Return a divisor of values, and a label such as "slip [10⁻⁶ m]".

    The divisor is 1 if the largest absolute value is from 0.02 to 9999, else a power of thousand.
    """
    plain = largest == 0.0 or 0.02 <= largest < 10_000.0
    power = 0 if plain else 3 * math.floor(math.log10(largest * (1.0 + 1e-12)) / 3.0)
    ten = "10" + str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    inside = f"{ten if power else ''} {unit}".strip()
    return 10.0**power, f"{name} [{inside}]" if inside else name


def quantity(value: float, unit: str) -> str:
    """Return a value with three digits and its unit, such as "18.9 · 10⁻⁶ m"."""
    factor, label = scaled("", unit, abs(value))
    digits, inside = value / factor, label.strip(" []")
    number = f"{digits:.0f}" if abs(digits) >= 99.95 else f"{digits:.3g}"
    return f"{number}{' ·' if factor != 1.0 else ''} {inside}".strip()


def round_ticks() -> Any:
    """Return matplotlib's locator of at most six round ticks."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=5, steps=(1.0, 2.0, 2.5, 5.0, 10.0))


def skin(grid: Any) -> Any:
    """Return the outer faces of a grid; faces of degree 2 are cut into pieces of half the length.

    Newer versions of pyvista require the argument `algorithm`, older ones have none.
    """
    takes_algorithm = "algorithm" in inspect.signature(grid.extract_surface).parameters
    kwargs = {"algorithm": "dataset_surface"} if takes_algorithm else {}
    return grid.extract_surface(nonlinear_subdivision=1, **kwargs)
