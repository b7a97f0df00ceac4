"""The interface of known products with A, and its implementation for a known matrix A."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.models.bfgs_model import BlockBFGSModel
from dolfinx_tresca.optimise.models.model import Model
from dolfinx_tresca.optimise.models.whole_model import WholeModel


class KnownProducts(ABC):
    """Products with A that are known, and the model of A that follows from them.

    Methods are collective.
    """

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of vectors with known products."""

    @abstractmethod
    def add(self, x: Array, product: Array, error: float = 0.0) -> bool:
        """Add the product of x (size,), with its error in the norm sqrt(e'A^-1 e).

        Returns:
            True if the new part of the product, which does not follow from known products, exceeds
            its error.
        """

    @abstractmethod
    def split(self, x: Array) -> tuple[Array, Array]:
        """Return the part of x whose product is unknown, and A times the rest of x."""

    @abstractmethod
    def product(self, x: Array) -> tuple[Array, float]:
        """Return an approximation of A x, and its error in the norm sqrt(e'A^-1 e)."""

    @abstractmethod
    def model(self) -> Model:
        """Return the model of A."""

    @abstractmethod
    def largest_ritz_value(self) -> float:
        """Return a lower bound of the largest eigenvalue of A; 0 if nothing is known."""

    def fit_far(self, base: BlockBFGSModel | None = None) -> None:
        """Scale the far field of an earlier A, if there is one, to fit the known products.

        Args:
            base: model of the near field, which replaces the diagonal; None: the diagonal is used.
        """
        return

    def drop_inaccurate_pairs(self) -> None:
        """Drop products whose errors are too large for later solves; exact products stay."""
        return


class WholeProducts(KnownProducts):
    """All products with A, which is known as a matrix."""

    def __init__(self, matrix: WholeModel) -> None:
        """Wrap A. Not collective."""
        self._matrix = matrix

    def __len__(self) -> int:
        return self._matrix.number

    def add(self, x: Array, product: Array, error: float = 0.0) -> bool:
        """Return False, since the product of x is already known."""
        return False

    def split(self, x: Array) -> tuple[Array, Array]:
        """Return zeros and A x, (size,) each. Collective."""
        return np.zeros_like(x), self._matrix.product(x)

    def product(self, x: Array) -> tuple[Array, float]:
        """Return A x (size,), and its error, which is zero. Collective."""
        return self._matrix.product(x), 0.0

    def model(self) -> WholeModel:
        """Return the matrix with its shift."""
        return self._matrix

    def largest_ritz_value(self) -> float:
        """Return the largest eigenvalue of A. The first call is collective."""
        return self._matrix.largest_eigenvalue
