"""What the next mesh will be like."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_tresca.adapt.forecast import FIRST_RATE, Forecast


def level(unknowns: float, error: float):
    return SimpleNamespace(free_dofs=unknowns, error=error)


def test_errors_fall_on_as_they_have():
    assert Forecast.error([], 10) == np.inf
    assert Forecast.error([level(100, 0.4)], 800) == pytest.approx(0.4 * 8**-FIRST_RATE)
    levels = [level(100, 0.4), level(200, 0.2)]
    assert Forecast.error(levels, 600) == pytest.approx(0.2 / 3)
    # one that has grown says nothing of the rate
    levels = [level(100, 0.1), level(200, 0.2)]
    assert Forecast.error(levels, 1600) == pytest.approx(0.2 * 8**-FIRST_RATE)


@pytest.mark.parametrize("dim", [2, 3])
def test_growth_is_that_of_the_refinement_before(dim):
    forecast = Forecast(dim)
    assert 1.0 < forecast.growth(0.01) < forecast.growth(0.1) <= 2**dim
    assert forecast.growth(0.5) <= forecast.growth(1.0) <= 2**dim
    forecast.learn(0.05, 1.4)
    assert forecast.growth(0.1) == pytest.approx(1.8)
