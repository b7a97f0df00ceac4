"""Forces and moments of pairs and bodies as a whole."""

from __future__ import annotations

import numpy as np
import pytest

from dolfinx_tresca import InputError, RigidPlane, Tresca
from dolfinx_tresca.solution.forces import Resultant
from scenes.blocks import BELOW, RIGHT, block, floor


@pytest.mark.parallel
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_supports_take_the_load(comm, dim, degree):
    """A block in a corner: what floor and wall do to it balances the load, with its moments."""
    wall = RigidPlane((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    load = np.array([0.3, 0.02, -1.0])
    model = block(
        comm,
        (3, 2, 3)[:dim],
        degree=degree,
        load=load,
        friction=Tresca(0.1),
        obstacles=[(BELOW, floor(dim)), (RIGHT, wall)],
    )
    load = load[[0, 2]] if dim == 2 else load
    with model.problem() as problem:
        solution = problem.solve(rtol=1e-9)
    for point in (np.zeros(dim), np.arange(3.0, 3.0 + dim)):
        below, beside = solution.resultants(point)
        (body,) = solution.body_resultants
        middle = np.array([0.5, 0.5, 1.0])[-dim:]  # of the upper face, on which the load is even
        applied = Resultant(load, np.zeros(3 if dim == 3 else 1), middle).about(point)
        np.testing.assert_allclose(below.force + beside.force, -load, atol=1e-8)
        np.testing.assert_allclose(below.moment + beside.moment, -applied.moment, atol=1e-7)
        np.testing.assert_allclose(body.about(point).moment, -applied.moment, atol=1e-7)
        # each presses from its side
        assert below.force[-1] > 0.5 > 0.0 > beside.force[0]
    assert solution.normal_force == pytest.approx(below.force[-1] - beside.force[0], abs=0.1 * 2.0)


def test_moments_about_other_points():
    """About (0, 0, 1) a force of 2 along x at the origin turns by -2 about y."""
    force = np.array([2.0, 0.0, 0.0])
    one = Resultant(force, np.zeros(3), np.zeros(3)).about((0, 0, 1))
    np.testing.assert_array_equal(one.moment, [0.0, -2.0, 0.0])
    np.testing.assert_array_equal(one.about([0.0, 0.0, 0.0]).moment, np.zeros(3))
    flat = Resultant(np.array([0.0, 3.0]), np.zeros(1), np.zeros(2)).about((-2.0, 5.0))
    np.testing.assert_array_equal(flat.moment, [6.0])
    for wrong in ((1.0, 2.0), "x", (np.nan, 0.0, 0.0), None):
        with pytest.raises(InputError, match="must be 3 finite numbers"):
            one.about(wrong)
