"""Orthotropic friction: tangents along the axes of friction ellipses, and discs for ellipses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import ROUNDING, Array, Mask, cross
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.operators import PairOperators

#: A direction counts as normal to the surface if the sine of its angle to the normal is at most
#: this.
LEAST_SINE = 1e-6


@dataclass(frozen=True)
class NodalEllipses:
    """The shapes of the friction ellipses at the nodes of a pair on this rank.

    Attributes:
        direction: (n, 3) vectors of any length, whose tangential parts are the first axes.
        shape: (n, 2) semi-axes along the first axis and across it, relative to the longer one.
    """

    direction: Array
    shape: Array


def with_tangents_along_axes(V: Any, pair: PairOperators, ellipses: NodalEllipses) -> PairOperators:
    """Return operators whose tangents are the axes of the friction ellipses. Collective.

    Along its axes an ellipse can be scaled to a disc (`FrictionDiscs`).

    A node with a single tangential direction keeps this direction, and its slip bound is the
    semi-diameter of the ellipse along this direction. A node whose ellipse is a circle keeps its
    tangents. If neither tangents nor semi-axes change on this rank, up to rounding, the result is
    `pair` itself.

    Args:
        V: the space of the displacement.
        pair: the operators of the pair.
        ellipses: the friction ellipses.

    Raises:
        InputError: a direction is not finite, is zero, or is normal to the surface.
    """
    shape = np.where(ellipses.shape > ROUNDING, ellipses.shape, 0.0)
    circular = shape[:, 0] == shape[:, 1]
    axes = _axes(V, pair, np.where(circular[:, None], 0.0, ellipses.direction), circular)
    node = pair.tangent_node
    second = np.flatnonzero(node[1:] == node[:-1]) + 1
    second = second[~circular[node[second]]]
    rows = np.stack([second - 1, second], axis=1)
    tangents = pair.tangents.copy()
    tangents[rows] = axes[node[second]]
    semi_axes = _semi_diameters(np.einsum("rai,ri->ra", axes[node], tangents), shape[node])
    change = max(
        np.abs(tangents - pair.tangents).max(initial=0.0),
        np.abs(semi_axes - pair.semi_axes).max(initial=0.0),
    )
    if change <= ROUNDING:  # the vectors and semi-axes are of order 1
        return pair
    return replace(pair, tangents=tangents, semi_axes=semi_axes)


def _axes(V: Any, pair: PairOperators, direction: Array, circular: Mask) -> Array:
    """Return the axes (n, 2, 3) of the ellipse of each node; zero for circles. Collective.

    Raises:
        InputError: a direction is not finite, is zero, or is normal to the surface.
    """
    axis = direction - np.einsum("ni,ni->n", direction, pair.normals)[:, None] * pair.normals
    length, whole = np.linalg.norm(axis, axis=1), np.linalg.norm(direction, axis=1)
    has_tangents = np.zeros(len(length), dtype=np.bool_)
    has_tangents[pair.tangent_node] = True
    with errors_on_all_ranks(V.mesh.comm):
        bad = np.flatnonzero(has_tangents & ~circular & ~(length > LEAST_SINE * whole))
        if len(bad):
            worst, node = direction[bad[0]], pair.nodes[bad[0]]
            fault = "is normal to the surface" if worst.any() else "is zero"
            fault = fault if np.isfinite(worst).all() else "is not finite"
            raise InputError(
                f"the direction of the slip bound {fault}: found {_vector_text(worst)} at "
                f"{_vector_text(V.tabulate_dof_coordinates()[node])}, with the normal "
                f"{_vector_text(pair.normals[bad[0]])}, and so at {len(bad)} of the "
                f"{len(pair.nodes)} contact nodes of rank {V.mesh.comm.rank}. Give a direction "
                "that varies, or two equal bounds where it has no meaning."
            )
    length[length == 0.0] = 1.0
    axis /= length[:, None]
    return np.stack([axis, cross(pair.normals, axis)], axis=1)


def _vector_text(vector: Array) -> str:
    """Return the text of a vector; components that are rounding are shown as zero."""
    rounding = np.abs(vector) <= ROUNDING * np.abs(vector).max()
    return f"({', '.join(f'{component:.4g}' for component in np.where(rounding, 0.0, vector))})"


def _semi_diameters(direction: Array, shape: Array) -> Array:
    """Return the semi-diameters (n,) of ellipses in given directions.

    Args:
        direction: (n, 2) components of unit vectors along the axes of the ellipses.
        shape: (n, 2) semi-axes, relative to the longer semi-axis.
    """
    nonzero = np.abs(direction) > ROUNDING
    inverse = np.zeros_like(shape)
    np.divide(direction, shape, out=inverse, where=nonzero & (shape > 0.0))
    length = np.linalg.norm(inverse, axis=1)
    length[(nonzero & (shape == 0.0)).any(axis=1)] = np.inf
    # at circles, which have no axes, `direction` may be zero
    length[shape[:, 0] == shape[:, 1]] = 1.0
    result: Array = 1.0 / length
    return result


@dataclass(frozen=True)
class FrictionDiscs:
    """Scaled tangential unknowns, in which each node's ellipse is a disc (docs/theory/coulomb.md).

    The projection onto a disc is explicit, but the projection onto an ellipse is not.

    For components t_i of the traction along semi-axes b_1 and b_2 the unknowns are t_i / stretch_i
    with stretch_1^2 = b_1 / b_2 and stretch_2^2 = b_2 / b_1, and the disc has the radius
    sqrt(b_1 b_2). If one semi-axis is zero, the disc of the node is an interval, from minus to plus
    the other semi-axis.

    Attributes:
        stretch: (n_tangential,) ratio of traction to unknown [1].
        radius: (n,) radius of the disc, relative to the longer semi-axis [1].
        frictionless: (n_tangential,) whether a row has a zero bound, while the other row of its
            node has a positive bound.
    """

    stretch: Array
    radius: Array
    frictionless: Mask

    @classmethod
    def from_pair(cls, pair: PairOperators) -> FrictionDiscs:
        """Return the scaling for the semi-axes of a pair. Not collective."""
        node, semi_axes, count = pair.tangent_node, pair.semi_axes, len(pair.nodes)
        positive = semi_axes > 0.0
        number = np.bincount(node[positive], minlength=count)
        logarithms = np.bincount(node[positive], np.log(semi_axes[positive]), minlength=count)
        radius = np.exp(logarithms / np.maximum(number, 1))
        radius[node[number[node] == 0]] = 0.0
        stretch = np.ones_like(semi_axes)
        np.divide(semi_axes, radius[node], out=stretch, where=positive)
        return cls(stretch, radius, ~positive & (number[node] > 0))
