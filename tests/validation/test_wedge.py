"""A wedge that is driven in and let go: friction holds it where it is steep enough."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from dolfinx_tresca import Coulomb, RigidPlane
from scenes.blocks import LEFT, RIGHT, block
from scenes.scene import Scene

#: Half of the angle of the wedge, the force that drives it in, and the requested residual.
SLOPE, FORCE, RTOL = np.arctan(0.1), 10.0, 1e-8


def wedge(comm: MPI.Comm, friction: float) -> Scene:
    """Return a square whose right side is one of the wedge's."""
    scene = block(
        comm,
        (2, 2),
        load=(0.0, 0.0, 0.0),
        across=(LEFT,),
        obstacles=[(RIGHT, RigidPlane((1, 0), (-np.cos(SLOPE), np.sin(SLOPE))))],
        friction=Coulomb(friction),
        boxes=True,
    )
    x = scene.mesh.geometry.x
    x[:, 0] *= 1.0 + x[:, 1] * np.tan(SLOPE)
    return scene


@pytest.mark.parallel
@pytest.mark.parametrize(("friction", "asked"), [(0.3, {"rtol": RTOL}), (0.05, {})])
def test_what_is_left_of_a_wedge_without_load(comm, friction, asked):
    """Without a load no pressure anywhere is a solution as well, but none that a process leads to.

    So is it with loads that are nearly nothing. It takes cos(a) (F - tan(a)) of the normal force, a
    fifth, to bring the wedge out.
    """
    scene = wedge(comm, friction)
    width = 1.0 + np.tan(SLOPE)
    locks = friction > np.tan(SLOPE)
    with scene.problem() as problem:
        for load in (FORCE, 1e-9 * FORCE, 0.0, *([-0.25 * FORCE] if locks else [])):
            scene.data.load.value[1] = -load / width
            solution = problem.solve(**asked)
            solution.raise_if_failed()
            problem.accept()
            normal, upwards = solution.normal_force, solution.pair_resultants[0].force[1]
            tolerance = (RTOL if asked else 1e-2) * FORCE
            assert upwards == pytest.approx(load, abs=tolerance)
            if load == FORCE:
                slips = FORCE / (np.sin(SLOPE) + friction * np.cos(SLOPE))
                assert normal == pytest.approx(slips, rel=RTOL if asked else 1e-2)
                driven = normal
            elif locks:
                assert normal > 0.5 * driven
                assert solution.counts.contact_stick > 0
            else:
                assert normal < 1e-6 * driven


@pytest.mark.parallel
def test_a_trial_that_is_not_accepted_leaves_no_trace(comm, folder: Path) -> None:
    """A trial without friction lets the wedge go; with friction again it is where it was, locked.

    No pressure anywhere would be a solution as well. So is it in another run, which begins with the
    state that was saved after the trial.
    """
    normal, products = {}, {}
    for trial in (False, True):
        scene = wedge(comm, 0.3)
        friction = fem.Constant(scene.mesh, 0.3)
        with scene.but(friction=Coulomb(friction)).problem() as problem:
            scene.data.load.value[1] = -FORCE / (1.0 + np.tan(SLOPE))
            driven = problem.solve(rtol=RTOL).normal_force
            problem.accept()
            scene.data.load.value[1] = 0.0
            if trial:
                friction.value = 0.0
                assert problem.solve(rtol=RTOL).normal_force < RTOL * driven
                friction.value = 0.3
                problem.save_state(folder / "state.npz")
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
            normal[trial], products[trial] = solution.normal_force, solution.products
    assert normal[False] > 0.5 * driven
    # each residual leaves an error of up to RTOL of what the load moves, times the stiffness
    assert normal[True] == pytest.approx(normal[False], abs=10 * RTOL * driven)
    assert products[True] <= products[False]  # the trial's are known
    with wedge(comm, 0.3).problem() as problem:
        problem.load_state(folder / "state.npz")
        assert problem.solve(rtol=RTOL).normal_force == pytest.approx(
            normal[False], abs=10 * RTOL * driven
        )
