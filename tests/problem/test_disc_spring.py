"""A disc spring between two plates, which contact alone holds: flat, beyond, and back to rest."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import Coulomb, Frictionless
from scenes.disc_spring import HEIGHT, OUTER, POISSON, THICKNESS, YOUNG, disc_spring

#: Deflections at which the spring is loaded, flat, squeezed, flat, unloaded, and at rest [mm].
PATH = (0.2, HEIGHT, HEIGHT + 0.01, HEIGHT, 0.2, 0.0)


def almen_laszlo(deflection: float) -> float:
    """Return the force [N] of the theory of Almen and Laszlo (1936), for a ratio of radii of 2."""
    s, h = deflection / THICKNESS, HEIGHT / THICKNESS
    factor = 4.0 * YOUNG / (1.0 - POISSON**2) * THICKNESS**4 / (0.694 * (2.0 * OUTER) ** 2)
    return factor * s * ((h - s) * (h - s / 2.0) + 1.0)


@pytest.mark.parallel(friction=[Coulomb(0.15)], unit=[1.0])
@pytest.mark.parametrize("friction", [Frictionless(), Coulomb(0.15)])
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_flat_and_back_to_rest(comm, friction, unit):
    """Forces follow theory and balance, whole faces close at once, and nothing remains at rest."""
    problem, plate = disc_spring(comm, friction, "finite", unit=unit)
    forces, steps = [], []
    with problem:
        for deflection in PATH:
            plate.move_to((0.0, -unit * deflection))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            low, up = (one.force[1] / unit**2 for one in solution.pair_resultants)
            assert low == pytest.approx(-up, rel=1e-3, abs=1e-6)
            forces.append(low)
            steps.append(len(solution.newton.steps))
        assert np.abs(problem.u.x.array).max(initial=0.0) <= 1e-12 * unit * OUTER
    assert forces[0] == pytest.approx(almen_laszlo(PATH[0]), rel=0.1)  # of thin shells
    assert forces[-1] == pytest.approx(0.0, abs=1e-6)
    if isinstance(friction, Frictionless):
        assert forces[3:5] == pytest.approx(forces[1::-1], rel=1e-3)
    assert max(steps) <= 10


def test_a_face_that_closes_takes_few_steps(comm):
    """On planes without friction finite sliding has the forces of small sliding."""
    forces = []
    for sliding in ("small", "finite"):
        problem, plate = disc_spring(comm, Frictionless(), sliding, (24, 2))
        with problem:
            for deflection in (0.5 * HEIGHT, 0.975 * HEIGHT, HEIGHT):
                plate.move_to((0.0, -deflection))
                solution = problem.solve()
                solution.raise_if_failed()
                problem.accept()
        assert solution.counts.contact > 24
        assert len(solution.newton.steps) <= 12
        forces.append(solution.pair_resultants[0].force[1])
    assert forces[0] == pytest.approx(forces[1], rel=1e-3)


def test_springs_in_the_contact_leave_no_force_unbalanced(comm):
    """The tangent of a tall spring is indefinite: springs held it, and forces differed by 1 %."""
    height, added, forces = 1.8, set(), {}
    path = (0.5, 1.0, 1.4, 1.6, 1.7, 1.75, 1.79, 1.8, 1.81)
    problem, plate = disc_spring(comm, Frictionless(), "small", height=height)
    with problem:
        for deflection in (*path, *path[-2::-1]):
            plate.move_to((0.0, -deflection))
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            added |= {step.added for step in solution.newton.steps}
            low, up = (resultant.force[1] for resultant in solution.pair_resultants)
            assert low == pytest.approx(-up, rel=2e-4)
            assert low == pytest.approx(forces.setdefault(deflection, low), rel=1e-3)
    assert "contact 10" in added
