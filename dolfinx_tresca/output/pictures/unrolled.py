"""Surfaces like cylinders and cones, unrolled into the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array

# Whether a surface is unrolled depends on the variances of its normals along three directions. The
# direction of the least variance is the axis.
#: Least value of the largest variance: below this value the surface is nearly flat.
BENT = 0.05
#: Largest ratio of the least to the middle variance: above it the surface is no cylinder or cone.
NOT_STRAIGHT = 0.02
#: Least ratio of the middle to the largest variance: below it the surface is two planes.
PLANES = 2e-3
#: Largest difference of radii from the radii of a circular cone, relative to the cone's radii.
NOT_ROUND = 0.15
#: A surface is open if a sector of this angle [rad] about the axis contains no node.
SEAM = 0.35
#: Largest angle [degrees] between an end and the coordinate direction after which it is named.
NEAR = 12


@dataclass(frozen=True)
class Unrolled:
    """A cylindrical or conical surface, unrolled into the plane.

    Attributes:
        surface: pyvista surface; points and vectors have the components (along the arc, along the
            axis, 0).
        source: (n,) the original number of each node; nodes at a seam occur twice.
        axis: name of the direction that points upwards.
        ends: names of the directions from the axis to the left and to the right end: "x side",
            for example, or an angle.
    """

    surface: Any
    source: npt.NDArray[np.int64]
    axis: str
    ends: tuple[str, str]


def unroll(surface: Any, fields: tuple[str, ...]) -> Unrolled | None:
    """Unroll a surface, seen from outside; return None unless it is nearly a cylinder or a cone.

    Args:
        surface: a surface of pyvista with cell normals.
        fields: names of point data that are vectors.
    """
    import pyvista

    cone = _Cone.through(surface)
    if cone is None:
        return None
    points = np.asarray(surface.points, dtype=float)
    start, closed = _seam(cone.angle(points))
    angle = np.mod(cone.angle(points) - start, 2.0 * math.pi)
    cells, source = surface.faces.reshape(-1, surface.faces[0] + 1), np.arange(len(points))
    if closed:
        cells, early = _cut(cells, angle)
        source = np.concatenate([source, early])
        angle = np.concatenate([angle, angle[early] + 2.0 * math.pi])
    middle = 0.5 * (angle.min() + angle.max())
    plane = np.zeros((len(source), 3))
    plane[:, 0] = (angle - middle) * cone.radius(points)[source]
    plane[:, 1] = (points @ cone.axis)[source]
    result = pyvista.PolyData(plane, cells.ravel())
    for name in surface.point_data:
        result.point_data[name] = np.asarray(surface.point_data[name])[source]
    around = cone.around(points)[source]
    for name in fields:
        vectors = np.asarray(result.point_data[name])
        parts = [np.sum(vectors * around, axis=1), vectors @ cone.axis, np.zeros(len(vectors))]
        result.point_data[name] = np.stack(parts, axis=1)
    index, oblique = int(np.argmax(np.abs(cone.axis))), np.abs(cone.axis).max() < 0.999
    at = (start, start) if closed else (start + angle.min(), start + angle.max())
    first_end, last_end = (_side(end, index, oblique) for end in at)
    name = "axis" if oblique else "xyz"[index]
    return Unrolled(result, source, name, (first_end, last_end))


@dataclass(frozen=True)
class _Cone:
    """A circular cone or cylinder.

    Attributes:
        axis: (3,) direction of the axis.
        frame: (2, 3) unit vectors across the axis: angles grow from the first to the second.
        centre: (2,) position of the axis in this frame [length].
        slope: (2,) change of the radius with height, and the radius at height zero [length].
    """

    axis: Array
    frame: Array
    centre: Array
    slope: Array

    @classmethod
    def through(cls, surface: Any) -> _Cone | None:
        """Return the cone or cylinder fitted to a surface; None if the surface is not near it."""
        axis = _axis(surface)
        if axis is None:
            return None
        points = np.asarray(surface.points, dtype=float)
        first = np.eye(3)[(np.argmax(np.abs(axis)) + 1) % 3]
        first = first - (first @ axis) * axis
        first /= np.linalg.norm(first)
        frame = np.array([first, np.cross(axis, first)])
        flat, height = points @ frame.T, points @ axis
        # points x across the axis satisfy |x|^2 = 2 centre.x + p(height), where p has degree 2
        scale = float(np.abs(points).max()) or 1.0
        powers = np.vander(height / scale, 3)
        terms = np.column_stack([2.0 * flat / scale, powers])
        squares = np.sum((flat / scale) ** 2, axis=1)
        centre = scale * np.linalg.lstsq(terms, squares, rcond=None)[0][:2]
        distance = np.linalg.norm(flat - centre, axis=1)
        slope = np.linalg.lstsq(np.vander(height, 2), distance, rcond=None)[0]
        cone = cls(axis, frame, centre, slope)
        # checked in the middles of cells as well, since all corners of a box are on a circle
        points = np.concatenate([points, np.asarray(surface.cell_centers().points)])
        off = np.linalg.norm(points @ frame.T - centre, axis=1) - cone.radius(points)
        return cone if (np.abs(off) <= NOT_ROUND * cone.radius(points)).all() else None

    def radius(self, points: Array) -> Array:
        """Return (n,) radii at the heights of points [length]."""
        return np.asarray(np.polyval(self.slope, points @ self.axis))

    def angle(self, points: Array) -> Array:
        """Return (n,) angles of points."""
        x, y = (points @ self.frame.T - self.centre).T
        return np.asarray(np.arctan2(y, x))

    def around(self, points: Array) -> Array:
        """Return (n, 3) unit vectors along which angles grow."""
        angle = self.angle(points)
        return np.asarray(np.stack([-np.sin(angle), np.cos(angle)], axis=1) @ self.frame)


def _cut(cells: Any, angle: Array) -> tuple[Any, npt.NDArray[np.int64]]:
    """Cut a surface along the seam: cells (m, 1 + k) that cross the seam get nodes of their own.

    Args:
        cells: (m, 1 + k) the number k and the nodes of each cell.
        angle: angle of each node, measured from the seam [rad].

    Returns:
        the cells with their new nodes; and for each new node the number of the node that it copies.
    """
    corners = angle[cells[:, 1:]]
    across = np.ptp(corners, axis=1, keepdims=True) > math.pi
    over = across & (corners < math.pi)
    early = np.unique(cells[:, 1:][over])
    copy = np.arange(len(angle))
    copy[early] = len(angle) + np.arange(len(early))
    cells = cells.copy()
    cells[:, 1:] = np.where(over, copy[cells[:, 1:]], cells[:, 1:])
    return cells, early


def _side(angle: float, index: int, oblique: bool) -> str:
    """Return the text of a direction around an axis: "y side", "−x side", or degrees.

    Args:
        angle: angle of the direction, measured from the coordinate direction that follows the axis
            in cyclic order [rad].
        index: number of the coordinate direction of the axis.
        oblique: whether the axis is not along a coordinate direction.
    """
    degrees = round(math.degrees(angle)) % 360
    quarter = round(degrees / 90.0)
    if oblique or abs(degrees - 90 * quarter) > NEAR:
        return f"{degrees}°"
    name = "xyz"[(index + 1 + quarter % 2) % 3]
    return f"{'−' if quarter % 4 in (2, 3) else ''}{name} side"


def _axis(surface: Any) -> Array | None:
    """Return the axis of a surface like a cylinder or a cone; None for other surfaces.

    All normals make nearly the same angle with the axis.
    """
    normals = np.asarray(surface.cell_data["Normals"])
    areas = np.asarray(surface.compute_cell_sizes(length=False, volume=False).cell_data["Area"])
    mean = areas @ normals / areas.sum()
    spread = (normals - mean).T @ ((normals - mean) * areas[:, None]) / areas.sum()
    variances, directions = np.linalg.eigh(spread)
    axis = directions[:, 0]
    two_planes = variances[1] < PLANES * variances[2]
    crooked = variances[0] > NOT_STRAIGHT * variances[1]
    if variances[2] < BENT or two_planes or crooked or abs(axis @ mean) > 0.5:
        return None
    return np.asarray(axis * np.sign(axis[np.argmax(np.abs(axis))]))


def _seam(angle: Array) -> tuple[float, bool]:
    """Return the angle at which the unrolled surface begins, and whether the surface is closed."""
    ordered = np.sort(np.mod(angle, 2.0 * math.pi))
    gaps = np.diff(np.append(ordered, ordered[0] + 2.0 * math.pi))
    widest = int(np.argmax(gaps))
    if gaps[widest] > SEAM:
        return float(ordered[(widest + 1) % len(ordered)]) - 1e-9, False
    return 0.5 * math.pi, True
