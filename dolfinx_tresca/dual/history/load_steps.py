"""The state of a process: the start of the next solve, and the accepted load steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Mask
from dolfinx_tresca.dual.history.saved_displacement import read_functions
from dolfinx_tresca.dual.history.saved_file import UNKNOWN
from dolfinx_tresca.dual.history.saved_state import SavedState
from dolfinx_tresca.dual.history.slip_history import SlipHistory
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import Carry
from dolfinx_tresca.errors import ContactError, ConvergenceError, InputError
from dolfinx_tresca.status import ContactStatus


@dataclass(frozen=True)
class StepStart:
    """The state of a process between two load steps, from which the next load step begins.

    Attributes:
        history: slip and dissipation of the accepted steps.
        multipliers: (size,) multipliers at which the next solve starts.
        accepted_u: displacement of the last accepted step, or of the slip origin [length]; None:
            the bodies are undeformed, or the displacement is not kept, as in checkpoints of a
            `ProcessTape`.
        accepted_motions: (pairs, 3, 4) positions of rigid obstacles (`RigidMotion.matrix`) at the
            last accepted step.
    """

    history: SlipHistory
    multipliers: Array
    accepted_u: fem.Function | None
    accepted_motions: Array


class LoadSteps:
    """The state of a process between solves.

    If friction depends on the pressure, the solution of a load step may depend on the tractions at
    which its solve starts: these must be tractions of the last accepted step, not of a trial solve.
    Otherwise the solution is unique, and the end of the last solve is the better start.

    Attributes:
        jump: B; each multiplier belongs to one of its rows.
        u: the displacement of nonlinear bodies, or all unknowns of a mixed space, at which solves
            start and end, owned by the caller; None for linear bodies.
        multipliers: (size,) multipliers of the last solve, at which the next solve starts unless it
            returns to the multipliers of the last accepted step.
        history: slip and dissipation of the accepted steps.
        accepted_u: the displacement [length] from which the slip of a step counts with finite
            sliding: the displacement of the last accepted step, of the slip origin (`begin_at`), or
            of the state that was read or returned to, whichever came last. None: the bodies were
            undeformed, or the state does not keep the displacement (`StepStart`).
        motions: (pairs, 3, 4) positions of rigid obstacles (`RigidMotion.matrix`) in the present
            solve.
        accepted_motions: `motions` at the last accepted step, from which the slip counts.
        last: status, history and displacement of the last solve, with all unknowns of a mixed
            space; None: there is nothing to accept.
    """

    def __init__(self, jump: JumpOperator, motions: Array, *, depends_on_start: bool) -> None:
        """Begin with undeformed bodies. Not collective.

        Args:
            jump: B.
            motions: (pairs, 3, 4) positions of rigid obstacles (`RigidMotion.matrix`).
            depends_on_start: whether solutions may depend on the tractions at which a solve starts.
        """
        self.jump, self._depends_on_start = jump, depends_on_start
        self.u: fem.Function | None = None
        self.accepted_u: fem.Function | None = None
        self.motions = self.accepted_motions = motions
        self.begin(SlipHistory.none(jump))
        self.forget()

    @property
    def accepted_values(self) -> Array | float:
        """Values of the displacement of the last accepted step [length]; 0 if there is none."""
        return 0.0 if self.accepted_u is None else self.accepted_u.x.array

    def forget(self) -> None:
        """Let the next solve start from zero; accepted steps remain. Not collective."""
        self._set_start(np.zeros(len(self.jump.gap)))

    def _set_start(self, multipliers: Array) -> None:
        """Start all solves from these multipliers until a step is accepted.

        Not collective.
        """
        self.multipliers = self._accepted = multipliers
        self._accepted_u = None if self.u is None else self.u.x.array.copy()
        self._trial_u: Array | None = None
        self._continues = False

    def begin(self, history: SlipHistory) -> None:
        """Let the next step continue a history; the last solution is dropped. Not collective."""
        self.history = history
        self.last: tuple[ContactStatus, SlipHistory, fem.Function] | None = None

    def begin_at(self, u: fem.Function | None) -> None:
        """Begin as after an accepted step with the displacement u. Collective.

        Args:
            u: displacement [length], whose tangential jump is the slip so far; None: undeformed
                bodies.
        """
        jump = self.jump
        self.accepted_u = None if u is None else u.copy()
        self.begin_with(
            SlipHistory.none(jump) if u is None else SlipHistory.from_displacement(jump, u)
        )
        self._set_start(self.multipliers)

    def begin_with(self, history: SlipHistory) -> None:
        """Call `begin`, with the present positions of obstacles as accepted. Not collective."""
        self.accepted_motions = self.motions
        self.begin(history)

    def begin_solve(self) -> None:
        """Return to the accepted state if the solution may depend on the start. Collective.

        A displacement u that was changed since the last solve is the caller's choice, and stays.
        """
        self.multipliers, u = self._start()
        self._continues = False
        if self.u is not None and u is not None:
            self.u.x.array[:] = u

    def end_solve(self) -> None:
        """Store the displacement u at which a solve has ended. Not collective."""
        self._trial_u = None if self.u is None else self.u.x.array.copy()

    def _start(self) -> tuple[Array, Array | None]:
        """Return the multipliers and u at which the next solve starts. Collective.

        If the returned u is None, the solve starts at the present displacement.
        """
        if not self._depends_on_start or not self.history.begun or self._continues:
            return self.multipliers, None
        is_trial = (
            self.u is not None
            and self._trial_u is not None
            and np.array_equal(self._trial_u, self.u.x.array)
        )
        everywhere = self.jump.comm.allreduce(is_trial, op=MPI.LAND)
        return self._accepted, self._accepted_u if everywhere else None

    @property
    def start(self) -> StepStart:
        """The state from which the next solve begins. Collective."""
        return StepStart(self.history, self._start()[0], self.accepted_u, self.accepted_motions)

    @property
    def end(self) -> StepStart:
        """The state from which the next solve begins if the last solution is accepted."""
        assert self.last is not None
        return StepStart(self.last[1], self.multipliers, self.last[2], self.motions)

    def return_to(self, start: StepStart) -> None:
        """Begin the next step at a state that belongs to the present B. Not collective."""
        self.accepted_u, self.accepted_motions = start.accepted_u, start.accepted_motions
        self.begin(start.history)
        self._set_start(start.multipliers)

    def accept(self, unconverged: bool) -> None:
        """Make the last solution an accepted step. Not collective.

        Args:
            unconverged: whether to accept a solution that missed the requested accuracy.

        Raises:
            ContactError: nothing was solved since the last step.
            ConvergenceError: the last solve failed.
        """
        history, w = self.acceptable(unconverged)
        self.begin_with(history)
        self.accepted_u = self.jump.system.displacement(w.copy(), w.name)
        self._set_start(self.multipliers)

    def acceptable(self, unconverged: bool) -> tuple[SlipHistory, fem.Function]:
        """Return the slip history and the unknowns of the last solution. Not collective.

        Args:
            unconverged: see `accept`.

        Raises:
            ContactError: nothing was solved since the last step.
            ConvergenceError: the last solve failed.
        """
        if self.last is None:
            raise ContactError(
                "there is no solution to accept: call solve() after each change of the loads, and "
                "then accept()."
            )
        status, history, w = self.last
        if status is not ContactStatus.CONVERGED and not unconverged:
            raise ConvergenceError(
                f"the last solve ended with {status.name}, and its errors would stay in all steps "
                "that follow: raise_if_failed() of its solution says what to do. accept("
                "unconverged=True) accepts the solution as it is."
            )
        return history, w

    def set_last_status(self, status: ContactStatus) -> None:
        """Replace the status of the last solve, which `accept` checks. Not collective."""
        if self.last is not None:
            self.last = status, *self.last[1:]

    def start_at(self, stress: Array) -> None:
        """Let the next solve start from (size,) tractions [stress]. Not collective."""
        self._set_start(stress / self.jump.stress_scale)

    def _carry_over(self, jump: JumpOperator) -> Carry:
        """Replace B, convert the multipliers to the new B, and return the conversion.

        Not collective.
        """
        carry, self.jump = Carry(self.jump, jump), jump
        self.multipliers, self._accepted = (
            carry.multipliers(one) for one in (self.multipliers, self._accepted)
        )
        return carry

    def rotate_tangents(self, jump: JumpOperator) -> None:
        """Replace B by the jump operator with rotated tangents, before a solve. Not collective.

        Components of the multipliers and of the slip history change with the tangents.
        """
        origin = self._carry_over(jump).residuals(self.history.origin)
        self.begin(replace(self.history, origin=origin))

    def move(
        self,
        jump: JumpOperator,
        u: fem.Function,
        *,
        continues: bool = False,
        since_accepted: Sequence[bool] | Mask | None = None,
    ) -> None:
        """Continue with the B of displaced surfaces. Collective.

        Args:
            jump: B of the displaced surfaces.
            u: displacement of the surfaces [length].
            continues: whether the load step goes on. True: u is the displacement of the last solve,
                and the next solve starts from the tractions of this last solve; False: it may start
                from the tractions of the last accepted step, see `LoadSteps`.
            since_accepted: for each pair, True: the slip of this step becomes the tangential jump,
                between nodes and their present partners, of the displacement since the last
                accepted step; False: nodes keep their slip so far. None: False for all pairs.
        """
        before = self.jump
        kept = self._carry_over(jump).residuals(before.of_displacement(u) - self.history.origin)
        history = self.history.with_slip(kept, u, jump)
        if since_accepted is not None:
            history = history.with_origin_at(self.accepted_u, jump, since_accepted)
        self.begin(history)
        self._continues = continues

    def save(
        self,
        path: str | Path,
        step: int,
        moved_by: fem.Function | None,
        material: Sequence[fem.Function],
    ) -> None:
        """Write a file with the state from which the next solve starts. Collective.

        Args:
            path: path of the file; the first rank's path is used.
            step: number of the step, which is stored, and which `load` returns.
            moved_by: displacement [length] at which the surfaces were paired; None: the bodies were
                undeformed.
            material: Functions of the material's history.

        Raises:
            InputError: the file cannot be written.
        """
        path = Path(self.jump.comm.bcast(str(path)))
        multipliers, accepted_u = self._start()
        tractions, u = multipliers * self.jump.stress_scale, self.u
        if u is not None and accepted_u is not None:
            u = fem.Function(u.function_space)
            u.x.array[:] = accepted_u
        others: Sequence[fem.Function] = ()
        component = self.jump.system.component
        if u is not None and component is not None:
            u, others = component.of(u), component.other_parts(u)
        displacements = {"u": u, "moved_by": moved_by, "accepted_u": self.accepted_u}
        known = {name: one for name, one in displacements.items() if one is not None}
        state = SavedState(tractions, self.history, step, known, material, others)
        state.write(path, self.jump, self.accepted_motions)

    def load(self, path: Path, u: fem.Function | None, accepted_u: fem.Function | None) -> int:
        """Continue from the file that `save` wrote, and return the number of its step. Collective.

        Obstacles keep their present positions. After an error, a part of the state may have
        changed: the caller returns to the former state.

        Args:
            path: path of the file, the same on all ranks.
            u: the displacement in the file; None: there is none.
            accepted_u: the displacement of the last accepted step in the file; None: there is none.

        Raises:
            InputError: the file cannot be read, belongs to another mesh, other pairs or other
                kinds of laws, or lacks a displacement that is needed.
        """
        component = self.jump.system.component
        if self.u is not None:
            if u is None:
                raise InputError(
                    f"the state in '{path}' has no displacement, since a ContactProblem wrote it; "
                    "a NonlinearContactProblem needs one."
                )
            others = [] if component is None else component.other_parts(self.u)
            read = read_functions(path, others, self.jump.comm, UNKNOWN)
            for unknown, values in zip(others, read, strict=True):
                unknown.x.array[:] = values
            if component is None:
                self.u.x.array[:] = u.x.array
            else:
                component.compose(self.u, u, others)
        state = SavedState.read(path, self.jump)
        self.begin_with(state.history)
        self.accepted_u = accepted_u
        self.start_at(state.multipliers)
        return state.step
