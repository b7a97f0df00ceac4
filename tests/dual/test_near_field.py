"""The compliance of what is near the contact, against A."""

from __future__ import annotations

import numpy as np
import pytest
from test_operator import local_random

from dolfinx_tresca.dual import near_field
from scenes.assembled import dual_program
from scenes.two_bricks import two_bricks

#: Rounding of solves with K.
SOLVE = 1e-9


@pytest.mark.parallel
def test_it_is_A_when_all_is_near(comm, monkeypatch):
    monkeypatch.setattr(near_field, "LAYERS", 10)
    with dual_program(two_bricks(comm, 4)) as dual:
        x = local_random(comm, len(dual.b), 0)
        size = np.sqrt(dual.inner(dual.b, dual.b))
        difference = dual.near_field(x) - dual.apply(x)
        assert np.abs(difference).max(initial=0.0) <= SOLVE * size


@pytest.mark.parallel
def test_it_is_less_than_A_and_close_to_it_for_rough_tractions(comm):
    """What is clamped gives way less; most of what alternating tractions do is near."""
    with dual_program(two_bricks(comm, 8)) as dual:
        for seed in range(3):
            x = local_random(comm, len(dual.b), seed)
            y = local_random(comm, len(dual.b), seed + 10)
            near, whole = dual.inner(x, dual.near_field(x)), dual.inner(x, dual.apply(x))
            assert 0.2 * whole <= near <= whole
            left, right = dual.inner(y, dual.near_field(x)), dual.inner(x, dual.near_field(y))
            assert abs(left - right) <= SOLVE * whole
        pressure = np.zeros_like(dual.b)
        pressure[dual.feasible_set.normal] = 1.0  # smooth
        near = dual.inner(pressure, dual.near_field(pressure))
        assert 0.0 < near < 0.25 * dual.inner(pressure, dual.apply(pressure))
