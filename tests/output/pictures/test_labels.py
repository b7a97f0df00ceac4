"""Numbers in pictures: round ticks, powers of ten, and colour ranges that show what varies."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca.output.pictures.labels import Range, locator, quantity, scaled


@pytest.mark.parametrize(
    ("unit", "largest", "factor", "label"),
    [
        ("MPa", 13.5, 1.0, "p [MPa]"),
        ("m", 9.46e-5, 1e-6, "p [10⁻⁶ m]"),
        ("mm", 0.0109, 1e-3, "p [10⁻³ mm]"),
        ("m", 1e-3 * (1.0 - 1e-16), 1e-3, "p [10⁻³ m]"),
        ("Pa", 2.5e9, 1e9, "p [10⁹ Pa]"),
        ("", 0.3, 1.0, "p"),
        ("", 3e-7, 1e-9, "p [10⁻⁹]"),
        ("m", 0.0, 1.0, "p [m]"),
    ],
)
def test_scaled(unit: str, largest: float, factor: float, label: str) -> None:
    """Names of units have powers of thousand, and there are no empty brackets."""
    found = scaled("p", unit, largest)
    assert (found.factor, found.label) == (pytest.approx(factor), label)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1.8871e-5, "m", "18.9 · 10⁻⁶ m"),
        (915.3, "kPa", "915 kPa"),
        (0.3342, "mm", "0.334 mm"),
        (13.456, "", "13.5"),
    ],
)
def test_quantity(value: float, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


@pytest.mark.parametrize("high", [0.637, 9.46, 13.5, 46.4, 915.0, 1.0, 7.3])
def test_ticks_are_round(high: float) -> None:
    """They are 1, 2, 2.5 or 5 times powers of ten apart, whatever the range is."""
    pytest.importorskip("matplotlib")
    ticks = locator().tick_values(0.0, high)
    step = ticks[1] - ticks[0]
    digits = step / 10.0 ** np.floor(np.log10(step) + 1e-9)
    assert min(abs(digits - np.array([1.0, 2.0, 2.5, 5.0]))) < 1e-9
    assert 3 <= np.sum((ticks >= 0.0) & (ticks <= high)) <= 6


def test_range_shows_what_varies() -> None:
    spread = np.linspace(0.0, 46.0, 100)
    assert Range.of(spread, clip=True) == Range(0.0, 46.0)
    assert Range.of(38.0 + 0.1 * spread) == Range(38.0, pytest.approx(42.6))
    assert Range.of(np.full(9, 2.5)) == Range(0.0, 2.5)  # rounding is no variation
    assert Range.of(spread - 1.0) == Range(-1.0, 45.0)
    assert Range.of(np.zeros(3)) == Range(0.0, 1.0)


def test_peaks_are_clipped() -> None:
    """Only a few, only if they are far beyond the others, and where that is asked for."""
    values = np.append(np.linspace(0.0, 3.3, 90), [13.5] * 10)
    assert Range.of(values) == Range(0.0, 13.5)
    assert Range.of(values, clip=True) == Range(0.0, 4.0, 13.5)
    assert Range.of(np.append(values, [13.5] * 30), clip=True).peak is None
