"""What the next mesh will be like, before it is there."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dolfinx_tresca.adapt.levels import Level

#: By dimension: the cells that a refinement adds over those that cutting all edges of the marked
#: ones adds, about; the others leave no hanging nodes. Measured on the two bricks and on Hertz's
#: line contact with half of the squared error marked: 3.0 to 4.9 and 1.5 to 2.1.
CLOSURE = {2: 1.7, 3: 3.5}

#: Power of 1/n with which the error falls from the first mesh to the second: one that singular
#: edges leave to degree 1.
FIRST_RATE = 1.0 / 3.0


class Forecast:
    """Learns from each mesh what the next one will be like."""

    def __init__(self, dim: int) -> None:
        """Begin with what is usual in a dimension."""
        self._closure, self._children = CLOSURE[dim], 2.0**dim

    def growth(self, marked: float) -> float:
        """Return the cells of a refined mesh over those before it; not more than a uniform one has.

        Args:
            marked: part of the cells that is marked.
        """
        added = self._closure * (self._children - 1) * marked
        return min(1.0 + added, self._children)

    def learn(self, marked: float, growth: float) -> None:
        """Take note of what a refinement with a part of the cells marked has made."""
        self._closure = (growth - 1.0) / ((self._children - 1) * marked)

    @staticmethod
    def error(levels: Sequence[Level], unknowns: int) -> float:
        """Return the relative error of a mesh if it falls as on the meshes before; inf without any.

        Args:
            levels: before it.
            unknowns: that it has.
        """
        if not levels:
            return math.inf
        last, rate = levels[-1], FIRST_RATE
        if len(levels) > 1 and levels[-2].error > last.error > 0.0:
            ratio = last.unknowns / levels[-2].unknowns
            rate = math.log(levels[-2].error / last.error) / math.log(ratio)
        return last.error * math.pow(last.unknowns / unknowns, rate)
