"""Factors of sparse symmetric matrices that are positive definite."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from dolfinx_tresca._base.arrays import Array


def factored(matrix: csr_array) -> Callable[[Array], Array] | None:
    """Return a function that applies the inverse; None if there is a zero pivot.

    The matrix is factored as L U without pivoting, which for positive definite matrices is as
    stable as Cholesky's method.
    """
    try:
        return _sparse_factors(matrix).solve  # type: ignore[no-any-return]
    except RuntimeError:
        return None


def is_positive_definite(matrix: csr_array) -> bool:
    """Return whether all pivots of a sparse symmetric matrix are positive (Sylvester)."""
    try:
        return bool((_sparse_factors(matrix).U.diagonal() > 0.0).all())
    except RuntimeError:
        return False


def _sparse_factors(matrix: csr_array) -> Any:
    return splu(csc_array(matrix), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
