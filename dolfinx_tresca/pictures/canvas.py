"""What all pyvista pictures share: outer faces, titles, colour bars, and the camera."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array

OBLIQUE = np.array([-0.38, -0.84, 0.38])  #: from where bodies are seen
UPWARDS = np.array([0.0, 0.0, 1.0])  #: up in that view, and from where 2D is seen


def skin(grid: Any) -> Any:
    """Return the outer faces; those of cells of degree 2 in pieces with half their edges.

    Newer versions of pyvista want to know how, older ones do not.
    """
    kwargs: dict[str, Any] = {"nonlinear_subdivision": 1}
    if "algorithm" in inspect.signature(grid.extract_surface).parameters:
        kwargs["algorithm"] = "dataset_surface"
    return grid.extract_surface(**kwargs)


def bar(title: str) -> dict[str, Any]:
    """Return how a colour bar looks."""
    return {
        "title": f"{title}\n",  # the line keeps it off the labels
        "color": "black",
        "title_font_size": 20,
        "label_font_size": 17,
        "n_labels": 4,
        "fmt": "%.3g",
        "width": 0.6,
        "height": 0.09,
        "position_x": 0.2,
        "position_y": 0.02,
    }


def title(plotter: Any, text: str, legend: str) -> None:
    """Write title and legend above the current part of the picture."""
    height = plotter.renderer.GetSize()[1]
    for line, below, size, color in ((text, 38, 10, "black"), (legend, 66, 7, "dimgrey")):
        at = (0.05, 1.0 - below / height)
        plotter.add_text(line, position=at, viewport=True, font_size=size, color=color)


def look(plotter: Any, points: Array, normal: Array, up: Array) -> None:
    """Look at points against `normal`, as large as fits between title and colour bar."""
    right = np.cross(up, normal)
    axes = np.array([right / np.linalg.norm(right), np.zeros(3), normal / np.linalg.norm(normal)])
    axes[1] = np.cross(axes[2], axes[0])
    seen = points @ axes.T
    spans, middle = np.ptp(seen, axis=0), 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    width, height = plotter.renderer.GetSize()
    half = 0.5 * max(spans[1] / 0.68, spans[0] / 0.84 * height / width)
    middle[1] -= 0.06 * half  # the bar is higher than the title
    centre = middle @ axes
    distance = float(np.linalg.norm(spans))
    plotter.enable_parallel_projection()
    plotter.camera_position = [tuple(centre + distance * axes[2]), tuple(centre), tuple(axes[1])]
    plotter.camera.parallel_scale = half
    plotter.renderer.reset_camera_clipping_range()
