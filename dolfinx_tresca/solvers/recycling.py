"""Every product that was paid for, kept: A-orthonormal pairs (W, A W) and what they are good for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh

from dolfinx_tresca.dual.feasible_set import Array, Face
from dolfinx_tresca.solvers.problem import DualProblem


class RecycledProducts:
    """Pairs W, Y = A W with W'A W = I, from all products of a problem so far.

    Y Y' is a positive semidefinite minorant of A that holds the directions the solver has met: a
    Nystroem approximation (Frangella, Tropp, Udell 2023) whose sketch costs nothing. A does not
    change between Newton steps, load steps or slip bounds, so the pairs stay valid; drop them when
    the stiffness changes.

    Attributes:
        capacity: number of pairs kept; when there are more, those of the largest Ritz values stay.
    """

    def __init__(self, problem: DualProblem, capacity: int = 240) -> None:
        self._problem = problem
        self.capacity = capacity
        self.W = np.empty((len(problem.b), 0))
        self.Y = np.empty((len(problem.b), 0))

    def __len__(self) -> int:
        return self.W.shape[1]

    def add(self, x: Array, product: Array) -> None:
        """Add a pair x, A x of shape (size,); one that holds nothing new is dropped. Collective."""
        inner = self._problem.inner
        energy = float(inner(x, product))
        if not energy > 0.0:
            return
        for _ in range(2):  # the second pass removes what rounding left in the first
            coefficients = inner(self.Y, x)
            x = x - self.W @ coefficients
            product = product - self.Y @ coefficients
        rest = float(inner(x, product))
        if rest <= 1e-10 * energy:
            return
        self.W = np.column_stack([self.W, x / np.sqrt(rest)])
        self.Y = np.column_stack([self.Y, product / np.sqrt(rest)])
        if len(self) > self.capacity:
            self._compress(self.capacity // 2)

    def _compress(self, keep: int) -> None:
        """Keep the combinations with the largest Ritz values of A."""
        _, vectors = eigh(self._problem.inner(self.Y, self.Y))
        self.W = self.W @ vectors[:, -keep:]
        self.Y = self.Y @ vectors[:, -keep:]

    def largest_ritz_value(self) -> float:
        """Return a lower bound of sigma_max; 0 without pairs. Collective."""
        if len(self) == 0:
            return 0.0
        # the eigenvalues of Y'Y are Ritz values of A for the space spanned by A^(1/2) W
        return float(eigh(self._problem.inner(self.Y, self.Y), eigvals_only=True)[-1])

    def preconditioner(self, face: Face, stiffness: Array) -> Callable[[Array], Array]:
        """Return the inverse of P (D + Y Y') P + C for vectors along a face, by Woodbury's formula.

        D is the problem's diagonal without the part that Y Y' holds already, C = diag(stiffness).
        Collective, as is the returned function.

        Args:
            face: gives P.
            stiffness: (size,) C >= 0, the same for all degrees of freedom of a disc.
        """
        inner = self._problem.inner
        diagonal = self._problem.diagonal
        rest = np.maximum(diagonal - np.einsum("ij,ij->i", self.Y, self.Y), 0.1 * diagonal)
        inverse = 1.0 / (self._problem.feasible_set.average(rest) + stiffness)
        along = face.project(self.Y)
        factor = cho_factor(np.eye(len(self)) + inner(along, inverse[:, None] * along))
        inverse_along = inverse[:, None] * along

        def precondition(v: Array) -> Array:
            return inverse * v - inverse_along @ cho_solve(factor, inner(inverse_along, v))

        return precondition
