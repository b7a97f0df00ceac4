"""The multipliers that laws of contact and friction allow. Numpy and scipy only.

`FeasibleSet` is Lambda for given slip bounds, with its projection and its faces; in `FrictionCones`
bounds depend on pressure and slip. All functions are local to a rank.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol, TypeAlias

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask


@dataclass(frozen=True)
class Face:
    """The face of Lambda on which a point lies: which nodes are open, pressed, stick or slip.

    A disc of radius zero is a single point, and counts neither as stick nor as slip.

    Attributes:
        stick: (n_discs,) the active set A_tau of (38.13): discs with the multiplier inside.
        slip: (n_discs,) discs whose multiplier is on the circle.
        active: (size,) multipliers without restriction: normal multipliers in the active set A_nu
            of (38.12), tangential multipliers of sticking nodes, and all of bonded nodes.
        free: (size,) active multipliers, and those of slipping nodes, which move along circles.
        radial: (size,) outward unit vectors of the discs of slipping nodes; zero elsewhere.
        discs: Lambda, with the positions of the discs' multipliers.
    """

    stick: Mask
    slip: Mask
    active: Mask
    free: Mask
    radial: Array
    discs: FeasibleSet

    def radial_parts(self, v: Array) -> Array:
        """Return components (n_discs,) of v (size,) along `radial`; 0 at nodes without slip."""
        return self.discs.sums(v * self.radial)

    def along_radius(self, lengths: Array) -> Array:
        """Return vectors (size,) along `radial` with lengths (n_discs,); 0 where nothing slips."""
        return self.radial * self.discs.at_tangents(lengths)


@dataclass(frozen=True)
class FeasibleSet:
    """Lambda: normal multipliers are not negative, tangential ones lie in the disc of their node.

    A disc has as many dimensions as its node has tangential degrees of freedom: two in 3D, one in
    2D and in a symmetry plane. Multipliers of bonded surfaces are in neither group, and any number.

    Attributes:
        size: number of multipliers on this rank.
        normal: (n_normal,) positions of the normal multipliers lambda_nu.
        tangential: (n_tangential,) positions of the tangential multipliers lambda_tau.
        node: (n_tangential,) disc of each tangential multiplier, in 0, ..., n_discs - 1.
        radius: (n_discs,) bounds g >= 0 of the norm of each node's lambda_tau.
        normal_of: (n_discs,) position of the normal multiplier that may bound the disc; -1: none.
    """

    #: Whether slip bounds depend neither on pressures nor on slips, as in Tresca's law.
    has_given_bounds: ClassVar[bool] = True

    size: int
    normal: Indices
    tangential: Indices
    node: Indices
    radius: Array
    normal_of: Indices

    def norms(self, v: Array) -> Array:
        """Return the norm (n_discs,) of the tangential entries of v (size,) in each disc."""
        return np.sqrt(self.sums(v**2))

    def disc_means(self, v: Array) -> Array:
        """Return the mean (n_discs,) of the tangential entries of v (size,) in each disc, or 0."""
        return np.asarray(self.sums(v) / np.maximum(self.sums(np.ones_like(v)), 1.0))

    def mean_over_discs(self, v: Array) -> Array:
        """Return a diagonal v (size,) with its mean in each disc: it scales discs to discs."""
        result = v.copy()
        result[self.tangential] = self.disc_means(v)[self.node]
        return result

    def at_point(self, x: Array, r: Array, target: Array | None = None) -> FeasibleSet:
        """Return the set itself, since its bounds are given (compare `FrictionCones.at_point`)."""
        return self

    def slip_along(self, face: Face) -> Array:
        """Return zeros (size,), since the bounds are given (`FrictionCones.slip_along`)."""
        return np.zeros(self.size)

    def slopes(self, x: Array, where: Mask | bool = True) -> Array:
        """Return zeros (2, n_discs), since the bounds are given (`FrictionCones.slopes`)."""
        return np.zeros((2, len(self.radius)))

    def at_normals(self, values: Array) -> Array:
        """Return values (n_discs,) as a vector (size,) of normal rows, zero elsewhere."""
        result = np.zeros(self.size)
        has_normal = self.normal_of >= 0
        result[self.normal_of[has_normal]] = values[has_normal]
        return result

    def of_normals(self, v: Array) -> Array:
        """Return the entry (n_discs,) of v (size,) in each disc's normal row; 0 without a row."""
        return np.append(v, 0.0)[self.normal_of]  # -1: the appended zero

    def at_tangents(self, values: Array) -> Array:
        """Return values (n_discs,) as a vector (size,) of tangential rows, zero elsewhere."""
        result = np.zeros(self.size)
        result[self.tangential] = values[self.node]
        return result

    def linear_bounds(self) -> list[tuple[Array, Array]]:
        """Return functions a + s p of the pressure p, the least of which is a disc's slip bound.

        The list has a pair (a, s) for each function, (n_discs,) each; a may be infinite.
        """
        return [(self.radius, np.zeros_like(self.radius))]

    def sums(self, v: Array) -> Array:
        """Return the sums (n_discs,) of the tangential entries of v (size,) in each disc."""
        entries, count = v[self.tangential], len(self.radius)
        return np.bincount(self.node, entries, minlength=count).astype(np.float64)

    @property
    def movable(self) -> Mask:
        """Whether each disc (n_discs,) may have nonzero tangential multipliers."""
        return np.asarray(self.radius > 0.0)

    def section(self, x: Array) -> FeasibleSet:
        """Return the set itself, since its bounds are given (compare `FrictionCones.section`)."""
        return self

    def dissipation(self, slip: Array) -> float:
        """Return the sum of g |slip| over this rank's discs of finite g; `slip` is (size,)."""
        bounded = np.isfinite(self.radius)
        return float(self.radius[bounded] @ self.norms(slip)[bounded])

    def project(self, y: Array) -> Array:
        """Return P_Lambda(y), the point of the set nearest to y (size,)."""
        norms = self.norms(y)
        factor = np.divide(self.radius, norms, out=np.ones_like(norms), where=norms > self.radius)
        result = self.scaled_discs(y, factor)
        result[self.normal] = np.maximum(y[self.normal], 0.0)
        return result

    def projection_derivative(self, y: Array) -> csr_array:
        """Return the slant derivative (size, size) of P_Lambda at y, (38.8)."""
        # outside of its disc, y with the unit vector e becomes g e: the derivative of the
        # tangential part is g / |y| (I - e e')
        face, norms = self.face(y), self.norms(y)
        factor = np.divide(self.radius, norms, out=np.ones_like(norms), where=face.slip)
        scales = self.scaled_discs(np.ones(self.size), factor)
        return self.nodal_matrix(scales * face.free, (-scales * face.radial, face.radial))

    def nodal_matrix(self, diagonal: Array, *terms: tuple[Array, Array]) -> csr_array:
        """Return a sparse matrix (size, size) that couples only multipliers of the same node.

        The diagonal (size,) is the first term. For each pair of vectors a and b (size,) in `terms`,
        a_i b_j is added to the entry (i, j) if i and j belong to the same node.
        """
        pattern = self._pattern
        columns = pattern.indices
        rows = np.repeat(np.arange(self.size), np.diff(pattern.indptr))  # of the same entries
        values = np.where(rows == columns, diagonal[rows], 0.0)
        for a, b in terms:
            values += a[rows] * b[columns]
        return csr_array((values, columns, pattern.indptr), shape=pattern.shape, copy=True)

    @cached_property
    def _pattern(self) -> csr_array:
        """The matrix (size, size) with nonzero entries where `nodal_matrix` may have entries."""
        size, n_discs = self.size, len(self.radius)
        # multipliers of a node have the number of its disc, all others a number of their own
        with_normal = np.flatnonzero(self.normal_of >= 0)
        number = np.arange(size) + n_discs
        number[self.tangential] = self.node
        number[self.normal_of[with_normal]] = with_normal
        # entry (i, j) of `member` is 1 if multiplier i has the number j
        entries = np.ones(size), number, np.arange(size + 1)
        member = csr_array(entries, shape=(size, size + n_discs))
        pattern = csr_array(member @ member.T)
        pattern.sort_indices()
        return pattern

    def face(self, y: Array) -> Face:
        """Return the face on which P_Lambda(y) lies: (38.12), (38.13) for y = lambda - rho r."""
        norms = self.norms(y)
        stick = (norms <= self.radius) & self.movable
        slip = ~stick & self.movable
        active = np.ones(self.size, dtype=np.bool_)
        active[self.normal] = y[self.normal] >= 0.0
        active[self.tangential] = stick[self.node]
        free = active.copy()
        free[self.tangential] = self.movable[self.node]
        factor = np.divide(1.0, norms, out=np.zeros_like(norms), where=slip)
        radial = y * self.at_tangents(factor)
        return Face(stick, slip, active, free, radial, self)

    def on_face(self, v: Array, face: Face) -> Array:
        """Return v (size,) moved to a face: open nodes to zero, slipping nodes to their circles."""
        radius = np.where(face.slip, self.radius, 0.0)  # infinity times zero is NaN
        return np.asarray(np.where(face.active, v, 0.0) + face.along_radius(radius))

    def circle_stiffness(self, gradient: Array, face: Face) -> Array:
        """Return kappa (size,), the inward part of the gradient r over g; 0 without slip.

        Kappa is the Lagrange multiplier of |lambda|^2 / 2 <= g^2 / 2: r + kappa lambda = 0 at the
        solution. The curvature of the circle adds kappa to the second derivative of q along it. If
        r points outwards, kappa is zero. With a radius that is almost zero, it may be infinite.
        """
        with np.errstate(over="ignore"):
            inwards = np.maximum(-face.radial_parts(gradient), 0.0)
            zero = np.zeros_like(inwards)
            kappa = np.divide(inwards, self.radius, out=zero, where=face.slip)
        return self.at_tangents(kappa)

    def scaled_discs(self, v: Array, factor: Array) -> Array:
        """Return v (size,) with the entries of each disc multiplied by its factor (n_discs,)."""
        result = v.copy()
        result[self.tangential] *= factor[self.node]
        return result


