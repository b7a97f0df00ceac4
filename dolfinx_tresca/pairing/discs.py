"""Scaling of tangential multipliers that turns friction ellipses into discs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.pairing.operators import PairOperators


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
    def of(cls, pair: PairOperators) -> FrictionDiscs:
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
