"""Bodies rubbed to and fro: Masing's rule where it is exact, and loops that close.

Against the theory of half-spaces: `test_cattaneo.py`.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx_tresca import ContactSolution, Coulomb
from scenes.cattaneo import COEFFICIENT
from scenes.nodal import nodal
from scenes.patches import patch

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each scene is one rank's")

#: Requested residual, and what it leaves of tractions, over their size.
RTOL, DIGITS = 1e-11, 1e-7


def along(solution: ContactSolution) -> np.ndarray:
    """Return the traction along x of all nodes."""
    return nodal(solution.traction)[:, 0]


@pytest.mark.parametrize(("degree", "shifts"), [(1, (0.03, 0.05, 0.08)), (2, (0.11, 0.13, 0.15))])
def test_masing(degree, shifts):
    """In 2D slip is parallel; mirrored bodies that meet in a plane keep their pressures: exact."""
    divisions = (24, 4)
    scene = patch(
        MPI.COMM_SELF,
        "quadrilateral",
        degree,
        upper=divisions,
        lower=divisions,
        distort=0.0,
        friction=Coulomb(COEFFICIENT),
    )
    x, height = scene.V.tabulate_dof_coordinates().T[:2]
    side = np.where(height > 1.0, 1.0, -1.0)
    ends = scene.data.exact.x.array.reshape(-1, 2)
    ends[:, 1] = -1e-3 * side * (1.0 - 2.5 * (2.0 * x - 1.0) ** 2)

    with scene.problem() as problem:

        def to(shift: float) -> ContactSolution:
            ends[:, 0] = 1e-3 * shift * side
            solution = problem.solve(rtol=RTOL)
            problem.accept()
            return solution

        pressed = to(0.0)
        up = [to(shift) for shift in shifts]
        there = [to(shifts[-1] - 2.0 * shift) for shift in shifts]
        back = [to(2.0 * shift - shifts[-1]) for shift in shifts]
        short = [to(shift) for shift in (-shifts[-1], shifts[-1])]
    size = DIGITS * COEFFICIENT * pressed.peak_pressure
    assert np.abs(along(pressed)).max() <= size
    sticking = [solution.counts.contact_stick for solution in up]
    assert sticking[0] > sticking[1] > sticking[2] > 0
    for first, second, third in zip(up, there, back, strict=True):
        assert first.normal_force == pytest.approx(pressed.normal_force, rel=DIGITS)
        np.testing.assert_allclose(along(second), along(up[-1]) - 2.0 * along(first), atol=size)
        np.testing.assert_allclose(along(third), -along(second), atol=size)
    np.testing.assert_allclose(along(back[-1]), along(up[-1]), atol=size)  # the loop closes
    # both ways slip by twice as much under the same traction, in one step or three
    work = [sum(solution.dissipation for solution in way) for way in (up, there, back, short)]
    twice = 2.0 * work[0]
    assert work[1:] == pytest.approx([twice, twice, 2.0 * twice], rel=DIGITS)