class Curve(Protocol):
    """A coefficient of friction F(p, v) of the pressure p and the slip v at a node."""

    def values(self, pressure: Array, slip: Array) -> Array:
        """Return F (n,) at pressures (n,) [stress] and slips (n,) [length]."""

    def slopes(self, pressure: Array, slip: Array) -> tuple[Array, Array]:
        """Return dF/dp (n,) [1 / stress] and dF/dv (n,) [1 / length]."""


#: A curve with the pressures (n,) [stress] and slips (n,) [length] of its nodes.
CurveAtNodes: TypeAlias = tuple[Curve, Array, Array]


def pressed_values(
    curve: Curve, pressure: Array, slip: Array, points: Array | None = None
) -> Array:
    """Return F (n,) at nodes under pressure and 0 at open nodes, where F may be infinite.

    The `points` are ignored: they let callers evaluate F like a function of positions.
    """
    with np.errstate(all="ignore"):
        return np.where(pressure > 0.0, curve.values(pressure, slip), 0.0)


@dataclass(frozen=True)
class NodalCurves:
    """The curves of all discs, as functions of multipliers and their gradient.

    A multiplier is a stress, and a gradient is a length, times the root of the area of its node.

    Attributes:
        of_discs: for each curve the range of its discs, and the curve.
        root: (n_discs,) root of the node's area.
    """

    of_discs: Sequence[tuple[slice, Curve]]
    root: Array

    @np.errstate(all="ignore")
    def coefficients(self, constant: Array, pressure: Array, slip: Array | float) -> Array:
        """Return F (n_discs,) at normal multipliers `pressure` and norms `slip` of gradients.

        Discs without a curve have the coefficient `constant` (n_discs,). Values of curves that are
        negative or not finite become zero: iterates may have pressures and slips far from those of
        the solution. The values at the solution are checked afterwards.
        """
        result = constant.copy()
        for discs, curve, p, v in self.arguments(pressure, slip):
            values = np.nan_to_num(curve.values(p, v), posinf=0.0)
            result[discs] = np.maximum(values, 0.0)
        return result

    @np.errstate(all="ignore")
    def slopes(self, pressure: Array, slip: Array | float) -> Array:
        """Return dF/dp and dF/dv (2, n_discs), p and v as in `coefficients`; 0 without a curve."""
        result = np.zeros((2, len(self.root)))
        for discs, curve, p, v in self.arguments(pressure, slip):
            result[:, discs] = np.nan_to_num(curve.slopes(p, v), posinf=0.0, neginf=0.0)
        return result / self.root  # the chain rule: the curve's arguments are p / root and v / root

    def arguments(
        self, pressure: Array, slip: Array | float
    ) -> list[tuple[slice, Curve, Array, Array]]:
        """Return for each curve its n discs, the curve, and their pressures and slips (n,).

        They are a stress and a length; the arguments (n_discs,) are those of `coefficients`.
        """
        p: Array = np.maximum(pressure, 0.0) / self.root
        v: Array = np.divide(slip, self.root)
        return [(discs, curve, p[discs], v[discs]) for discs, curve in self.of_discs]


