"""The compliance of the nodes on contact surfaces, which later pairings of the surfaces share."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.matrices import dense_matrix
from dolfinx_tresca._base.parallel import gather_rows, reduce_array
from dolfinx_tresca.dual.products.operator import DualOperator

#: Largest number of unknowns of the surfaces. With 3,000 unknowns, the compliance takes 72 MB on
#: each rank.
LARGEST = 3000

#: Number of solves with K in one block.
BLOCK = 32


class SurfaceCompliance:
    """The part S of K^-1 that belongs to unknowns on contact surfaces: A = B S B' for any pairing.

    S does not depend on B. Where surfaces slide on each other, or bodies turn in their frames, only
    the unknowns that were on no former B need solves with K. S is symmetric, so these solves give
    the new rows as well as the new columns.
    """

    def __init__(self) -> None:
        self._numbers: npt.NDArray[np.int64] = np.empty(0, dtype=np.int64)  # global, of unknowns
        self._S: Array = np.empty((0, 0))

    def product_rows(self, operator: DualOperator) -> Array | None:
        """Return this rank's rows of A (size, size on all ranks); None if B is too large.

        Collective.

        Args:
            operator: A, with a direct solver for K. Each solve counts as a product.
        """
        jump = operator.jump
        pointers, indices, data = jump.matrix.getValuesCSR()
        own = np.unique(indices[data != 0.0]).astype(np.int64)
        numbers = np.unique(gather_rows(jump.comm, own))
        if len(np.union1d(numbers, self._numbers)) > LARGEST:
            self._numbers, self._S = self._numbers[:0], self._S[:0, :0]
            if len(numbers) > LARGEST:
                return None
        self._extend(operator, np.setdiff1d(numbers, self._numbers))
        order = np.argsort(self._numbers)
        columns = order[np.searchsorted(self._numbers, indices, sorter=order) % len(order)]
        shape = len(jump.gap), len(self._numbers)
        B = csr_array((data, columns, pointers), shape)
        rows: Array = (B @ self._S) @ csr_array(jump.reductions.stacked(B)).T
        return rows

    def _extend(self, operator: DualOperator, new: npt.NDArray[np.int64]) -> None:
        """Add unknowns with these global numbers to S. Collective."""
        prescribed, comm = operator.jump.system.prescribed, operator.jump.comm
        first, end = operator.jump.matrix.getOwnershipRangeColumn()
        count, numbers = len(self._numbers), np.append(self._numbers, new)
        S = np.zeros((len(numbers), len(numbers)))
        S[:count, :count] = self._S
        row = np.flatnonzero((numbers >= first) & (numbers < end))
        for start in range(count, len(numbers), BLOCK):
            columns = np.arange(start, min(start + BLOCK, len(numbers)))
            units = numbers[columns] == np.arange(first, end)[:, None]
            forces = dense_matrix((units & ~prescribed[:, None]).astype(np.float64), comm)
            displacements = forces.duplicate()
            operator.solver.solve_several(forces, displacements)
            u = np.where(prescribed[:, None], 0.0, displacements.getDenseArray())
            values = np.zeros((len(numbers), len(columns)))
            values[row] = u[numbers[row] - first]
            S[:, columns] = reduce_array(comm, values)
            for owned in (forces, displacements):
                owned.destroy()
        operator.products += len(new)
        S[count:, :count] = S[:count, count:].T
        self._numbers, self._S = numbers, S
