"""Forecast of the size and the error of the next mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence

from dolfinx_tresca.adapt.levels import Level

#: Approximate number of cells that a refinement adds for each marked cell, by dimension; most of
#: the added cells avoid hanging nodes. Measured with marked cells that have half of the squared
#: error: on Hertz's line contact 4.4 to 6.2, on the two bricks 2.6 to 4.8.
ADDED = {2: 5.0, 3: 4.0}

#: Assumed power of 1/n, for n unknowns, with which the error falls from the first mesh to the
#: second: the rate of degree 1 with singular edges.
FIRST_RATE = 1.0 / 3.0

#: Logarithm above which a growth counts as infinite: no mesh is that large.
MOST_LOGARITHM = 100.0


class Forecast:
    """Predicts the size of a refined mesh, from the growth in earlier refinements.

    A growth is a factor: a number of cells or unknowns divided by the number before.

    Attributes:
        cut: growth of the number of cells in the last cut; 1 before the first cut.
    """

    def __init__(self, dim: int) -> None:
        """Begin with the usual growth of meshes of dimension `dim`."""
        self._added, self._most = ADDED[dim], 2.0**dim
        self.cut = 1.0

    def growth(self, marked: float) -> float:
        """Predict the growth of the number of cells, at most the growth of uniform refinement.

        Args:
            marked: part of the cells that is marked.
        """
        return min(1.0 + self._added * marked, self._most)

    def learn(self, marked: float, growth: float) -> None:
        """Store the growth of the number of cells in a refinement.

        Args:
            marked: part of the cells that were marked.
            growth: number of cells after the refinement, divided by the number before.
        """
        self._added, self.cut = (growth - 1.0) / marked, growth

    @staticmethod
    def error(levels: Sequence[Level], free_dofs: int) -> float:
        """Predict the relative error of a mesh from earlier meshes; infinite if there are none.

        Args:
            levels: the earlier meshes.
            free_dofs: number of unknowns of the mesh.
        """
        if not levels:
            return math.inf
        last = levels[-1]
        return last.error * math.pow(last.free_dofs / free_dofs, _rate(levels))

    @staticmethod
    def growth_to(levels: Sequence[Level], error: float) -> float:
        """Return the growth of the number of unknowns that leads to a relative error.

        The growth is infinite if the error has hardly fallen so far.

        Args:
            levels: the earlier meshes.
            error: the relative error.
        """
        logarithm = math.log(levels[-1].error / error) / _rate(levels)
        return math.exp(logarithm) if logarithm < MOST_LOGARITHM else math.inf


def _rate(levels: Sequence[Level]) -> float:
    """Return the power of 1/n, for n unknowns, with which the error has fallen."""
    if len(levels) > 1:
        last, before = levels[-1], levels[-2]
        if before.error > last.error > 0.0 and last.free_dofs > before.free_dofs:
            return math.log(before.error / last.error) / math.log(last.free_dofs / before.free_dofs)
    return FIRST_RATE
