"""Global properties of a surface, independent of the partition."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, GlobalNumbers
from dolfinx_tresca._base.exchange import row_of_least
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.pairing.search.facets import Facets


@dataclass(frozen=True)
class WholeSurface:
    """Sizes and reference points of a whole surface, the same on all ranks.

    Attributes:
        smallest_facet: diameter of the smallest facet [length].
        largest_coordinate: largest absolute value of a corner's coordinates [length]; rounding
            errors of positions are relative to it.
        reference_points: (2, 3) points towards which tangents are turned; they are not nodes, and
            are moved, rotated, scaled and mirrored with the surface [length].
    """

    smallest_facet: float
    largest_coordinate: float
    reference_points: Array

    @classmethod
    def of(cls, comm: MPI.Comm, owned: Facets) -> WholeSurface:
        """Compute the properties from the facets that each rank owns. Collective."""
        size = np.linalg.norm(np.ptp(owned.points, axis=1), axis=1)
        corners = owned.points[:, : owned.corners].reshape(-1, 3)
        values = [-size.min(initial=np.inf), np.abs(corners).max(initial=0.0)]
        negative, largest = reduce_array(comm, values, MPI.MAX)
        return cls(
            float(-negative),
            float(largest),
            _reference_points(comm, corners, owned.file_numbers.ravel()),
        )


def _reference_points(comm: MPI.Comm, points: Array, order: GlobalNumbers) -> Array:
    """Return two points (2, 3) that are no nodes and move with the surface. Collective.

    Args:
        comm: communicator of the mesh.
        points: (n, 3) corners of this rank's facets [length].
        order: (n,) numbers of these corners in the mesh file.
    """
    first, last = (row_of_least(comm, sign * order, points) for sign in (1, -1))
    golden = 0.5 * (np.sqrt(5.0) - 1.0)
    # The first reference point is on the line through `first` and `last`. The second one must be
    # off this line: nodes on the line would see both points in the same direction.
    along = (last - first) / (np.linalg.norm(last - first) or 1.0)
    offset = points - first
    off = np.linalg.norm(offset - np.outer(offset @ along, along), axis=1)
    far = off >= golden**2 * reduce_array(comm, off.max(initial=0.0), MPI.MAX)
    beside = row_of_least(comm, order[far], points[far])
    return np.stack([first + golden * (last - first), beside + golden**3 * (last - beside)])
