"""The model of A for assemblies of many small bodies: A as a sparse matrix, and a small shift."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from scipy.sparse import block_array, csr_array, eye_array
from scipy.sparse.linalg import eigsh

from dolfinx_tresca._base.arrays import Array, Indices, Matrix
from dolfinx_tresca.optimise.models.model import LEAST_SOFTNESS, Model, NodalMaps
from dolfinx_tresca.optimise.reductions import Reductions

#: Number that the model adds to the diagonal of A, divided by the mean of the diagonal. A wall of
#: 52 bricks pushed in 17 accepted steps of 0.025 takes 53 iterations with 1e-2, 34 with 1e-3 and
#: 1e-4, 18 with 1e-5; with 1e-10, Newton's method on the model fails.
SHIFT = 1e-4

#: Least softness of the equality constraints in Newton steps with softened constraints, times
#: the compliance of the multipliers. With 1e-10, a wall of 1,104 bricks is not solved.
PROXIMAL = 1e-4


class SparseModel(Model):
    """The model M = A + s I of A, sparse since A couples only multipliers of the same body.

    A is singular if rows of B are linearly dependent, as at corners of bricks that touch two other
    bricks; the shift s makes M positive definite. Since gradients are computed with A, the
    iteration with M is a proximal point method (Rockafellar 1976): its solution is the solution for
    A, and the error falls by the factor s / (s + sigma) in each iteration, where sigma is the least
    positive eigenvalue of A.

    A sparse direct solver replaces Woodbury's formula of `BlockBFGSModel`. The matrix of the direct
    solver neglects that slip bounds may depend on the slip; for such bounds, Newton's method
    converges linearly. Every rank has the whole matrix.

    Attributes:
        diagonal: (size,) diag(A).
    """

    def __init__(
        self,
        reductions: Reductions,
        rows: csr_array,
        first: int,
        nodes: Indices,
        solve: Callable[[csr_array, Array], Array],
    ) -> None:
        """Prepare products. Collective.

        Args:
            reductions: sums over the ranks.
            rows: (size, n) this rank's rows of A, with columns for the multipliers of all ranks.
            first: position of this rank's first row in A.
            nodes: (size,) the node of each of this rank's multipliers.
            solve: function that solves a system of equations with a sparse matrix that is not
                symmetric; every rank calls it.
        """
        self._reductions, self._rows, self._solve = reductions, rows, solve
        size, n = rows.shape
        self._mine = slice(first, first + size)
        identity = csr_array(eye_array(size))
        self.diagonal: Array = rows[:, self._mine].diagonal()
        self._unit = float(reductions.inner(self.diagonal, np.ones(size))) / max(n, 1)
        self._same_node, place = _groups(nodes)
        self._units = np.zeros((size, int(place.max(initial=0)) + 1))
        self._units[np.arange(size), place] = 1.0
        row = np.repeat(np.arange(size), np.diff(self._same_node.indptr))
        self._values_at = row, place[self._same_node.indices]
        self._shifted = csr_array(rows + SHIFT * self._unit * self._in_own_columns(identity))

    @property
    def number(self) -> int:
        """The number of multipliers of all ranks."""
        return int(self._rows.shape[1])

    @property
    def proximal_softness(self) -> float:
        """Softness to add to the constraints after a Newton step that failed, see `PROXIMAL`."""
        return float(PROXIMAL / self._unit)

    @property
    def size(self) -> Array:
        """diag(A), (size,): diag(M) without the small shift."""
        return self.diagonal

    def product(self, x: Array) -> Array:
        """Return A x for x of shape (size,) or (size, columns). Collective."""
        result: Array = self._rows @ self._gathered(x)
        return result

    def apply(self, x: Array) -> Array:
        """Return M x for x of shape (size,) or (size, columns). Collective."""
        result: Array = self._shifted @ self._gathered(x)
        return result

    @cached_property
    def largest_eigenvalue(self) -> float:
        """The largest eigenvalue of A. The first call is collective."""
        matrix = self._reductions.stacked(self._rows)
        if matrix.shape[0] <= 2:
            values = np.linalg.eigvalsh(matrix.toarray())[-1:]
        else:
            start = np.ones(matrix.shape[0])
            values = eigsh(matrix, 1, which="LA", v0=start, return_eigenvectors=False, tol=1e-3)
        return float(self._reductions.from_first_rank(values)[0])

    def solve_between(
        self, maps: NodalMaps, right: Array, G: Matrix, softness: Matrix, missing: Array
    ) -> tuple[Array, Array]:
        """Return V s and c, the solution of the equations in `Model.solve_between`. Collective.

        `LEAST_SOFTNESS`, divided by the mean of diag(A), is added to the diagonal of S, so that the
        equations have a solution even if the constraints have none.
        """
        unit, k = self._unit, len(missing)
        test, trial, stiffness, fixed = (
            self._matrix(one)
            for one in (maps.test, maps.trial, maps.stiffness, lambda x: x - maps.projector(x))
        )
        trial, G = self._in_own_columns(trial), csr_array(G)
        A = (1.0 / unit) * (self._shifted + self._in_own_columns(stiffness))
        rows = test @ (A @ self._reductions.stacked(trial)) + self._in_own_columns(fixed)
        equations = self._reductions.sparse_inner(G, trial)
        soft = csr_array(unit * softness) + LEAST_SOFTNESS * eye_array(k)
        matrix = self._reductions.stacked(rows)
        if k:
            columns = self._reductions.stacked(test @ G)
            matrix = csr_array(block_array([[matrix, -columns], [equations, soft]]))
        wanted = np.append(1.0 / unit * self._gathered(maps.test(right)), missing)
        found = self._reductions.from_first_rank(self._solve(matrix, wanted))
        return maps.trial(found[self._mine]), unit * found[len(found) - k :]

    def _gathered(self, x: Array) -> Array:
        """Return the values of all ranks, (n,) or (n, columns). Collective."""
        result = np.zeros((self._rows.shape[1], *x.shape[1:]))
        result[self._mine] = x
        return self._reductions.total(result)

    def _in_own_columns(self, matrix: csr_array) -> csr_array:
        """Return a matrix (size, size) in the columns of this rank's multipliers, (size, n)."""
        indices = matrix.indices + self._mine.start
        return csr_array((matrix.data, indices, matrix.indptr), shape=self._rows.shape)

    def _matrix(self, nodal: Callable[[Array], Array]) -> csr_array:
        """Return the matrix (size, size) of a map that couples only multipliers of one node."""
        pattern, values = self._same_node, nodal(self._units)[self._values_at]
        return csr_array((values, pattern.indices, pattern.indptr), shape=pattern.shape)


def _groups(nodes: Indices) -> tuple[csr_array, Indices]:
    """Return which multipliers belong to the same node, and each multiplier's number in its node.

    Returns:
        a matrix (size, size) with an entry in row i and column j if the multipliers i and j belong
        to the same node; and for each multiplier (size,) its number 0, 1, ... among the multipliers
        of its node.
    """
    size = len(nodes)
    _, index = np.unique(nodes, return_inverse=True)
    member = csr_array((np.ones(size), (np.arange(size), index)), shape=(size, size))
    order = np.argsort(index, kind="stable")
    numbers = np.bincount(index)
    place = np.empty(size, dtype=np.intp)
    place[order] = np.arange(size) - (np.cumsum(numbers) - numbers)[index[order]]
    return csr_array(member @ member.T), place
