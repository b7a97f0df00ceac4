"""The feasible set Lambda, its projection, and its faces. Numpy only.

All functions are local to a rank.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse import csc_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask


@dataclass(frozen=True)
class Face:
    """The face of Lambda on which a point lies, and the directions that stay on it to first order.

    A disc of radius zero is a single point, and counts neither as stick nor as slip.

    Attributes:
        stick: (n_discs,) the active set A_tau of (38.13): discs whose multiplier is inside the
            disc.
        slip: (n_discs,) discs whose multiplier is on the circle.
        active: (size,) multipliers without restriction: normal multipliers in the active set A_nu
            of (38.12), tangential multipliers of sticking nodes, and all multipliers of bonded
            nodes.
        free: (size,) active multipliers, and tangential multipliers of slipping nodes, which may
            move along their circles.
        radial: (size,) unit vectors from the centres of slipping nodes' discs to their multipliers;
            zero elsewhere.
        discs: Lambda, with the positions of the discs' multipliers.
    """

    stick: Mask
    slip: Mask
    active: Mask
    free: Mask
    radial: Array
    discs: FeasibleSet

    def radial_parts(self, v: Array) -> Array:
        """Return the parts (n_discs,) or (n_discs, k) of v along the unit vectors `radial`."""
        return self.discs.sums((v.T * self.radial).T)

    def along_radius(self, lengths: Array) -> Array:
        """Return vectors along `radial` with the given lengths, (n_discs,) or (n_discs, k)."""
        discs = self.discs
        result = np.zeros((discs.size, *lengths.shape[1:]))
        result[discs.tangential] = (lengths[discs.node].T * self.radial[discs.tangential]).T
        return result

    def project(self, v: Array) -> Array:
        """Return the part P v of v, (size,) or (size, k), along the face."""
        along = (v.T * self.free).T
        return np.asarray(along - self.along_radius(self.radial_parts(along)))


@dataclass(frozen=True)
class FeasibleSet:
    """Lambda: normal multipliers are not negative, tangential ones lie in the disc of their node.

    A disc has as many dimensions as its node has tangential degrees of freedom: two in 3D, one in
    2D and in a symmetry plane. Multipliers of bonded surfaces are neither normal nor tangential;
    they are not restricted.

    Attributes:
        size: number of multipliers on this rank.
        normal: (n_normal,) positions of the normal multipliers lambda_nu.
        tangential: (n_tangential,) positions of the tangential multipliers lambda_tau.
        node: (n_tangential,) disc of each tangential multiplier, in 0, ..., n_discs - 1.
        radius: (n_discs,) bounds g >= 0 of the norm of each node's lambda_tau, in the units of
            lambda_tau.
    """

    #: Whether slip bounds depend neither on pressures nor on slips, as in Tresca's law.
    has_given_bounds: ClassVar[bool] = True

    size: int
    normal: Indices
    tangential: Indices
    node: Indices
    radius: Array

    def norms(self, v: Array) -> Array:
        """Return the norms (n_discs,) of the tangential parts of v (size,)."""
        return np.sqrt(self.sums(v**2))

    def disc_means(self, v: Array) -> Array:
        """Return the mean (n_discs,) of the tangential parts of each disc; 0 for empty discs."""
        return np.asarray(self.sums(v) / np.maximum(self.sums(np.ones_like(v)), 1.0))

    def mean_over_discs(self, v: Array) -> Array:
        """Return v with the tangential parts of each disc replaced by their mean."""
        result = v.copy()
        result[self.tangential] = self.disc_means(v)[self.node]
        return result

    def at_point(self, x: Array, r: Array, target: Array | None = None) -> FeasibleSet:
        """Return the set itself: its bounds depend neither on pressures nor on slips."""
        return self

    def slip_along(self, face: Face) -> Array:
        """Return zeros (size,): slip bounds do not depend on slips."""
        return np.zeros(self.size)

    def with_bound_change(
        self, x: Array, face: Face, diagonal: Array
    ) -> Callable[[Array, Array], Array]:
        """Return the function (s, v) -> s: slip bounds do not change with steps s."""
        return lambda step, v: step

    def dilation(self, x: Array, r: Array) -> Array:
        """Return zeros (size,): slip bounds do not grow with pressures."""
        return np.zeros(self.size)

    def sums(self, v: Array) -> Array:
        """Return the sum of the tangential entries of v in each disc, (n_discs,) or (n_discs, k).

        Args:
            v: (size,) or (size, k); the columns are summed separately.
        """
        entries, n = v[self.tangential], len(self.radius)
        if v.ndim == 1:
            return np.bincount(self.node, entries, minlength=n).astype(np.float64)
        size = len(entries)  # stored by columns, so that `node` needs no conversion
        total = csc_array((np.ones(size), self.node, np.arange(size + 1)), shape=(n, size))
        return np.asarray(total @ entries)

    @property
    def movable(self) -> Mask:
        """Which discs (n_discs,) may have nonzero multipliers."""
        return np.asarray(self.radius > 0.0)

    def section(self, x: Array) -> FeasibleSet:
        """Return the set itself: its bounds do not depend on the pressures of x (size,)."""
        return self

    def dissipation(self, slip: Array) -> float:
        """Return the sum of g |slip| over this rank's discs of finite radius."""
        bounded = np.isfinite(self.radius)
        return float(self.radius[bounded] @ self.norms(slip)[bounded])

    def project(self, y: Array) -> Array:
        """Return P_Lambda(y), the point of the set nearest to y (size,)."""
        norms = self.norms(y)
        result = self._scale_to_radius(y, norms, where=norms > self.radius)
        result[self.normal] = np.maximum(y[self.normal], 0.0)
        return result

    def projection_derivative(self, y: Array) -> Callable[[Array], Array]:
        """Return the slant derivative of P_Lambda at y, (38.8): a map of (size,) or (size, k)."""
        face = self.face(y)
        norms = self.norms(y)
        return lambda v: self._scale_to_radius(face.project(v), norms, where=face.slip)

    def face(self, y: Array) -> Face:
        """Return the face that holds P_Lambda(y): (38.12) and (38.13) for y = lambda - rho r."""
        norms = self.norms(y)
        stick = (norms <= self.radius) & self.movable
        slip = ~stick & self.movable
        active = np.ones(self.size, dtype=np.bool_)
        active[self.normal] = y[self.normal] >= 0.0
        active[self.tangential] = stick[self.node]
        free = active.copy()
        free[self.tangential] = self.movable[self.node]

        radial = np.zeros(self.size)
        factor = np.zeros_like(norms)
        np.divide(1.0, norms, out=factor, where=slip)
        radial[self.tangential] = y[self.tangential] * factor[self.node]
        return Face(stick, slip, active, free, radial, self)

    def on_face(self, v: Array, face: Face) -> Array:
        """Return v moved to a face: open nodes to zero, slipping nodes to g times `radial`."""
        radius = np.where(face.slip, self.radius, 0.0)  # infinity times zero is NaN
        return np.asarray(np.where(face.active, v, 0.0) + face.along_radius(radius))

    def circle_stiffness(self, gradient: Array, face: Face) -> Array:
        """Return kappa = |r| / g (size,) at slipping nodes, zero elsewhere.

        Kappa is the Lagrange multiplier of |lambda| <= g: the curvature of the circle adds kappa to
        the second derivative of q along the circle. If the gradient points outwards, kappa is zero
        instead of negative. With a radius that is almost zero, kappa may be infinite.
        """
        kappa = np.zeros_like(self.radius)
        with np.errstate(over="ignore"):
            np.divide(
                np.maximum(-face.radial_parts(gradient), 0.0),
                self.radius,
                out=kappa,
                where=face.slip,
            )
        result = np.zeros(self.size)
        result[self.tangential] = kappa[self.node]
        return result

    def scaled_discs(self, v: Array, factor: Array) -> Array:
        """Return v (size,) or (size, k) with the tangential parts of each disc times a factor.

        Args:
            v: vectors.
            factor: (n_discs,) factor for the tangential parts of each disc.
        """
        result = v.copy()
        result[self.tangential] = (result[self.tangential].T * factor[self.node]).T
        return result

    def _scale_to_radius(self, v: Array, norms: Array, where: Mask) -> Array:
        """Return v (size,) or (size, k) with tangential parts times radius / norms.

        Args:
            v: vectors.
            norms: (n_discs,) norms by which tangential parts are divided.
            where: (n_discs,) discs whose tangential parts change; other parts stay.
        """
        factor = np.ones_like(self.radius)
        np.divide(self.radius, norms, out=factor, where=where)
        return self.scaled_discs(v, factor)
