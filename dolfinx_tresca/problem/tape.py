"""Accepted load steps of a process, for derivatives through its slip history."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

import ufl
from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of_self
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.number import integer, real
from dolfinx_tresca.dual.nodal_values import inputs_of
from dolfinx_tresca.dual.program import DualProgram
from dolfinx_tresca.dual.slip_history import SlipHistory
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.problem.contact_system import ContactSystem
from dolfinx_tresca.scene.friction import DryFriction
from dolfinx_tresca.scene.goal import Goal
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.gradient import (
    Control,
    Differentiation,
    Forms,
    SolvedStep,
    WeightedGoals,
    as_derivatives,
    check_control,
    checked_form_or_goal,
    sum_of_known,
)
from dolfinx_tresca.solution.prescribed import replaced, values_of

#: What is differentiated at a step: a goal, or several with their factors in a sum.
GoalsOfStep: TypeAlias = "Goal | ufl.Form | Sequence[tuple[float, Goal | ufl.Form]]"


@dataclass(frozen=True)
class _Recorded:
    """An accepted step.

    Attributes:
        solved: the solution with its problem.
        values: values of all inputs of the problem in this step.
    """

    solved: SolvedStep
    values: Sequence[Array]


class ProcessTape:
    """The accepted load steps of a process, and derivatives of goals through all of them.

    `ContactProblem.record` makes one. It keeps for each step the displacement, the multipliers, and
    the values of all Constants and Functions in forms, gaps and laws of friction, in memory; values
    that do not change from one step to the next are kept once.

    Slip is measured from the positions in which friction held the surfaces in the step before, so
    a goal of the last step depends on all steps. Derivatives go backwards through the slip history:
    one adjoint solve for each step.

    Example:
        The cube of `ContactProblem` on a floor with Tresca friction, pressed more and more in two
        steps; the derivative of the force by the displacement that is prescribed in each of them:

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
        solved_for: Callable[[str], tuple[DualProgram, Array, Evaluation]],
        forms_at: Callable[[fem.Function], Forms],
    ) -> None:
        """Begin without steps. Not collective.

        Args:
            contact: the problem.
            solved_for: returns its last solve, or says why there is none for a purpose.
            forms_at: returns its forms and conditions at a displacement.

        Raises:
            InputError: `a` or `L` is no form of UFL.
        """
        self._contact, self._solved_for, self._forms_at = contact, solved_for, forms_at
        self._inputs = inputs_of_problem(
            contact.linear.ufl_forms, contact.pairs, contact.linear.bcs
        )
        self._steps: list[_Recorded] = []
        self._history: SlipHistory = contact.steps.history

    def __len__(self) -> int:
        return len(self._steps)

    def __repr__(self) -> str:
        return f"<ProcessTape: {len(self)} load step(s) of {self._contact!r}>"

    @property
    def comm(self) -> Any:
        """The communicator of the mesh."""
        return self._contact.comm

    @contextmanager
    def adding_step(self) -> Iterator[None]:
        """Record the last solution if the block accepts it. Collective.

        Raises:
            ContactError: the solution has no derivative; or the slip history is not the one that
                the last recorded step has left.
        """
        contact = self._contact
        dual, multipliers, found = self._solved_for("a recorded load step")
        contact.check_inputs("a recorded load step")
        if contact.steps.history is not self._history:
            raise ContactError(
                "the slip history has changed since the last recorded load step, by "
                "set_slip_origin(), load_state(), start_from() or surfaces that were paired anew. "
                "Leave the block of record(), and begin another one."
            )
        # without the sum of slips at all nodes, which is as large as u
        dual = replace(dual, history=replace(dual.history, slipped=()))
        solved = SolvedStep(dual, multipliers, found.u, contact.slip_bounds())
        yield
        self._history = contact.steps.history
        before = self._steps[-1].values if self._steps else [None] * len(self._inputs)
        values = [
            one if one is not None and np.array_equal(one, now) else now.copy()
            for one, now in zip(before, map(values_of, self._inputs), strict=True)
        ]
        self._steps.append(_Recorded(solved, values))

    @collective(comm_of_self)
    def gradient(self, goals: Mapping[int, GoalsOfStep], controls: Sequence[Control]) -> list[Any]:
        """Return the derivatives of a sum of goals with respect to controls. Collective.

        They are those with respect to values that are the same in all steps: the sums of
        `gradient_by_step`. With each node held in its contact state of each step they are exact
        for the discrete problem; solve accurately, since they are those at the solutions that were
        found: `solve(rtol=1e-8)`. The cost is one adjoint solve for each step up to the last one
        with a goal, however many goals and controls there are.

        The slip at which recording begins counts as independent of the controls.

        Args:
            goals: number of a recorded step, from 0 on -> a goal of `ContactProblem.gradient`, or
                pairs of a factor and a goal. A form depends on the `solution.u` of that step.
            controls: see `ContactProblem.gradient`.

        Returns:
            for each control the derivatives with respect to its values: an array of the shape of a
            Constant, a Function on the space of a Function [unit of the sum over its unit].

        Raises:
            ContactError: the problem was destroyed, or K or the pairing has changed since.
            InputError: a step, a goal or a control is wrong.
            ConvergenceError: with the contact state kept, rigid motions of bodies change a goal.
        """
        controls = list(controls)
        steps = self._derivatives(goals, controls)
        total = [sum_of_known(parts) for parts in zip(*steps, strict=True)]
        return as_derivatives(total, controls, self.comm)

    @collective(comm_of_self)
    def gradient_by_step(
        self, goals: Mapping[int, GoalsOfStep], controls: Sequence[Control]
    ) -> list[list[Any]]:
        """Return the derivatives with respect to the values of controls in each step. Collective.

        For controls that change from step to step, such as loads and prescribed displacements. The
        cost is that of `gradient`.

        Args:
            goals: see `gradient`.
            controls: see `gradient`.

        Returns:
            for each recorded step a list as `gradient` returns it: derivatives with respect to the
            values in this step alone. They are zero after the last step with a goal.

        Raises:
            ContactError: see `gradient`.
            InputError: see `gradient`.
            ConvergenceError: see `gradient`.
        """
        controls = list(controls)
        steps = self._derivatives(goals, controls)
        return [as_derivatives(parts, controls, self.comm) for parts in steps]

    def _derivatives(
        self, goals: Mapping[int, GoalsOfStep], controls: Sequence[Control]
    ) -> list[list[Any]]:
        """Return the derivatives of each step, see `Differentiation.backwards`. Collective."""
        contact = self._contact
        contact.check_not_destroyed()
        goals_of_step = self._checked_goals(goals)
        for control in controls:
            check_control(control, contact.pairs)
        if any(step.solved.dual.compliance is not contact.compliance for step in self._steps):
            raise ContactError(
                "the stiffness or the pairing of the surfaces has changed since load steps were "
                "recorded: ask for derivatives before update_stiffness(), update_geometry(), and "
                "before obstacles are moved."
            )
        u = fem.Function(contact.linear.V)
        differentiation = Differentiation(
            contact.pairs, self._forms_at(u), u, contact.nodal_values, controls
        )
        result: list[list[Any]] = [[None] * len(controls) for _ in self._steps]
        on_origin: Array | None = None
        for number in reversed(range(max(goals_of_step, default=-1) + 1)):
            step = self._steps[number]
            with replaced(self._inputs, step.values):
                result[number], on_origin = differentiation.backwards(
                    step.solved, goals_of_step.get(number, []), on_origin
                )
        return result

    def _checked_goals(self, goals: Any) -> dict[int, WeightedGoals]:
        """Check goals, and return them with their factors for the numbers of steps.

        Raises:
            InputError: they are no such mapping; or see `checked_form_or_goal`.
        """
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
            V = self._contact.linear.V
            result[int(number)] = [
                (float(weight), checked_form_or_goal(goal, len(self._contact.pairs), V))
                for weight, goal in pairs
            ]
        return result


def inputs_of_problem(
    forms: Sequence[Any], pairs: Sequence[ContactPair], bcs: Sequence[Any]
) -> list[Any]:
    """Return all Constants and Functions on which solutions depend, each once.

    Those of Dirichlet conditions may be DOLFINx's objects of C++; `values_of` takes them as well.
    """
    found: list[Any] = []
    for form in forms:
        if form is not None:
            found += [*form.coefficients(), *form.constants()]
    for pair in pairs:
        fields = [pair.gap]
        if isinstance(pair.friction, DryFriction):
            terms = pair.friction.terms
            fields += [terms.constant, terms.coefficient, terms.limit]
        for field in fields:
            found += inputs_of(field)
    found += [bc.g for bc in bcs]
    return list(dict.fromkeys(found))
