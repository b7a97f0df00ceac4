"""The user's scalar fields at contact nodes, and derivatives with respect to their values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import ROUNDING, Array, Indices, LocalNumbers, Mask
from dolfinx_tresca.derivatives.solved_step import SolvedStep
from dolfinx_tresca.dual.slip_bounds import TERMS, NodalBounds
from dolfinx_tresca.pairing.friction_axes import NodalEllipses
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.scene.friction import BoundTerms, DryFriction
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solvers.friction_cones import FrictionCones, pressed_values


@dataclass(frozen=True)
class NodalField:
    """A user's scalar field, such as a gap, at the nodes of a pair, and its effect on solutions.

    Attributes:
        field: the scalar as the user gave it.
        nodes: (n,) local numbers of the nodes.
        name: name of the scalar in errors.
        offset: (size, n) derivatives of the offsets (gaps d; slip origins s), divided by
            `JumpOperator.length_scale`, with respect to the nodal values.
        radius: (n_discs, n) derivatives of the radii of the discs with respect to the nodal values.
    """

    field: Any
    nodes: LocalNumbers
    name: str
    offset: csr_array
    radius: csr_array

    def weights(self, y: Array, radial: Array) -> Array:
        """Return the derivatives (n,) of a goal with respect to the nodal values of the scalar.

        Args:
            y: (size,) derivatives of the goal with respect to the offsets.
            radial: (n_discs,) derivatives of the goal with respect to the radii of the discs.
        """
        return np.asarray(self.offset.T @ y + self.radius.T @ radial)


def nodal_fields(step: SolvedStep, pairs: Sequence[ContactPair]) -> list[NodalField]:
    """Return the scalars on which solutions depend: gaps and terms of slip bounds. Collective."""
    jump, x = step.dual.jump, step.multipliers
    discs = step.state.face.discs
    cones = step.dual.admissible.at(x, step.gradient)
    curves = iter(cones.curve_arguments(x) if isinstance(cones, FrictionCones) else ())
    is_limited = cones.exceed_limit(x) if isinstance(cones, FrictionCones) else False
    shape, by_value = (discs.size, len(discs.radius)), _radii_by_terms(step, is_limited)
    result: list[NodalField] = []
    first = 0
    for pair, on_nodes, bounds, (normal, tangential) in zip(
        pairs, jump.pairs, step.bounds, jump.slices, strict=True
    ):
        nodes, n = on_nodes.nodes, len(on_nodes.nodes)
        own = slice(first, first + n)
        first += n

        def offsets(rows: Any, columns: Any, values: Any, n: int = n) -> csr_array:
            return csr_array((values, (rows, columns)), shape=(shape[0], n))

        def radii(values: Array, n: int = n, own: slice = own) -> csr_array:
            rows = np.arange(own.start, own.stop)
            return csr_array((values, (rows, np.arange(n))), shape=(shape[1], n))

        of_gap = 1.0 / jump.length_scale[normal]
        by_gap = offsets(np.arange(normal.start, normal.stop), on_nodes.normal_node, of_gap)
        gap = f"the gap of contact pair {pair}"
        result.append(NodalField(pair.gap, nodes, gap, by_gap, radii(np.zeros(n))))
        terms = pair.friction.terms if isinstance(pair.friction, DryFriction) else BoundTerms()
        for name, words in TERMS.items():
            field, by_bound, words = getattr(terms, name), by_value[name][own], f"{words} of {pair}"
            if name == "coefficient" and terms.curve is not None:
                field = partial(pressed_values, *next(curves))
            if not isinstance(field, tuple) or bounds.ellipses is None:
                result.append(NodalField(field, nodes, words, offsets([], [], []), radii(by_bound)))
                continue
            ellipses = _Ellipses.of(on_nodes, bounds.ellipses)
            rows = tangential.start + ellipses.rows
            stretched = ellipses.turned(x[rows])
            r_less_Cx = step.gradient[rows] - step.state.curvature[rows] * x[rows]
            outwards = np.einsum("na,na->n", step.state.face.radial[rows], stretched)
            largest = np.argmax(bounds.ellipses.shape, axis=1)
            for k, part in enumerate(field):
                value = bounds.ellipses.shape[:, k] * getattr(bounds, name)
                known = np.isfinite(value) & (value > 0.0)
                inverse = np.zeros(n)
                np.divide(1.0, value, out=inverse, where=known)
                is_largest = largest == k
                grows = inverse * np.where(known, discs.radius[own], 0.0)
                grows *= ellipses.shares[:, k] - is_largest
                grows += np.where(is_largest, by_bound, 0.0)
                half = (0.5 if k == 0 else -0.5) * inverse[ellipses.node]
                grows[ellipses.node] += half * outwards
                turned = half[:, None] * ellipses.turned(r_less_Cx)
                columns = np.repeat(ellipses.node, 2)
                by_part = offsets(rows.ravel(), columns, turned.ravel())
                result.append(NodalField(part, nodes, words, by_part, radii(grows)))
    return result


def _radii_by_terms(step: SolvedStep, is_limited: Mask | bool) -> dict[str, Array]:
    """Return derivatives of the discs' radii by each term of the slip bound c + min(F p, l).

    The derivatives by one term are an array (n_discs,). Collective.

    Args:
        step: the solution.
        is_limited: (n_discs,) whether F p exceeds its limit l.
    """
    dual, x = step.dual, step.multipliers

    def radii(constant: float, coefficient: float) -> Array:
        """Return the radii (n_discs,) for a bound c + F p that is the same at all nodes."""
        ones = [np.ones(len(one.nodes)) for one in dual.jump.pairs]
        given = [NodalBounds(constant * one, coefficient * one, np.inf * one) for one in ones]
        return np.asarray(dual.jump.bounded(given).section(x).radius)

    by_constant, by_coefficient = radii(1.0, 0.0), radii(0.0, 1.0)
    return {
        "constant": by_constant,
        "coefficient": np.where(is_limited, 0.0, by_coefficient),
        "limit": np.where(is_limited, by_constant, 0.0),
    }


@dataclass(frozen=True)
class _Ellipses:
    """Derivatives of friction discs and tangential rows by the semi-axes of friction ellipses.

    Tangential rows are stretched so that the ellipse of a node becomes a disc. A change of the
    semi-axes b_1, b_2 stretches the multipliers of a node with two tangential rows by 1 + S, with
    S = (a a' - e e') (db_1/b_1 - db_2/b_2) / 2 for the unit vectors a and e along the axes.

    Attributes:
        rows: (m, 2) tangential rows of each node with two tangential rows.
        node: (m,) index of each node with two tangential rows among the nodes of the pair.
        along: (m, 2) components of a along the tangents of the rows.
        shares: (n, 2) derivatives of log(radius) of the discs with respect to log(b_1), log(b_2).
    """

    rows: Indices
    node: Indices
    along: Array
    shares: Array

    @classmethod
    def of(cls, pair: PairOperators, ellipses: NodalEllipses) -> _Ellipses:
        """Return the derivatives at the nodes of a pair. Not collective."""
        node, d = pair.tangent_node, pair.normals.shape[1]
        direction = ellipses.direction[:, :d]
        inward = np.einsum("ni,ni->n", direction, pair.normals)
        axis = direction - inward[:, None] * pair.normals
        length = np.linalg.norm(axis, axis=1)
        axis /= np.where(length > 0.0, length, 1.0)[:, None]
        parts = np.einsum("ri,ri->r", pair.tangents, axis[node])
        second = np.flatnonzero(node[1:] == node[:-1]) + 1
        has_two = np.zeros(len(pair.nodes), dtype=np.bool_)
        has_two[node[second]] = True
        positive = ellipses.shape > ROUNDING
        shares = positive / np.maximum(positive.sum(axis=1, keepdims=True), 1)
        for row in np.flatnonzero(~has_two[node]):
            # the semi-diameter b has 1/b^2 = (cos/b_1)^2 + (sin/b_2)^2
            squares = np.array([parts[row] ** 2, max(1.0 - parts[row] ** 2, 0.0)])
            b = ellipses.shape[node[row]]
            squares = np.where(squares > ROUNDING, squares, 0.0)
            each = np.divide(squares, b**2, out=np.zeros(2), where=b > ROUNDING)
            shares[node[row]] = each / each.sum() if each.any() else 0.0
        both = positive[node[second]].all(axis=1)
        second = second[both]
        rows = np.stack([second - 1, second], axis=1)
        return cls(rows, node[second].astype(np.intp), parts[rows], shares)

    def turned(self, v: Array) -> Array:
        """Return (a a' - e e') v for (m, 2) components along the tangents."""
        across = np.stack([-self.along[:, 1], self.along[:, 0]], axis=1)
        parts = (np.einsum("na,na->n", one, v)[:, None] * one for one in (self.along, across))
        first, second = parts
        return np.asarray(first - second)
