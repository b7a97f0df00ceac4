"""Contact problems on the tape of pyadjoint, with the types of dolfinx-adjoint.

`ContactProblem` takes the place of `dolfinx_tresca.ContactProblem`, as the `LinearProblem` of
dolfinx-adjoint takes the place of DOLFINx's. `pyadjoint.ReducedFunctional`, `pyadjoint.minimize`
and `pyadjoint.taylor_test` then differentiate contact solves. This needs dolfinx-adjoint 0.4.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.compat import prescribed_function
from dolfinx_tresca.contact.step_state import StepState
from dolfinx_tresca.derivatives.change_of_data import DataOfSolution, inputs_of_problem
from dolfinx_tresca.derivatives.goals import value_of
from dolfinx_tresca.derivatives.gradient_and_tangent import gradient
from dolfinx_tresca.derivatives.linearised import LinearisedContact
from dolfinx_tresca.dual.nodal_values import replaced, values_of
from dolfinx_tresca.errors import ContactError, InputError
from dolfinx_tresca.problem.linear import ContactProblem as _ContactProblem
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.scene.goal import Goal

import dolfinx_adjoint  # isort: skip
import pyadjoint  # isort: skip


class ContactProblem(_ContactProblem):
    """A contact problem whose solves, goals and accepted load steps are on pyadjoint's tape.

    Arguments are those of `dolfinx_tresca.ContactProblem`. A solve depends on each
    `dolfinx_adjoint.Constant` and `dolfinx_adjoint.Function` in the forms, gaps, laws of
    friction and Dirichlet conditions, on each `dolfinx_adjoint.dirichletbc`, and on the solve that
    was accepted before it. Other Constants and Functions count as data, with the values that they
    have in each solve.

    Solves on the tape raise an error if they fail, and K is assembled again when coefficients of
    the form `a` have changed. Solve accurately, with `rtol=1e-8` or less, since derivatives are
    evaluated at the computed solutions.

    Example:
        >>> import dolfinx_adjoint, pyadjoint  # doctest: +SKIP
        >>> friction = dolfinx_adjoint.Constant(mesh, 0.3)  # doctest: +SKIP
        >>> pair = ContactPair(tags, 1, 2, friction=Coulomb(friction))  # doctest: +SKIP
        >>> problem = ContactProblem(a, L, [pair], bcs)  # doctest: +SKIP
        >>> solution = problem.solve(rtol=1e-10)  # doctest: +SKIP
        >>> drag = problem.goal_value(ContactForce((1.0, 0.0)))  # doctest: +SKIP
        >>> J = pyadjoint.ReducedFunctional(drag, pyadjoint.Control(friction))  # doctest: +SKIP
        >>> J.derivative()  # doctest: +SKIP
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """See `dolfinx_tresca.ContactProblem`. Collective.

        Raises:
            InputError: a pair has finite sliding, or another argument is wrong.
        """
        super().__init__(*args, **kwargs)
        self._check_pairing_fixed()
        a, L = self._contact.linear.ufl_forms
        bcs = self._contact.linear.bcs
        prescribed = {id(bc.g): prescribed_function(bc, dolfinx_adjoint.Function) for bc in bcs}
        inputs = inputs_of_problem((a, L), self.pairs, bcs)
        self.inputs = list(dict.fromkeys(prescribed.get(id(field), field) for field in inputs))
        self.solved: _Solved | None = None
        self.accepted: _Solved | None = None
        u = fem.Function(self._contact.linear.V)
        self.data = DataOfSolution(self._contact, self._forms_at(u), u)

    def solve(self, **options: Any) -> ContactSolution:
        """Solve, and record the solution on the tape. Collective.

        Args:
            options: arguments of `dolfinx_tresca.ContactProblem.solve`.

        Returns:
            the solution, whose `u` is a `dolfinx_adjoint.Function`.

        Raises:
            ConvergenceError: the solve is on the tape and failed.
            ContactError: see `dolfinx_tresca.ContactProblem.solve`.
        """
        annotate = pyadjoint.annotate_tape()
        with pyadjoint.stop_annotating():
            start = self.start_of_solve()
            solution = super().solve(**options)
            u = dolfinx_adjoint.Function(solution.u.function_space, solution.u.x, solution.u.name)
        self.solved = None
        if annotate:
            solution.raise_if_failed()
            before = self.accepted
            if before is not None and before.content.end.history is not start.history:
                before = None  # the slip origin has been set since that step
            block = _SolveBlock(self, options, start, before)
            self.solved = _Solved(self.content_of_solve())
            for output in (u, self.solved):
                block.add_output(output.block_variable)
            pyadjoint.get_working_tape().add_block(block)
        surfaces, solved = self._contact.surfaces, self._contact.solution_for("the tape")
        fields = dataclasses.replace(solved.fields, u=u)
        solved = dataclasses.replace(solved, fields=fields)
        surfaces.state = dataclasses.replace(surfaces.state, solution=solved)
        return dataclasses.replace(solution, u=u, w=u)

    def accept(self, *, unconverged: bool = False) -> None:
        """Make the last solution a load step, from which later solves on the tape start.

        See `dolfinx_tresca.ContactProblem.accept`. Collective.
        """
        super().accept(unconverged=unconverged)
        self.accepted = self.solved

    def goal_value(self, goal: Goal) -> Any:
        """Return the value of a goal of the last solution, and record it. Collective.

        Returns:
            a `pyadjoint.AdjFloat`. See `dolfinx_tresca.ContactProblem.goal_value`.

        Raises:
            ContactError: nothing was solved, or the last solve is not on the tape.
            InputError: the goal is wrong.
        """
        value = pyadjoint.AdjFloat(super().goal_value(goal))
        if pyadjoint.annotate_tape():
            if self.solved is None:
                raise ContactError("the goal is of a solve that is not on the tape: solve again.")
            block = _GoalBlock(goal, self.solved)
            block.add_output(value.block_variable)
            pyadjoint.get_working_tape().add_block(block)
        return value

    def update_geometry(self, u: fem.Function) -> None:
        """Raise an error: all solves on the tape share one pairing of the surfaces.

        Raises:
            InputError: always.
        """
        raise InputError(
            "solves on the tape need one pairing of the surfaces, which update_geometry() replaces."
        )

    def start_of_solve(self) -> StepState:
        """Update K and the rows of B, and return the state from which the next solve begins.

        Collective.
        """
        contact = self._contact
        contact.check_not_destroyed()
        if contact.linear.outdated:
            self.update_stiffness()
        surfaces = contact.surfaces
        surfaces.begin_solve()
        surfaces.align_tangents(surfaces.slip_bounds())
        return surfaces.state

    def content_of_solve(self) -> _Content:
        """Return the last solution, and the state after it if it is accepted. Collective."""
        solution = LinearisedContact.of_last_solve(self._contact)
        end = self._contact.surfaces.state.after_solution(unconverged=True)
        return _Content(solution, end)

    def solve_again(self, start: StepState, options: dict[str, Any]) -> _Content:
        """Solve from a given state with the present values of all inputs. Collective.

        Raises:
            ContactError: the pairing of the surfaces has changed.
            ConvergenceError: the solve failed.
        """
        surfaces = self._contact.surfaces
        surfaces.return_to(start)
        jump = surfaces.jump
        self.start_of_solve()
        if surfaces.jump is not jump:
            raise ContactError(
                "the pairing of the surfaces, or the direction of friction, has changed since the "
                "solve on the tape: move obstacles and turn friction between tapes only."
            )
        super().solve(**options).raise_if_failed()
        return self.content_of_solve()


