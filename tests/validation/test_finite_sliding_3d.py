"""Finite sliding in 3D: rotations of the whole scene."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ufl
from dolfinx import fem

from dolfinx_tresca import Coulomb, NonlinearContactProblem, RigidSphere, SolverOptions
from scenes.blocks import ABOVE, BELOW, block
from scenes.rubber_block import neo_hookean

#: Accuracy of the configuration in these tests, and of the contact problems.
GEOMETRY, RTOL = 1e-5, 1e-8
OPTIONS = SolverOptions(rtol=RTOL, geometry_accuracy=GEOMETRY)

#: Coefficient of friction.
F = 0.3


@pytest.mark.parallel(steps=[2])
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
