"""The user's slip bounds at the nodes of a pair: terms, friction ellipses, and checks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array, LocalNumbers, Mask, cross, dots, real
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.dual.nodal_values import NodalValues
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.friction import COEFFICIENT_ROUNDING, Friction, ScalarField, two_bounds
from dolfinx_tresca.solvers.feasible_set import Curve


@dataclass(frozen=True)
class NodalBounds:
    """Slip bounds c + min(F p, l) under the pressure p, at the nodes of a pair on this rank.

    Attributes:
        constant: (n,) c [stress].
        coefficient: (n,) F, the coefficient of friction; with a curve, a number to begin with.
        limit: (n,) l [stress], the upper limit of the part F p; infinite without a limit.
        shape: (n, 2) semi-axes of the friction ellipses along the first axis and normal to it,
            divided by the longer one, whose length is c + min(F p, l); 1 for circles.
        direction: (n, 3) vectors whose tangential parts are the first axes; None: all are circles.
        curve: F as a function of pressure and slip; None: F is the coefficient.
    """

    constant: Array
    coefficient: Array
    limit: Array
    shape: Array
    direction: Array | None = None
    curve: Curve | None = None


def with_tangents_along_axes(
    V: Any, operators: PairOperators, bounds: NodalBounds
) -> PairOperators:
    """Return operators whose tangents are the axes of the friction ellipses. Collective.

    If T has its rows along the axes, an ellipse can be scaled to a disc (`friction_discs`). A node
    with one tangent keeps it, and its slip bound is the semi-diameter of the ellipse along it. A
    node whose ellipse is a circle keeps its tangents. If neither tangents nor semi-axes change on
    this rank, up to rounding, the result is `operators` itself.
    """
    if bounds.direction is None:
        return operators
    shape = np.where(bounds.shape > ROUNDING, bounds.shape, 0.0)
    circular = shape[:, 0] == shape[:, 1]
    axes = _axes(V, operators, np.where(circular[:, None], 0.0, bounds.direction), circular)
    node = operators.tangent_node
    # the two rows of each node with two tangents and an ellipse: rows of a node are adjacent
    second = np.flatnonzero(node[1:] == node[:-1]) + 1
    second = second[~circular[node[second]]]
    rows = np.stack([second - 1, second], axis=1)
    tangents = operators.tangents.copy()
    tangents[rows] = axes[node[second]]
    # of each row the semi-diameter 1 / |(d_1 / b_1, d_2 / b_2)| along its tangent, which has the
    # components d along the axes, with the semi-axes b; (rows, 2)
    d = np.einsum("rai,ri->ra", axes[node], tangents)
    b = shape[node]
    # a component d_i that is zero counts as zero where b_i is zero, too; any other one as infinite
    nonzero = np.abs(d) > ROUNDING
    scaled = np.zeros_like(b)
    np.divide(d, b, out=scaled, where=nonzero & (b > 0.0))
    reciprocals = np.linalg.norm(scaled, axis=1)
    reciprocals[(nonzero & (b == 0.0)).any(axis=1)] = np.inf
    reciprocals[circular[node]] = 1.0  # a circle has no axes, and d may be zero
    semi_axes = 1.0 / reciprocals
    turned = np.abs(tangents - operators.tangents).max(initial=0.0)
    stretched = np.abs(semi_axes - operators.semi_axes).max(initial=0.0)
    if max(turned, stretched) <= ROUNDING:  # the vectors and semi-axes are of order 1
        return operators
    return replace(operators, tangents=tangents, semi_axes=semi_axes)


def _axes(V: Any, operators: PairOperators, direction: Array, circular: Mask) -> Array:
    """Return the axes (n, 2, 3) of each node's ellipse, as unit vectors. Collective.

    The first axis is along the tangential part of the direction (n, 3). Where this part is zero, so
    are the axes, as at circles; at a node with tangents that is not `circular`, it is an error.
    """
    along_normal = dots(direction, operators.normals)
    axis = direction - along_normal[:, None] * operators.normals
    length, whole = np.linalg.norm(axis, axis=1), np.linalg.norm(direction, axis=1)
    has_tangents = np.zeros(len(length), dtype=np.bool_)
    has_tangents[operators.tangent_node] = True
    with errors_on_all_ranks(V.mesh.comm):
        # a direction counts as normal if the sine of its angle to the normal is at most 1e-6
        bad = np.flatnonzero(has_tangents & ~circular & ~(length > 1e-6 * whole))
        if len(bad):
            worst, node = direction[bad[0]], operators.nodes[bad[0]]
            fault = "is normal to the surface" if worst.any() else "is zero"
            fault = fault if np.isfinite(worst).all() else "is not finite"
            raise InputError(
                f"the direction of the slip bound {fault}: found {_vector_text(worst)} at "
                f"{_vector_text(V.tabulate_dof_coordinates()[node])}, with the normal "
                f"{_vector_text(operators.normals[bad[0]])}, and so at {len(bad)} of the "
                f"{len(operators.nodes)} contact nodes of rank {V.mesh.comm.rank}. Give a "
                "direction that varies, or two equal bounds where it has no meaning."
            )
    length[length == 0.0] = 1.0
    axis /= length[:, None]
    return np.stack([axis, cross(operators.normals, axis)], axis=1)


def _vector_text(vector: Array) -> str:
    """Return a vector as text; components that are rounding are shown as zero."""
    is_rounding = np.abs(vector) <= ROUNDING * np.abs(vector).max()
    components = [f"{component:.4g}" for component in np.where(is_rounding, 0.0, vector)]
    return f"({', '.join(components)})"


def friction_discs(node: LocalNumbers, semi_axes: Array, count: int) -> tuple[Array, Array, Mask]:
    """Return the factors that make each node's friction ellipse a disc (docs/theory/coulomb.md).

    The projection onto a disc is explicit, but the projection onto an ellipse is not. For
    components t_i of the traction along semi-axes b_1 and b_2 the unknowns are t_i / stretch_i with
    stretch_1^2 = b_1 / b_2 and stretch_2^2 = b_2 / b_1, and the disc has the radius sqrt(b_1 b_2).
    If one semi-axis is zero, the disc of the node is an interval, from minus to plus the other
    semi-axis. Each tangential row has its node in `node` (n_tangential,), one of `count` nodes, and
    its semi-axis in `semi_axes` (n_tangential,), relative to the longer one. Not collective.

    Returns:
        the stretch (n_tangential,), the ratio of traction to unknown [1]; the radius (count,) of
        each node's disc, relative to the longer semi-axis [1], and 1 at nodes without rows; and
        whether a row (n_tangential,) has a zero bound, while the other row of its node has not.
    """
    # sums over the positive semi-axes of each node: their number, and their logarithms
    positive = semi_axes > 0.0
    positive_axes = np.bincount(node[positive], minlength=count)
    logarithms = np.bincount(node[positive], np.log(semi_axes[positive]), minlength=count)
    radius = np.exp(logarithms / np.maximum(positive_axes, 1))  # geometric mean of positive axes
    radius[node[positive_axes[node] == 0]] = 0.0
    stretch = np.ones_like(semi_axes)
    np.divide(semi_axes, radius[node], out=stretch, where=positive)
    return stretch, radius, ~positive & (positive_axes[node] > 0)


#: Names of the terms of a bound in error messages; laws name the constant term `constant_name`.
TERMS = {
    "constant": Friction.constant_name,
    "coefficient": "the coefficient of friction",
    "limit": "the limit of the slip bound",
}

#: Name of the direction of a friction ellipse in error messages.
DIRECTION = "the direction of the slip bound"


def _named_scalars(friction: Friction) -> dict[str, list[tuple[ScalarField, str]]]:
    """Return term -> its fields, two for ellipses, each with the name for error messages."""
    result = {}
    for term, words in TERMS.items():
        name = friction.constant_name if term == "constant" else words
        bound = getattr(friction.terms, term)
        result[term] = two_bounds(bound, name) if isinstance(bound, tuple) else [(bound, name)]
    return result


class SlipBounds:
    """Evaluates friction laws at nodes: the bounds of which `JumpOperator.bounded` makes Lambda."""

    def __init__(self, V: Any) -> None:
        """Keep the space of the displacements, to whose local numbers of nodes `nodes` refer."""
        self._comm, self._dim = V.mesh.comm, V.mesh.geometry.dim
        self.values = NodalValues(V)

    def check(self, friction: Friction, nodes: LocalNumbers, stress_rounding: float) -> None:
        """Check that bounds can be evaluated at nodes (n,), as a problem is created. Collective.

        Values are checked only of bounds that are plain numbers: others may change before a solve.
        For `stress_rounding` [stress] see `nodal_bounds`.

        Raises:
            InputError: the bound or the direction is on another mesh; a function returns neither a
                number (or a vector) nor one value for each point; a direction is given in 2D; or a
                number is negative by more than rounding, NaN, or an infinite coefficient.
        """
        for scalars in _named_scalars(friction).values():
            for field, name in scalars:
                if real(field) is None:  # not a plain number
                    self.values.values_at(field, nodes, name)
                else:
                    self._bound(field, nodes, name, stress_rounding)
        if friction.terms.curve is not None:
            zero = np.zeros(len(nodes))  # pressures and slips
            self.check_curve(friction.terms.curve, zero, zero)
        if friction.terms.direction is not None:
            if self._dim == 2:
                raise InputError(
                    "two slip bounds and their direction are for surfaces in 3D: in 2D the "
                    "surfaces slide along one direction only, so give one bound."
                )
            self.values.values_at(friction.terms.direction, nodes, DIRECTION, 3)

    def nodal_bounds(
        self, friction: Friction, nodes: LocalNumbers, stress_rounding: float = 0.0
    ) -> NodalBounds:
        """Return the present bounds at nodes (n,) of this rank; 0 without friction. Collective.

        A negative value counts as zero if it is rounding: at most `COEFFICIENT_ROUNDING` times the
        largest finite value (for a coefficient, or times 1), or, for a stress, `stress_rounding`.

        Raises:
            InputError: a value is negative by more than rounding, or NaN; a coefficient is
                infinite; only one of the two values of a bound is infinite; or `check` raises it.
        """
        terms = friction.terms
        bounds: dict[str, Array] = {}
        shape: Array = np.ones((len(nodes), 2))
        for term, scalars in _named_scalars(friction).items():
            columns = [self._bound(field, nodes, name, stress_rounding) for field, name in scalars]
            values = np.stack(columns, axis=1)
            bounds[term] = longer = values.max(axis=1)
            if len(scalars) == 2:  # an ellipse
                infinite = np.isinf(values)
                with errors_on_all_ranks(self._comm):
                    if (infinite[:, 0] != infinite[:, 1]).any():
                        raise InputError(
                            f"{TERMS[term]} must be finite in both directions, or infinite in "
                            "both, found infinity in one of them. Where surfaces hardly slide in "
                            "one direction give a bound that is larger there by a factor such as "
                            "100."
                        )
                # if both semi-axes are infinite, or zero, it is a circle
                is_ellipse = np.isfinite(longer) & (longer > 0.0)
                shape = np.ones_like(values)
                shape[is_ellipse] = values[is_ellipse] / longer[is_ellipse, None]
        direction = None
        if terms.direction is not None:
            direction = self.values.values_at(terms.direction, nodes, DIRECTION, 3)
        return NodalBounds(**bounds, shape=shape, direction=direction, curve=terms.curve)

    def check_curve(self, curve: Curve, pressure: Array, slip: Array) -> None:
        """Check a curve's values at pressures (n,) and slips (n,) of this rank. Collective.

        Without pressure any value is accepted: the bound at an open node does not contain it.
        """
        name = TERMS["coefficient"]
        with errors_on_all_ranks(self._comm), np.errstate(all="ignore"):
            values = curve.values(pressure, slip)
            curve.slopes(pressure, slip)
            wrong = ~(values >= -COEFFICIENT_ROUNDING) & (pressure > 0.0)
            wrong |= np.isinf(values) & (pressure > 0.0)
            if wrong.any():
                raise InputError(
                    f"{name} must be finite and not negative, found {values[wrong][0]:g} at the "
                    f"pressure {pressure[wrong][0]:g} and the slip {slip[wrong][0]:g}, and at "
                    f"{wrong.sum()} of the {len(values)} contact nodes of rank {self._comm.rank}."
                )

    def _bound(
        self, field: ScalarField, nodes: LocalNumbers, name: str, stress_rounding: float
    ) -> Array:
        """Return a term's values (n,) at nodes of this rank, if they are bounds. Collective.

        NaN, an infinite coefficient and negative values are errors. But negative values become zero
        if they are rounding, as `nodal_bounds` says.
        """
        is_coefficient = name.startswith(TERMS["coefficient"])
        values = self.values.values_at(field, nodes, name)[:, 0]
        largest = values[np.isfinite(values)].max(initial=0.0)
        relative = COEFFICIENT_ROUNDING * self._comm.allreduce(float(largest), op=MPI.MAX)
        least = -max(relative, COEFFICIENT_ROUNDING if is_coefficient else stress_rounding)
        with errors_on_all_ranks(self._comm):
            bad = ~(values >= least)
            if bad.any():
                fault = "NaN" if np.isnan(values[bad][0]) else "negative"
                raise InputError(
                    f"{name} must not be {fault}, found {values[bad][0]:g} "
                    f"at {bad.sum()} of the {len(nodes)} contact nodes of rank {self._comm.rank}."
                )
            if is_coefficient and np.isinf(values).any():
                raise InputError(f"{name} must be finite, found infinity.")
        return np.asarray(np.maximum(values, 0.0))
