"""The model of A where A is known whole, as a sparse or dense matrix: A and a small shift."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cached_property

import numpy as np
from scipy.sparse import block_array, csr_array, diags_array, eye_array, issparse
from scipy.sparse.linalg import eigsh

from dolfinx_tresca._base.arrays import Array, Indices, Matrix, dense
from dolfinx_tresca.solvers.linear_algebra import (
    LEAST_SOFTNESS,
    NodalMaps,
    NodalPattern,
    Reductions,
    solve_or_fit,
)

#: Number that the model adds to the diagonal of A, divided by the compliance of nodes whose
#: neighbours are fixed. (The diagonal of A would be no measure: slender bodies bend a million times
#: as much as their surfaces are pressed in.) A wall of 52 bricks pushed in 17 accepted steps of
#: 0.025 takes 53 iterations with 1e-2, 34 with 1e-3 and 1e-4, 18 with 1e-5; with 1e-10, Newton's
#: method on the model fails.
SHIFT = 1e-5


class WholeModel:
    """The model M = A + s I of A, whose matrix is known.

    The matrix is sparse for assemblies of many small bodies, since A couples only multipliers of
    the same body; otherwise it is dense. A is singular if rows of B are linearly dependent, as at
    corners of bricks that touch two other bricks; the shift s makes M positive definite. Since
    gradients are computed with A, the iteration with M is a proximal point method (Rockafellar
    1976): its solution is the solution for A, and the error falls by the factor s / (s + sigma) in
    each iteration, where sigma is the least positive eigenvalue of A.

    A direct solver replaces Woodbury's formula of `BlockBFGSModel`. Every rank has the whole
    matrix.

    Attributes:
        diagonal: (size,) diag(A).
        size: (size,) diag(A), too: diag(M) without the small shift.
        unit: mean of diag(A) over all ranks.
    """

    def __init__(
        self,
        reductions: Reductions,
        rows: Matrix,
        begin: int,
        nodes: Indices,
        local_compliance: Array,
        solve: Callable[[csr_array, Array], Array],
    ) -> None:
        """Prepare products. Collective.

        Args:
            reductions: sums over the ranks.
            rows: (size, n) this rank's rows of A, with columns for the multipliers of all ranks.
            begin: position of this rank's first row in A.
            nodes: (size,) the node of each of this rank's multipliers.
            local_compliance: (size,) compliance of nodes whose neighbours are fixed.
            solve: function that solves a system of equations with a sparse matrix that is not
                symmetric; every rank calls it. Not used if `rows` is dense.
        """
        self._reductions, self._solve = reductions, solve
        size, n = rows.shape
        self._mine, self._count = slice(begin, begin + size), int(n)
        self.diagonal: Array = rows[:, self._mine].diagonal()
        self.size = self.diagonal
        self.unit = float(reductions.inner(self.diagonal, np.ones(size))) / max(n, 1)
        self._pattern = NodalPattern(nodes)
        self._matrix = reductions.stacked(rows) if issparse(rows) else self._gathered(rows)
        shift = diags_array(self._gathered(SHIFT * local_compliance), format="csr")
        self._shifted = self._matrix + shift

    def __len__(self) -> int:
        """Return the number of multipliers of all ranks, whose products are known."""
        return self._count

    def add(self, x: Array, product: Array, error: float = 0.0) -> bool:
        """Return False, since the product of x is already known."""
        return False

    def split(self, x: Array) -> tuple[Array, Array]:
        """Return zeros and A x, (size,) each, like `ProductStore.split`. Collective."""
        return np.zeros_like(x), self.product(x)[0]

    def product(self, x: Array) -> tuple[Array, float]:
        """Return A x (size,), and its error, which is zero. Collective."""
        return self._matrix[self._mine] @ self._gathered(x), 0.0

    def model(self) -> WholeModel:
        """Return the model itself, like `ProductStore.model`."""
        return self

    def apply(self, x: Array) -> Array:
        """Return M x for x of shape (size,) or (size, columns). Collective."""
        return np.asarray(self._shifted[self._mine] @ self._gathered(x))

    @cached_property
    def largest_ritz_value(self) -> float:
        """The largest eigenvalue of A. Collective at the first access."""
        matrix = self._matrix
        if matrix.shape[0] <= 2:
            return float(np.linalg.eigvalsh(dense(matrix))[-1])
        start = np.ones(matrix.shape[0])
        values = eigsh(matrix, 1, which="LA", v0=start, return_eigenvectors=False, tol=1e-3)
        return float(self._reductions.from_first_rank(values)[0])

    def softened(self, softness: float) -> WholeModel:
        """Return the model A + s diag(A) of contact on a soft layer at each node. Collective.

        Args:
            softness: s, the compliance of the layer relative to that of the node.
        """
        layer = diags_array(self._gathered(softness * self.diagonal), format="csr")
        model = copy(self)
        model._shifted = self._matrix + layer
        return model

    def solve_between(
        self, maps: NodalMaps, right: Array, G: csr_array, softness: csr_array, missing: Array
    ) -> tuple[Array, Array]:
        """Return s and c, which solve the equations of `NodalMaps`. Collective.

        `LEAST_SOFTNESS`, divided by the mean of diag(A), is added to the diagonal of S, so that the
        equations have a solution even if the constraints have none.
        """
        unit, n, k = self.unit, len(self), len(missing)
        T, R = self._whole(maps.test), self._whole(maps.added)
        matrix, G = (T @ self._shifted + R) / unit, self._reductions.stacked(G)
        soft = unit * softness + LEAST_SOFTNESS * eye_array(k)
        right = np.append(1.0 / unit * self._gathered(maps.test(right)), missing)
        if issparse(matrix):
            equations = block_array([[matrix, -(T @ G)], [G.T, soft]]) if k else matrix
            solution = self._solve(csr_array(equations), right)
        else:
            equations = np.block([[matrix, -dense(T @ G)], [dense(G).T, dense(soft)]])
            moving = np.count_nonzero(equations, axis=1) > 1
            moving[n:] = True
            solution = np.zeros(n + k)
            solution[moving] = solve_or_fit(equations[np.ix_(moving, moving)], right[moving])
        solution = self._reductions.from_first_rank(solution)
        return solution[self._mine], unit * solution[n:]

    def _gathered(self, x: Array) -> Array:
        """Return the values of all ranks, (n,) or (n, columns). Collective."""
        result = np.zeros((self._count, *x.shape[1:]))
        result[self._mine] = x
        return self._reductions.total(result)

    def _whole(self, nodal: Callable[[Array], Array]) -> csr_array:
        """Return the matrix (n, n) of a map that couples multipliers of one node. Collective."""
        own = self._pattern.matrix(nodal)
        columns = own.indices + self._mine.start
        rows = csr_array((own.data, columns, own.indptr), shape=(own.shape[0], len(self)))
        return self._reductions.stacked(rows)