@dataclass(frozen=True)
class _Content:
    """A solution on the tape.

    Attributes:
        step: the solution with its problem.
        end: the state from which the next solve begins if this solution is accepted.
    """

    step: LinearisedContact
    end: StepState


#: The derivative of a functional by the contact state of a solution, which pyadjoint adds up: goals
#: of the solution with their factors; and, with the factor 1, arrays (size,) of derivatives by the
#: slip origin of the next load step.
_Cotangent: TypeAlias = "list[tuple[float, Goal | Array]]"


class _Solved(pyadjoint.OverloadedType):  # type: ignore[misc]
    """The contact state of a solution, on which goals and later load steps depend."""

    def __init__(self, content: _Content) -> None:
        super().__init__()
        self.content = content

    def _ad_create_checkpoint(self) -> _Content:
        return self.content

    def _ad_restore_at_checkpoint(self, checkpoint: _Content) -> _Content:
        return checkpoint


class _GoalBlock(pyadjoint.Block):  # type: ignore[misc]
    """The step on the tape that computes the value of a goal from a contact state."""

    def __init__(self, goal: Goal, solved: _Solved) -> None:
        super().__init__()
        self._goal = goal
        self.add_dependency(solved)

    def evaluate_adj_component(
        self, inputs: Any, adj_inputs: Any, block_variable: Any, idx: int, prepared: Any = None
    ) -> _Cotangent:
        return [(float(adj_inputs[0]), self._goal)]

    def recompute_component(self, inputs: Any, block_variable: Any, idx: int, prepared: Any) -> Any:
        step = inputs[0].step
        jump = step.dual.jump
        jump_of_u = jump.of_displacement(step.u)
        return pyadjoint.AdjFloat(value_of(self._goal, jump, step.multipliers, jump_of_u))


