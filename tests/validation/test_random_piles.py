"""Random stacks and piles of stones: which of them stand, against linear programmes."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from rigid_blocks import RigidBlocks, loads_of

from dolfinx_tresca import ContactStatus, InputError
from scenes.pile import CELL, SEARCH, random_pile

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="each pile is one rank's")

RTOL = 1e-6

#: Forces and moments that contact leaves, over those of the loads: HiGHS leaves 1e-12 where there
#: is equilibrium, and the package takes 1e-8 for rounding. Between both numbers neither decides.
BALANCED, UNBALANCED = 1e-10, 1e-6

#: What the mesh changes: joints between blocks are shorter by up to a cell at both ends. Stones are
#: turned by 5e-4, which joints of the linear programme with more friction and length allow for.
LESS_FRICTION, MORE_FRICTION, LONGER = 0.99, 1.01, 1e-3

#: Of 300 piles: those whose fixed point is not found (none here; another processor may miss one,
#: such as pile 242, in which a body touches another almost without force), and those for which the
#: programmes of shorter and of longer joints differ.
MISSED, DECIDED_BY_MESH = 2, 37

REASONS = {"nothing holds": "unresisted", "no contact forces balance the loads": "falls"}


def check(seed: int) -> tuple[str, str]:
    """Check a pile; return what a programme with forces at nodes says, and one of whole joints.

    The first is "missed" if the blocks stand and no fixed point of Coulomb's law is found.
    """
    pile = random_pile(seed)
    scene = pile.scene()
    body = scene.data.body_of_cell
    loads = loads_of(scene, body)
    wanted = outcome([RigidBlocks.at_nodes(scene, body, pile.friction)], loads)
    of_joints = outcome(
        [
            RigidBlocks.of_joints(
                pile.corners, pile.on_floor, part * pile.friction, SEARCH, shorter
            )
            for part, shorter in ((LESS_FRICTION, CELL), (MORE_FRICTION, -LONGER))
        ],
        loads,
    )
    try:
        with scene.problem() as problem:
            solution = problem.solve(rtol=RTOL)
        if solution.status is ContactStatus.NO_FIXED_POINT and wanted == "stands":
            return "missed", of_joints
        assert solution.status is ContactStatus.CONVERGED, str(solution)
        size = np.abs(loads).sum()
        forces = np.array([one.force for one in solution.body_resultants])
        assert np.allclose(
            forces.sum(axis=0), -loads.reshape(-1, 3)[:, :2].sum(axis=0), atol=1e-6 * size
        )
        found = "stands"
    except InputError as error:
        (found,) = (reason for text, reason in REASONS.items() if text in str(error))
    assert wanted in (found, "near the limit")
    # the mesh can leave one node of a short joint, about which stones turn without resistance
    assert of_joints in (found, "near the limit") or (of_joints, found) == ("falls", "unresisted")
    return wanted, of_joints


def outcome(programmes: list[RigidBlocks], loads: np.ndarray) -> str:
    """Return whether blocks stand, on which programmes, from the strictest one on, agree."""
    free = [one.unresisted for one in programmes]
    if any(free):
        return "unresisted" if all(free) else "near the limit"
    left = [one.imbalance(loads) for one in programmes]
    if left[0] <= BALANCED:
        return "stands"
    return "falls" if left[-1] >= UNBALANCED else "near the limit"


# One that stands, one that falls, one with motions that nothing resists.
@pytest.mark.parametrize("seed", [22, 5, 19])
def test_piles_stand_as_linear_programmes_say(seed):
    check(seed)


# Without points of the interior-point method as other initial guesses, pile 28 is missed.
@pytest.mark.parametrize("seed", [28])
def test_piles_whose_fixed_point_is_hard_to_find(seed):
    assert check(seed)[0] == "stands"


@pytest.mark.long
def test_three_hundred_piles():
    """No pile is refused that stands, and none that falls is accepted; none is left out."""
    found, wrong = [], {}
    for seed in range(300):
        try:
            found.append(check(seed))
        except AssertionError as error:
            wrong[seed] = str(error)
    assert not wrong, wrong
    of_nodes, of_joints = zip(*found, strict=True)
    assert "near the limit" not in of_nodes
    assert of_nodes.count("missed") <= MISSED
    assert of_joints.count("near the limit") <= DECIDED_BY_MESH
