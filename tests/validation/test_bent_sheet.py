"""A slender sheet between a die and a punch, which contact alone holds."""

from __future__ import annotations

import pytest

from scenes.bent_sheet import FLAT, POISSON, THICKNESS, YOUNG, bent_sheet

#: Motion of the punch [mm].
STROKE = 0.285


@pytest.mark.parallel(cells=[(120, 2)])
@pytest.mark.parametrize("cells", [(60, 2), (120, 2)])
def test_the_punch_has_the_force_of_a_beam(comm, cells):
    """The face that lies on the die lifts off but for its end: 71 of 242 nodes overlap at first.

    Newton's method on the multipliers took no step from the states at the start.
    """
    scene = bent_sheet(comm, cells)
    with scene.problem() as problem:
        scene.data.punch.move_to((0.0, -STROKE))
        solution = problem.solve(rtol=1e-8)
    solution.raise_if_failed()
    stiffness = YOUNG / (1.0 - POISSON**2) * THICKNESS**3 / 12.0
    die, punch = (resultant.force[1] for resultant in solution.pair_resultants)
    assert die == pytest.approx(-punch, rel=1e-6)
    assert die == pytest.approx(3.0 * stiffness * STROKE / FLAT**3, rel=0.05)
