"""Large sliding: the cases of docs/large_sliding_cases.md, on coarse meshes and on its meshes."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import Coulomb, Frictionless, SolverOptions
from scenes.large_sliding import (
    RADIUS,
    half_ring,
    hemisphere,
    hertz_far_away,
    iron,
    ironing,
    press,
    there_and_back,
)

#: Accuracy of forces and gaps relative to the largest ones (`geometry_accuracy`): the default.
GEOMETRY = SolverOptions().geometry_accuracy

#: Published vertical and horizontal forces of shallow ironing [N], lowest and highest.
PUBLISHED = {1.0: ((268.0, 332.0), (55.0, 71.0)), 1.5: ((338.0, 421.0), (102.0, 189.0))}

#: Corners of the hemisphere's closed path.
IN_SPACE = (0.0, 0.0, -0.2), (1.6, 0.0, -0.2), (1.6, 0.0, -0.3), (0.0, 0.0, -0.3)


@pytest.mark.long
def test_shallow_ironing_to_the_end(comm):
    """Forces are within the published range; at t = 2, near its end, the foundation gives way."""
    found = []
    for n in (40, 60):
        body = ironing(comm, n)
        with body.problem:
            found.append(iron(body, n // 5))
        assert np.mean(body.newton_steps) < 12.0
    coarse, fine = found
    for time, both in PUBLISHED.items():
        for force, (low, high) in zip(fine[time], both, strict=True):
            assert low < force < high
    assert np.allclose(coarse[2.0], fine[2.0], rtol=0.1)
    assert (fine[2.0] < fine[1.5]).all()


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("make", "n", "corners", "cell"),
    [
        (ironing, 40, [(0.0, -0.4), (0.6, -0.4), (0.0, -0.5)], 0.6),
        pytest.param(ironing, 60, [(0, -0.4), (5, -0.4), (0, -0.5)], 0.6, marks=pytest.mark.long),
        pytest.param(hemisphere, 6, IN_SPACE, 0.33, marks=pytest.mark.long),
    ],
)
def test_closed_path(comm, make, n, corners, cell):
    """Without friction displacement and energy come back."""
    body = make(comm, n, Frictionless())
    with body.problem:
        assert max(there_and_back(body, corners, cell).values()) < 10.0 * GEOMETRY


@pytest.mark.parallel
def test_hertz_far_away(comm, caplog):
    """A cylinder that comes from 50 radii away has the pressure of one that is meshed there."""
    far, here = (hertz_far_away(comm, 0.24, x) for x in (50.0 * RADIUS, 0.0))
    assert "linear theory" not in caplog.text
    assert far.peak == pytest.approx(here.peak, rel=10.0 * GEOMETRY)
    assert far.difference == pytest.approx(here.difference, rel=0.01)
    assert here.difference < 0.1  # the error of five cells on half of the contact


@pytest.mark.parallel
@pytest.mark.parametrize(
    ("n", "depths", "error"),
    [
        (16, (2.0, 4.0), 0.03),
        pytest.param(32, np.linspace(2.0, 20.0, 10), 0.02, marks=pytest.mark.long),
    ],
)
def test_half_ring_with_sides_exchanged(comm, n, depths, error):
    """The force is the same within the mesh error, whichever side is the secondary one."""
    found = []
    for exchanged in (False, True):
        ring = half_ring(comm, n, Coulomb(0.5), exchanged=exchanged)
        with ring.problem:
            found.append(ring.force(press(ring, depths)))
    assert abs(found[0][0]) < GEOMETRY * found[0][1]  # symmetry
    assert found[1][1] == pytest.approx(found[0][1], rel=error)
