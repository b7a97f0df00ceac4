"""Handles of matplotlib for legends."""

from __future__ import annotations

from typing import Any


def line(label: str, color: str, width: float = 1.2) -> Any:
    """Return a line for a legend."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, linewidth=width, label=label)


def mark(label: str, marker: str, color: str = "black", face: str | None = None) -> Any:
    """Return a mark for a legend; a marker in dollars, such as "$x$", is drawn as text."""
    from matplotlib.lines import Line2D

    is_text = marker.startswith("$")
    return Line2D(
        [],
        [],
        linestyle="",
        marker=marker,
        markersize=9.0 if is_text else 5.0,
        markeredgewidth=0.3 if is_text else 1.0,
        color=color,
        markerfacecolor=color if face is None else face,
        label=label,
    )


def patch(label: str, color: str) -> Any:
    """Return a filled box for a legend."""
    from matplotlib.patches import Patch

    return Patch(facecolor=color, edgecolor="none", label=label)


def words(label: str) -> Any:
    """Return an entry of a legend with text only."""
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="", label=label)