@dataclass(frozen=True)
class FrictionCones(FeasibleSet):
    """The convex set lambda_nu >= 0, |lambda_tau| <= c + min(F lambda_nu, l) of each node.

    For c = 0 and without limit l, each node has a second-order cone. The section of the set at
    given pressures is a set Lambda of Tresca friction. A solution with friction that depends on the
    pressure minimises q over its own section, not over this set.

    If F depends on pressure and slip (`curves`), the section at x has the bounds of these functions
    at the pressures of x and at the slips `slip`. The cones themselves have the coefficients of a
    single point, which `at_point` sets; `project` moves points near it into these cones.

    Attributes:
        radius: (n_discs,) c >= 0, maybe infinite.
        coefficient: (n_discs,) F >= 0.
        limit: (n_discs,) l >= 0, maybe infinite.
        curves: coefficients that depend on pressure and slip, for some discs or none.
        slip: (n_discs,) norm of the tangential gradient, at which curves are evaluated; 0.0: rest.
    """

    has_given_bounds = False

    coefficient: Array
    limit: Array
    curves: NodalCurves = NodalCurves((), np.ones(1))
    slip: Array | float = 0.0

    @property
    def movable(self) -> Mask:
        """Whether each disc (n_discs,) may have nonzero tangential multipliers."""
        grows = (self.coefficient > 0.0) & (self.limit > 0.0) & (self.normal_of >= 0)
        return (self.radius > 0.0) | grows

    def at_point(self, x: Array, r: Array, target: Array | None = None) -> FrictionCones:
        """Return the cones with the coefficients of friction at the pressures and slips of a point.

        Slips are the norms of the tangential parts of r. If the end `target` (size,) of a gradient
        step from x is given, the slip of a node counts as zero where the bound at rest would hold
        the node at `target`, except while the bound falls at the present slip. So a node beyond the
        fall of a curve is tried at rest, where bodies are before they slide; Newton's method would
        else find the solution in which they slide.
        """
        if not self.curves.of_discs:
            return self
        slip = self.norms(r)
        cones = dataclasses.replace(self, slip=slip)
        if target is not None:
            bound_at_rest = dataclasses.replace(self, slip=0.0).section(x).radius
            weakens = cones.slopes(x)[1] < 0.0
            rests = (self.norms(target) <= bound_at_rest) & ~weakens
            cones = dataclasses.replace(self, slip=np.where(rests, 0.0, slip))
        coefficient = self.curves.coefficients(self.coefficient, self.of_normals(x), cones.slip)
        return dataclasses.replace(cones, coefficient=coefficient)

    def linear_bounds(self) -> list[tuple[Array, Array]]:
        """Return c + F p and c + l, of which the least is the slip bound, as in `FeasibleSet`."""
        zero = np.zeros_like(self.limit)
        return [(self.radius, self.coefficient), (self.radius + self.limit, zero)]

    def section(self, x: Array) -> FeasibleSet:
        """Return Lambda with the bounds at the pressures of x (size,) and the slips of the set."""
        pressure = self.of_normals(x)
        coefficient = self.curves.coefficients(self.coefficient, pressure, self.slip)
        grown = coefficient * np.maximum(pressure, 0.0)
        g = self.radius + np.minimum(grown, self.limit)
        return FeasibleSet(self.size, self.normal, self.tangential, self.node, g, self.normal_of)

    def slip_along(self, face: Face) -> Array:
        """Return the slips of slipping nodes as vectors (size,) along their tractions."""
        return face.along_radius(np.zeros_like(self.radius) + self.slip)

    def project(self, y: Array) -> Array:
        """Return the point of the cones, of all pressures and tractions, nearest to y (size,)."""
        pressure, ratio, _ = self._nearest(y)
        result: Array = self.scaled_discs(y, ratio)
        result[self.normal] = np.maximum(y[self.normal], 0.0)  # of nodes without a disc
        has_normal = self.normal_of >= 0
        result[self.normal_of[has_normal]] = pressure[has_normal]
        return result

    def projection_derivative(self, y: Array) -> csr_array:
        """Return a slant derivative (size, size) of `project` at y.

        A node with the pressure p and the traction q e, |e| = 1, gets P(p, q) and R(p, q) e. With
        the unit vector n in its normal row, the derivative is n dP' + e dR' + R / q (I - e e'),
        where the gradients dP and dR are combinations of n and e.
        """
        _, ratio, jacobian = self._nearest(y)
        norms = self.norms(y)
        radial = y * self.at_tangents(1.0 / np.where(norms > 0.0, norms, 1.0))
        normal = self.at_normals(np.ones_like(norms))
        diagonal = self.scaled_discs(np.ones(self.size), ratio)
        diagonal[self.normal] = y[self.normal] > 0.0  # of nodes without a disc
        diagonal[normal > 0.0] = 0.0
        jacobian[1, 1] -= ratio
        # the gradients dP and dR - R / q e
        of_pressure = self.at_normals(jacobian[0, 0]) + self.scaled_discs(radial, jacobian[0, 1])
        of_radius = self.at_normals(jacobian[1, 0]) + self.scaled_discs(radial, jacobian[1, 1])
        return self.nodal_matrix(diagonal, (normal, of_pressure), (radial, of_radius))

    def slopes(self, x: Array, where: Mask | bool = True) -> Array:
        """Return dg/dp and dg/dv (2, n_discs), at the pressures of x and the slips `slip`.

        The bounds are g = c + min(F(p, v) p, l). Slopes are zero outside of the mask `where`
        (n_discs,), and where F p reaches the limit l.
        """
        pressure = self.of_normals(x)
        coefficient = self.curves.coefficients(self.coefficient, pressure, self.slip)
        grows = where & (self.normal_of >= 0) & (coefficient * pressure < self.limit)
        # (F, 0) + p (dF/dp, dF/dv)
        result = np.array([coefficient, np.zeros_like(coefficient)])
        result += np.maximum(pressure, 0.0) * self.curves.slopes(pressure, self.slip)
        return np.where(grows, result, 0.0)

    def exceed_limit(self, x: Array) -> Mask:
        """Return for which discs (n_discs,) F p exceeds the limit l at x (size,)."""
        pressure = self.of_normals(x)
        coefficient = self.curves.coefficients(self.coefficient, pressure, self.slip)
        return np.asarray(coefficient * pressure > self.limit)

    def curve_arguments(self, x: Array) -> list[CurveAtNodes]:
        """Return each curve with the pressures of x [stress] and the slips of the set [length]."""
        arguments = self.curves.arguments(self.of_normals(x), self.slip)
        return [(curve, pressure, slip) for _, curve, pressure, slip in arguments]

    def _nearest(self, y: Array) -> tuple[Array, Array, Array]:
        """Return the point of the set nearest to y (size,), in each node's (pressure, radius).

        The boundary of the set in this half-plane has three edges: on the axis of zero pressure up
        to the radius c, along a slope up to c + l, and from there with constant radius.

        Returns:
            normal multipliers (n_discs,); ratio (n_discs,) of the norm of the tangential
            multipliers to their norm in y, 1 if that is zero; and the derivative (2, 2, n_discs)
            of pressure and radius with respect to their values in y.
        """
        given = np.array([self.of_normals(y), self.norms(y)])  # (2, n_discs)
        nodes = np.arange(len(self.radius))
        zero, unit = np.zeros(len(nodes)), np.ones(len(nodes))
        grows = (self.normal_of >= 0) & np.isfinite(self.radius)
        F = np.where(grows, self.coefficient, zero)
        hypot = np.hypot(unit, F)
        # the pressure where the slope ends
        end = np.divide(self.limit, F, out=np.full_like(F, np.inf), where=F > 0.0)
        # first points and unit vectors (edges, 2, nodes) of the edges, and lengths (edges, nodes)
        origins = np.array([[zero, zero], [zero, self.radius], [end, self.radius + self.limit]])
        directions = np.array([[zero, unit], [unit / hypot, F / hypot], [unit, zero]])
        lengths = np.array([self.radius, end * hypot, np.inf * unit])
        with np.errstate(invalid="ignore"):  # the distance of an edge at infinity is NaN
            along = ((given - origins) * directions).sum(axis=1)
            along = np.clip(along, 0.0, lengths)
            feet = origins + along[:, None] * directions
            distances = np.linalg.norm(given - feet, axis=1)
        distances[np.isnan(distances)] = np.inf
        edge = np.argmin(distances, axis=0)  # the nearest one
        grown = self.coefficient * np.maximum(given[0], 0.0)
        bound = self.radius + np.minimum(grown, self.limit)
        inside = (given[0] >= 0.0) & (given[1] <= bound)
        pressure, radius = np.where(inside, given, feet[edge, :, nodes].T)
        ratio = np.divide(radius, given[1], out=np.ones_like(radius), where=given[1] > 0.0)
        # I inside of the set, t t' on an edge with the unit vector t, zero at a corner
        is_inner = ((along > 0.0) & (along < lengths))[edge, nodes]
        direction = np.where(is_inner, directions[edge, :, nodes].T, 0.0)
        jacobian = np.where(inside, np.eye(2)[:, :, None], direction[:, None] * direction)
        return pressure, ratio, jacobian
