"""A flange with 12 preloaded bolts: the joint diagram, and what the bolts carry when it opens."""

from __future__ import annotations

from collections import Counter

from mpi4py import MPI

import numpy as np
import pytest

from scenes.flange import BOLTS, YOUNG, flange
from scenes.scene import EPS

RTOL = 1e-6

#: Strain by which the bolts shrink.
SHRINKAGE = 2e-3


def forces_on_heads(solution) -> np.ndarray:
    """Return the force along the axis with which the upper ring presses each head (BOLTS,)."""
    between = solution.between_bodies
    rings = {body for body, _ in Counter(np.ravel([*between])).most_common(2)}
    found: dict[int, float] = {}
    for (i, j), one in between.items():
        for bolt, force in ((i, one.force[2]), (j, -one.force[2])):
            if bolt not in rings:
                found[bolt] = max(force, found.get(bolt, 0.0))
    return np.array([*found.values()])


@pytest.mark.long
def test_the_bolts_of_a_flange_that_opens() -> None:
    """The joint diagram (VDI 2230): bolts take the part n Phi of the load, and all after opening.

    Between rigid rings the force of a bolt would be E A times the shrinkage. It is smaller by the
    factor 1 - Phi, where Phi is the compliance of rings and heads over that of all parts. A load
    between the heads does not unload all of the clamped length, hence n < 1. The rings part at the
    preload over 1 - n Phi if they do so at once, and later if they rotate.
    """
    scene = flange(MPI.COMM_SELF)
    with scene.problem() as problem:

        def step(load: float) -> np.ndarray:
            scene.data.load.value = load / scene.data.area
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
            problem.accept()
            clamped, heads, nuts = (one.force[2] for one in solution.pair_resultants)
            bolts = forces_on_heads(solution)
            assert len(bolts) == BOLTS
            rounding = 1e5 * EPS * bolts.sum()  # equilibrium is exact, whatever the residual
            assert heads == pytest.approx(bolts.sum(), abs=rounding)
            assert nuts == pytest.approx(-heads, abs=rounding)  # of the bolts
            assert clamped == pytest.approx(heads - load, abs=rounding)  # of the upper ring
            assert np.ptp(bolts) <= 100.0 * RTOL * bolts.mean()  # by symmetry
            return bolts.sum()

        scene.data.shrinkage.value = SHRINKAGE
        preload = step(0.0)
        phi = 1.0 - preload / (BOLTS * YOUNG * scene.data.section * SHRINKAGE)
        share = (step(0.2 * preload) - preload) / (0.2 * preload)
        assert 0.0 < share < phi < 0.2
        assert 1.0 < step(preload) / preload < 1.1
        for load in (1.3, 1.5):  # the rings have parted
            assert step(load * preload) == pytest.approx(load * preload, rel=1e5 * EPS)
