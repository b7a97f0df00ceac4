"""A slender sheet between a die and a punch, which contact alone holds."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from scenes.bent_sheet import FLAT, POISSON, THICKNESS, YOUNG, bent_sheet, plastic_sheet
from scenes.bent_sheet import STROKE as FULL

#: Motion of the punch [mm].
STROKE = 0.285


@pytest.mark.parallel(cells=[(120, 2)])
@pytest.mark.parametrize("cells", [(60, 2), (120, 2)])
def test_the_punch_has_the_force_of_a_beam(comm, cells):
    """The face that lies on the die lifts off but for its end: 71 of 242 nodes overlap at first."""
    scene = bent_sheet(comm, cells)
    with scene.problem() as problem:
        scene.data.punch.move_to((0.0, -STROKE))
        solution = problem.solve(rtol=1e-8)
    solution.raise_if_failed()
    stiffness = YOUNG / (1.0 - POISSON**2) * THICKNESS**3 / 12.0
    die, punch = (resultant.force[1] for resultant in solution.pair_resultants)
    assert die == pytest.approx(-punch, rel=1e-6)
    assert die == pytest.approx(3.0 * stiffness * STROKE / FLAT**3, rel=0.05)


@pytest.mark.long
def test_bent_into_the_die_and_released():
    """The angles are those of NAFEMS R0094, at full stroke and after springback."""
    sheet = plastic_sheet(MPI.COMM_WORLD, (120, 4))
    strokes = FULL * np.arange(1, 101) / 100.0
    steps, angles = [], []
    with sheet.problem as problem:
        for stroke in [*strokes, *(FULL - 12.0 * (np.arange(1, 31) / 30.0) ** 2)]:
            sheet.punch.move_to((0.0, -stroke))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            steps.append(len(solution.newton.steps))
            angles.append(sheet.angle())
    assert 20.0 <= angles[99] <= 23.0
    assert 43.0 <= angles[-1] <= 55.0
    assert np.mean(steps) <= 8.0 and max(steps) <= 80  # more than 30 where the sheet snaps
