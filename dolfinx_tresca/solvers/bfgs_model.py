"""A model of A: the block BFGS update of a diagonal matrix with all known products."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.solvers.nodal_maps import LEAST_SOFTNESS, NodalMaps, solve_or_fit
from dolfinx_tresca.solvers.reductions import Reductions


class BlockBFGSModel:
    """The model M = Y Y' + (I - Y W') D (I - W Y') of A: symmetric and positive definite.

    The columns of Y are the known products A w with the columns w of W, and W'Y = I. M equals A on
    all combinations of these vectors (M W = Y); on other vectors, it has the magnitude of D, an
    approximation of diag(A). M is the block BFGS update of D with W and Y; the term Y Y' alone is a
    Nystroem approximation of A. Applying or inverting M needs no product with A. D may be replaced
    by another model, such as the model of an earlier A; M is then the block BFGS update of that
    model.

    Attributes:
        diagonal: (size,) D, the same for all degrees of freedom of a friction disc.
    """

    def __init__(
        self,
        reductions: Reductions,
        diagonal: Array,
        W: Array,
        Y: Array,
        base: BlockBFGSModel | None = None,
    ) -> None:
        """Update D with known products. Collective.

        Args:
            reductions: sums over the ranks.
            diagonal: (size,) D, the same for all degrees of freedom of a friction disc.
            W: (size, k) vectors with known products.
            Y: (size, k) products A W, with W'Y = I.
            base: model that takes the place of D and is not changed; its diagonal replaces
                `diagonal`.
        """
        self._inner, self._agreed = reductions.inner, reductions.from_first_rank
        self.diagonal: Array = diagonal if base is None else base.diagonal
        # multiplied out, M = D + U C U' with U = (Y, D W)
        image = diagonal[:, None] * W if base is None else base.apply(W)
        identity = np.eye(W.shape[1])
        zero = np.zeros_like(identity)
        gram = identity + self._inner(W, image)
        self._U = np.column_stack([Y, image])
        self._C = np.block([[gram, -identity], [-identity, zero]])
        self._C_inverse = np.block([[zero, -identity], [-identity, -gram]])
        if base is not None:
            self._U = np.column_stack([base._U, self._U])
            self._C = block_diag(base._C, self._C)
            self._C_inverse = block_diag(base._C_inverse, self._C_inverse)
        # square root of the mean of D, weighted by D: it scales the constraints so that all rows of
        # the matrix that Woodbury's formula inverts have a similar size
        total = float(self._inner(self.diagonal, np.ones_like(self.diagonal)))
        square = float(self._inner(self.diagonal, self.diagonal))
        self._unit = float(np.sqrt(square / total)) if total > 0.0 else 1.0

    @property
    def size(self) -> Array:
        """diag(M), (size,)."""
        result: Array = self.diagonal + ((self._U @ self._C) * self._U).sum(axis=1)
        return result

    def apply(self, x: Array) -> Array:
        """Return M x for x of shape (size,) or (size, columns). Collective."""
        result: Array = (self.diagonal * x.T).T + self._U @ (self._C @ self._inner(self._U, x))
        return result

    def solve_between(
        self, maps: NodalMaps, right: Array, G: csr_array, softness: csr_array, missing: Array
    ) -> tuple[Array, Array]:
        """Return V s and c, which solve the equations of `NodalMaps`. Collective.

        Woodbury's formula inverts both equations at once. The tiny `LEAST_SOFTNESS` is added to S,
        so that the system has a solution even if the second equation has none.

        Args:
            maps: T, V and R.
            right: (size,) r.
            G: (size, k) columns of length 1.
            softness: (k, k) S.
            missing: (k,) e.
        """
        unit = self._unit
        columns = np.column_stack([self._U, unit * G.toarray()])
        scaled = maps.inverse(columns)
        first = maps.inverse(right)
        capacitance = self._inner(columns, scaled)
        k = len(missing)
        rank = len(capacitance) - k
        capacitance[:rank, :rank] += self._C_inverse
        capacitance[rank:, rank:] += LEAST_SOFTNESS * np.eye(k) + unit**2 * softness.toarray()
        wanted = self._inner(columns, first) - np.append(np.zeros(rank), unit * missing)
        found = self._agreed(solve_or_fit(capacitance, wanted))
        return first - scaled @ found, -unit * found[rank:]
