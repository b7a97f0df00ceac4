"""Where the next solve starts: the last one's multipliers, and the load steps before it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.moved import carried_over
from dolfinx_tresca.dual.saved_state import SavedState
from dolfinx_tresca.dual.slip_history import SlipHistory
from dolfinx_tresca.errors import ContactError, ConvergenceError
from dolfinx_tresca.status import ContactStatus


class LoadSteps:
    """What a problem remembers of its solves, but for products.

    Attributes:
        jump: B, whose rows the multipliers are those of.
        multipliers: (size,) where the next solve starts.
        history: of the steps that were accepted.
        last: how the last solve ended, and the history with it; None: there is nothing to accept.
    """

    def __init__(self, jump: JumpOperator) -> None:
        """Begin with bodies at rest. Not collective."""
        self.jump = jump
        self.begin(SlipHistory.none(jump))
        self.forget()

    def forget(self) -> None:
        """Let the next solve start from zero; what was accepted stays. Not collective."""
        self.multipliers: Array = np.zeros(len(self.jump.gap))

    def begin(self, history: SlipHistory) -> None:
        """Begin the next step. Not collective."""
        self.history = history
        self.last: tuple[ContactStatus, SlipHistory] | None = None

    def begin_at(self, u: fem.Function | None) -> None:
        """Begin with the slip of a displacement [length]; None: with bodies at rest. Collective."""
        jump = self.jump
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
        status, history = self.last
        if status is not ContactStatus.CONVERGED and not unconverged:
            raise ConvergenceError(
                f"the last solve ended with {status.name}, and its errors would stay in all steps "
                "that follow. Solve again, allow more iterations or ask for less; or take it as it "
                "is with accept(unconverged=True)."
            )
        self.begin(history)

    def start_at(self, stress: Array) -> None:
        """Let the next solve start from (size,) tractions [stress]. Not collective."""
        self.multipliers = stress / self.jump.stress_scale

    def turn(self, jump: JumpOperator) -> None:
        """Go on with another B, along other axes; a solution can't be accepted. Not collective."""
        before, self.jump = self.jump, jump
        self.start_at(jump.turned(self.multipliers * before.stress_scale, before))
        self.begin(self.history.turned(jump, before))

    def move(self, jump: JumpOperator, u: fem.Function) -> None:
        """Go on with the B of surfaces that a displacement has moved. Collective."""
        before, self.jump = self.jump, jump
        self.start_at(carried_over(self.multipliers * before.stress_scale, before, jump))
        self.begin(self.history.carried_over(u, before, jump))

    def save(self, path: str | Path, step: int) -> None:
        """Write multipliers and history to a file; the first rank's path counts. Collective.

        Raises:
            InputError: it cannot be written.
        """
        path = Path(self.jump.comm.bcast(str(path)))
        tractions = self.multipliers * self.jump.stress_scale
        SavedState(tractions, self.history, step).write(path, self.jump)

    def load(self, path: str | Path) -> int:
        """Go on from what `save` wrote, and return its step. Collective.

        Raises:
            InputError: it cannot be read, or is of another mesh or other pairs.
        """
        state = SavedState.read(Path(self.jump.comm.bcast(str(path))), self.jump)
        self.begin(state.history)
        self.start_at(state.multipliers)
        return state.step
