"""Exchange of array rows between ranks, through MPI buffers."""

from __future__ import annotations

import logging
from math import prod
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

import dolfinx.la

from dolfinx_tresca._base.arrays import Array, Indices

_logger = logging.getLogger("dolfinx_tresca.exchange")


def exchange(
    comm: MPI.Comm, rows: npt.NDArray[Any], ranks: Indices
) -> tuple[npt.NDArray[Any], Indices]:
    """Send each row to a rank and return the rows received from all ranks. Collective.

    Each rank logs, at level DEBUG, how many bytes it sends to how many ranks.

    Args:
        comm: the communicator.
        rows: (n, ...) rows of any data type, records included; the type is equal on all ranks.
        ranks: (n,) the rank to which each row goes.

    Returns:
        The received rows (m, ...), in the order of the sending ranks and of each sender's rows, and
        the rank (m,) from which each row comes.
    """
    if comm.size == 1:
        return rows, np.asarray(ranks, dtype=np.intp)
    sent = np.ascontiguousarray(rows[np.argsort(ranks, kind="stable")])
    counts = np.bincount(ranks, minlength=comm.size).astype(np.intc)
    incoming = np.empty_like(counts)
    comm.Alltoall(counts, incoming)
    received = np.empty((int(incoming.sum()), *rows.shape[1:]), dtype=rows.dtype)
    _logger.debug("%d bytes to %d ranks", sent.nbytes, np.count_nonzero(counts))
    row = MPI.BYTE.Create_contiguous(rows.dtype.itemsize * prod(rows.shape[1:])).Commit()
    comm.Alltoallv(
        [_bytes(sent), counts, row],
        [_bytes(received), incoming, row],
    )
    row.Free()
    return received, np.repeat(np.arange(comm.size), incoming)


def summed_at_nodes(index_map: Any, nodes: Indices, values: Array) -> Array:
    """Return sums (nodes, k) of values (..., k) at nodes (...) of all ranks. Collective.

    Args:
        index_map: the nodes of this rank, ghosts included.
        nodes: (...) local numbers of nodes, each any number of times.
        values: (..., k) values at the nodes.
    """
    vector = dolfinx.la.vector(index_map, values.shape[-1])
    vector.array[:] = 0.0
    np.add.at(vector.array.reshape(-1, values.shape[-1]), nodes, values)
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    vector.scatter_forward()
    return np.array(vector.array).reshape(-1, values.shape[-1])


def row_of_least(comm: MPI.Comm, keys: npt.NDArray[Any], rows: npt.NDArray[Any]) -> Any:
    """Return the row (k,) with the least key among the rows of all ranks. Collective.

    The result is None if no rank has a row.

    Args:
        comm: the communicator.
        keys: (n,) the key of each row.
        rows: (n, k) the rows of this rank.
    """
    mine = (keys.min(), rows[keys.argmin()]) if len(keys) else None
    candidates = [candidate for candidate in comm.allgather(mine) if candidate is not None]
    return min(candidates, key=lambda candidate: candidate[0])[1] if candidates else None


def _bytes(rows: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    return rows.reshape(-1).view(np.uint8)
