"""Solutions with symmetric matrices that are positive definite, sparse or dense."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csc_array, csr_array, issparse
from scipy.sparse.linalg import splu

from dolfinx_tresca._base.arrays import Array, Matrix


def factored(matrix: Matrix) -> Callable[[Array], Array] | None:
    """Return a function that applies the inverse; None if the matrix is not positive definite.

    Sparse matrices are factored as L U without pivoting, which for positive definite matrices is as
    stable as Cholesky's method. For other matrices, this factorisation fails only at a zero pivot,
    not at a negative pivot.
    """
    try:
        if issparse(matrix):
            return _sparse_factors(matrix).solve  # type: ignore[no-any-return]
        return partial(cho_solve, cho_factor(matrix, check_finite=False))
    except (RuntimeError, np.linalg.LinAlgError):  # a zero pivot in L U, a negative one in L L'
        return None


def is_positive_definite(matrix: csr_array) -> bool:
    """Return whether all pivots of a sparse symmetric matrix are positive (Sylvester)."""
    try:
        return bool((_sparse_factors(matrix).U.diagonal() > 0.0).all())
    except RuntimeError:
        return False


def _sparse_factors(matrix: csr_array) -> Any:
    return splu(csc_array(matrix), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
