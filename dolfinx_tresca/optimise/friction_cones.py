"""The set of multipliers for friction with bounds that grow with the pressure. Numpy only.

All functions are local to a rank.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.optimise.feasible_set import Face, FeasibleSet


@dataclass(frozen=True)
class FrictionCones:
    """The convex set lambda_nu >= 0, |lambda_tau| <= c + min(F lambda_nu, l) of each node.

    For c = 0 and without limit l each node has a second-order cone. The section of the set at given
    pressures is a set Lambda of Tresca friction. A solution with friction that depends on the
    pressure minimises q over its own section, not over this set: see `fixed_point`.

    Attributes:
        discs: Lambda with arbitrary radii, for the positions of normal and tangential multipliers.
        normal_of: (n_discs,) position of the normal multiplier that each bound grows with; -1
            for bounds that do not depend on a pressure.
        constant: (n_discs,) c >= 0, maybe infinite.
        coefficient: (n_discs,) F >= 0.
        limit: (n_discs,) l >= 0, maybe infinite.
    """

    discs: FeasibleSet
    normal_of: Indices
    constant: Array
    coefficient: Array
    limit: Array

    @property
    def size(self) -> int:
        """Number of multipliers on this rank."""
        return self.discs.size

    @property
    def carrying(self) -> Mask:
        """Which multipliers (size,) can be other than zero."""
        pressed = (self.coefficient > 0.0) & (self.limit > 0.0) & (self.normal_of >= 0)
        has_friction = (self.constant > 0.0) | pressed
        return dataclasses.replace(self.discs, radius=has_friction.astype(np.float64)).carrying

    def section(self, x: Array) -> FeasibleSet:
        """Return Lambda with the bounds at the pressures of x (size,)."""
        return dataclasses.replace(self.discs, radius=self._bound(self._pressures(x)))

    def with_reduced_friction(self, part: float) -> FrictionCones:
        """Return the cones with the coefficients of friction times `part`."""
        return dataclasses.replace(self, coefficient=part * self.coefficient)

    def with_bound_change(self, x: Array, face: Face) -> Callable[[Array], Array]:
        """Return the map I + Q of (size,) or (size, k) that adds the change of slip bounds.

        Q maps the change of a slipping node's pressure to the change of its bound, along the
        node's tangential multiplier.
        """
        slope = self._slope(x, face)
        return lambda v: v + face.along_radius((self._pressures(v).T * slope).T)

    def with_bound_change_transpose(self, x: Array, face: Face) -> Callable[[Array], Array]:
        """Return I + Q', the transpose of `with_bound_change`."""
        slope = self._slope(x, face)

        def follow(v: Array) -> Array:
            result, grows = v.copy(), slope > 0.0
            parts = (face.radial_parts(v)[grows].T * slope[grows]).T
            np.add.at(result, self.normal_of[grows], parts)
            return result

        return follow

    def project(self, y: Array) -> Array:
        """Return the point of the set nearest to y (size,)."""
        nearest = self._nearest(y)
        result: Array = self.discs.scaled_discs(y, nearest.ratio)
        result[self.discs.normal] = np.maximum(y[self.discs.normal], 0.0)
        has = self.normal_of >= 0
        result[self.normal_of[has]] = nearest.pressure[has]
        return result

    def projection_derivative(self, y: Array) -> Callable[[Array], Array]:
        """Return a slant derivative of `project` at y: a map of (size,) or (size, k)."""
        nearest = self._nearest(y)
        discs, has = self.discs, self.normal_of >= 0
        direction = np.zeros_like(y)
        norms = discs.norms(y)
        direction[discs.tangential] = y[discs.tangential]
        direction = discs.scaled_discs(direction, 1.0 / np.where(norms > 0.0, norms, 1.0))
        pressed = np.ones(self.size)
        pressed[discs.normal] = y[discs.normal] > 0.0

        def derivative(v: Array) -> Array:
            if self.size == 0:  # reshape cannot infer a number of columns
                return v
            columns = v.reshape(self.size, -1)
            radial = discs.sums(direction[:, None] * columns)
            pressure = np.where(has[:, None], columns[self.normal_of], 0.0)
            jacobian = nearest.jacobian
            along = jacobian[:, 1, 0, None] * pressure + jacobian[:, 1, 1, None] * radial
            result: Array = discs.scaled_discs(columns * pressed[:, None], nearest.ratio)
            turned = along - nearest.ratio[:, None] * radial
            t = discs.tangential
            result[t] += direction[t, None] * turned[discs.node]
            moved = jacobian[:, 0, 0, None] * pressure + jacobian[:, 0, 1, None] * radial
            result[self.normal_of[has]] = moved[has]
            return result.reshape(v.shape)

        return derivative

    def nodes(self) -> Indices:
        """Return a number (size,) for each multiplier, equal for the multipliers of one cone."""
        result = self.discs.nodes()
        normal_of = self.normal_of[self.discs.node]
        has = normal_of >= 0
        result[self.discs.tangential[has]] = normal_of[has]
        return result

    def _slope(self, x: Array, face: Face) -> Array:
        """Return the slope (n_discs,) of slipping nodes' bounds over their pressure at x."""
        grows = face.slip & (self.normal_of >= 0)
        grows &= self.coefficient * self._pressures(x) < self.limit
        return np.where(grows, self.coefficient, 0.0)

    def _pressures(self, x: Array) -> Array:
        """Return the normal multiplier that each bound depends on; 0 if there is none.

        Args:
            x: (size,) or (size, k) multipliers.

        Returns:
            (n_discs,) or (n_discs, k).
        """
        result = np.zeros((len(self.normal_of), *x.shape[1:]))
        has = self.normal_of >= 0
        result[has] = x[self.normal_of[has]]
        return result

    def _bound(self, pressure: Array) -> Array:
        grown = self.coefficient * np.maximum(pressure, 0.0)
        result: Array = self.constant + np.minimum(grown, self.limit)
        return result

    def _nearest(self, y: Array) -> _Nearest:
        """Return the nearest points of the set in each node's half-plane (pressure, radius).

        The boundary of the set in this plane has three edges: the axis up to c, the slope up to
        c + l, and a line of constant radius beyond.
        """
        p, s = self._pressures(y), self.discs.norms(y)
        c, grows = self.constant, (self.normal_of >= 0) & np.isfinite(self.constant)
        F = np.where(grows, self.coefficient, 0.0)
        end = np.full_like(F, np.inf)  # pressure at which the slope ends
        np.divide(self.limit, F, out=end, where=F > 0.0)
        above = np.where(F > 0.0, s - np.where(np.isfinite(c), c, 0.0), 0.0)
        square = 1.0 + F**2
        foot = (p + F * above) / square
        on_slope = np.clip(foot, 0.0, end)
        edges = (
            (np.zeros_like(p), np.minimum(s, c)),
            (on_slope, c + F * on_slope),
            (np.maximum(p, end), np.where(np.isfinite(end), c + self.limit, np.inf)),
        )
        with np.errstate(invalid="ignore"):  # edges at infinity
            distances = [np.hypot(p - a, s - b) for a, b in edges]
        which = np.argmin(np.where(np.isnan(distances), np.inf, distances), axis=0)
        inside = (p >= 0.0) & (s <= self._bound(p))
        pressure = np.where(inside, p, np.choose(which, [a for a, _ in edges]))
        radius = np.where(inside, s, np.choose(which, [b for _, b in edges]))
        ratio = np.ones_like(s)
        np.divide(radius, s, out=ratio, where=s > 0.0)

        jacobian = np.zeros((len(p), 2, 2))
        jacobian[inside] = np.eye(2)
        axis = ~inside & (which == 0)
        jacobian[axis, 1, 1] = s[axis] < c[axis]
        slope = ~inside & (which == 1) & (foot > 0.0) & (foot < end)
        edge = np.stack([np.ones_like(F), F], axis=1) / np.sqrt(square)[:, None]
        jacobian[slope] = edge[slope, :, None] * edge[slope, None, :]
        level = ~inside & (which == 2)
        jacobian[level, 0, 0] = p[level] > end[level]
        return _Nearest(pressure, ratio, jacobian)


@dataclass(frozen=True)
class _Nearest:
    """Nearest points of the set, in the half-planes (pressure, radius).

    Attributes:
        pressure: (n_discs,) normal multiplier.
        ratio: (n_discs,) norm of the tangential multiplier over its norm before; 1 for zero.
        jacobian: (n_discs, 2, 2) derivative of pressure and radius.
    """

    pressure: Array
    ratio: Array
    jacobian: Array
