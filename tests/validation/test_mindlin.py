"""Bodies rubbed to and fro: Masing's rule, loops that close, and what a cycle dissipates.

R. D. Mindlin and H. Deresiewicz 1953. By Masing's rule a whole cycle follows from the shift s(Q)
under a force that grows: it dissipates 4 Q s(Q) - 8 times the integral of s from 0 to Q, to which
what is linear in s adds nothing.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from scipy.integrate import quad

from dolfinx_tresca import ContactSolution, Coulomb
from scenes.cattaneo import COEFFICIENT, POISSON, YOUNG, Cattaneo, cattaneo, cell_size
from scenes.nodal import nodal
from scenes.patches import patch

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each scene is one rank's")

#: Approach [mm], which makes the contact some 12 cells wide on the coarsest mesh; shift over it.
APPROACH, SHIFT = {2: 2e-4, 3: 4e-4}, {2: 0.5, 3: 0.4}

#: Residual that is asked for, and what it leaves of tractions, over their size.
RTOL, DIGITS = 1e-11, 1e-7

#: Error of the dissipation over h and the width of what slips.
DISSIPATION = 0.3


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


def cycle_work(theory: Cattaneo) -> float:
    """Return what a cycle with the amplitude `theory.tangential` dissipates [N mm, in 2D N]."""
    bearable = COEFFICIENT * theory.normal
    end = theory.tangential / bearable
    if theory.dim == 2:
        modulus = 0.5 * YOUNG / (1.0 - POISSON[2] ** 2)
        scale = bearable / (np.pi * modulus)

        def shift(q: float) -> float:
            return (1.0 - q) * np.log(1.0 - q) + q
    else:
        scale = Cattaneo(3, theory.normal, bearable).shift()

        def shift(q: float) -> float:
            return 1.0 - (1.0 - q) ** (2 / 3)

    return float(scale * bearable * (4.0 * end * shift(end) - 8.0 * quad(shift, 0.0, end)[0]))


def dissipation_error(dim: int, n: int) -> tuple[float, float]:
    """Return the error of a cycle's dissipation over it, and h over the width of what slips."""
    scene = cattaneo(MPI.COMM_SELF, dim, n, approach=APPROACH[dim])
    end = SHIFT[dim] * APPROACH[dim]
    cycle: list[ContactSolution] = []
    with scene.problem(stiffness="cholesky") as problem:
        for shift in (0.0, end, -end, end):
            scene.data.end.value[0] = shift
            cycle.append(problem.solve(rtol=RTOL))
            problem.accept()
    there, back = cycle[-2:]
    halves = dim - 1  # y = 0 is a plane of symmetry
    P, Q = (halves * f for f in (back.normal_force, back.tangential_force))
    theory = Cattaneo(dim, P, Q)
    work = halves * (there.dissipation + back.dissipation)
    slips = theory.radius - theory.stick_radius(Q)
    return work / cycle_work(theory) - 1.0, cell_size(dim, n, theory.radius) / slips


def test_dissipation_of_a_cycle():
    """In 2D; in 3D the demo of fretting does it."""
    error, cell = dissipation_error(2, 48)
    assert abs(error) <= DISSIPATION * cell


@pytest.mark.long
@pytest.mark.parametrize(("dim", "sizes"), [(2, (24, 48, 96, 192)), (3, (12, 16, 20))])
def test_dissipation_under_refinement(dim, sizes):
    """Errors fall with h; in 2D how much depends on where edges lie between nodes."""
    errors, cells = np.array([dissipation_error(dim, n) for n in sizes]).T
    assert (np.abs(errors) <= DISSIPATION * cells).all()
    if dim == 3:  # the edge crosses cells everywhere
        assert np.polyfit(np.log(cells), np.log(np.abs(errors)), 1)[0] > 1.0
