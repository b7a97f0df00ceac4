"""A wedge that friction locks or not: its forces follow from statics."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

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
    """No pressure anywhere is a solution without load, too, but no process leads to it.

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
