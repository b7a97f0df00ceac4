"""What the next mesh will be like."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dolfinx_tresca.adapt.levels import expected_error, growth_to
from dolfinx_tresca.adapt.solve import GROWTH, step_of
from scenes.scene import EPS


def level(unknowns: float, error: float):
    return SimpleNamespace(free_dofs=unknowns, error=error)


def test_errors_fall_on_as_they_have():
    assert expected_error([], 10) == np.inf
    assert expected_error([level(100, 0.4)], 800) == pytest.approx(0.4 * 8 ** (-1 / 3))
    levels = [level(100, 0.4), level(200, 0.2)]
    assert expected_error(levels, 600) == pytest.approx(0.2 / 3)
    # one that has grown says nothing of the rate
    levels = [level(100, 0.1), level(200, 0.2)]
    assert expected_error(levels, 1600) == pytest.approx(0.2 * 8 ** (-1 / 3))
    # nor one on which all new nodes are prescribed
    levels = [level(200, 0.3), level(200, 0.2)]
    assert expected_error(levels, 1600) == pytest.approx(0.2 * 8 ** (-1 / 3))


def test_meshes_grow_to_the_accuracy():
    levels = [level(100, 0.4), level(200, 0.2)]
    assert growth_to(levels, 0.05) == pytest.approx(4.0)
    # where the error has hardly fallen it is as large as any mesh
    assert growth_to([level(100, 0.3003), level(200, 0.3)], 0.0475) == pytest.approx(np.exp(100.0))


def test_steps_are_alike():
    """No small one is left for the end."""
    for growth in (1.1, 2.2, 2.8, 2.9, 7.0, 100.0):
        step = step_of(growth)
        number = np.log(growth) / np.log(step)
        assert number == pytest.approx(round(number))
        assert step <= GROWTH * np.sqrt(GROWTH) * (1 + EPS)
        assert growth < GROWTH or step >= GROWTH / np.sqrt(GROWTH)
    assert step_of(np.exp(100.0)) == pytest.approx(GROWTH, rel=0.01)
