"""The displacement at which surfaces were paired."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem


class Sliding:
    """The displacement at which surfaces were last paired.

    Attributes:
        origin: displacement at which the surfaces were paired [length].
    """

    def __init__(self, V: Any) -> None:
        self.origin = fem.Function(V)

    def begin(self, u: fem.Function) -> None:
        """Note the displacement at which surfaces are paired again. Not collective."""
        self.origin = u.copy()

    @property
    def moved_by(self) -> fem.Function | None:
        """The displacement at which surfaces were paired; None if it is zero. Collective."""
        return None if self.began_at(fem.Function(self.origin.function_space)) else self.origin

    def began_at(self, u: fem.Function) -> bool:
        """Return whether surfaces were paired at a displacement. Collective."""
        same = np.array_equal(self.origin.x.array, u.x.array)
        return bool(self.origin.function_space.mesh.comm.allreduce(same, op=MPI.LAND))
