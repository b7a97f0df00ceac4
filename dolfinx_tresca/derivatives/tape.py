"""Accepted load steps of a problem, for derivatives through its slip history."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import Array, integer, real
from dolfinx_tresca.contact.contact_system import ContactSystem
from dolfinx_tresca.contact.step_state import StepSolution
from dolfinx_tresca.derivatives.change_of_data import Control, DataOfSolution
from dolfinx_tresca.derivatives.goals import WeightedGoals, as_derivatives, gradient
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.dual.load_steps import SlipHistory
from dolfinx_tresca.dual.nodal_values import inputs_of, replaced, values_of
from dolfinx_tresca.dual.slip_bounds import TERMS
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.scene.pair import Goal
from dolfinx_tresca.solvers.feasible_set import CurveAtNodes

#: The quantity of a step that is differentiated: a goal, or a sum of goals as pairs (factor, goal).
GoalsOfStep: TypeAlias = "Goal | ufl.Form | Sequence[tuple[float, Goal | ufl.Form]]"


@dataclass(frozen=True)
class _Recorded:
    """An accepted load step, as the tape keeps it until gradients are asked for.

    Attributes:
        values: values of all inputs of the problem in this step, in the order of the tape's.
        curves: each friction curve with the pressures [stress] and slips [length] of its nodes.
        laws: `ContactSystem.law_values` of the step.
    """

    linearised: LinearisedContact
    obstacle_moves: bool
    values: Sequence[Array]
    curves: Sequence[CurveAtNodes]
    laws: Sequence[Array]


class ProcessTape:
    """The accepted load steps of a problem, and derivatives of goals through all of them.

    `ContactProblem.record` makes a tape. For each step, the tape keeps in memory the displacement,
    the multipliers, and the values of all Constants and Functions in forms, gaps, laws of friction
    and Dirichlet conditions; values that do not change from one step to the next are kept once. Of
    Constants that a Python function reads, those are kept that are variables of the function.

    Slip is measured from the positions in which friction held the surfaces in the previous step, so
    a goal of the last step depends on all steps. Derivatives take an adjoint solve for each step.

    Example:
        The cube in the example of `ContactProblem`, pressed more and more in two steps; the
        derivative of the force with respect to the displacement prescribed in each step:

        >>> from dolfinx_tresca import ContactProblem, NormalForce
        >>> down = fem.Constant(cube, (0.0, 0.0, -1e-3))
        >>> bcs = [fem.dirichletbc(down, pressed, V)]
        >>> pressing = ContactProblem(a, L, [pair], bcs=bcs)
        >>> with pressing.record() as tape:
        ...     for down.value[2] in (-1e-3, -2e-3):
        ...         solution = pressing.solve(rtol=1e-8)
        ...         pressing.accept()
        >>> first, second = tape.gradient_by_step({1: NormalForce()}, [down])
        >>> [f"{float(by[0][2]):.1f} N/mm" for by in (first, second)]
        ['0.0 N/mm', '-1000.0 N/mm']
    """

    def __init__(
        self,
        contact: ContactSystem,
        solved_for: Callable[[str], StepSolution],
        residual_at: Callable[[fem.Function], ufl.Form],
    ) -> None:
        """Begin without steps. Not collective.

        The function `solved_for` (purpose) returns the last solve of the problem, or raises an
        error that names the purpose, and `residual_at` (u) returns internal minus external forces.
        """
        self._contact, self._solved_for, self._residual_at = contact, solved_for, residual_at
        self.comm = contact.comm
        # all Constants and Functions on which solutions depend, but for places of obstacles and
        # directions of friction; values of `bcs` may be C++ objects
        inputs: list[Any] = []
        for form in contact.linear.ufl_forms:
            if form is not None:
                inputs += [*form.coefficients(), *form.constants()]
        for pair in contact.pairs:
            terms = pair.friction.terms
            bounds = [getattr(terms, name) for name in TERMS]
            functions = [getattr(terms.curve, name, None) for name in ("function", "derivatives")]
            inputs += inputs_of((pair.gap, *bounds, *functions))
        inputs += [bc.g for bc in contact.linear.bcs]
        self._inputs = list(dict.fromkeys(inputs))
        self._steps: list[_Recorded] = []
        self._history: SlipHistory = contact.state.history  # after the last recorded step

    def __len__(self) -> int:
        return len(self._steps)

    def __repr__(self) -> str:
        return f"<ProcessTape: {len(self)} load step(s) of {self._contact!r}>"

    @contextmanager
    def adding_step(self) -> Iterator[None]:
        """Record the last solution as a step; inside the block, `ContactProcess.accept` accepts it.

        The solution is read before the block, which replaces the slip history from which it was
        computed; it is added to the tape after the block, if this raises no error. Collective.
        """
        contact = self._contact
        step = self._solved_for("a recorded load step")
        contact.check_inputs("a recorded load step")
        if self._steps and contact.state.history is not self._history:
            raise ContactError(
                "the slip history has changed since the last recorded load step, by "
                "set_slip_origin(), load_state(), continue_from(), surfaces that were paired anew, "
                "or another direction or ratio of the bounds of orthotropic friction. Leave the "
                "block of record(), and begin another one."
            )
        # without the sum of slips at all nodes, which takes as much memory as u
        dual = copy(step.dual)
        dual.history = replace(dual.history, slipped=())
        linearised = LinearisedContact(dual, step.multipliers, step.fields.u, contact.slip_bounds())
        yield
        self._history = contact.state.history
        # arrays that have not changed since the last step are shared with it
        values = [values_of(control).copy() for control in self._inputs]
        former_values = self._steps[-1].values if self._steps else []
        for number, former in enumerate(former_values):
            if np.array_equal(former, values[number]):
                values[number] = former
        moves = bool(step.obstacle_moves.any())
        self._steps.append(_Recorded(linearised, moves, values, step.curves, step.laws))

    @collective(comm_of_self)
    def gradient(self, goals: Mapping[int, GoalsOfStep], controls: Sequence[Control]) -> list[Any]:
        """Return the derivatives of a sum of goals with respect to controls. Collective.

        The values of controls are taken to be the same in all steps: the result is the sum of
        `gradient_by_step` over the steps, for one adjoint solve for each step up to the last one
        with a goal. As for `ContactProblem.gradient`, solve accurately. The slip at which recording
        begins counts as independent of the controls.

        Args:
            goals: number of a recorded step, from 0 on -> a goal of `ContactProblem.gradient`, or a
                sequence of pairs (factor, goal). A form depends on the `solution.u` of that step.
            controls: see `ContactProblem.gradient`.

        Returns:
            for each control the derivatives with respect to its values [unit of the sum of the
            goals divided by the unit of the control]: for a Constant, an array of its shape; for a
            Function, a Function on its space.

        Raises:
            ContactError: the problem was destroyed, or K or the pairing changed since recording.
            InputError: a step, a goal or a control is wrong.
            ConvergenceError: with the contact state kept, rigid motions of bodies change a goal.
        """
        by_step = self._derivatives(goals, controls)  # checks the controls first
        columns = zip([0.0] * len(controls), *by_step, strict=True)  # of each control in all steps
        return as_derivatives([sum(column) for column in columns], controls, self.comm)

    @collective(comm_of_self)
    def gradient_by_step(
        self, goals: Mapping[int, GoalsOfStep], controls: Sequence[Control]
    ) -> list[list[Any]]:
        """Return the derivatives of goals with respect to controls in each step. Collective.

        This is for controls that change from step to step, such as loads and prescribed
        displacements. For arguments, cost and errors see `gradient`.

        Returns:
            for each recorded step a list like the result of `gradient`, but with respect to the
            values in this step alone. The derivatives are zero after the last step with a goal.
        """
        return [
            as_derivatives(derivatives, controls, self.comm, f" in step {number}")
            for number, derivatives in enumerate(self._derivatives(goals, controls))
        ]

    def _derivatives(
        self, goals: Mapping[int, GoalsOfStep], controls: Sequence[Control]
    ) -> list[list[Any]]:
        """Return for each step the derivatives by the values of each control in it. Collective."""
        contact = self._contact
        contact.check_not_destroyed()
        u = fem.Function(contact.linear.V)
        data = DataOfSolution(contact, self._residual_at(u), u, in_all_steps=True)
        goals_of_step = self._checked_goals(goals, data)
        data.check_controls(controls)
        steps = self._steps
        if any(step.linearised.dual.compliance is not contact.compliance for step in steps):
            raise ContactError(
                "the stiffness or the pairing of the surfaces has changed since load steps were "
                "recorded: ask for derivatives before update_stiffness(), update_geometry(), and "
                "before obstacles are moved."
            )
        # obstacles must be where they were, and controls may move them only without earlier slip
        if contact.obstacles.changed(contact.jump).any():
            raise ContactError(
                "obstacles are elsewhere than in the recorded load steps: ask for derivatives "
                "before they are moved, or move them back."
            )
        slips = bool(steps) and bool(steps[0].linearised.dual.history.origin.any())
        obstacle_moves = any(step.obstacle_moves for step in steps)
        is_unknown = contact.comm.allreduce(slips or obstacle_moves, op=MPI.LOR)
        for control in controls:
            if is_unknown and contact.obstacles.rates(control, None, contact.jump).any():
                raise InputError(
                    f"through a process the derivative with respect to {shown(control)}, on which "
                    "the place of an obstacle depends, is known only if no obstacle moves in it, "
                    "and recording began without slip."
                )
        # each step hands the derivatives by its slip origin, `by_origin`, to the step before
        result: list[list[Any]] = [[0.0] * len(controls) for _ in steps]
        by_origin: Array | None = None
        for number in reversed(range(max(goals_of_step, default=-1) + 1)):
            step, weighted = steps[number], goals_of_step.get(number, [])
            with replaced(self._inputs, step.values):
                # the recorded inputs must give the recorded gaps and friction
                same = all(map(np.array_equal, contact.law_values(step.curves), step.laws))
                if not self.comm.allreduce(same, op=MPI.LAND):
                    raise InputError(
                        f"a gap or a law of friction has other values than in load step {number}: "
                        "a Python function reads something that has changed and was not recorded. "
                        "Read values that change from Constants that are variables of the function "
                        "itself."
                    )
                data.linearise(step.linearised)
                result[number], by_origin = gradient(data, weighted, controls, by_origin)
        return result

    def _checked_goals(self, goals: Any, data: DataOfSolution) -> dict[int, WeightedGoals]:
        """Return number of a step -> pairs (weight, goal), from the user's goals, or raise."""
        numbers = [integer(key) for key in goals] if isinstance(goals, Mapping) else [None]
        if any(number is None or not 0 <= number < len(self) for number in numbers):
            raise InputError(
                "goals must be a dictionary from numbers of recorded steps to goals, such as "
                f"{{{len(self) - 1}: NormalForce()}}, with numbers from 0 to {len(self) - 1}, "
                f"found {shown(goals)}."
            )
        result: dict[int, WeightedGoals] = {}
        for number, given in goals.items():
            pairs = given if isinstance(given, Sequence) else [(1.0, given)]
            for pair in pairs:
                if not isinstance(pair, tuple) or len(pair) != 2 or real(pair[0]) is None:
                    raise InputError(
                        "the goals of a step must be one goal, or a list of pairs such as "
                        f"(2.0, NormalForce()), found {shown(pair)}."
                    )
            result[int(number)] = [
                (float(weight), data.checked_goal(goal)) for weight, goal in pairs
            ]
        return result
