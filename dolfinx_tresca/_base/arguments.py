"""Checks of the numbers, vectors and words that users give."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array, integer, real
from dolfinx_tresca.errors import InputError, shown

#: Interval -> its name in error messages; other intervals appear as they are.
_IN_WORDS = {
    "(0, inf)": "a positive number",
    "(0, inf]": "a positive number",
    "[0, inf)": "a number of 0 or more",
    "(-inf, inf)": "a finite number",
}


def checked_number(name: str, value: Any, interval: str = "(0, inf)") -> float:
    """Return a float in an interval, such as "(0, 1]"; raise an InputError for other values."""
    number = real(value)
    low, high = map(float, interval[1:-1].split(","))
    is_excluded = {low: interval[0] == "(", high: interval[-1] == ")"}  # for both ends
    if number is None or not low <= number <= high or is_excluded.get(number, False):
        wanted = _IN_WORDS.get(interval, f"a number in {interval}")
        raise InputError(f"{name} must be {wanted}, found {shown(value)}.")
    return number


def checked_integer(name: str, value: Any, least: int = 1) -> int:
    """Return an integer that is at least `least`; raise an InputError for other values."""
    number = integer(value)
    if number is None or number < least:
        wanted = "a positive integer" if least == 1 else f"an integer from {least} on"
        raise InputError(f"{name} must be {wanted}, found {shown(value)}.")
    return number


def real_array(value: npt.ArrayLike) -> Array:
    """Return real numbers as floats; raise a TypeError or ValueError for other or ragged values."""
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"expected real numbers, found {array.dtype}")
    return array.astype(np.float64)


def checked_vector(name: str, value: Any, *counts: int, nonzero: bool = False) -> Array:
    """Return a vector (n,) of finite numbers, n one of `counts`; else raise an InputError."""
    try:
        vector = real_array(value)
    except (TypeError, ValueError):
        vector = np.full(1, np.nan)
    if vector.ndim != 1 or len(vector) not in counts or not np.isfinite(vector).all():
        numbers = " or ".join(map(str, counts))
        raise InputError(f"{name} must be {numbers} finite numbers, found {shown(value)}.")
    if nonzero and not vector.any():
        raise InputError(f"{name} must have a direction, found {shown(value)}.")
    return vector


def check_type(name: str, value: Any, kinds: Any, wanted: str, advice: str = "") -> None:
    """Check that an argument is of the types `kinds`; the error says `wanted` and then `advice`."""
    if not isinstance(value, kinds):
        raise InputError(f"{name} must be {wanted}, found {shown(value)}.{advice}")


def check_word(name: str, value: Any, choices: Sequence[str]) -> None:
    """Check that the argument `name` is one of several words, such as a method."""
    if not isinstance(value, str) or value not in choices:
        raise InputError(f"{name} must be one of {', '.join(choices)}, found {shown(value)}.")
