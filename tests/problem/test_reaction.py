"""Forces and moments of supports against statics."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactPair,
    ContactProblem,
    Coulomb,
    InputError,
    NonlinearContactProblem,
    RigidPlane,
    SolverOptions,
)
from scenes.elasticity import elasticity

FLOOR, WALL, BED, TOP = 1, 2, 3, 4


def block(comm, *, nonlinear=False, bed=0.0):
    """A block on a floor with friction, held at a wall (x = 0), or on a bed of springs there."""
    mesh = dolfinx.mesh.create_box(comm, [[0, 0, 0], [2, 1, 1]], [4, 2, 2])
    facets, values = [], []
    for tag, axis, at in ((FLOOR, 2, 0.0), (WALL, 0, 0.0), (BED, 0, 2.0), (TOP, 2, 1.0)):
        found = dolfinx.mesh.locate_entities_boundary(
            mesh, 2, lambda x, axis=axis, at=at: abs(x[axis] - at) < 1e-9
        )
        facets.append(found)
        values.append(np.full(len(found), tag, dtype=np.int32))
    order = np.argsort(np.concatenate(facets), kind="stable")
    tags = dolfinx.mesh.meshtags(
        mesh, 2, np.concatenate(facets)[order], np.concatenate(values)[order]
    )
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=tags)
    a = elasticity(V, 100.0) + bed * ufl.inner(u, v) * ds(BED)
    load = fem.Constant(mesh, np.array([0.3, 0.1, -1.0]))
    L = ufl.inner(load, v) * ds(TOP)
    bcs = []
    if not bed:
        nodes = fem.locate_dofs_topological(V, 2, tags.find(WALL))
        bcs = [fem.dirichletbc(np.zeros(3), nodes, V)]
    floor = RigidPlane(point=(0, 0, -0.001), normal=(0, 0, 1))
    pair = ContactPair(tags, FLOOR, floor, Coulomb(0.3))
    options = SolverOptions(rtol=1e-10)
    if nonlinear:
        w = fem.Function(V)
        F = ufl.replace(a, {u: w}) - L
        return NonlinearContactProblem(F, w, [pair], bcs, options=options), load
    return ContactProblem(a, L, [pair], bcs, options=options), load


@pytest.mark.parallel
@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("bed", [0.0, 20.0])
def test_support_and_contact_balance_the_load(comm, nonlinear, bed):
    """In forces and moments, whether a condition holds the block or a bed of springs."""
    problem, load = block(comm, nonlinear=nonlinear, bed=bed)
    solution = problem.solve()
    origin = np.zeros(3)
    support = problem.reaction(BED if bed else WALL, origin)
    contact = solution.resultants(origin)[0]
    total = 2.0 * load.value
    force = support.force + contact.force + total
    moment = support.moment + contact.moment + np.cross([1.0, 0.5, 1.0], total)
    assert np.linalg.norm(contact.force) > 0.1
    assert np.abs(force).max() <= 1e-6 and np.abs(moment).max() <= 1e-6
    if not bed:
        (bc,) = problem._forms_at(solution.u).bcs
        same = problem.reaction(bc)
        assert np.allclose(same.about(origin).moment, support.moment, atol=1e-12)


@pytest.mark.parallel
@pytest.mark.parametrize("nonlinear", [False, True])
@pytest.mark.parametrize("bed", [0.0, 20.0])
def test_a_support_as_a_goal(comm, nonlinear, bed):
    """Its derivative with respect to the load, against a difference; and its row in tables."""
    problem, load = block(comm, nonlinear=nonlinear, bed=bed)
    tag, direction = BED if bed else WALL, np.array([1.0, 0.0, 0.5])
    values, step = [], 1e-4
    for change in (step, -step, 0.0):
        load.value[2] = -1.0 + change
        solution = problem.solve()
        values.append(problem.reaction(tag).force @ direction)
        goal = problem.reaction_form(tag, direction)
        number = comm.allreduce(fem.assemble_scalar(fem.form(goal)))
        assert number == pytest.approx(values[-1], rel=1e-6)
    (exact,) = problem.gradient(goal, [load])
    assert (values[0] - values[1]) / (2 * step) == pytest.approx(exact[2], rel=1e-4)
    assert f"support        tag {tag}: (" in solution.summary()


def test_what_is_wrong_is_named():
    problem, load = block(MPI.COMM_SELF)
    with pytest.raises(ContactError, match=r"call solve\(\) first"):
        problem.reaction(WALL)
    problem.solve()
    for where, message in (
        (99, "no facet has the tag 99"),
        ("wall", "needs the tag of a surface, or a Dirichlet condition"),
    ):
        with pytest.raises(InputError, match=message):
            problem.reaction(where)
    with pytest.raises(InputError, match="direction must be 3 finite numbers"):
        problem.reaction_form(WALL, (1, 0))
    load.value[2] = -2.0
    with pytest.raises(ContactError, match="have changed since the solution"):
        problem.reaction(WALL)


@pytest.mark.parallel
def test_a_body_that_has_been_moved_away_needs_no_force(comm):
    """All forces are zero but for rounding, which is no sign of a change of loads."""
    mesh = dolfinx.mesh.create_unit_square(comm, 4, 4)
    tags = [
        dolfinx.mesh.locate_entities_boundary(mesh, 1, lambda x, y=y: abs(x[1] - y) < 1e-9)
        for y in (0.0, 1.0)
    ]
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    place = fem.Constant(mesh, np.zeros(2))
    held = fem.dirichletbc(place, fem.locate_dofs_topological(V, 1, tags[1]), V)
    floor = RigidPlane(point=(0, 0, 0), normal=(0, 1, 0))
    lower = dolfinx.mesh.meshtags(mesh, 1, tags[0], np.full(len(tags[0]), FLOOR, dtype=np.int32))
    pair = ContactPair(lower, FLOOR, floor, Coulomb(0.3))
    with ContactProblem(elasticity(V, 1e5), None, [pair], [held]) as problem:
        for height, least in ((-0.1, 100.0), (0.5, 0.0)):
            place.value[1] = height
            problem.solve().raise_if_failed()
            force = problem.reaction(held).force
            assert -force[1] >= least
        assert np.abs(force).max() <= 1e-8
