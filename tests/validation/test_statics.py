"""Scenes whose forces follow from statics: a wedge, and a belt round a drum."""

from __future__ import annotations

import dataclasses

from mpi4py import MPI

import numpy as np
import pytest

from dolfinx import fem

from dolfinx_tresca import (
    Coulomb,
    RigidPlane,
    RigidSphere,
)
from scenes.blocks import LEFT, RIGHT, YOUNG, block
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


#: Coefficient, angle of contact, cells along it, thickness of the belt over the drum's radius.
BELT_FRICTION, ANGLE, CELLS, THICKNESS = 0.3, np.pi, 24, 0.05

#: Force on the free end, which goes to the right at the top.
FREE_FORCE = 0.1


def test_slip_spreads_over_a_belt():
    """The forces of a belt are those of Euler and Eytelwein, before and after its slip has turned.

    The drum takes the moment of friction about its axis.
    """
    scene = block(
        MPI.COMM_SELF,
        (CELLS, 1),
        size=(ANGLE, THICKNESS),
        load=(0.0, 0.0, 0.0),
        poisson=0.0,
        pull=FREE_FORCE / THICKNESS,
        boxes=True,
    )
    x = scene.mesh.geometry.x
    along, radius = x[:, 0].copy(), 1.0 + x[:, 1]
    x[:, 0], x[:, 1] = -radius * np.sin(along), -radius * np.cos(along)
    part, _ = scene.V.sub(0).collapse()
    end = fem.Function(part)  # turns round the axis with the drum
    held = fem.locate_dofs_topological((scene.V.sub(0), part), 1, scene.facet_tags.find(LEFT))
    pair = dataclasses.replace(
        scene.pair, primary=RigidSphere((0, 0), 1.0), friction=Coulomb(BELT_FRICTION)
    )
    middle = 1.0 + 0.5 * THICKNESS
    spread = ANGLE / CELLS
    # nothing rubs at the end that is held, which has half a cell
    exponent = BELT_FRICTION * (ANGLE - 0.5 * spread) / middle
    stretch = FREE_FORCE / (THICKNESS * YOUNG * BELT_FRICTION) * np.expm1(exponent)
    logarithms = []
    with scene.problem(pairs=[pair], bcs=[fem.dirichletbc(end, held, scene.V.sub(0))]) as problem:
        for pull in (0.0, 0.2, 0.5, 1.5):
            end.interpolate(lambda x, pull=pull: -pull * stretch * x[1])
            solution = problem.solve(rtol=RTOL)
            solution.raise_if_failed()
            problem.accept()
            (moment,) = solution.resultants((0, 0))[0].moment
            logarithms.append(np.log1p(-moment / middle / FREE_FORCE))
    # the trapezoidal rule
    tolerance = exponent * spread**2
    assert abs(logarithms[0] + exponent) < tolerance
    assert (np.diff(logarithms) > 0.0).all()
    assert abs(logarithms[-1] - exponent) < tolerance
