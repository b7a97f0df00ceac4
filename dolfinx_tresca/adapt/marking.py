"""Which cells to refine."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.parallel import reduce_array

#: Relative difference of squared errors that counts as rounding: cells whose errors differ less are
#: marked together, so that the mesh of a symmetric scene stays symmetric, and is the same on any
#: number of ranks.
TIE = 1e-9


def largest_part(comm: MPI.Comm, squares: Array, fraction: float) -> Mask:
    """Mark the fewest cells whose squared errors sum up to a given part of the total. Collective.

    This is the marking of Doerfler (1996, A convergent adaptive algorithm for Poisson's equation),
    except that all cells whose errors equal the least marked error are marked, too.

    Args:
        comm: communicator of the ranks.
        squares: (n,) squared errors of this rank's cells, none negative; not all zero.
        fraction: part of the sum over all ranks, in (0, 1].

    Returns:
        (n,) whether each of this rank's cells is marked.
    """
    ascending = np.sort(squares)
    from_here = np.append(np.cumsum(ascending[::-1])[::-1], 0.0)

    def beyond(least: float) -> float:
        """Return the sum of the squared errors that are at least `least`. Collective."""
        return float(reduce_array(comm, from_here[np.searchsorted(ascending, least)]))

    high = float(comm.allreduce(squares.max(initial=0.0), op=MPI.MAX)) * (1.0 + TIE)
    least = squares[squares > 0.0].min(initial=high)
    low = float(comm.allreduce(least, op=MPI.MIN)) * (1.0 - TIE)
    wanted = fraction * beyond(low) * (1.0 - TIE)
    while high > low * (1.0 + TIE):
        middle = np.sqrt(low) * np.sqrt(high)
        low, high = (middle, high) if beyond(middle) >= wanted else (low, middle)
    return np.asarray(squares >= low * (1.0 - TIE))
