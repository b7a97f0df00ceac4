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
from scipy.optimize import linprog

from dolfinx_tresca import InputError
from scenes.arch import FRICTION, RADIUS, arch, thrusts

#: Least thickness over the radius for joints everywhere.
MILANKOVITCH = 0.1075

DIVISIONS = (2, 4)

RTOL = 1e-6

REFUSED = r"no contact forces balance the loads on body \d+ of 25"


def stands(thickness, voussoirs, friction, chords):
    """Return whether forces at the corners of rigid voussoirs balance their weights.

    It is a linear programme. Unknowns are, for each joint, the normal forces inside and outside and
    the shear force; each voussoir has three equations.

    Args:
        thickness: over the radius.
        voussoirs: their number.
        friction: coefficient of friction.
        chords: number of chords that stand for the arcs of a voussoir.
    """
    phi = np.linspace(-0.5 * np.pi, 0.5 * np.pi, voussoirs + 1)
    radii = 1.0 + thickness * np.array([-0.5, 0.5])
    outwards = np.column_stack([np.sin(phi), np.cos(phi)])
    along = np.column_stack([np.cos(phi), -np.sin(phi)])
    part = np.pi / voussoirs / chords
    middles = phi[0] + part * (np.arange(voussoirs * chords) + 0.5)
    areas = np.full_like(middles, 0.5 * np.sin(part) * np.diff(radii**2)[0])
    levers = 2.0 / 3.0 * np.cos(0.5 * part) * np.diff(radii**3)[0] / np.diff(radii**2)[0]
    weights = areas.reshape(voussoirs, chords).sum(axis=1)
    moments = (-areas * levers * np.sin(middles)).reshape(voussoirs, chords).sum(axis=1)
    loads = np.column_stack([np.zeros(voussoirs), -weights, moments])

    def wrench(point, force):
        return [*force, point[0] * force[1] - point[1] * force[0]]

    columns = np.stack(
        [
            np.array([wrench(r * e, n) for e, n in zip(outwards, along, strict=True)]).T
            for r in radii
        ]
        + [np.array([wrench(e, e) for e in outwards]).T],
        axis=2,
    )  # (3, joints, 3)
    equations = np.zeros((voussoirs, 3, voussoirs + 1, 3))
    for k in range(voussoirs):
        equations[k, :, k], equations[k, :, k + 1] = columns[:, k], -columns[:, k + 1]
    slides = np.kron(np.eye(voussoirs + 1), [[-friction, -friction, s] for s in (-1.0, 1.0)])
    # least sum of what is left of the equations, which has a solution always
    count, rows = slides.shape[1], 3 * voussoirs
    left = np.hstack([np.eye(rows), -np.eye(rows)])
    found = linprog(
        np.concatenate([np.zeros(count), np.ones(2 * rows)]),
        np.hstack([slides, np.zeros((len(slides), 2 * rows))]),
        np.zeros(len(slides)),
        np.hstack([equations.reshape(rows, count), left]),
        -loads.ravel() / weights.sum(),
        [(0.0, None), (0.0, None), (None, None)] * (voussoirs + 1) + [(0.0, None)] * 2 * rows,
    )
    assert found.status == 0, found.message
    return found.fun < 1e-9  # of the weight; HiGHS leaves 1e-12


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


@pytest.mark.parametrize(("voussoirs", "below"), [(25, 5e-3), (26, 1e-3), (200, 1e-3)])
def test_rigid_blocks(voussoirs, below):
    """Voussoirs need less than joints everywhere, the less so the more they are."""
    found = least_of_rigid_blocks(voussoirs, chords=50, part=1e-4)
    assert -below < found / MILANKOVITCH - 1.0 < 2e-4


@pytest.mark.parallel
def test_an_arch_next_to_its_limit(comm):
    limit = RADIUS * least_of_rigid_blocks()
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


def test_one_declaration_is_a_pair_for_each_joint():
    scene = arch(MPI.COMM_SELF, 0.12)
    found = []
    for pairs in (scene.pairs, scene.data.by_hand):
        with scene.problem(pairs=pairs) as problem:
            found.append(problem.solve(rtol=RTOL))
            found[-1].raise_if_failed()
    one, other = found
    assert one.counts == other.counts
    assert one.primal_energy == pytest.approx(other.primal_energy, rel=10 * RTOL)
    forces = [thrusts(solution, scene.data.joints) for solution in found]
    assert np.allclose(*forces, rtol=0.0, atol=10 * RTOL * forces[0].max())


def test_springings_that_slide():
    """Springings that need more friction than there is slide outwards, and the arch stands.

    Few tractions with the bounds of the solution satisfy the equilibrium then.
    """
    scene = arch(MPI.COMM_SELF, 0.125, friction=0.39, divisions=(3, 4))
    with scene.problem() as problem:
        solution = problem.solve(rtol=RTOL)
    solution.raise_if_failed()
    normal, shear, _ = thrusts(solution, scene.data.joints)[[0, -1]].T
    assert np.abs(shear / normal) == pytest.approx(0.39, rel=10 * RTOL)


@pytest.mark.long
@pytest.mark.parametrize("friction", [0.7, 0.4, 0.39, 0.36])
def test_the_least_thickness(friction):
    """Bisection from both sides; below 0.395 the springings slide outwards before hinges open."""
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
