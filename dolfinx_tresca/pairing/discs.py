"""Ellipses of friction as discs: factors of tangential multipliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.pairing.operators import PairOperators


@dataclass(frozen=True)
class FrictionDiscs:
    """Unknowns in which the ellipse of each node of a pair is a disc (docs/theory/coulomb.md).

    With the semi-axes b_1 and b_2 these are t_i / stretch_i, where stretch_i^2 is b_i over the
    other one; the disc has the radius sqrt(b_1 b_2). Where one of two semi-axes is zero the other
    one alone is the disc of the node.

    Attributes:
        stretch: (n_tangential,) traction over unknown.
        radius: (n,) of the disc, over the longer semi-axis.
        frictionless: (n_tangential,) rows of zero traction beside one that may carry some.
    """

    stretch: Array
    radius: Array
    frictionless: Mask

    @classmethod
    def of(cls, pair: PairOperators) -> FrictionDiscs:
        """Return those of a pair. Not collective."""
        node, semi_axes, count = pair.tangent_node, pair.semi_axes, len(pair.nodes)
        rubs = semi_axes > 0.0
        number = np.bincount(node[rubs], minlength=count)
        logarithms = np.bincount(node[rubs], np.log(semi_axes[rubs]), minlength=count)
        radius = np.exp(logarithms / np.maximum(number, 1))
        radius[node[number[node] == 0]] = 0.0
        stretch = np.ones_like(semi_axes)
        np.divide(semi_axes, radius[node], out=stretch, where=rubs)
        return cls(stretch, radius, ~rubs & (number[node] > 0))
