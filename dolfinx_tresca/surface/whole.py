"""What a surface is as a whole, whichever ranks have its facets."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, GlobalNumbers
from dolfinx_tresca._base.exchange import row_of_least
from dolfinx_tresca.surface.facets import Facets


@dataclass(frozen=True)
class WholeSurface:
    """Sizes and points of reference of a surface, the same on all ranks.

    Attributes:
        finest: the diameter of its smallest facet [length].
        extent: the largest coordinate of its nodes [length]: rounding is a part of that.
        frame: (2, 3) points off the nodes that follow the surface when it is moved, turned, scaled
            or mirrored.
    """

    finest: float
    extent: float
    frame: Array

    @classmethod
    def of(cls, comm: MPI.Comm, owned: Facets) -> WholeSurface:
        """Return them from the facets that each rank owns. Collective."""
        size = np.linalg.norm(np.ptp(owned.points, axis=1), axis=1)
        corners = owned.points[:, : owned.corners].reshape(-1, 3)
        return cls(
            comm.allreduce(size.min(initial=np.inf), op=MPI.MIN),
            comm.allreduce(np.abs(corners).max(initial=0.0), op=MPI.MAX),
            _frame(comm, corners, owned.file_numbers.ravel()),
        )


def _frame(comm: MPI.Comm, points: Array, order: GlobalNumbers) -> Array:
    """Return two points off the nodes; which ones depends on the order in the mesh file only."""
    first, last = (row_of_least(comm, sign * order, points) for sign in (1, -1))
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    # the second point must not lie on a line with the first: nodes there would see no side of it
    along = (last - first) / (np.linalg.norm(last - first) or 1.0)
    offset = points - first
    off = np.linalg.norm(offset - np.outer(offset @ along, along), axis=1)
    far = off >= golden**2 * comm.allreduce(off.max(initial=0.0), op=MPI.MAX)
    beside = row_of_least(comm, order[far], points[far])
    return np.stack([first + golden * (last - first), beside + golden**3 * (last - beside)])
