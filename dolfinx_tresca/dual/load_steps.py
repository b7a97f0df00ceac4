"""Where the next solve starts: the last one's multipliers, and the load steps before it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import carried_over
from dolfinx_tresca.dual.saved_state import SavedState
from dolfinx_tresca.dual.slip_history import SlipHistory
from dolfinx_tresca.errors import ContactError, ConvergenceError, InputError
from dolfinx_tresca.status import ContactStatus


class LoadSteps:
    """What a problem remembers of its solves, but for products.

    Attributes:
        jump: B, whose rows the multipliers are those of.
        u: the displacement that solves start from, and end with, where bodies are nonlinear; the
            caller's. None: none is needed.
        multipliers: (size,) where the next solve starts.
        history: of the steps that were accepted.
        accepted_u: the displacement of the last accepted step [length]; None: the undeformed state.
        last: status, history and displacement of the last solve; None: there is nothing to accept.
    """

    def __init__(self, jump: JumpOperator) -> None:
        """Begin with bodies at rest. Not collective."""
        self.jump = jump
        self.u: fem.Function | None = None
        self.accepted_u: fem.Function | None = None
        self.begin(SlipHistory.none(jump))
        self.forget()

    def forget(self) -> None:
        """Let the next solve start from zero; what was accepted stays. Not collective."""
        self.multipliers: Array = np.zeros(len(self.jump.gap))

    def begin(self, history: SlipHistory) -> None:
        """Begin the next step. Not collective."""
        self.history = history
        self.last: tuple[ContactStatus, SlipHistory, fem.Function] | None = None

    def begin_at(self, u: fem.Function | None) -> None:
        """Begin with the slip of a displacement [length]; None: with bodies at rest. Collective."""
        jump = self.jump
        self.accepted_u = None if u is None else u.copy()
        self.begin(SlipHistory.none(jump) if u is None else SlipHistory.from_displacement(jump, u))

    def accept(self, unconverged: bool) -> None:
        """Make the last solution a step. Not collective.

        Args:
            unconverged: whether to take one that missed what was asked for.

        Raises:
            ContactError: nothing was solved since the last step.
            ConvergenceError: the last solve failed.
        """
        if self.last is None:
            raise ContactError(
                "there is no solution to accept: call solve() after each change of the loads, and "
                "then accept()."
            )
        status, history, u = self.last
        if status is not ContactStatus.CONVERGED and not unconverged:
            raise ConvergenceError(
                f"the last solve ended with {status.name}, and its errors would stay in all steps "
                "that follow. Take a smaller step, allow more iterations or ask for less; or take "
                "it as it is with accept(unconverged=True)."
            )
        self.begin(history)
        self.accepted_u = u.copy()

    def set_last_status(self, status: ContactStatus) -> None:
        """Replace the status of the last solve, which `accept` checks. Not collective."""
        if self.last is not None:
            self.last = status, *self.last[1:]

    def start_at(self, stress: Array) -> None:
        """Let the next solve start from (size,) tractions [stress]. Not collective."""
        self.multipliers = stress / self.jump.stress_scale

    def turn(self, jump: JumpOperator) -> None:
        """Go on with another B, along other axes; a solution can't be accepted. Not collective."""
        before, self.jump = self.jump, jump
        self.start_at(jump.turned(self.multipliers * before.stress_scale, before))
        self.begin(self.history.turned(jump, before))

    def move(
        self, jump: JumpOperator, u: fem.Function, finite: Sequence[bool] | None = None
    ) -> None:
        """Continue with the B of displaced surfaces. Collective.

        Args:
            jump: B of the displaced surfaces.
            u: their displacement [length].
            finite: for each pair whether its slip is measured with the present partners of its
                nodes from the last accepted step on; None: for none, the slip of each node so far
                is kept.
        """
        before, self.jump = self.jump, jump
        self.start_at(carried_over(self.multipliers * before.stress_scale, before, jump))
        history = self.history.carried_over(u, before, jump)
        if finite is not None:
            history = history.measured_from(self.accepted_u, jump, finite)
        self.begin(history)

    def save(self, path: str | Path, step: int, moved_by: fem.Function | None) -> None:
        """Write where the next solve starts to a file; the first rank's path counts. Collective.

        Args:
            path: of the file.
            step: a number of the user's.
            moved_by: displacement [length] at which the surfaces were paired; None: at rest.

        Raises:
            InputError: it cannot be written.
        """
        path = Path(self.jump.comm.bcast(str(path)))
        tractions = self.multipliers * self.jump.stress_scale
        displacements = {"u": self.u, "moved_by": moved_by, "accepted_u": self.accepted_u}
        known = {name: u for name, u in displacements.items() if u is not None}
        SavedState(tractions, self.history, step, known).write(path, self.jump)

    def load(self, path: Path, u: fem.Function | None, accepted_u: fem.Function | None) -> int:
        """Go on from what `save` wrote, and return its step. Collective.

        Args:
            path: of the file, the same on all ranks.
            u: the displacement in the file; None: there is none.
            accepted_u: the displacement of the last accepted step in the file; None: there is none.

        Raises:
            InputError: it cannot be read, or is of another mesh, other pairs or other kinds of
                laws; or has no displacement where one is needed.
        """
        if self.u is not None and u is None:
            raise InputError(
                f"the state in '{path}' has no displacement, since it is one of a ContactProblem; "
                "a NonlinearContactProblem goes on from one."
            )
        state = SavedState.read(path, self.jump)
        if self.u is not None and u is not None:
            self.u.x.array[:] = u.x.array
        self.begin(state.history)
        self.accepted_u = accepted_u
        self.start_at(state.multipliers)
        return state.step
