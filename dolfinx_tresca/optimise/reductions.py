"""What algorithms on distributed vectors need to know of other ranks."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from dolfinx_tresca._base.arrays import Array


class Reductions(Protocol):
    """Sums and agreements over all ranks. All methods are collective."""

    def inner(self, x: Array, y: Array) -> Array:
        """Return x'y over all ranks; x and y of shape (size,) or (size, k)."""
        ...

    def agreed(self, x: Array) -> Array:
        """Return the first rank's x, which others have but for rounding."""
        ...

    def least(self, value: float) -> float:
        """Return the least value of all ranks."""
        ...


def norm(reductions: Reductions, v: Array) -> float:
    """Return the Euclidean norm of v (size,) over all ranks. Collective."""
    return float(np.sqrt(reductions.inner(v, v)))
