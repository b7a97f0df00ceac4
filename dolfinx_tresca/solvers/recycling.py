"""Every product that was paid for, kept: A-orthonormal pairs, and the model of A that they give."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh, eigvalsh, solve

from dolfinx_tresca.dual.feasible_set import Array, Face
from dolfinx_tresca.solvers.problem import DualProblem

#: Part of the energy of a vector that must be new for its product to be kept: above rounding.
NEW = 1e-10


class RecycledProducts:
    """Pairs W, Y = A W with W'A W = I, from all products of a problem so far.

    A does not change between Newton steps, load steps or slip bounds, so the pairs stay valid; drop
    them when the stiffness changes.

    Attributes:
        W: (size, k) the vectors.
        Y: (size, k) their products.
        capacity: number of pairs kept; when there are more, half of that stays: those combinations
            that hold the largest eigenvalues of A.
    """

    def __init__(self, problem: DualProblem, capacity: int = 120) -> None:
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
        if rest <= NEW * energy:
            return
        self.W = np.column_stack([self.W, x / np.sqrt(rest)])
        self.Y = np.column_stack([self.Y, product / np.sqrt(rest)])
        if len(self) > self.capacity:
            _, vectors = eigh(inner(self.Y, self.Y))
            self.W = self.W @ vectors[:, -(self.capacity // 2) :]
            self.Y = self.Y @ vectors[:, -(self.capacity // 2) :]

    def largest_ritz_value(self) -> float:
        """Return a lower bound of sigma_max; 0 without pairs. Collective."""
        if len(self) == 0:
            return 0.0
        # the eigenvalues of Y'Y are the Ritz values of A on the span of A^(1/2) W
        return float(eigvalsh(self._problem.inner(self.Y, self.Y))[-1])

    def model(self) -> RecycledModel:
        """Return the model of A that the pairs and the problem's diagonal give. Collective."""
        return RecycledModel(self._problem, self.W, self.Y)


class RecycledModel:
    """M = Y Y' + (I - Y W') D (I - W Y'), D = diag(A): symmetric, positive definite, and cheap.

    M equals A on all vectors whose products are known (M W = Y); elsewhere it has the size of
    diag(A). It is what a block BFGS update makes of D with the pairs (W, Y), and the first term
    alone is a Nystroem approximation of A. No product is needed to apply or invert it.

    Attributes:
        diagonal: (size,) D, the same for all degrees of freedom of a disc.
    """

    def __init__(self, problem: DualProblem, W: Array, Y: Array) -> None:
        self._inner = problem.inner
        self.diagonal = problem.diagonal
        # written out, M = D + U C U' with U = (Y, D W)
        self._U = np.column_stack([Y, self.diagonal[:, None] * W])
        identity = np.eye(W.shape[1])
        zero = np.zeros_like(identity)
        gram = identity + self._inner(W, self.diagonal[:, None] * W)
        self._C = np.block([[gram, -identity], [-identity, zero]])
        self._C_inverse = np.block([[zero, -identity], [-identity, -gram]])

    def apply(self, x: Array) -> Array:
        """Return M x. Collective."""
        result: Array = self.diagonal * x + self._U @ (self._C @ self._inner(self._U, x))
        return result

    def solve_on(self, face: Face, stiffness: Array, right: Array) -> Array:
        """Return s along a face with (P M P + C) s = P right, by Woodbury's formula. Collective.

        Args:
            face: gives P.
            stiffness: (size,) diagonal of C >= 0, the same for all degrees of freedom of a disc.
            right: (size,).
        """
        inverse = 1.0 / (self.diagonal + stiffness)
        along = face.project(self._U)
        scaled = inverse[:, None] * along
        right = inverse * face.project(right)
        capacitance = self._C_inverse + self._inner(along, scaled)
        result: Array = right - scaled @ solve(
            capacitance, self._inner(along, right), assume_a="sym"
        )
        return result
