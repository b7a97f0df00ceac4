"""Bodies pressed together and drawn aside: Cattaneo and Mindlin, there, back, and in one step."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

from scenes.cattaneo import COEFFICIENT, Cattaneo, cattaneo, cell_size
from scenes.cattaneo_cycle import APPROACH, Found, cycle_errors

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each scene is one rank's")

#: Shifts over the approach.
SHIFT, BACK = 0.3, -0.06

#: Errors over h/a, with the cells at the edge of the contact: of pressure and traction in the mean
#: square, over those of the pressure and of what it can bear; of radii; and of the shift.
PRESSURE, TRACTION, RADIUS, COMPLIANCE = 0.5, 0.5, 1.2, 0.2


def check(found: Found, theory: Cattaneo, sign: float, sheared: float, n: int) -> None:
    """Compare a solution with the theory of its forces."""
    cell = cell_size(found.dim, n, theory.radius) / theory.radius
    assert found.difference(found.pressure, theory.pressure(found.r)) <= PRESSURE * cell
    wanted = sign * theory.traction(found.r)
    assert found.difference(found.traction, wanted) <= TRACTION * COEFFICIENT * cell
    assert found.radius(found.touching) == pytest.approx(theory.radius, rel=RADIUS * cell)
    sticking = theory.stick_radius(sheared)
    assert found.radius(found.sticking) == pytest.approx(sticking, rel=RADIUS * cell)


@pytest.mark.parametrize(("dim", "n"), [(2, 24), (2, 48), (3, 12)])
def test_there_and_back(dim, n):
    """Pressure and traction are those of theory in load steps there and back, and in one step."""
    scene = cattaneo(MPI.COMM_SELF, dim, n, approach=APPROACH[dim])
    with scene.problem(stiffness="cholesky") as problem:
        pressed = Found.of(problem.solve(rtol=1e-6), dim)
        problem.accept()
        assert np.abs(pressed.traction).max() <= 0.02 * COEFFICIENT * pressed.pressure.max()
        scene.data.end.value[0] = SHIFT * APPROACH[dim]
        drawn = Found.of(problem.solve(rtol=1e-6), dim)
        problem.accept()
        scene.data.end.value[0] = BACK * APPROACH[dim]
        back = Found.of(problem.solve(rtol=1e-6), dim)
    normal, tangential = drawn.force(drawn.pressure), drawn.force(drawn.traction)
    sign = np.sign(tangential)
    theory = Cattaneo(dim, normal, abs(tangential))
    assert 0.3 < abs(tangential) / (COEFFICIENT * normal) < 0.9
    check(drawn, theory, sign, theory.tangential, n)
    if dim == 3:
        cell = cell_size(dim, n, theory.radius) / theory.radius
        assert theory.shift(finite=True) == pytest.approx(
            SHIFT * APPROACH[dim], rel=COMPLIANCE * cell
        )

    rest = sign * back.force(back.traction)
    reversed_ = Cattaneo(dim, back.force(back.pressure), rest, theory.tangential)
    check(back, reversed_, sign, 0.5 * (theory.tangential - rest), n)

    scene.data.end.value[0] = SHIFT * APPROACH[dim]
    with scene.problem(stiffness="cholesky") as problem:
        once = Found.of(problem.solve(rtol=1e-6), dim)
    # equal bodies do not slip while they are pressed: the path makes no difference
    assert once.difference(once.traction, drawn.traction) <= 1e-2 * COEFFICIENT


#: Rates at least: h where stresses end like a square root, more for integrals of them.
RATES = {"pressure": 0.7, "traction": 0.7, "contact": 1.5, "stick": 1.5, "dissipation": 1.5}

#: Loads over which errors are averaged, since they depend on where edges lie between nodes.
LOADS = (1.0, 1.2, 1.45, 1.75)

#: Bodies are mirrored, but slopes of a/R at the edge of the contact mix pressures into tractions;
#: in 3D slip is parallel only about.
MASING = {2: 1e-4, 3: 5e-4}


def check_rates(dim: int, sizes: tuple[int, ...], rates: dict[str, float]) -> None:
    """Compare fitted rates with the least ones; and check Masing's rule, and that loops close."""
    found = [cycle_errors(MPI.COMM_SELF, dim, n, 1e-9, LOADS) for n in sizes]
    cells = np.log([errors["cell"] for errors in found])
    for name, least in rates.items():
        rate = np.polyfit(cells, np.log([errors[name] for errors in found]), 1)[0]
        assert rate >= least, name
    for errors in found:
        assert errors["masing"] <= MASING[dim]
        assert errors["open"] <= 0.1 * MASING[dim]


def test_rates():
    check_rates(2, (24, 96), RATES)


@pytest.mark.long
def test_rates_in_3d():
    """Errors fall with the mesh, and the shift converges to that of the finite bodies."""
    check_rates(3, (12, 16, 24), {**RATES, "shift": 1.5})
