"""A matplotlib figure with views that pyvista renders; matplotlib draws all text."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.pictures.labels import Range, locator, quantity, scaled

OBLIQUE = np.array([-0.38, -0.84, 0.38])  #: direction from which bodies are seen
UPWARDS = np.array([0.0, 0.0, 1.0])  #: up in the oblique view; direction from which 2D is seen

#: Names and directions of the coordinates.
COORDINATES = tuple(zip("xyz", np.eye(3), strict=True))

DPI = 200  #: pixels per inch of rendered views
TURN = 0.75  #: views are rotated if this enlarges the bodies by more than 1 / TURN
LEFT = 0.15  #: inches between the left end of a panel and its title
GREY = "#404040"  #: colour of legends and other small text
HEADER = 0.66  #: inches for title and legend
FOOTER = 0.62  #: inches for a colour bar

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
        aspect: width divided by height.
    """

    centre: Array
    axes: Array
    half: float
    aspect: float

    @classmethod
    def at(cls, points: Array, normal: Array, up: Array, aspect: float) -> Camera:
        """Return the largest view of all points, seen from the direction `normal`."""
        right = np.cross(up, normal)
        axes = np.array([right / np.linalg.norm(right), up, normal / np.linalg.norm(normal)])
        axes[1] = np.cross(axes[2], axes[0])
        seen = points @ axes.T
        spans, middle = np.ptp(seen, axis=0), 0.5 * (seen.min(axis=0) + seen.max(axis=0))
        return cls(middle @ axes, axes, _half(spans, aspect) or 1.0, aspect)

    @classmethod
    def turned(cls, points: Array, normal: Array, up: Array, aspect: float) -> Camera:
        """Return the view of `at`, turned by a right angle if points are then much larger.

        In the turned view `up` points to the right.
        """
        upright = cls.at(points, normal, up, aspect)
        flat = cls.at(points, normal, -upright.axes[0], aspect)
        return flat if flat.half < TURN * upright.half else upright

    def project(self, points: Array) -> Array:
        """Return positions (n, 2) of points in the view: (0, 0) lower left, (1, 1) upper right."""
        seen = (points - self.centre) @ self.axes[:2].T
        return np.asarray(0.5 + seen / (2.0 * self.half * np.array([self.aspect, 1.0])))

    def use(self, plotter: Any, depth: float) -> None:
        """Set the camera of a pyvista plotter to this view.

        Args:
            plotter: the plotter.
            depth: extent of the scene along the viewing direction [length].
        """
        plotter.enable_parallel_projection()
        plotter.camera_position = [
            tuple(self.centre + 2.0 * depth * self.axes[2]),
            tuple(self.centre),
            tuple(self.axes[1]),
        ]
        plotter.camera.parallel_scale = self.half
        plotter.renderer.reset_camera_clipping_range()


def _half(spans: Array, aspect: float) -> float:
    """Return half the height of a view that shows a width and a height, with a margin."""
    return 0.5 * max(float(spans[1]) / 0.96, float(spans[0]) / 0.92 / aspect)


@dataclass(frozen=True)
class Colours:
    """A field that is shown as colour.

    Attributes:
        name: name of the quantity.
        unit: unit of the values, or "".
        cmap: matplotlib's name of the colours.
        range: values of the first and the last colour.
    """

    name: str
    unit: str
    cmap: str
    range: Range

    @property
    def mesh_options(self) -> dict[str, Any]:
        """Options of pyvista's `add_mesh`."""
        limits = (self.range.low, self.range.high)
        return {"cmap": self.cmap, "clim": limits, "show_scalar_bar": False}


@dataclass(frozen=True)
class Drawn:
    """The camera of a drawing, and the texts that are to be written in and beside the view.

    Attributes:
        title: text above the view.
        legend: handles of matplotlib with labels.
        camera: camera of the view.
        colours: field that the colour bar explains; None: there is no colour bar.
        notes: texts in the view: for each its place (3,) [length], the text, and matplotlib's
            options of the text.
        directions: names and (3,) vectors of the directions that are shown as arrows.
    """

    title: str
    legend: Sequence[Any]
    camera: Camera
    colours: Colours | None = None
    notes: Sequence[tuple[Array, str, dict[str, Any]]] = ()
    directions: Sequence[tuple[str, Array]] = COORDINATES


