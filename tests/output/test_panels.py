"""Numbers in pictures: powers of ten, and ranges of colours that show what varies."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca.output.panels import colour_range, scaled


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


def test_colours_show_what_varies() -> None:
    """Colours begin at zero unless all values are far from it."""
    spread = np.linspace(0.0, 46.0, 100)
    assert colour_range(spread, clip=True) == (0.0, 46.0, 46.0)
    assert colour_range(38.0 + 0.1 * spread)[:2] == (38.0, pytest.approx(42.6))
    assert colour_range(np.full(9, 2.5)) == (0.0, 2.5, 2.5)  # rounding is no variation
    assert colour_range(np.zeros(3))[:2] == (0.0, 1.0)
    assert colour_range(np.empty(0), clip=True)[:2] == (0.0, 1.0)


def test_peaks_are_clipped() -> None:
    """Only a few, only if they are far beyond the others, and where that is asked for."""
    values = np.append(np.linspace(0.0, 3.3, 90), [13.5] * 10)
    assert colour_range(values) == (0.0, 13.5, 13.5)
    low, high, peak = colour_range(values, clip=True)
    assert (low, peak) == (0.0, 13.5)
    assert np.percentile(values, 85.0) <= high < 13.5 / 2.5
    assert colour_range(np.append(values, [13.5] * 30), clip=True)[1] == 13.5