class _SolveBlock(pyadjoint.Block):  # type: ignore[misc]
    """A solve on the tape.

    It maps its inputs and the accepted step to the displacement and the contact state.
    """

    def __init__(
        self,
        problem: ContactProblem,
        options: dict[str, Any],
        start: StepState,
        accepted: _Solved | None,
    ) -> None:
        super().__init__()
        self._problem, self._options, self._start = problem, options, start
        self._values = [values_of(field).copy() for field in problem.inputs]
        self._accepted = accepted
        bcs = problem._contact.linear.bcs
        candidates = [*problem.inputs, *bcs]
        on_tape = [value for value in candidates if isinstance(value, pyadjoint.OverloadedType)]
        prescribed = {id(bc.g) for bc in bcs if isinstance(bc, pyadjoint.OverloadedType)}
        if accepted is not None:
            self.add_dependency(accepted)
        for dependency in on_tape:
            if id(dependency) in prescribed:  # by a condition, which is a dependency itself
                continue
            self.add_dependency(dependency, no_duplicates=True)
            present = _control(dependency)
            recorded = _control(dependency.block_variable.saved_output)
            if not np.array_equal(values_of(present), values_of(recorded)):
                raise ContactError(
                    f"{getattr(present, 'name', present)!r} has other values than on the tape: it "
                    "was changed in place, or a ReducedFunctional was evaluated elsewhere. Change "
                    "it with dolfinx_adjoint.assign, take a Constant or Function of dolfinx.fem "
                    "for data, or solve inside pyadjoint.stop_annotating()."
                )

    @contextmanager
    def _at_inputs(self) -> Iterator[None]:
        """In a `with` block, give all inputs their values of this solve. Collective."""
        values = dict(zip(map(id, self._problem.inputs), self._values, strict=True))
        for dependency in self.get_dependencies():
            control = _control(dependency.output)
            if control is not None:
                values[id(control)] = values_of(_control(dependency.saved_output)).copy()
        with (
            self._problem._contact.restored(),
            replaced(self._problem.inputs, list(values.values())),
        ):
            yield

    def _solved_again(self) -> _Content:
        start = self._start
        if self._accepted is not None:
            start = self.get_dependencies()[0].saved_output.end
        return self._problem.solve_again(start, self._options)

    def prepare_recompute_component(self, inputs: Any, relevant_outputs: Any) -> _Content:
        with self._at_inputs():
            return self._solved_again()

    def recompute_component(
        self, inputs: Any, block_variable: Any, idx: int, prepared: _Content
    ) -> Any:
        if idx == 1:
            return prepared
        u = dolfinx_adjoint.Function(prepared.step.u.function_space, annotate=False)
        u.x.array[:] = prepared.step.u.x.array
        return u

    def prepare_evaluate_adj(
        self, inputs: Any, adj_inputs: Any, relevant_dependencies: Any
    ) -> dict[int, Any]:
        on_u, cotangent = adj_inputs
        by_control = {
            idx: _control(dependency.output)
            for idx, dependency in relevant_dependencies
            if _control(dependency.output) is not None
        }
        content: _Content = self.get_outputs()[1].saved_output
        origins = [given for _, given in cotangent or [] if isinstance(given, np.ndarray)]
        goals = [pair for pair in cotangent or [] if not isinstance(pair[1], np.ndarray)]
        system, data = self._problem._contact, self._problem.data
        with self._at_inputs():
            compliance = content.step.dual.compliance
            if compliance is not system.surfaces.compliance or system.linear.outdated:
                content = self._solved_again()
            data.linearise(content.step)
            derivatives, on_origin = gradient(
                data,
                goals,
                list(by_control.values()),
                np.sum(origins, axis=0) if origins else None,
                None if on_u is None else on_u.array,
            )
        result: dict[int, Any] = {}
        for (idx, control), values in zip(by_control.items(), derivatives, strict=True):
            by_values = dolfinx_adjoint.Function(control.function_space, annotate=False)
            by_values.x.array[: np.size(values)] = np.ravel(values)
            by_values.x.scatter_forward()
            result[idx] = by_values.x
        if self._accepted is not None:
            result[0] = [(1.0, on_origin)]
        return result

    def evaluate_adj_component(
        self, inputs: Any, adj_inputs: Any, block_variable: Any, idx: int, prepared: Any = None
    ) -> Any:
        return prepared[idx]


def _control(dependency: Any) -> Any:
    """Return the Function whose values a dependency stands for; None for an accepted step."""
    if isinstance(dependency, fem.DirichletBC):
        return dependency.g
    return dependency if isinstance(dependency, fem.Function) else None
