"""Bounding boxes of points along their principal axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask


@dataclass(frozen=True)
class Box:
    """A bounding box along the principal axes of points, which is flat for points in a plane.

    Attributes:
        origin: (3,) the mean of the points, origin of the axes [length].
        axes: (3, 3) orthonormal axes in columns.
        low: (3,) least coordinates along the axes [length]; infinite without points.
        high: (3,) greatest coordinates along the axes [length]; -infinite without points.
    """

    origin: Array
    axes: Array
    low: Array
    high: Array

    @classmethod
    def around(cls, points: Array) -> Box:
        """Return the bounding box of points (n, 3)."""
        middle = points.sum(axis=0) / max(len(points), 1)
        axes = np.linalg.svd((points - middle).T @ (points - middle))[0]
        places = (points - middle) @ axes
        low, high = places.min(axis=0, initial=np.inf), places.max(axis=0, initial=-np.inf)
        return cls(middle, axes, low, high)

    def to_row(self) -> Array:
        """Return the box as an array (18,), for communication."""
        return np.concatenate([self.origin, self.axes.ravel(), self.low, self.high])

    @classmethod
    def from_row(cls, row: Array) -> Box:
        """Return the box from the array (18,) of `to_row`."""
        return cls(row[:3], row[3:12].reshape(3, 3), row[12:15], row[15:])

    def within_reach(self, points: Array, reach: Array) -> Mask:
        """Return a mask (n,) of the points (n, 3) within a distance `reach` (n,) of the box."""
        x = (points - self.origin) @ self.axes
        outside = np.maximum(np.maximum(self.low - x, x - self.high), 0.0)
        return np.asarray(np.linalg.norm(outside, axis=1) <= reach)

    def line_intervals(
        self, origins: Array, directions: Array, reach: Array
    ) -> tuple[Array, Array]:
        """Intersect lines with the box, widened on all sides.

        Args:
            origins: (n, 3) the point of each line whose parameter is 0 [length].
            directions: (n, 3) unit vectors along the lines.
            reach: (n,) distance by which the box is widened for each line [length].

        Returns:
            The parameters (n,) at which the lines enter the box, and the parameters (n,) at which
            they leave it [length]. If a line misses the box, its first parameter is the greater
            one.
        """
        x, slope = (origins - self.origin) @ self.axes, directions @ self.axes
        low, high = self.low - reach[:, None] - x, self.high + reach[:, None] - x
        with np.errstate(divide="ignore", invalid="ignore"):
            at_low, at_high = low / slope, high / slope
        flat = slope == 0.0
        inside = (low <= 0.0) & (high >= 0.0)
        enter = np.where(flat, np.where(inside, -np.inf, np.inf), np.minimum(at_low, at_high))
        leave = np.where(flat, np.where(inside, np.inf, -np.inf), np.maximum(at_low, at_high))
        return enter.max(axis=1), leave.min(axis=1)
