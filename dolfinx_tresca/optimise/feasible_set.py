"""The feasible set Lambda, its projection, and its faces. Numpy only.

All is rank-local.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask

#: Distance from a circle, over its radius, that is rounding.
DISC_ROUNDING = 64 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class Face:
    """The face of Lambda on which a point lies, and the directions that stay on it to first order.

    Discs of radius zero hold a single point: they neither stick nor slip here.

    Attributes:
        stick: (n_discs,) the active set A_tau of (38.13): discs with the multiplier inside.
        slip: (n_discs,) discs with the multiplier on the circle.
        active: (size,) degrees of freedom without restriction: normals in the active set A_nu of
            (38.12), sticking nodes, bonded nodes.
        free: (size,) those and the ones of slipping nodes, which may move along their circle.
        radial: (size,) unit vectors from the centres of slipping nodes' discs to their multipliers;
            zero elsewhere.
        discs: the set.
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

    def along_radius(self, parts: Array) -> Array:
        """Return the unit vectors times (n_discs,) or (n_discs, k) parts, and zero elsewhere."""
        discs = self.discs
        result = np.zeros((discs.size, *parts.shape[1:]))
        result[discs.tangential] = (parts[discs.node].T * self.radial[discs.tangential]).T
        return result

    def project(self, v: Array) -> Array:
        """Return the part P v of v, (size,) or (size, k), along the face."""
        along = (v.T * self.free).T
        result: Array = along - self.along_radius(self.radial_parts(along))
        return result


@dataclass(frozen=True)
class FeasibleSet:
    """Lambda: normal multipliers are not negative, tangential ones stay in their node's disc.

    A disc has as many dimensions as its node has tangential degrees of freedom: two in 3D, one in
    2D and where a symmetry plane leaves no more. Multipliers that are neither normal nor tangential
    are free: those of bonded surfaces.

    Attributes:
        size: number of multipliers on this rank.
        normal: (n_normal,) their positions that carry lambda_nu.
        tangential: (n_tangential,) positions that carry lambda_tau.
        node: (n_tangential,) the disc of each tangential one, in 0, ..., n_discs - 1.
        radius: (n_discs,) bounds g on the norm of each node's lambda_tau; not negative.
    """

    size: int
    normal: Indices
    tangential: Indices
    node: Indices
    radius: Array

    def norms(self, v: Array) -> Array:
        """Return the norms (n_discs,) of the tangential parts of v (size,)."""
        squares = np.bincount(
            self.node, weights=v[self.tangential] ** 2, minlength=len(self.radius)
        )
        return np.sqrt(squares)

    def disc_means(self, v: Array) -> Array:
        """Return the mean (n_discs,) of the tangential parts of each disc; 0 where it has none."""
        sums = np.bincount(self.node, v[self.tangential], minlength=len(self.radius))
        number = np.bincount(self.node, minlength=len(self.radius))
        result: Array = sums / np.maximum(number, 1)
        return result

    def mean_over_discs(self, v: Array) -> Array:
        """Return v with the tangential parts of each disc replaced by their mean."""
        result = v.copy()
        result[self.tangential] = self.disc_means(v)[self.node]
        return result

    def with_bound_change(self, x: Array, face: Face) -> Callable[[Array], Array]:
        """Return the identity: multipliers on their circles do not follow their pressures."""
        return lambda v: v

    def with_bound_change_transpose(self, x: Array, face: Face) -> Callable[[Array], Array]:
        """Return the transpose of `following`: the identity."""
        return lambda v: v

    def sums(self, v: Array) -> Array:
        """Return the sums over each disc, (n_discs,) or (n_discs, k), of tangential parts of v."""
        parts, n = v[self.tangential], len(self.radius)
        if v.ndim == 1:
            return np.bincount(self.node, parts, minlength=n).astype(np.float64)
        place = np.arange(len(parts))
        total = csr_array((np.ones(len(parts)), (self.node, place)), shape=(n, len(parts)))
        return np.asarray(total @ parts)

    @property
    def carrying(self) -> Mask:
        """Which multipliers (size,) can be other than zero."""
        result = np.ones(self.size, dtype=np.bool_)
        result[self.tangential] = self.radius[self.node] > 0.0
        return result

    def section(self, x: Array) -> FeasibleSet:
        """Return the set itself: its bounds do not depend on the pressures of x (size,)."""
        return self

    def weakened(self, part: float) -> FeasibleSet:
        """Return the set itself: no coefficients of friction."""
        return self

    def dissipation(self, slip: Array) -> float:
        """Return the sum of g |slip| over this rank's discs that slip is possible for."""
        bounded = np.isfinite(self.radius)
        return float(self.radius[bounded] @ self.norms(slip)[bounded])

    def project(self, y: Array) -> Array:
        """Return the nearest point P_Lambda(y) of the set."""
        norms = self.norms(y)
        result = self._scale(y, self.radius, norms, where=norms > self.radius)
        result[self.normal] = np.maximum(y[self.normal], 0.0)
        return result

    def projection_derivative(self, y: Array) -> Callable[[Array], Array]:
        """Return the slant derivative of P_Lambda at y, (38.8): a map of (size,) or (size, k)."""
        face = self.face(y)
        norms = self.norms(y)
        return lambda v: self._scale(face.project(v), self.radius, norms, where=face.slip)

    def projection_jacobian(self, y: Array) -> csr_array:
        """Return the same derivative (size, size) as a matrix, block diagonal by nodes."""
        return self._blocks.matrix(self.projection_derivative(y))

    @cached_property
    def _blocks(self) -> DiagonalBlocks:
        return DiagonalBlocks.of(self.nodes())

    def nodes(self) -> Indices:
        """Return a number (size,) for each multiplier, the same for those of one disc."""
        result = np.arange(self.size)
        first = np.full(len(self.radius), self.size)
        np.minimum.at(first, self.node, self.tangential)
        result[self.tangential] = first[self.node]
        return result

    def face(self, y: Array) -> Face:
        """Return the face that holds P_Lambda(y): (38.12) and (38.13) for y = lambda - rho r."""
        norms = self.norms(y)
        movable = self.radius > 0.0
        stick = (norms <= self.radius) & movable
        slip = ~stick & movable
        active = np.ones(self.size, dtype=np.bool_)
        active[self.normal] = y[self.normal] >= 0.0
        active[self.tangential] = stick[self.node]
        free = active.copy()
        free[self.tangential] = movable[self.node]

        radial = np.zeros(self.size)
        factor = np.zeros_like(norms)
        np.divide(1.0, norms, out=factor, where=slip)
        radial[self.tangential] = y[self.tangential] * factor[self.node]
        return Face(stick, slip, active, free, radial, self)

    def on_face(self, v: Array, face: Face) -> Array:
        """Return v on a face: open normals at zero, slipping nodes at their point `radial`."""
        radius = np.where(face.slip, self.radius, 0.0)  # an infinite one times zero is NaN
        result: Array = np.where(face.active, v, 0.0) + face.along_radius(radius)
        return result

    def to_circle(self, v: Array, face: Face) -> Array:
        """Return v with slipping nodes back on their circles; others may be outside Lambda."""
        norms = self.norms(v)
        return self._scale(v, self.radius, norms, where=face.slip & (norms > 0.0))

    def circle_stiffness(self, gradient: Array, face: Face) -> Array:
        """Return kappa = |r| / g (size,) at slipping nodes, zero elsewhere.

        It is the multiplier of |lambda| <= g: the curvature that the circle adds to q along it. A
        gradient that points outwards, which would make it negative, counts as zero.
        """
        kappa = np.zeros_like(self.radius)
        np.divide(
            np.maximum(-face.radial_parts(gradient), 0.0), self.radius, out=kappa, where=face.slip
        )
        result = np.zeros(self.size)
        result[self.tangential] = kappa[self.node]
        return result

    def gradient_at_rest(self, x: Array, r: Array) -> Array:
        """Return the gradient (size,) next to r with which x of the set would be the solution.

        Nothing where nodes press or stick; not negative where they are open; opposite to the
        multiplier where they slip. Where they may not rub any.
        """
        result = np.zeros_like(r)
        open_ = x[self.normal] <= 0.0
        result[self.normal] = np.where(open_, np.maximum(r[self.normal], 0.0), 0.0)
        norms, t = self.norms(x), self.tangential
        unit = np.zeros_like(x)
        unit[t] = x[t]
        unit = self.scaled_discs(unit, 1.0 / np.where(norms > 0.0, norms, 1.0))
        slips = norms >= (1.0 - DISC_ROUNDING) * self.radius
        along = np.where(slips, np.minimum(self.sums(unit * r), 0.0), 0.0)
        result[t] = np.where((self.radius > 0.0)[self.node], unit[t] * along[self.node], r[t])
        return result

    def scaled_discs(self, v: Array, factor: Array) -> Array:
        """Return v, or columns, with tangential parts times their disc's factor (n_discs,)."""
        result = v.copy()
        result[self.tangential] = (result[self.tangential].T * factor[self.node]).T
        return result

    def _scale(self, v: Array, numerator: Array, denominator: Array, where: Mask) -> Array:
        """Return v, or columns, with the tangential parts of some discs times a fraction."""
        factor = np.ones_like(self.radius)
        np.divide(numerator, denominator, out=factor, where=where)
        return self.scaled_discs(v, factor)


