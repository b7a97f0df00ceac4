"""Nodes that several ranks share, with the same numbers on all of them."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca._base.exchange import exchange


class SharedNodes:
    """Nodes with keys: a node has the same key on all ranks that have the node.

    Each key determines one rank, its keeper. All ranks that have the node send their messages about
    it to the keeper.

    Attributes:
        numbers: (n,) numbers of this rank's nodes: 0, 1, ... over all ranks, in the order of their
            keys, for any partition.
    """

    def __init__(self, comm: MPI.Comm, keys: npt.NDArray[np.int64], limit: int) -> None:
        """Number the nodes. Collective.

        Args:
            comm: communicator of the ranks.
            keys: (n,) keys of this rank's nodes, ascending, without repetition.
            limit: a number larger than all keys.
        """
        self._comm = comm
        # ascending like the keys, so that answers come back in the order of the questions
        self._keepers = (keys // (limit // comm.size + 1)).astype(np.intp)
        asked, self._askers = exchange(comm, keys, self._keepers)
        kept, self._position = np.unique(asked, return_inverse=True)
        self._count = len(kept)
        first = sum(comm.allgather(self._count)[: comm.rank])
        self.numbers, _ = exchange(comm, (first + self._position).astype(np.int64), self._askers)

    def kept(self, rows: Array) -> Array:
        """Return the rows (m, k) of the nodes whose keeper is this rank, by ascending number.

        Collective.

        Args:
            rows: (n, k) rows of this rank's nodes, the same on all ranks that have them.
        """
        told, _ = exchange(self._comm, rows, self._keepers)
        result = np.zeros((self._count, rows.shape[1]))
        result[self._position] = told
        return result

    def known_values(self, rows: Array, known: Mask) -> tuple[Array, Mask]:
        """Return values at this rank's nodes, taken from any rank that knows them. Collective.

        Args:
            rows: (n, k) rows of this rank's nodes; known rows are the same on all ranks.
            known: (n,) whether this rank knows each row.

        Returns:
            The rows (n, k), unchanged where no rank knows them; and whether a rank knows each row,
            (n,).
        """
        told, _ = exchange(self._comm, np.column_stack([rows, known]), self._keepers)
        result = np.zeros((self._count, rows.shape[1] + 1))
        some = told[:, -1] > 0.0
        result[self._position[some]] = told[some]
        answers, _ = exchange(self._comm, result[self._position], self._askers)
        return np.where(answers[:, -1:] > 0.0, answers[:, :-1], rows), answers[:, -1] > 0.0
