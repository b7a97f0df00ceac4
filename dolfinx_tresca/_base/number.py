"""Conversion of arguments to plain Python numbers."""

from __future__ import annotations

import numbers
from typing import Any

import numpy as np


def real(value: Any) -> float | None:
    """Convert a real number of any type to float; return None if the value is not a real number.

    Scalars of numpy, fractions and zero-dimensional arrays, such as the value of a `fem.Constant`,
    are numbers; bools are not.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    return float(value)


def integer(value: Any) -> int | None:
    """Convert an integer of any type to int; return None for other values, such as 2.0 or True."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        return None
    return int(value)
