"""Numbers and units in pictures: round ticks, powers of ten, colour ranges."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_tresca._base.arrays import Array

#: Steps between ticks are one of these numbers times a power of ten.
ROUND_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
#: Ends of clipped ranges are one of these numbers times a power of ten.
ENDS = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)

#: A range is clipped if its largest value is more than `PEAK` times the value at the percentile
#: `PEAK_PERCENTILE`: otherwise most values would have one colour.
PEAK = 2.5
PEAK_PERCENTILE = 85.0

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Scaled:
    """The number format of an axis.

    Attributes:
        factor: divisor of the values, a power of ten.
        label: name, power of ten and unit, such as "slip [10⁻⁶ m]".
    """

    factor: float
    label: str


def scaled(name: str, unit: str, largest: float) -> Scaled:
    """Return the number format for values up to `largest`.

    Values are divided by a power of ten unless `largest` is from 0.02 to 9999. Exponents are
    multiples of three: ..., -6, -3, 3, 6, ...

    Args:
        name: name of the quantity.
        unit: unit of the values, or "".
        largest: largest absolute value.
    """
    power = _power(largest)
    inside = " ".join(part for part in (_ten(power), unit) if part)
    return Scaled(10.0**power, f"{name} [{inside}]" if inside else name)


def quantity(value: float, unit: str) -> str:
    """Return a value with three digits and its unit, such as "18.9 · 10⁻⁶ m"."""
    power = _power(abs(value))
    digits = value / 10.0**power
    number = f"{digits:.0f}" if abs(digits) >= 99.95 else f"{digits:.3g}"
    if power:
        number += f" · {_ten(power)}"
    return f"{number} {unit}".strip()


def locator() -> Any:
    """Return matplotlib's locator of at most six round ticks."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(nbins=5, steps=ROUND_STEPS)


def _power(largest: float) -> int:
    if largest == 0.0 or 0.02 <= largest < 10_000.0:
        return 0
    return 3 * math.floor(math.log10(largest * (1.0 + 1e-12)) / 3.0)


def _ten(power: int) -> str:
    return "10" + str(power).translate(_SUPERSCRIPT) if power else ""


@dataclass(frozen=True)
class Range:
    """The values from the first to the last colour.

    Attributes:
        low: value of the first colour.
        high: value of the last colour, also used for larger values.
        peak: the largest value, if colours end below it, else None.
    """

    low: float
    high: float
    peak: float | None = None

    @classmethod
    def of(cls, values: Array, *, clip: bool = False) -> Range:
        """Return a range that shows how values vary.

        It begins at zero, unless all values are far from zero or some are negative.

        Args:
            values: the values in the picture.
            clip: whether the range may end, at a round number, below a few values that are much
                larger than the others.
        """
        least, largest = float(values.min(initial=0.0)), float(values.max(initial=0.0))
        if least < 0.0 or largest <= 0.0:
            return cls(least, largest or 1.0)
        least = float(values.min())
        most = float(np.percentile(values, PEAK_PERCENTILE))
        if clip and 0.0 < PEAK * most < largest:
            return cls(0.0, _round_up(most), largest)
        far = 0.5 * largest < least < (1.0 - 1e-6) * largest
        return cls(least if far else 0.0, largest)


def _round_up(value: float) -> float:
    power = 10.0 ** math.floor(math.log10(value))
    return next(end * power for end in ENDS if end * power >= value * (1.0 - 1e-9))
