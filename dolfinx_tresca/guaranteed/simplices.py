"""The geometry of simplices, cell by cell, and the constants that depend on their shapes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import factorial

import numpy as np

from dolfinx_tresca._base.arrays import Array


def moments(arms: Array, forces: Array) -> Array:
    """Return the moments of forces (..., d) about a point: (..., 1) in 2D, (..., 3) in 3D."""
    return np.stack(
        [
            arms[..., i] * forces[..., j] - arms[..., j] * forces[..., i]
            for i, j in combinations(range(arms.shape[-1]), 2)
        ],
        axis=-1,
    )


def mean_products(corners: int, factors: int) -> Array:
    """Return the means over a simplex of products of barycentric coordinates.

    Args:
        corners: number of vertices of the simplex.
        factors: number of factors of each product.

    Returns:
        an array with `factors` axes of length `corners`; its entry (i, j, ...) is the mean of
        lambda_i lambda_j ... over the simplex.
    """
    result = np.empty((corners,) * factors)
    scale = factorial(corners - 1) / factorial(corners - 1 + factors)
    for index in np.ndindex(*result.shape):
        powers = np.bincount(index, minlength=corners)
        result[index] = scale * np.prod([factorial(int(power)) for power in powers])
    return result


@dataclass(frozen=True)
class Simplices:
    """Simplices with d + 1 vertices; facet j is opposite to vertex j.

    Attributes:
        points: (n, d + 1, d) the vertices [length].
    """

    points: Array

    @cached_property
    def frames(self) -> Array:
        """(n, d, d) the matrices B of the maps x = x_0 + B X from the reference simplex."""
        return np.swapaxes(self.points[:, 1:] - self.points[:, :1], 1, 2)

    @cached_property
    def inverses(self) -> Array:
        """(n, d, d) the inverses of `frames`."""
        return np.asarray(np.linalg.inv(self.frames))

    @cached_property
    def volumes(self) -> Array:
        """(n,) volumes, in 2D areas."""
        return np.asarray(np.abs(np.linalg.det(self.frames)) / factorial(self.points.shape[2]))

    @cached_property
    def gradients(self) -> Array:
        """(n, d + 1, d) gradients of the barycentric coordinates."""
        inner = self.inverses
        return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)

    @cached_property
    def heights(self) -> Array:
        """(n, d + 1) heights of the vertices over the opposite facets."""
        return np.asarray(1.0 / np.linalg.norm(self.gradients, axis=2))

    @cached_property
    def areas(self) -> Array:
        """(n, d + 1) areas of the facets, in 2D lengths."""
        return np.asarray(self.points.shape[2] * self.volumes[:, None] / self.heights)

    @cached_property
    def normals(self) -> Array:
        """(n, d + 1, d) outward unit normals of the facets."""
        return -self.gradients * self.heights[:, :, None]

    @cached_property
    def diameters(self) -> Array:
        """(n,) longest edges."""
        edges = self.points[:, :, None] - self.points[:, None]
        return np.asarray(np.sqrt(np.square(edges).sum(axis=3).max(axis=(1, 2))))

    @cached_property
    def korn_factors(self) -> Array:
        """(n,) upper bounds of |grad w| / |sym grad w| for w whose rotation has the mean zero.

        The factor is sqrt(1 + c^2) with |skw grad w| <= c |sym grad w|. With Babuska and Aziz's
        constant beta of the cell, c^2 <= 2 / beta^2 - 1 in 2D, c^2 <= 4 / beta^2 in 3D
        (docs/theory/guaranteed.md). In 2D beta >= sin(alpha / 4) with the smallest angle alpha
        (Horgan and Payne 1983; Costabel and Dauge 2015). In 3D 1 / beta^2 <= 1 + 4 C^2 with
        C = 4 D / (pi r) + 2 R / r, the diameter D, the radius r of the inscribed ball, and the
        largest distance R of a vertex from its centre.
        """
        perimeter = self.areas.sum(axis=1)
        centre = np.einsum("nj,njd->nd", self.areas, self.points) / perimeter[:, None]
        radius = self.points.shape[2] * self.volumes / perimeter
        far = np.linalg.norm(self.points - centre[:, None], axis=2).max(axis=1)
        if self.points.shape[2] == 2:  # sin(alpha / 2) = r / R
            return np.asarray(np.sqrt(2.0) / np.sin(0.5 * np.arcsin(radius / far)))
        constant = 4.0 * self.diameters / (np.pi * radius) + 2.0 * far / radius
        return np.asarray(np.sqrt(5.0 + 16.0 * np.square(constant)))

    @cached_property
    def poincare_factors(self) -> Array:
        """(n,) upper bounds of |w| / |sym grad w| [length] for w without mean and mean rotation.

        Payne and Weinberger's constant D / pi of convex cells with the diameter D, times
        `korn_factors`.
        """
        return self.diameters / np.pi * self.korn_factors

    @cached_property
    def trace_factors(self) -> Array:
        """(n, d + 1) upper bounds of |w|_F / |sym grad w| [length^(1/2)] on each facet F.

        As for `poincare_factors`; from the divergence of |w|^2 (x - x_F), with the vertex x_F
        opposite to the facet.
        """
        d, over_pi = self.points.shape[2], self.diameters / np.pi
        edges = np.linalg.norm(self.points[:, :, None] - self.points[:, None], axis=3).max(axis=2)
        squares = (d * over_pi**2)[:, None] + 2.0 * over_pi[:, None] * edges
        return np.asarray(np.sqrt(squares / self.heights) * self.korn_factors[:, None])
