"""Boxes around points, along their principal axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask


@dataclass(frozen=True)
class Box:
    """A box around points that is thin where they lie in a plane, however that lies in space.

    Attributes:
        middle: (3,) the origin of its axes.
        axes: (3, 3) orthonormal, in columns.
        low: (3,) its least coordinates along these; infinite without any points.
        high: (3,) its largest ones.
    """

    middle: Array
    axes: Array
    low: Array
    high: Array

    @classmethod
    def around(cls, points: Array) -> Box:
        """Return the box around points (n, 3)."""
        middle = points.sum(axis=0) / max(len(points), 1)
        axes = np.linalg.svd((points - middle).T @ (points - middle))[0]
        places = (points - middle) @ axes
        low, high = places.min(axis=0, initial=np.inf), places.max(axis=0, initial=-np.inf)
        return cls(middle, axes, low, high)

    def as_row(self) -> Array:
        """Return the box as numbers (18,)."""
        return np.concatenate([self.middle, self.axes.ravel(), self.low, self.high])

    @classmethod
    def of_row(cls, row: Array) -> Box:
        """Return the box of numbers (18,)."""
        return cls(row[:3], row[3:12].reshape(3, 3), row[12:15], row[15:])

    def near(self, points: Array, reach: Array) -> Mask:
        """Return which points (n, 3) are not farther from the box than a reach (n,) each."""
        x = (points - self.middle) @ self.axes
        outside = np.maximum(np.maximum(self.low - x, x - self.high), 0.0)
        return np.asarray(np.linalg.norm(outside, axis=1) <= reach)

    def crossed(self, origins: Array, directions: Array, reach: Array) -> tuple[Array, Array]:
        """Return for lines where they enter and leave the box, widened by a reach (n,) each.

        One that misses it enters behind the place where it leaves.
        """
        x, slope = (origins - self.middle) @ self.axes, directions @ self.axes
        low, high = self.low - reach[:, None] - x, self.high + reach[:, None] - x
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = low / slope, high / slope
        flat = slope == 0.0
        inside = (low <= 0.0) & (high >= 0.0)
        enter = np.where(flat, np.where(inside, -np.inf, np.inf), np.minimum(one, two))
        leave = np.where(flat, np.where(inside, np.inf, -np.inf), np.maximum(one, two))
        return enter.max(axis=1), leave.min(axis=1)
