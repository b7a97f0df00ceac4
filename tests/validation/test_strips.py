"""Two slender strips, clamped at an end and pressed on each other: they stick, or slide if bent."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import Bonded, Coulomb
from scenes.strips import FRICTION, LENGTH, PRESSURE, two_strips


@pytest.mark.parallel(cells=[100])
@pytest.mark.parametrize(("cells", "degree"), [(100, 1), (100, 2), (400, 1)])
def test_strips_that_stick(comm, cells, degree):
    """They are as if they were bonded; far from the clamped end the pressure is that of the load.

    Slender bodies bend a million times as much as their surfaces are pressed in, so that pressures
    have larger errors than the residual.
    """
    found = []
    for law in (Coulomb(FRICTION), Bonded()):
        with two_strips(comm, cells, degree, law).problem() as problem:
            solution = problem.solve(rtol=1e-11)
        solution.raise_if_failed()
        found.append((solution.normal_force, solution.pressure.x.array.copy()))
        far = solution.surface.points[:, 0] > 0.5 * LENGTH
        near = solution.surface.weights > 0.0
        assert solution.surface.pressure.x.array[far & near] == pytest.approx(PRESSURE, 1e-2)
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-4)
    assert np.abs(found[0][1] - found[1][1]).max(initial=0.0) <= 5e-3 * PRESSURE


def test_strips_that_are_bent_and_let_go(comm):
    """The joint carries the load that the clamped end does not, at each of three steps."""
    scene = two_strips(comm, 100, 2)
    with scene.problem() as problem:
        for value in (0.8, 0.4, 0.0):
            scene.data.shear.value = value
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            assert solution.normal_force == pytest.approx(PRESSURE * LENGTH, rel=0.02)
