"""Forces and moments of supports against statics."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactError, Coulomb, InputError, NonlinearContactProblem, SolverOptions
from scenes.blocks import ABOVE, BELOW, LEFT, RIGHT, block, floor
from scenes.elasticity import fixed


def block_at_a_wall(comm, *, nonlinear=False, bed=0.0):
    """Return the problem of a block on a floor with friction, and its load.

    It is held at a wall, or on a bed of springs at the other side.
    """
    scene = block(
        comm,
        (4, 2, 2),
        size=(2.0, 1.0, 1.0),
        young=100.0,
        held=() if bed else (LEFT,),
        obstacles=[(BELOW, floor(3, -0.001))],
        friction=Coulomb(0.3),
    )
    u, v = ufl.TrialFunction(scene.V), ufl.TestFunction(scene.V)
    ds = ufl.Measure("ds", domain=scene.mesh, subdomain_data=scene.facet_tags)
    a = scene.a + bed * ufl.inner(u, v) * ds(RIGHT)
    options = SolverOptions(rtol=1e-10)
    if nonlinear:
        w = fem.Function(scene.V)
        F = ufl.replace(a, {u: w}) - scene.L
        problem = NonlinearContactProblem(F, w, scene.pairs, scene.bcs, options=options)
    else:
        problem = scene.problem(a=a, options=options)
    return problem, scene.data.load


@pytest.mark.parallel
@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("bed", [0.0, 20.0])
def test_support_and_contact_balance_the_load(comm, nonlinear, bed):
    """In forces and moments, whether a condition holds the block or a bed of springs."""
    problem, load = block_at_a_wall(comm, nonlinear=nonlinear, bed=bed)
    solution = problem.solve()
    origin = np.zeros(3)
    support = problem.reaction(RIGHT if bed else LEFT, origin)
    contact = solution.resultants(origin)[0]
    total = 2.0 * load.value
    force = support.force + contact.force + total
    moment = support.moment + contact.moment + np.cross([1.0, 0.5, 1.0], total)
    assert np.linalg.norm(contact.force) > 0.1
    assert np.abs(force).max() <= 1e-6 and np.abs(moment).max() <= 1e-6
    if not bed:
        (bc,) = problem._contact.linear.bcs
        same = problem.reaction(bc)
        assert np.allclose(same.about(origin).moment, support.moment, atol=1e-12)


@pytest.mark.parallel
@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_support_as_a_goal(comm, nonlinear):
    """Its derivative with respect to the load, against a difference; and its row in tables."""
    problem, load = block_at_a_wall(comm, nonlinear=nonlinear)
    direction, step, values = np.array([1.0, 0.0, 0.5]), 1e-4, []
    for change in (step, -step, 0.0):
        load.value[2] = -1.0 + change
        solution = problem.solve()
        values.append(problem.reaction(LEFT).force @ direction)
        pull = fem.Function(solution.u.function_space)
        pull.interpolate(lambda x: np.outer(direction, np.isclose(x[0], 0.0)))
        goal = ufl.action(problem._residual_at(solution.u), pull)
        number = comm.allreduce(fem.assemble_scalar(fem.form(goal)))
        assert number == pytest.approx(values[-1], rel=1e-6)
    (exact,) = problem.gradient(goal, [load])
    assert (values[0] - values[1]) / (2 * step) == pytest.approx(exact[2], rel=1e-4)
    assert f"support        tag {LEFT}: (" in str(solution)


def test_what_is_wrong_is_named():
    problem, load = block_at_a_wall(MPI.COMM_SELF)
    with pytest.raises(ContactError, match=r"call solve\(\) first"):
        problem.reaction(LEFT)
    problem.solve()
    for where, message in (
        (99, "no facet has the tag 99"),
        ("wall", "needs the tag of a surface, or a Dirichlet condition"),
    ):
        with pytest.raises(InputError, match=message):
            problem.reaction(where)
    load.value[2] = -2.0
    with pytest.raises(ContactError, match="have changed since the solution"):
        problem.reaction(LEFT)


@pytest.mark.parallel
def test_a_body_that_has_been_moved_away_needs_no_force(comm):
    """All forces are zero but for rounding, which is no sign of a change of loads."""
    scene = block(comm, (4, 4), young=1e5, load=(0.0, 0.0, 0.0), friction=Coulomb(0.3))
    place = fem.Constant(scene.mesh, np.zeros(2))
    held = fixed(scene.V, scene.facet_tags.find(ABOVE), place)
    with scene.problem(bcs=[held]) as problem:
        for height, least in ((-0.1, 100.0), (0.5, 0.0)):
            place.value[1] = height
            problem.solve().raise_if_failed()
            force = problem.reaction(held).force
            assert -force[1] >= least - 1e-8
        assert np.abs(force).max() <= 1e-8