def view(figure: Any, box: Box, draw: Callable[[Any, float], Drawn]) -> None:
    """Render a view and put it into a box of a figure, with title, legend and colour bar.

    Args:
        figure: a figure of matplotlib.
        box: box of the whole picture.
        draw: function (plotter, aspect) -> camera and texts. It draws the view with a plotter of
            pyvista; `aspect` is the width of the view divided by its height.
    """
    import pyvista

    inner = Box(box.left, box.bottom + FOOTER, box.width, box.height - HEADER - FOOTER)
    pixels = round(DPI * inner.width), round(DPI * inner.height)
    plotter = pyvista.Plotter(off_screen=True, window_size=list(pixels))
    try:
        plotter.set_background("white")
        drawn = draw(plotter, pixels[0] / pixels[1])
        drawn.camera.use(plotter, max(plotter.length, drawn.camera.half))
        plotter.enable_anti_aliasing("msaa", multi_samples=8)
        image = plotter.screenshot(return_img=True)
    finally:
        plotter.close()
    axes = inner.axes(figure)
    axes.imshow(image, extent=(0, 1, 0, 1), aspect="auto", interpolation="none")
    axes.set_axis_off()
    for place, text, options in drawn.notes:
        axes.text(*drawn.camera.project(place[None])[0], text, **options)
    _draw_directions(figure, box, drawn)
    write_header(figure, box, drawn.title, drawn.legend)
    if drawn.colours is not None:
        _draw_bar(figure, box, drawn.colours)


def write_header(figure: Any, box: Box, title: str, legend: Sequence[Any]) -> None:
    """Write a title and below it the legend, at the top of a box."""
    width, height = figure.get_size_inches()
    left, top = box.left + LEFT, box.bottom + box.height
    figure.text(left / width, (top - 0.3) / height, title, fontsize=11.0)
    if legend:
        narrow = 0.6 if len(legend) > 3 else 1.0  # four entries may be wider than half a picture
        figure.legend(
            handles=list(legend),
            loc="upper left",
            bbox_to_anchor=(left / width, (top - 0.36) / height),
            bbox_transform=figure.transFigure,
            ncols=len(legend),
            borderpad=0.0,
            borderaxespad=0.0,
            handlelength=1.6 * narrow,
            handletextpad=0.5,
            columnspacing=1.4 * narrow,
            labelcolor=GREY,
        )


def _draw_bar(figure: Any, box: Box, colours: Colours) -> None:
    """Draw a colour bar at the bottom of a box; an arrow and a text show a peak beyond it."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    low, high, peak = colours.range.low, colours.range.high, colours.range.peak
    how = scaled(colours.name, colours.unit, max(abs(low), abs(high)))
    axes = Box(box.left + 0.27 * box.width, box.bottom + 0.42, 0.58 * box.width, 0.12).axes(figure)
    bar = figure.colorbar(
        ScalarMappable(Normalize(low / how.factor, high / how.factor), colours.cmap),
        cax=axes,
        orientation="horizontal",
        ticks=locator(),
        extend="neither" if peak is None else "max",
        label=how.label + ("" if peak is None else f", at most {quantity(peak, colours.unit)}"),
    )
    bar.outline.set_linewidth(0.5)
    bar.ax.tick_params(width=0.6, length=2.5, pad=2.0)
    bar.ax.xaxis.labelpad = 1.5


def _draw_directions(figure: Any, box: Box, drawn: Drawn) -> None:
    """Draw the visible directions as arrows, left of the colour bar."""
    size, length, distance = 0.7, 0.22, 0.08  # inches
    axes = Box(box.left + LEFT, box.bottom + 0.06, size, size).axes(figure)
    axes.set(xlim=(0.0, size), ylim=(0.0, size))
    axes.set_axis_off()
    arrows = {name: drawn.camera.axes[:2] @ direction for name, direction in drawn.directions}
    arrows = {name: along for name, along in arrows.items() if np.linalg.norm(along) > 0.2}
    ends = np.stack([np.zeros(2), *arrows.values()])
    start = 0.5 * (size - length * (ends.min(axis=0) + ends.max(axis=0)))
    start[0] = 0.1 - length * ends[:, 0].min()
    for name, along in arrows.items():
        tip = start + length * along
        axes.annotate(
            "", tip, start,
            arrowprops={"arrowstyle": "-|>", "mutation_scale": 5, "lw": 0.8, "color": GREY,
                        "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
        place = tip + distance * along / np.linalg.norm(along)
        axes.text(*place, name, fontsize=8, color=GREY, ha="center", va="center")


def skin(grid: Any) -> Any:
    """Return the outer faces of a grid; faces of degree 2 are cut into pieces of half the length.

    Newer versions of pyvista require the argument `algorithm`, older ones have none.
    """
    kwargs: dict[str, Any] = {"nonlinear_subdivision": 1}
    if "algorithm" in inspect.signature(grid.extract_surface).parameters:
        kwargs["algorithm"] = "dataset_surface"
    return grid.extract_surface(**kwargs)
