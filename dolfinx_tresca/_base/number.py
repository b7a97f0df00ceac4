"""What counts as a number where one is asked for."""

from __future__ import annotations

import numbers
from typing import Any

import numpy as np


def real(value: Any) -> float | None:
    """Return a number of any kind as a float; None where it is none.

    Scalars of numpy, fractions, and arrays without dimensions, such as the value of a
    `fem.Constant`, are numbers; bools are not.
    """
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        return None
    return float(value)


def integer(value: Any) -> int | None:
    """Return an integer of any kind as an int; None where it is none, as for 2.0; see `real`."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        return None
    return int(value)
