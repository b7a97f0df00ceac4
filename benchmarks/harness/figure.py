"""The look of pictures of measurements."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

WIDTH = 8.8  #: inches; shown at 880 pixels, so that a point is as large as on other pages
DPI = 200  #: pixels per inch

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
    "svg.hashsalt": "dolfinx_tresca",
}


def new_figure(height: float, rows: int, columns: int, **options: Any) -> tuple[Any, Any]:
    """Return a figure of matplotlib of the usual width and its panels."""
    import matplotlib.style
    from matplotlib.figure import Figure

    with matplotlib.style.context(["default", STYLE]):
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        return figure, figure.subplots(rows, columns, squeeze=False, **options)


def save(figure: Any, path: Path) -> None:
    """Save a figure."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI)


def plain_ticks(axis: Any) -> None:
    """Write numbers such as 0.5, 1, 2, 5 and 10 at an axis with a logarithmic scale."""
    _ticks(axis, lambda value: f"{value:g}")


def percent_ticks(axis: Any) -> None:
    """Write percentages such as 0.5 %, 1 %, 2 % and 5 % at an axis with a logarithmic scale."""
    _ticks(axis, lambda value: f"{100 * value:g} %")


def _ticks(axis: Any, text: Callable[[float], str]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    least, largest = axis.get_view_interval()
    crowded = axis.axis_name == "x" and largest > 500.0 * least  # labels would touch side by side
    axis.set_major_locator(LogLocator(subs=(1.0, 3.0) if crowded else (1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))
    axis.set_minor_locator(NullLocator())
