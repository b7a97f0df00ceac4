"""Rigid obstacles near the bodies."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.output.pictures.legend import patch
from dolfinx_tresca.scene.obstacle import RigidObstacle

_LOGGER = logging.getLogger("dolfinx_tresca")

COLOUR = "#a9b8c6"
EDGE = "#5b6670"
MARGIN = 0.12  #: margin around bodies in which obstacles are drawn, divided by the bodies' length
BAND = 0.05  #: thickness of obstacles in 2D, divided by the length of the bodies
SAMPLES = {2: 400, 3: 80}  #: samples along the longest side


def draw_obstacle(
    plotter: Any, obstacle: RigidObstacle, points: Array, dim: int, revolved: bool = False
) -> Array:
    """Draw the surface of an obstacle around points: where its signed distance is zero.

    In 3D a side that is seen from within the obstacle is transparent, since it may hide the bodies.
    In 2D the surface is a line with a grey band behind.

    Args:
        plotter: a plotter of pyvista.
        obstacle: the obstacle to draw.
        points: (n, 3) points of the bodies [length].
        dim: dimension of space.
        revolved: whether the obstacle is given in the meridian plane and turned about the y axis.

    Returns:
        the points that were drawn; none if the obstacle is not near the bodies.
    """
    try:
        grid = sampled(obstacle, points, dim, revolved)
    except Exception as error:  # the user's function may fail away from the surface
        _LOGGER.warning("%s is not in the picture: its signed distance fails: %s", obstacle, error)
        return np.empty((0, 3))
    length = float(np.linalg.norm(np.ptp(points, axis=0)))
    surface = grid.contour([0.0], scalars="distance")
    if not surface.n_points:
        return np.empty((0, 3))
    if dim == 2:
        # behind everything else
        behind = np.array([0.0, 0.0, -0.01 * length])
        band = grid.clip_scalar(scalars="distance", value=0.0, invert=True)
        band = band.clip_scalar(scalars="distance", value=-BAND * length, invert=False)
        plotter.add_mesh(
            band.translate(behind), color=COLOUR, lighting=False, show_scalar_bar=False
        )
        plotter.add_mesh(
            surface.translate(0.5 * behind), color=EDGE, line_width=3.0, lighting=False
        )
        return np.asarray(band.points)
    # normals point to where distances grow
    options = {"color": COLOUR, "smooth_shading": True, "ambient": 0.4, "diffuse": 0.6}
    surface = surface.compute_normals(
        cell_normals=False, auto_orient_normals=False, consistent_normals=False
    )
    plotter.add_mesh(surface, culling="front", **options)
    plotter.add_mesh(surface, culling="back", opacity=0.25, **options)
    rim = surface.extract_feature_edges(
        boundary_edges=True, feature_edges=False, non_manifold_edges=False, manifold_edges=False
    )
    if rim.n_points:
        plotter.add_mesh(rim, color=EDGE, line_width=1.5, lighting=False)
    return np.asarray(surface.points)


def legend_of_obstacles() -> Any:
    """Return the handle for a legend."""
    return patch("obstacle", COLOUR)


def sampled(obstacle: RigidObstacle, points: Array, dim: int, revolved: bool = False) -> Any:
    """Return a regular grid around points with an obstacle's signed distance [length]."""
    import pyvista

    low, high = points.min(axis=0), points.max(axis=0)
    margin = MARGIN * float(np.linalg.norm(high - low))
    low, high = low[:dim] - margin, high[:dim] + margin
    spacing = float((high - low).max()) / SAMPLES[dim]
    counts = np.ones(3, dtype=int)
    counts[:dim] = np.ceil((high - low) / spacing).astype(int) + 1
    grid = pyvista.ImageData(
        dimensions=counts,
        spacing=(spacing, spacing, spacing),
        origin=(*low, *np.zeros(3 - dim)),
    )
    at = np.array(grid.points)
    if revolved:
        at[:, 0], at[:, 2] = np.hypot(at[:, 0], at[:, 2]), 0.0
    grid.point_data["distance"] = obstacle.distance(at)
    return grid
