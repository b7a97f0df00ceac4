"""Derivatives through a process: against central differences where no node changes its state."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from rubbing_controls import Rubbing, along, smooth, values_of

import ufl
from dolfinx import fem

from dolfinx_tresca import (
    ContactError,
    ContactForce,
    ContactPair,
    ContactProblem,
    ContactState,
    Coulomb,
    InputError,
    NormalForce,
    RigidSphere,
)
from scenes.blocks import ABOVE, BELOW, block

#: Residual of the solves; step of central differences of order 4 over the controls.
RTOL, STEP = 1e-12, 2e-4

#: Error of central differences that the solves' residuals and the step allow, over the derivative.
ACCURACY = 1e-6

#: Parts of the drag and of the pressing in each load step: nodes slip to one side, stick as the
#: drag turns, slip to the other side, and stick again.
DRAG = (0.6, 1.0, -1.0, -5.0, -4.5)
PRESS = (1.0, 1.0, 1.1, 0.9, 0.97)


#: States without slip: of what is pressed, and of what is open.
STICKING = (ContactState.STICK, ContactState.OPEN_STICK)


class Process:
    """Load steps of two blocks, of which all data are controls."""

    def __init__(self, comm, kind, law="coulomb", **arguments):
        self.model = model = Rubbing(comm, kind, law=law, **arguments)
        model.factor.value *= 2.0
        self.problem = ContactProblem(*model.arguments, stiffness="cholesky")
        self.u = fem.Function(model.end.function_space)
        self.work = fem.form(ufl.action(model.L, self.u))
        dim = model.load.value.size
        self.controls = model.controls
        self.base = {id(one): values_of(one).copy() for one in self.controls}
        self.factors = [
            np.tile([*[drag] * (dim - 1), press], len(model.end.x.array) // dim)
            for drag, press in zip(DRAG, PRESS, strict=True)
        ]

    def run(self, amount=0.0):
        """Return goals and the work of each step (steps, goals), solutions, and the tape.

        Args:
            amount: by how much all controls are changed along their directions.
        """
        problem, model = self.problem, self.model
        for control in self.controls:
            values_of(control)[...] = self.base[id(control)] + amount * self.direction(control)
        problem.update_stiffness()
        problem.set_slip_origin(None)
        end = model.end.x.array.copy()
        values, solutions = [], []
        with problem.record() as tape:
            for step, factor in enumerate(self.factors):
                model.end.x.array[:] = factor * end
                model.load.value[-1] = step * model.load.value[0]
                solution = problem.solve(rtol=RTOL)
                solution.raise_if_failed()
                self.u.x.array[:] = solution.u.x.array
                work = problem.comm.allreduce(fem.assemble_scalar(self.work))
                values.append([*map(problem.goal_value, model.goals), work])
                solutions.append(solution)
                problem.accept()
        return np.array(values), solutions, tape

    def check_states(self, solutions):
        """Return the states of nodes (steps, nodes), the same in all runs."""
        states = np.array([one.state.x.array for one in solutions])
        self.states = getattr(self, "states", states)
        assert np.array_equal(states, self.states)
        return states

    def direction(self, control):
        """Return the direction of a control, as large as its values."""
        largest = np.abs(self.base[id(control)]).max(initial=1e-2)
        comm = self.problem.comm
        return max(comm.allgather(largest)) * smooth(control)

    def along(self, tape, goals):
        """Return the derivative of a sum of goals along the direction of each control."""
        steps = tape.gradient_by_step(goals, self.controls)
        parts = np.zeros(len(self.controls))
        for number, (derivatives, factor) in enumerate(zip(steps, self.factors, strict=True)):
            for k, (control, by) in enumerate(zip(self.controls, derivatives, strict=True)):
                direction = self.direction(control)
                if control is self.model.end:
                    direction = factor * direction
                if control is self.model.load:
                    direction = np.append(direction[:-1], number * direction[0])
                parts[k] += along(by, direction)
        return parts


@pytest.mark.parallel(kind=["triangle", "tetrahedron"])
@pytest.mark.parametrize(
    ("kind", "law", "upper"),
    [
        ("triangle", "tresca", (8, 2)),
        ("quadrilateral", "coulomb", (8, 2)),
        ("tetrahedron", "ellipse", (3, 2)),
        ("triangle", "curve", (8, 2)),
    ],
)
def test_central_differences(comm, kind, law, upper):
    """Of goals of single steps, of sums over steps, and of controls that change in each step."""
    process = Process(comm, kind, law, upper=upper)
    changed = {}
    for amount in (1.0, -1.0, 2.0, -2.0):
        changed[amount], solutions, _ = process.run(amount * STEP)
        process.check_states(solutions)
    slopes = 8.0 * (changed[1.0] - changed[-1.0]) - (changed[2.0] - changed[-2.0])
    slopes /= 12.0 * STEP
    _, solutions, tape = process.run()
    sticks = np.isin(process.check_states(solutions), STICKING)
    assert comm.allreduce(int((sticks[1:] & ~sticks[:-1]).sum())) > 0
    assert comm.allreduce(int((sticks[:-1] & ~sticks[1:]).sum())) > 0
    for weights in ({1: 1.0}, {1: -0.5, 3: 2.0, 4: 1.0}):
        for k, goal in enumerate([*process.model.goals, None]):
            goals = {
                step: [(weight, goal or ufl.action(process.model.L, solutions[step].u))]
                for step, weight in weights.items()
            }
            wanted = sum(weight * slopes[step, k] for step, weight in weights.items())
            parts = process.along(tape, goals)
            assert abs(parts.sum() - wanted) <= ACCURACY * np.abs(parts).max()
    young = [process.model.young]
    of_steps = tape.gradient_by_step(goals, young)
    by_step = np.array([of_step[0] for of_step in of_steps])
    summed = tape.gradient(goals, young)[0]
    assert abs(summed - by_step.sum()) <= 100 * np.finfo(float).eps * np.abs(by_step).sum()


def test_functions_whose_constants_change(comm):
    """A Constant that changes from step to step is a coefficient, is read by a curve, is hidden."""
    model = Rubbing(comm, "triangle", upper=(8, 2))
    c = fem.Constant(model.end.function_space.mesh, 0.3)
    hidden = [c]
    a, L, [pair], bcs = model.arguments
    derivatives = []
    for law in (c, lambda p, v: float(c.value) + 0.0 * p, lambda p, v: hidden[0].value + 0.0 * p):
        pair = dataclasses.replace(pair, friction=Coulomb(law))
        with ContactProblem(a, L, [pair], bcs, stiffness="cholesky") as problem:
            with problem.record() as tape:
                for c.value in (0.3, 0.2):
                    problem.solve(rtol=RTOL)
                    problem.accept()
            if len(derivatives) < 2:
                derivatives.append(tape.gradient_by_step({1: model.goals[1]}, [c]))
            else:
                with pytest.raises(InputError, match=r"law of friction .* than in load step 0"):
                    tape.gradient_by_step({1: model.goals[1]}, [c])
    by_number, by_curve = np.array(derivatives).reshape(2, 2)
    assert np.abs(by_number).max() > 0.0
    assert np.abs(by_curve - by_number).max() <= ACCURACY * np.abs(by_number).max()


def test_constants_that_only_the_derivatives_of_a_curve_read(comm):
    """They have the value of each step again when its derivatives are computed."""
    model = Rubbing(comm, "triangle", upper=(8, 2))
    mesh = model.end.function_space.mesh
    c, slopes, values = fem.Constant(mesh, 0.3), [], []
    law = Coulomb(lambda p, v: c.value / (1.0 + 0.2 * p) + 0.0 * v)
    a, L, [pair], bcs = model.arguments
    pair = dataclasses.replace(pair, friction=law)
    change = 1e-4
    for first_value in (0.3, 0.3 - change, 0.3 + change):
        with ContactProblem(a, L, [pair], bcs, stiffness="cholesky") as problem:
            with problem.record() as tape:
                for value in (first_value, 0.2):
                    c.value = value
                    problem.solve(rtol=RTOL)
                    values.append(problem.goal_value(model.goals[1]))
                    problem.accept()
            slopes.append(tape.gradient_by_step({0: model.goals[1]}, [c])[0][0])
    quotient = (values[4] - values[2]) / (2.0 * change)
    assert slopes[0] == pytest.approx(quotient, rel=1e-4) and quotient != 0.0


def test_what_cannot_be_recorded(comm):
    """Each error says what has changed, or what to give."""
    process = Process(comm, "triangle")
    problem, young, force = process.problem, process.model.young, NormalForce()
    with problem.record() as tape:
        with pytest.raises(ContactError, match="records its load steps already"):
            with problem.record():
                pass
        with pytest.raises(ContactError, match=r"no solution for a recorded load step: call solve"):
            problem.accept()
        problem.solve()
        process.model.load.value *= 2.0
        with pytest.raises(ContactError, match="have changed since the solution that a recorded"):
            problem.accept()
        problem.solve()
        problem.accept()
        problem.set_slip_origin(None)
        problem.solve()
        with pytest.raises(ContactError, match="slip history has changed since the last recorded"):
            problem.accept()
    assert len(tape) == 1
    problem.accept()
    assert len(tape) == 1
    for goals, message in (
        ({1: force}, r"such as {0: NormalForce\(\)}, with numbers from 0 to 0, found {1:"),
        (force, r"must be a dictionary from numbers of recorded steps"),
        ({0: [force]}, r"a list of pairs such as \(2.0, NormalForce\(\)\), found NormalForce"),
        ({0: 3.0}, r"goal must be a NormalForce"),
        ({0: process.model.L}, "a form with arguments"),
    ):
        with pytest.raises(InputError, match=message):
            tape.gradient(goals, [young])
    with pytest.raises(InputError, match=r"must be a fem\.Constant or a fem\.Function, found 3"):
        tape.gradient({0: force}, [3.0])
    with pytest.raises(InputError, match=r"controls must be a list of .* found an object of type"):
        tape.gradient({0: force}, young)
    assert tape.gradient({}, [young])[0] == 0.0
    problem.update_stiffness()
    with pytest.raises(ContactError, match=r"stiffness or the pairing .* has changed since"):
        tape.gradient({0: force}, [young])
    far = Rubbing(comm, "triangle", sliding="finite")
    with ContactProblem(*far.arguments) as problem, pytest.raises(InputError, match="pairing of"):
        with problem.record():
            pass


@pytest.mark.parametrize("dim", [2, 3])
def test_places_of_obstacles(comm, dim):
    """The centre and radius of a ball on which a block is dragged to and fro, in all steps."""
    n, end = ((4, 3), (0.56, -2.0)) if dim == 2 else ((3, 3, 2), (0.56, 0.41, -2.0))
    scene = block(comm, n, load=(0.0, 0.0, 0.0), held=[ABOVE])
    centre, radius = fem.Constant(scene.mesh, end), fem.Constant(scene.mesh, 2.0)
    pair = ContactPair(scene.facet_tags, BELOW, RigidSphere(centre, radius), Coulomb(0.3))
    goals = [NormalForce(), ContactForce(np.eye(dim)[0])]
    direction = np.cos(np.arange(dim) + 0.3)
    with ContactProblem(scene.a, scene.L, [pair], scene.bcs, stiffness="cholesky") as problem:

        def run(amount):
            """Return goals (steps, goals), the states of all nodes, and the tape."""
            centre.value, radius.value = end + amount * direction, 2.0 + amount
            problem.set_slip_origin(None)
            values, states = [], []
            with problem.record() as tape:
                for along_first in (0.02, -0.02, -0.015):
                    scene.data.held.x.array.reshape(-1, dim)[:, 0] = along_first
                    scene.data.held.x.array.reshape(-1, dim)[:, -1] = -0.05
                    solution = problem.solve(rtol=RTOL)
                    values.append([problem.goal_value(goal) for goal in goals])
                    states.append(solution.surfaces[0].state.x.array.copy())
                    problem.accept()
            return np.array(values), np.array(states), tape

        changes = {k: run(k * 0.1 * STEP) for k in (1, -1, 2, -2)}
        _, states, tape = run(0)
        sticks = np.isin(states, STICKING)
        assert (sticks[1:] & ~sticks[:-1]).any()
        assert all(np.array_equal(states, one[1]) for one in changes.values())
        wanted = 8.0 * (changes[1][0] - changes[-1][0]) - (changes[2][0] - changes[-2][0])
        wanted /= 1.2 * STEP
        for step, (goal, k) in itertools.product((1, 2), zip(goals, (0, 1), strict=True)):
            by_centre, by_radius = tape.gradient({step: goal}, [centre, radius])
            parts = [*by_centre * direction, by_radius]
            assert abs(sum(parts) - wanted[step, k]) <= ACCURACY * np.abs(parts).max()
        centre.value[0] += 1e-3
        with pytest.raises(ContactError, match="obstacles are elsewhere than in the recorded"):
            tape.gradient({2: goals[0]}, [centre])
        problem.solve(rtol=RTOL)
        with problem.record() as tape:
            problem.accept()
        with pytest.raises(InputError, match="and recording began without slip"):
            tape.gradient({0: goals[0]}, [centre])
