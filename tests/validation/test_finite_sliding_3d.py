"""Finite sliding in 3D: all cells, both degrees, sides exchanged, rotations of the whole scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ufl
from dolfinx import fem

from dolfinx_tresca import Coulomb, NonlinearContactProblem, RigidSphere, SolverOptions
from scenes.blocks import ABOVE, BELOW, block
from scenes.elasticity import fixed
from scenes.patches import BOTTOM, LOWER, TOP, UPPER, patch
from scenes.rubber_block import neo_hookean

#: Accuracy of the configuration in these tests, and of the contact problems.
GEOMETRY, RTOL = 1e-5, 1e-8
OPTIONS = SolverOptions(rtol=RTOL, geometry_accuracy=GEOMETRY)

#: Coefficient of friction.
F = 0.3

#: Motion of the upper block, more than a cell along both axes, and how deep it is pressed.
WAY, DEPTH = (0.45, 0.3), 0.02

#: Where the upper block is at the end, along both axes.
END = (0.5, 0.9)

#: Difference of forces from sides that are exchanged, over the forces: these meshes are coarse.
EXCHANGED = 0.1


def pushed(comm, kind, degree, way, exchanged=False):
    """Return the force on the upper block at the end of its way, without friction."""
    span = [(END[0] - x, END[1] - x) for x in way]
    scene = patch(comm, kind, degree, upper=(1, 1), lower=(3, 1), distort=0.0, span=span)
    tags = scene.facet_tags
    top = fixed(scene.V, tags.find(TOP), np.array([*way, -DEPTH]))
    pairs = scene.but(sliding="finite").pairs
    if exchanged:
        pairs = [replace(pair, secondary=LOWER, primary=UPPER) for pair in pairs]
    bcs = [top, fixed(scene.V, tags.find(BOTTOM))]
    with scene.problem(bcs=bcs, pairs=pairs, options=OPTIONS) as problem:
        solution = problem.solve()
        solution.raise_if_failed()
    return (-1.0 if exchanged else 1.0) * solution.pair_resultants[0].force


@pytest.mark.parallel(kind=["tetrahedron"], degree=[1])
@pytest.mark.parametrize(
    "kind, degree, exchanged",
    [
        ("tetrahedron", 1, False),
        ("tetrahedron", 2, True),
        ("hexahedron", 1, True),
        ("hexahedron", 2, False),
    ],
)
def test_a_block_pushed_over_another_one(comm, kind, degree, exchanged):
    """The forces are those of a block that stands there, within the mesh error on either side."""
    force = pushed(comm, kind, degree, WAY, exchanged)
    wanted = pushed(comm, kind, degree, (0.0, 0.0))
    relative = EXCHANGED if exchanged else 5 * GEOMETRY
    assert np.allclose(force, wanted, rtol=0.0, atol=relative * np.linalg.norm(wanted))


@pytest.mark.parametrize("steps", [2, pytest.param(10, marks=pytest.mark.long)])
def test_a_rotation_of_all_changes_nothing(comm, steps):
    """A block of rubber that rubs on a ball is turned with it, by 90 degrees in 10 steps.

    The ball and the top of the block turn about the same axis, oblique to the contact. Forces turn
    with them, nothing slips and nothing is dissipated.
    """
    axis, about = np.array([0.6, 0.0, 0.8]), np.array([0.2, 0.1, -0.3])
    ball = RigidSphere((0.5, 0.45, -0.95), 1.0)
    scene = block(
        comm, (2, 2, 1), size=(1.0, 1.0, 0.5), friction=Coulomb(F), obstacles=[(BELOW, ball)]
    )
    u, motion = fem.Function(scene.V), fem.Function(scene.V)
    residual = ufl.derivative(neo_hookean(u) * ufl.dx, u, ufl.TestFunction(scene.V))
    top = fem.locate_dofs_topological(scene.V, 2, scene.facet_tags.find(ABOVE))
    pairs = scene.but(sliding="finite").pairs
    bcs = [fem.dirichletbc(motion, top)]
    forces, slips = [], []
    with NonlinearContactProblem(residual, u, pairs, bcs, options=OPTIONS) as problem:
        for angle in np.pi / 20 * np.arange(steps + 1):
            turn = Rotation.from_rotvec(angle * axis)
            R = turn.as_matrix()
            ball.move_to(rotation=angle * axis, about=about)

            def moved(x, R=R):
                pushed_top = x + np.array([[0.04], [0.02], [-0.03]])
                return R @ (pushed_top - about[:, None]) + about[:, None] - x

            motion.interpolate(moved)
            solution = problem.solve()
            solution.raise_if_failed()
            problem.accept()
            forces.append(turn.inv().apply(solution.pair_resultants[0].force))
            slips.append(solution.greatest_slip)
    size = np.linalg.norm(forces[0])
    assert np.abs(forces[0]).min() > 0.01 * size
    assert np.allclose(forces, forces[0], rtol=0.0, atol=10 * len(forces) * GEOMETRY * size)
    assert max(slips[1:]) <= 10 * GEOMETRY * slips[0]
