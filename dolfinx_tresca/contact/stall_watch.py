"""Detection of solves that make no progress."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace

from mpi4py import MPI

from dolfinx_tresca._base.parallel import log
from dolfinx_tresca._base.tolerances import PATIENCE
from dolfinx_tresca.monitor import Iteration

#: Number of Newton steps without progress, and number of configurations with finite sliding, after
#: which a solve counts as stalled. (For iterations of a contact problem, the number is
#: `_base.tolerances.PATIENCE`.)
#: Of the solves in tests/validation and tests/problem that converge, none needs more than 6 such
#: Newton steps or 15 configurations. If both numbers are doubled, the warning comes later, and
#: nothing else changes.
IDLE_NEWTON_STEPS, IDLE_CONFIGURATIONS = 15, 20


class StallWatch:
    """An observer that detects whether a solve makes progress, and calls another observer.

    The log gets one warning, when the solve stalls for the first time. A contact problem makes
    progress if its residual halves within `_base.tolerances.PATIENCE` iterations. Newton's method
    makes progress if its residual halves, or a further part of the load is solved, within
    `IDLE_NEWTON_STEPS` steps. With finite sliding, a solve stalls after `IDLE_CONFIGURATIONS`
    configurations.
    """

    def __init__(self, comm: MPI.Comm, observe: Callable[[Iteration], bool]) -> None:
        """Begin to watch a solve. Not collective.

        Args:
            comm: communicator whose first rank logs the warning.
            observe: observer to be called with each iteration.
        """
        self._comm, self._observe = comm, observe
        self._contact, self._newton = _Halving(), _Halving()
        self._step, self._applied = 0, 0.0
        self._warned = False

    def __call__(self, iteration: Iteration) -> bool:
        """Call the observer with an iteration whose `stalled` is set; return the observer's answer.

        The first stall is logged as a warning. Collective if the observer is.
        """
        stalled = self._stalled(iteration)
        if stalled and not self._warned:
            self._warned = True
            log(
                self._comm,
                "no progress: %s. The solve goes on; an observer that returns True, or Ctrl-C, "
                "stops it.",
                stalled,
                level=logging.WARNING,
            )
        return self._observe(replace(iteration, stalled=stalled))

    def _stalled(self, iteration: Iteration) -> str:
        """Return a text that says why the solve counts as stalled; empty if it does not."""
        newton = iteration.newton
        if newton is not None and newton.number != self._step:
            self._step = newton.number
            if newton.applied != self._applied:
                self._applied, self._newton = newton.applied, _Halving()
            self._newton.add(newton.residual)
        if iteration.number == 0:
            self._contact = _Halving()
        self._contact.add(iteration.residual)
        if self._newton.idle >= IDLE_NEWTON_STEPS:
            return f"the residual has not halved in {self._newton.idle} Newton steps"
        if self._contact.idle >= PATIENCE:
            return f"the residual has not halved in {self._contact.idle} iterations"
        if iteration.configuration is not None and iteration.configuration > IDLE_CONFIGURATIONS:
            return f"the surfaces were paired in {iteration.configuration} configurations"
        return ""


class _Halving:
    """A count of the values of a residual since the residual last halved.

    Attributes:
        idle: number of values since the residual last halved.
    """

    def __init__(self) -> None:
        self.idle = 0
        self._least = math.inf

    def add(self, value: float) -> None:
        """Add the next value of the residual."""
        self.idle += 1
        if value <= 0.5 * self._least:
            self._least, self.idle = value, 0