@dataclass(frozen=True)
class DiagonalBlocks:
    """The places of matrices (size, size) that couple multipliers of one block only.

    Attributes:
        unit: (size, most) unit vectors: the place of each multiplier in its block.
        ends: (size + 1,) where rows end among the entries.
        columns: (entries,) the column of each entry.
        places: (entries,) its place in its block.
    """

    unit: Array
    ends: Indices
    columns: Indices
    places: Indices

    @classmethod
    def of(cls, block: Indices) -> DiagonalBlocks:
        """Return the places for numbers (size,) of the blocks."""
        _, index, counts = np.unique(block, return_inverse=True, return_counts=True)
        first, order = np.cumsum(counts) - counts, np.argsort(index, kind="stable")
        place = np.empty_like(index)
        place[order] = np.arange(len(block)) - first[index[order]]
        every = np.arange(counts.max(initial=0))
        row, places = np.nonzero(every < counts[index, None])
        ends = np.concatenate([[0], np.cumsum(counts[index])])
        unit = (place[:, None] == every).astype(np.float64)
        return cls(unit, ends, order[first[index[row]] + places], places)

    def matrix(self, apply: Callable[[Array], Array]) -> csr_array:
        """Return the matrix of a linear map of (size, columns), which is applied to `unit`."""
        rows = np.repeat(np.arange(len(self.unit)), np.diff(self.ends))
        values = apply(self.unit)[rows, self.places]
        return csr_array((values, self.columns, self.ends), shape=2 * (len(self.unit),))
