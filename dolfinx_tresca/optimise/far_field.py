"""What is known of an earlier A beyond what stands in for it: the next model begins with that."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.reductions import Reductions

#: Part of a vector's energy x'A x that the far field must have to be kept: less is the error of
#: inexact products, and of what is known of the near field (two bricks with multigrid: 72 to 74
#: products in 14 cases with 0.01 to 0.1, 81 with 1e-10).
FAR_ENERGY = 0.03


class FarField:
    """F = s Z Z': of A - D, for a stand-in D that is too small, as much as products tell.

    If D knows what is near the contact, F is what comes from further away: smooth, so that few
    columns hold it. For another A with a D of its own D + F is positive definite, whatever has
    changed, and right near the contact; how large F is now shows with the first products.

    Attributes:
        W: (size, k) vectors.
        Z: (size, k) with Z Z'W = (A - D) W.
        scale: s, of the A that F is used for, over that of the earlier A.
    """

    def __init__(self, reductions: Reductions, W: Array, rest: Array, most: int) -> None:
        """Make A - D definite, whatever errors do, as a Nystroem approximation. Collective.

        Args:
            reductions: over the ranks.
            W: (size, k) vectors: those of pairs, so that W'A W = I, and of an earlier far field.
            rest: (size, k) (A - D) W.
            most: number of columns that are kept: those that hold the largest eigenvalues.
        """
        self._inner, agreed = reductions.inner, reductions.from_first_rank
        values, vectors = (agreed(one) for one in np.linalg.eigh(self._inner(W, rest)))
        kept = values > FAR_ENERGY
        turn = vectors[:, kept] / np.sqrt(values[kept])
        W, Z = W @ turn, rest @ turn
        self._values, vectors = (agreed(one) for one in np.linalg.eigh(self._inner(Z, Z)))
        self.W, self.Z = W @ vectors[:, -most:], Z @ vectors[:, -most:]
        self.scale = 1.0

    def fit(self, W: Array, D: BlockBFGSModel) -> None:
        """Scale F so that D + F has the energies of A, in the sense of least squares. Collective.

        Vectors that are nearly orthogonal to F tell nothing of its scale: of rounding, they would
        tell one of 1e30, and no step would be long enough to see.

        Args:
            W: (size, k) vectors with W'A W = I for the present A.
            D: stands in for that.
        """
        wanted = 1.0 - np.diag(self._inner(W, D.apply(W)))
        found = np.square(self._inner(self.Z, W)).sum(axis=0)
        most = self._values[-1:].sum() * np.diag(self._inner(W, W))
        found = np.where(found > FAR_ENERGY * most, found, 0.0)
        if (square := float(found @ found)) > 0.0:
            self.scale = max(0.0, float(wanted @ found) / square)

    @property
    def root(self) -> Array:
        """(size, k) R with F = R R'."""
        result: Array = np.sqrt(self.scale) * self.Z
        return result

    def apply(self, x: Array) -> Array:
        """Return F x for x of shape (size,) or (size, columns). Collective."""
        result: Array = self.root @ self._inner(self.root, x)
        return result

    @property
    def largest_eigenvalue(self) -> float:
        """Of F; 0 if that is 0. Not collective."""
        return self.scale * float(self._values[-1:].sum())
