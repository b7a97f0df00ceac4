"""Surfaces like cylinders and cones, unrolled into the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_tresca.dual.feasible_set import Array

BENT = 0.05  #: variance of normals along one direction; with less a surface is seen well as it is
STRAIGHT = 0.02  #: variance along the axis over that along another direction: more is no cylinder
PLANES = 2e-3  #: the latter over the largest: less is two planes with an edge
ROUND = 0.15  #: how far radii may be from those of a circular cone, over them
SEAM = 0.35  #: angle [rad] without nodes that makes a surface open
NEAR = 12  #: degrees from a coordinate: an end on its side


@dataclass(frozen=True)
class Unrolled:
    """A surface in the plane.

    Attributes:
        surface: of pyvista, at (arc length, height along the axis, 0); vectors alike.
        source: (n,) the node that each of its nodes was; at a seam some are there twice.
        axis: name of the direction that points upwards.
        ends: where its left and its right end are: "x side" on that side of the axis, or an angle.
    """

    surface: Any
    source: npt.NDArray[np.int64]
    axis: str
    ends: tuple[str, str]


def unroll(surface: Any, fields: tuple[str, ...]) -> Unrolled | None:
    """Return a surface unrolled, seen from outside, if all normals make one angle with an axis.

    Args:
        surface: of pyvista, with cell normals.
        fields: names of point data that are vectors.
    """
    import pyvista

    axis = _axis(surface)
    if axis is None:
        return None
    points = np.asarray(surface.points, dtype=float)
    first = np.eye(3)[(np.argmax(np.abs(axis)) + 1) % 3]
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    frame = np.array([first, np.cross(axis, first)])
    flat, height = points @ frame.T, points @ axis
    # circles around one axis, whose radius changes with height
    t = (height - height.mean()) / (np.ptp(height) or 1.0)
    terms = np.column_stack([2.0 * flat, np.ones(len(t)), t, t**2])
    centre = np.linalg.lstsq(terms, np.sum(flat**2, axis=1), rcond=None)[0][:2]
    arm = flat - centre
    angle, distance = np.arctan2(arm[:, 1], arm[:, 0]), np.hypot(*arm.T)
    cone = np.polyfit(t, distance, 1)
    radius = np.polyval(cone, t)
    middles = np.asarray(surface.cell_centers().points, dtype=float)
    inner = np.polyval(cone, (middles @ axis - height.mean()) / (np.ptp(height) or 1.0))
    inside = np.linalg.norm(middles @ frame.T - centre, axis=1)
    if (np.abs(np.append(distance - radius, inside - inner)) > ROUND * radius.min()).any():
        return None
    start, closed = _seam(angle)
    angle = np.mod(angle - start, 2.0 * math.pi)
    cells = surface.faces.reshape(-1, surface.faces[0] + 1).copy()
    source = np.arange(len(points))
    if closed:
        of_cells = angle[cells[:, 1:]]
        across = np.ptp(of_cells, axis=1) > math.pi
        early = np.unique(cells[across, 1:][of_cells[across] < math.pi])
        copy = source.copy()
        copy[early] = len(source) + np.arange(len(early))
        lines = cells[across, 1:]
        cells[across, 1:] = np.where(of_cells[across] < math.pi, copy[lines], lines)
        source = np.concatenate([source, early])
        angle = np.concatenate([angle, angle[early] + 2.0 * math.pi])
    middle = 0.5 * (angle.min() + angle.max())
    plane = np.zeros((len(source), 3))
    plane[:, 0] = (angle - middle) * radius[source]
    plane[:, 1] = height[source]
    result = pyvista.PolyData(plane, cells.ravel())
    for name in surface.point_data:
        result.point_data[name] = np.asarray(surface.point_data[name])[source]
    around = arm / np.linalg.norm(arm, axis=1, keepdims=True)
    around = (np.stack([-around[:, 1], around[:, 0]], axis=1) @ frame)[source]
    for name in fields:
        vectors = np.asarray(result.point_data[name])
        parts = [np.sum(vectors * around, axis=1), vectors @ axis, np.zeros(len(vectors))]
        result.point_data[name] = np.stack(parts, axis=1)
    index, oblique = int(np.argmax(np.abs(axis))), np.abs(axis).max() < 0.999
    at = (start, start) if closed else (start + angle.min(), start + angle.max())
    first_end, last_end = (_side(end, index, oblique) for end in at)
    name = "axis" if oblique else "xyz"[index]
    return Unrolled(result, source, name, (first_end, last_end))


def _side(angle: float, index: int, oblique: bool) -> str:
    """Return where an angle is, from the coordinate after that of the axis on."""
    degrees = round(math.degrees(angle)) % 360
    quarter = round(degrees / 90.0)
    if oblique or abs(degrees - 90 * quarter) > NEAR:
        return f"{degrees}°"
    name = "xyz"[(index + 1 + quarter % 2) % 3]
    return f"{'−' if quarter % 4 in (2, 3) else ''}{name} side"


def _axis(surface: Any) -> Array | None:
    """Return the direction with which all normals make the same angle; None if there is none."""
    normals = np.asarray(surface.cell_data["Normals"])
    areas = np.asarray(surface.compute_cell_sizes(length=False, volume=False).cell_data["Area"])
    mean = areas @ normals / areas.sum()
    spread = (normals - mean).T @ ((normals - mean) * areas[:, None]) / areas.sum()
    variances, directions = np.linalg.eigh(spread)
    axis = directions[:, 0]
    two_planes = variances[1] < PLANES * variances[2]
    crooked = variances[0] > STRAIGHT * variances[1]
    if variances[2] < BENT or two_planes or crooked or abs(axis @ mean) > 0.5:
        return None
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))


def _seam(angle: Array) -> tuple[float, bool]:
    """Return the angle at which a surface begins, and whether it goes all round."""
    ordered = np.sort(np.mod(angle, 2.0 * math.pi))
    gaps = np.diff(np.append(ordered, ordered[0] + 2.0 * math.pi))
    widest = int(np.argmax(gaps))
    if gaps[widest] > SEAM:
        return float(ordered[(widest + 1) % len(ordered)]) - 1e-9, False
    return 0.5 * math.pi, True
