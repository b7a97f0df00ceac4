"""Measurements kept as JSON, with the code that made them, and the look of pictures of them."""

from __future__ import annotations

import argparse
import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dolfinx_tresca.output.pictures.canvas import DPI, STYLE

Row = dict[str, Any]

WIDTH = 8.8  #: inches; shown at 880 pixels, so that a point is as large as on other pages


def measured_by() -> str:
    """Return the commit of this checkout; "+" behind it if its code was changed since."""

    def git(*arguments: str) -> str:
        folder = Path(__file__).parent
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", "../dolfinx_tresca", "*.py")
    return f"{git('rev-parse', '--short', 'HEAD') or 'unknown'}{'+' if changed else ''}"


def keep(path: Path | None, rows: list[Row]) -> None:
    """Write rows and the commit that measured them, if there is a path."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"commit": measured_by(), "rows": rows}, indent=1) + "\n")


def kept(path: Path) -> list[Row]:
    """Return the rows of such a file."""
    rows: list[Row] = json.loads(path.read_text())["rows"]
    return rows


def add_files(parser: argparse.ArgumentParser) -> None:
    """Add the options for JSON and picture, and for a picture of JSON alone."""
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--picture", type=Path, metavar="FILE")
    parser.add_argument(
        "--from", dest="kept", type=Path, metavar="FILE", help="draw the picture, measure nothing"
    )


def redraw(arguments: argparse.Namespace, draw: Callable[[Path, list[Row]], None]) -> bool:
    """Draw what was kept, if that is asked for; return whether it is."""
    if arguments.kept is None:
        return False
    if arguments.picture is None:
        raise SystemExit("--from needs --picture: where to draw what is kept")
    draw(arguments.picture, kept(arguments.kept))
    return True


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
    """Write 0.5, 1, 2, 5, 10, ... at an axis with a logarithmic scale."""
    _ticks(axis, lambda value: f"{value:g}")


def percent_ticks(axis: Any) -> None:
    """Write 0.5 %, 1 %, 2 %, 5 %, ... at an axis with a logarithmic scale."""
    _ticks(axis, lambda value: f"{100 * value:g} %")


def _ticks(axis: Any, text: Callable[[float], str]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: text(value)))
    axis.set_minor_locator(NullLocator())
