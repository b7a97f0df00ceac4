"""The least thickness of a semicircular arch: Couplet's problem.

With friction that excludes sliding and radial joints everywhere it is 0.1075 of the radius of the
centre line (Milankovitch 1907; Makris and Alexakis 2013, "The effect of stereotomy on the shape of
the thrust-line and the minimum thickness of semicircular masonry arches", Archive of Applied
Mechanics 83), with hinges outside at the crown and at the springings, and inside at 54.5 degrees
from the crown. Voussoirs of finite size can open at their joints only, so they need a little less.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from rigid_blocks import RigidBlocks

from dolfinx_tresca import InputError
from scenes.arch import FRICTION, RADIUS, arch, thrusts

#: Least thickness over the radius for joints everywhere.
MILANKOVITCH = 0.1075

DIVISIONS = (2, 4)

RTOL = 1e-6

REFUSED = r"no contact forces balance the loads on body \d+ of 25"


def stands(thickness, voussoirs, friction, chords):
    """Return whether forces at the corners of so many rigid voussoirs balance their weights.

    The thickness is that over the radius; chords, in this number, stand for a voussoir's arcs.
    """
    phi = np.linspace(-0.5 * np.pi, 0.5 * np.pi, voussoirs + 1)
    radii = 1.0 + thickness * np.array([-0.5, 0.5])
    outwards = np.column_stack([np.sin(phi), np.cos(phi)])
    along = np.column_stack([np.cos(phi), -np.sin(phi)])
    angle = np.pi / voussoirs / chords
    middles = phi[0] + angle * (np.arange(voussoirs * chords) + 0.5)
    areas = np.full_like(middles, 0.5 * np.sin(angle) * np.diff(radii**2)[0])
    levers = 2.0 / 3.0 * np.cos(0.5 * angle) * np.diff(radii**3)[0] / np.diff(radii**2)[0]
    weights = areas.reshape(voussoirs, chords).sum(axis=1)
    moments = (-areas * levers * np.sin(middles)).reshape(voussoirs, chords).sum(axis=1)
    loads = np.column_stack([np.zeros(voussoirs), -weights, moments])
    # normal and tangential forces inside and outside of each joint, on the voussoirs beside it
    forces = np.zeros((2, voussoirs, 3, voussoirs + 1, 2))
    for kind, direction in enumerate((along, outwards)):
        for end, radius in enumerate(radii):
            x = radius * outwards
            moment = x[:, 0] * direction[:, 1] - x[:, 1] * direction[:, 0]
            wrench = np.column_stack([direction, moment])
            for k in range(voussoirs):
                forces[kind, k, :, k, end] = wrench[k]
                forces[kind, k, :, k + 1, end] = -wrench[k + 1]
    blocks = RigidBlocks(*forces.reshape(2, 3 * voussoirs, -1), friction)
    return blocks.imbalance(loads.ravel()) < 1e-9  # of the weight; HiGHS leaves 1e-12


def least(holds, low, high, part):
    """Return the least thickness that holds, from below and from above, by bisection."""
    assert not holds(low) and holds(high)
    while high - low > part * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return low, high


def least_of_rigid_blocks(voussoirs=25, friction=FRICTION, chords=DIVISIONS[0], part=1e-6):
    return least(lambda t: stands(t, voussoirs, friction, chords), 0.05, 0.3, part)[1]


def hinges(solution, joints, thickness):
    """Return the joints whose resultant passes within a hundredth of the thickness of an edge.

    As angles from the crown [degrees], positive outside and negative inside.
    """
    normal, _, moment = thrusts(solution, joints).T
    place = moment / normal / thickness
    assert np.abs(place).max() < 0.5 + RTOL
    some = np.abs(place) > 0.49
    return np.degrees(joints[some]), np.sign(place[some])


@pytest.mark.parallel
def test_an_arch_next_to_its_limit(comm):
    limit = RADIUS * least_of_rigid_blocks()
    assert -5e-3 < limit / RADIUS / MILANKOVITCH - 1.0 < 2e-4
    thickness = 1.001 * limit
    scene = arch(comm, thickness, divisions=DIVISIONS)
    with scene.problem() as problem:
        solution = problem.solve(rtol=RTOL)
        solution.raise_if_failed()
    found, sides = hinges(solution, scene.data.joints, thickness)
    assert np.allclose(found, [-90.0, -54.0, -3.6, 3.6, 54.0, 90.0])
    assert np.array_equal(sides, [1, -1, 1, 1, -1, 1])
    thinner = arch(comm, 0.999 * limit, divisions=DIVISIONS)
    with thinner.problem() as problem:
        with pytest.raises(InputError, match=REFUSED):
            problem.solve(rtol=RTOL)


def test_springings_that_slide():
    """Springings that need more friction than there is slide outwards, and the arch stands."""
    scene = arch(MPI.COMM_SELF, 0.125, friction=0.39, divisions=(3, 4))
    with scene.problem() as problem:
        solution = problem.solve(rtol=RTOL)
    solution.raise_if_failed()
    normal, shear, _ = thrusts(solution, scene.data.joints)[[0, -1]].T
    assert np.abs(shear / normal) == pytest.approx(0.39, rel=10 * RTOL)


@pytest.mark.long
@pytest.mark.parametrize("friction", [0.7, 0.4, 0.39, 0.36])
def test_the_least_thickness(friction):
    """The least thickness by bisection is that of rigid blocks, also where springings slide."""
    wanted = RADIUS * least_of_rigid_blocks(friction=friction, part=1e-7)

    def holds(thickness):
        scene = arch(MPI.COMM_SELF, thickness, friction=friction, divisions=DIVISIONS)
        with scene.problem() as problem:
            try:
                solution = problem.solve(rtol=RTOL)
            except InputError as error:
                assert "no contact forces balance the loads" in str(error)
                return False
            solution.raise_if_failed()
            return True

    low, high = least(holds, 0.9 * wanted, 1.2 * wanted, 1e-4)
    assert low <= wanted * (1.0 + 1e-5) and high >= wanted * (1.0 - 1e-5)
    if friction > 0.395:
        assert 0.98 * MILANKOVITCH < low and high < 1.02 * MILANKOVITCH
