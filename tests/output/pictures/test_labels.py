"""Numbers in pictures: round ticks, powers of ten, and colour ranges that show what varies."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca.output.pictures.canvas import Colours, quantity, round_ticks, scaled


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
    assert scaled("p", unit, largest) == (pytest.approx(factor), label)


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
    ticks = round_ticks().tick_values(0.0, high)
    step = ticks[1] - ticks[0]
    digits = step / 10.0 ** np.floor(np.log10(step) + 1e-9)
    assert min(abs(digits - np.array([1.0, 2.0, 2.5, 5.0]))) < 1e-9
    assert 3 <= np.sum((ticks >= 0.0) & (ticks <= high)) <= 6


def colours_of(values: np.ndarray, *, clip: bool = False) -> tuple[float, float, float | None]:
    """Return the values of the first and last colour, and the peak beyond it."""
    colours = Colours.from_values(values, "p", "MPa", "viridis", clip=clip)
    return colours.low, colours.high, colours.peak


def test_colours_show_what_varies() -> None:
    """Colours begin at zero unless all values are far from it."""
    spread = np.linspace(0.0, 46.0, 100)
    assert colours_of(spread, clip=True) == (0.0, 46.0, None)
    assert colours_of(38.0 + 0.1 * spread) == (38.0, pytest.approx(42.6), None)
    assert colours_of(np.full(9, 2.5)) == (0.0, 2.5, None)  # rounding is no variation
    assert colours_of(np.zeros(3)) == (0.0, 1.0, None)
    assert colours_of(np.empty(0), clip=True) == (0.0, 1.0, None)


def test_peaks_are_clipped() -> None:
    """Only a few, only if they are far beyond the others, and where that is asked for."""
    values = np.append(np.linspace(0.0, 3.3, 90), [13.5] * 10)
    assert colours_of(values) == (0.0, 13.5, None)
    low, high, peak = colours_of(values, clip=True)
    assert (low, peak) == (0.0, 13.5)
    assert np.percentile(values, 85.0) <= high < 13.5 / 2.5
    assert colours_of(np.append(values, [13.5] * 30), clip=True)[2] is None
