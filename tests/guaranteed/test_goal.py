"""Guaranteed bounds of goals from both sides, against values that are known."""

from __future__ import annotations

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactForce,
    Coulomb,
    GuaranteedGoal,
    InputError,
    MeanPressure,
    NormalForce,
)
from scenes.elasticity import fixed
from scenes.known_contact import HELD, block_on_plane
from scenes.manufactured import blocks_scene


def value(comm, form):
    return comm.allreduce(fem.assemble_scalar(fem.form(form)))


def force_on_plane(scene, direction):
    """Return the component of the exact force, whose weight is zero where the block is held."""
    w, (test, trial) = fem.Function(scene.V), scene.a.arguments()
    floor = fem.locate_dofs_geometrical(scene.V, lambda x: np.isclose(x[1], 0.0) & (x[0] > 1e-9))
    w.x.array.reshape(-1, 2)[floor] = direction
    work = ufl.replace(scene.a, {trial: scene.data.exact, test: w})
    return value(scene.V.mesh.comm, work - ufl.replace(scene.L, {scene.L.arguments()[0]: w}))


@pytest.mark.parallel(kind=["slips"])
@pytest.mark.parametrize("kind", ["lifts", "slips"])
def test_known_solutions_on_a_plane(comm, kind):
    """The exact value is inside, also where contact ends, and the width falls faster than h."""
    widths = []
    for n in (8, 16):
        scene = block_on_plane(comm, "triangle", 1, n, kind, distort=0.3, seed=n)
        v, component = ufl.TestFunction(scene.V), 1 if kind == "lifts" else 0
        goals = {
            NormalForce(): force_on_plane(scene, (0.0, 1.0)),
            ContactForce((2.0, 1.0)): force_on_plane(scene, (2.0, 1.0)),
            v[component] * ufl.dx: value(comm, scene.data.exact[component] * ufl.dx),
        }
        with scene.problem() as problem:
            problem.solve(rtol=1e-8)
            before = problem.guaranteed_error().error
            for goal, exact in goals.items():
                bounds = problem.guaranteed_goal(goal)
                assert bounds.lower <= exact <= bounds.upper
                assert bounds.lower <= bounds.value <= bounds.upper
                widths.append(bounds.upper - bounds.lower)
            assert problem.guaranteed_error().error == pytest.approx(before, rel=1e-9)
    coarse, fine = np.split(np.array(widths), 2)
    assert (fine < 0.5 * coarse).all()


def test_two_bodies(comm):
    scene = blocks_scene(comm, "triangle", 1, (8, 8))
    with scene.problem() as problem:
        problem.solve(rtol=1e-8)
        bounds = problem.guaranteed_goal(ufl.TestFunction(scene.V)[1] * ufl.dx)
        exact = value(comm, scene.data.exact[1] * ufl.dx)
        assert bounds.lower <= exact <= bounds.upper
        assert bounds.upper - bounds.lower <= 0.05 * abs(exact)


def test_goals_without_bounds(comm):
    scene = block_on_plane(comm, "triangle", 1, 4, "slips")
    with scene.problem() as problem:
        problem.solve(rtol=1e-6)
        with pytest.raises(InputError, match="NormalForce, a ContactForce or a linear form"):
            problem.guaranteed_goal(MeanPressure((0.5, 0.0), 0.1))
        with pytest.raises(InputError, match="space of the displacement"):
            problem.guaranteed_goal(scene.a)
        with pytest.raises(InputError, match="numbered from 0"):
            problem.guaranteed_goal(NormalForce(1))
        with pytest.raises(InputError, match="no free displacement changes the goal"):
            problem.guaranteed_goal(ufl.TestFunction(scene.V)[0] * ufl.ds(99))
    with scene.problem(L=None, bcs=[fixed(scene.V, scene.facet_tags.find(HELD))]) as problem:
        problem.solve(rtol=1e-6)  # nothing loads the block
        assert problem.guaranteed_goal(NormalForce()) == GuaranteedGoal(0.0, 0.0, 0.0)
    with scene.but(friction=Coulomb(0.1)).problem() as problem:
        problem.solve(rtol=1e-6)
        with pytest.raises(InputError, match="do not depend on the pressure"):
            problem.guaranteed_goal(NormalForce())
