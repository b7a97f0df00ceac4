"""Contact on the tape of pyadjoint: its Taylor tests, and derivatives of `ContactProblem`."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import ufl
from dolfinx import fem

from dolfinx_tresca import ContactError, ContactForce, Coulomb, InputError, NormalForce
from scenes.elasticity import elasticity
from scenes.rubbing import rubbing

pyadjoint = pytest.importorskip("pyadjoint")
dolfinx_adjoint = pytest.importorskip("dolfinx_adjoint")
from dolfinx_tresca.pyadjoint import ContactProblem  # noqa: E402

#: Residual of the solves.
RTOL = 1e-12

#: Rates of the Taylor test may differ from 1 and 2 by this, since the first step is 0.01.
RATE = 0.1


@pytest.fixture
def tape():
    """An empty tape that records."""
    with pyadjoint.set_working_tape() as tape:
        yield tape


class Blocks:
    """Two blocks that rub, whose data are controls of dolfinx-adjoint."""

    def __init__(self, comm, upper=(3, 2), constant=dolfinx_adjoint.Constant):
        scene = rubbing(comm, "triangle", upper=upper)
        mesh, V = scene.mesh, scene.V
        Q = fem.functionspace(mesh, ("Lagrange", 1))
        self.young = dolfinx_adjoint.Constant(mesh, 1000.0)
        self.load = constant(mesh, (0.2, 0.1))
        self.coefficient = dolfinx_adjoint.Function(Q, name="F")
        self.coefficient.interpolate(lambda x: 0.25 + 0.1 * x[0])
        self.profile = dolfinx_adjoint.Function(Q, name="profile")
        self.profile.interpolate(lambda x: 1e-4 * (1.0 + x[0]))
        end = dolfinx_adjoint.Function(V, name="end")
        end.x.array[:] = 2.0 * scene.data.exact.x.array
        dofs = np.concatenate([bc.dof_indices()[0] // 2 for bc in scene.bcs])
        self.dofs = np.unique(dofs).astype(np.int32)
        bc = dolfinx_adjoint.dirichletbc(end, self.dofs, V)
        self.end = bc.g  # the step from `end` to it would need scifem
        pair = dataclasses.replace(scene.pair, friction=Coulomb(self.coefficient), gap=self.profile)
        self.stiffer = fem.Constant(mesh, 1.0)
        self.a = elasticity(V, self.stiffer * self.young)
        self.L = ufl.inner(self.load, ufl.TestFunction(V)) * ufl.dx
        self.problem = ContactProblem(self.a, self.L, [pair], [bc], stiffness="cholesky")
        self.controls = [self.young, self.load, self.coefficient, self.profile, self.end]


def direction_of(control):
    """Return a direction in which a control is changed, as large as its values."""
    result = control._ad_copy()
    result.x.array[:] *= np.cos(np.arange(len(result.x.array)) + 0.3)
    result.x.scatter_forward()
    return result


def rate(J, controls, **arguments):
    """Return the rate at which the remainder falls with the step along all controls at once."""
    directions = [direction_of(control) for control in controls]
    points = [control._ad_copy() for control in controls]
    reduced = pyadjoint.ReducedFunctional(J, [pyadjoint.Control(one) for one in controls])
    return pyadjoint.taylor_test(reduced, points, directions, **arguments)


def number(blocks):
    """Return a number on the tape that depends on a form and on a goal of a solution."""
    solution = blocks.problem.solve(rtol=RTOL)
    work = dolfinx_adjoint.assemble_scalar(ufl.action(blocks.L, solution.u))
    return blocks.problem.goal_value(ContactForce((1.0, 0.2))) ** 2 + 10.0 * work


@pytest.mark.parallel
def test_taylor(comm, tape):
    """Along a modulus, loads, friction, a gap and prescribed values, one after the other."""
    blocks = Blocks(comm)
    J = number(blocks)
    assert abs(rate(J, blocks.controls, dJdm=0.0) - 1.0) < RATE
    for control in blocks.controls:
        assert abs(rate(J, [control]) - 2.0) < RATE


def test_condition_of_dolfinx(comm, tape):
    """A Function of dolfinx-adjoint in a plain `fem.dirichletbc` is a control."""
    blocks = Blocks(comm)
    end = dolfinx_adjoint.Function(blocks.end.function_space, name="moved")
    end.x.array[:] = blocks.end.x.array
    bc = fem.dirichletbc(end, blocks.dofs)
    blocks.problem = ContactProblem(blocks.a, blocks.L, blocks.problem.pairs, [bc])
    J = number(blocks)
    assert abs(rate(J, [end], dJdm=0.0) - 1.0) < RATE
    assert abs(rate(J, [end]) - 2.0) < RATE


def test_a_process(comm, tape):
    """Through accepted load steps: a node that sticks in the last one has slipped before."""
    blocks = Blocks(comm, upper=(8, 2), constant=fem.Constant)
    problem, values = blocks.problem, []
    for factor, stiffer in ((1.0, 1.0), (-5.0, 1.0), (-4.0, 1.1)):
        blocks.load.value[:] = (0.5 * factor, 0.1)  # data: as large as they are in each step
        blocks.stiffer.value = stiffer
        solution = problem.solve(rtol=RTOL)
        problem.accept()
        values.append(problem.goal_value(ContactForce((1.0, 0.2))))
    assert solution.counts.contact_stick > 0
    problem.set_slip_origin(None)  # the next solve depends on no step
    problem.solve(rtol=RTOL)
    assert len(tape.get_blocks()[-1].get_dependencies()) == 4
    for control in (blocks.young, blocks.coefficient):
        assert abs(rate(values[0] * values[2], [control]) - 2.0) < RATE


def test_what_is_refused(comm, tape):
    """Each error says what to do."""
    blocks = Blocks(comm)
    problem = blocks.problem
    problem.solve(rtol=RTOL)
    with pytest.raises(InputError, match="one pairing of the surfaces"):
        problem.update_geometry(fem.Function(blocks.end.function_space))
    blocks.profile.x.array[:] *= 2.0
    with pytest.raises(ContactError, match="'profile' has other values than on the tape"):
        problem.solve()
    with pyadjoint.stop_annotating():
        problem.solve()
    with pytest.raises(ContactError, match="solve that is not on the tape"):
        problem.goal_value(NormalForce())
