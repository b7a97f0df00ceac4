"""The far field: the part of A that a cheap approximation misses, kept for the next model of A."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.models.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.reductions import Reductions

#: The far field represents A - D, where D is an approximation of A, by vectors x. A vector is kept
#: if the ratio of x'(A - D) x to x'A x exceeds this number. Smaller ratios may be due to errors of
#: inexact products, or of the model of the near field. With twice or half the value, the number of
#: products is the same (benchmarks/ablation.py).
FAR_ENERGY = 0.03


class FarField:
    """The low-rank approximation F = s Z Z' of A - D, from known products with A.

    D is an approximation of A with x'D x <= x'A x, at least approximately. If D is the near field,
    which represents the bodies near the contact, F represents the rest of the bodies. F is then
    smooth, so that few columns suffice. For another A with its own D, the sum D + F is always
    positive definite, and accurate near the contact; the scale of F follows from the first products
    with the new A.

    Attributes:
        W: (size, k) vectors with known products (A - D) W.
        Z: (size, k) factor of F, with Z Z'W = (A - D) W.
        scale: s, the ratio of the present A - D to the earlier A - D.
    """

    def __init__(self, reductions: Reductions, W: Array, rest: Array, most: int) -> None:
        """Compute a positive semidefinite Nystroem approximation of A - D. Collective.

        Args:
            reductions: sums over the ranks.
            W: (size, k) vectors with known products, for which W'A W = I, and vectors of an earlier
                far field.
            rest: (size, k) products (A - D) W.
            most: limit on the number of columns; those with the largest eigenvalues are kept.
        """
        self._reductions, self._inner = reductions, reductions.inner
        agreed = reductions.from_first_rank
        values, vectors = (agreed(one) for one in np.linalg.eigh(self._inner(W, rest)))
        kept = values > FAR_ENERGY
        orthonormal = vectors[:, kept] / np.sqrt(values[kept])
        W, Z = W @ orthonormal, rest @ orthonormal
        self._values, vectors = (agreed(one) for one in np.linalg.eigh(self._inner(Z, Z)))
        self.W, self.Z = W @ vectors[:, -most:], Z @ vectors[:, -most:]
        self.scale = 1.0

    def carried_over(
        self, multipliers: Callable[[Array], Array], products: Callable[[Array], Array]
    ) -> FarField:
        """Return the far field for another pairing of the same bodies. Collective.

        Args:
            multipliers: function that maps multipliers (size, k) to multipliers of the other
                pairing.
            products: function that maps products A x (size, k) to products with A of the other
                pairing.
        """
        W, Z = multipliers(self.W), products(self.root)
        return FarField(self._reductions, W, Z @ self._inner(Z, W), W.shape[1])

    def fit(self, W: Array, D: BlockBFGSModel) -> None:
        """Fit the scale of F so that w'(D + F) w is near w'A w for each column w of W. Collective.

        The fit is by least squares. Columns w with a small w'F w are left out. With such columns
        alone, the scale would follow from rounding errors, and could be so large that no step
        changes the multipliers.

        Args:
            W: (size, k) vectors with W'A W = I for the present A.
            D: approximation of the present A.
        """
        wanted = 1.0 - np.diag(self._inner(W, D.apply(W)))
        found = np.square(self._inner(self.Z, W)).sum(axis=0)
        most = self._values[-1:].sum() * np.diag(self._inner(W, W))
        found = np.where(found > FAR_ENERGY * most, found, 0.0)
        if (square := float(found @ found)) > 0.0:
            self.scale = max(0.0, float(wanted @ found) / square)

    @property
    def root(self) -> Array:
        """The factor R (size, k) with F = R R'."""
        result: Array = np.sqrt(self.scale) * self.Z
        return result

    def apply(self, x: Array) -> Array:
        """Return F x for x of shape (size,) or (size, columns). Collective."""
        result: Array = self.root @ self._inner(self.root, x)
        return result

    @property
    def largest_eigenvalue(self) -> float:
        """The largest eigenvalue of F; 0 if F is zero. Not collective."""
        return self.scale * float(self._values[-1:].sum())
