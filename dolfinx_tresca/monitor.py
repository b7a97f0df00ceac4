"""Observers of the iteration: the records that they receive, and a progress bar."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(frozen=True)
class NewtonProgress:
    """The progress of Newton's method for nonlinear bodies; each step solves a contact problem.

    Attributes:
        number: number of the step since the solve began, from 1 on.
        fraction: fraction of the whole change of load at which this step seeks the equilibrium, in
            (0, 1]. The fraction is reduced if the method has failed for a larger fraction.
        residual: residual of the newest complete step, see `NewtonStep`; infinite before the first.
        ended: True in an additional call at the end, when the whole load is in equilibrium.
    """

    number: int
    fraction: float
    residual: float
    ended: bool = False


@dataclass(frozen=True)
class Iteration:
    """The state of the solver at its start, or after an outer iteration.

    Attributes:
        number: number of outer iterations so far, 0 at the start.
        products: number of applications of A so far.
        residual: natural residual, relative to its value at lambda = 0.
        reached: value of the first stopping criterion that is not met, else of the last criterion:
            the imbalance of forces on floating bodies, the residual, `ContactSolution.local_error`,
            or the bound of the relative energy error.
        wanted: value of `reached` at which the criterion is met: 1e-10, `rtol`, `local_accuracy`,
            or `accuracy` (by default a fraction of the estimated error of the mesh).
        q: the dual energy q(lambda) [energy].
        newton: the step of Newton's method that the iteration belongs to; None for linear bodies.
        configuration: number of the configuration in which the surfaces of linear bodies are
            paired with finite sliding, from 1 on; None with small sliding.
        ended: True in an additional call of the observer at the end of a solve with finite sliding,
            when the configurations have converged; False in all other calls.
    """

    number: int
    products: int
    residual: float
    reached: float
    wanted: float
    q: float
    newton: NewtonProgress | None = None
    configuration: int | None = None
    ended: bool = False


#: Function that is called on every rank at the start and after each iteration. If it returns True
#: on any rank, the solve ends with the status STOPPED, unless it has converged.
Observer: TypeAlias = Callable[[Iteration], "bool | None"]


class ProgressBar:
    """An observer that shows the progress of a solve.

    The progress is the fraction of the requested digits that are reached; for nonlinear bodies, it
    is the fraction of the change of load. The bar is a line on standard error that is overwritten
    at each iteration, in a terminal or a notebook; elsewhere, as in log files, nothing is shown.
    The same object serves any number of solves::

        bar = ProgressBar(comm)
        solution = problem.solve(observer=bar)

    Used as a context manager, it also ends its line after a solve that did not converge.
    """

    def __init__(self, comm: Any = None, *, disable: bool | None = None) -> None:
        """Choose where the bar appears. Not collective.

        Args:
            comm: communicator whose first rank shows the bar. None: each rank shows it.
            disable: True: show nothing; False: show the bar even if standard error is not a
                terminal; None: show it in terminals and notebooks.
        """
        self._progress, self._start, self._line_is_open = 0.0, 0.0, False
        is_seen = disable is False or sys.stderr.isatty() or "ipykernel" in sys.modules
        self._is_shown = not disable and is_seen and (comm is None or comm.rank == 0)

    def __call__(self, iteration: Iteration) -> None:
        """Show the progress at an iteration.

        A new solve begins a new line, which ends when the solve has converged.
        """
        if not self._is_shown:
            return
        newton, configuration = iteration.newton, iteration.configuration
        starts_solve = configuration in (None, 1) and (newton is None or newton.number == 1)
        if iteration.number == 0 and starts_solve:
            self._end_line()
            self._progress, self._start = 0.0, time.perf_counter()
        if newton is not None:
            # the last hundredth of the bar is kept for the end of Newton's method
            done, residual = newton.ended, newton.residual
            self._progress = newton.fraction if done else 0.99 * newton.fraction
            text = f"of load, Newton step {newton.number}"
        else:
            reached, wanted = iteration.reached, iteration.wanted
            done, residual = reached <= wanted, iteration.residual
            # the fraction of the digits
            progress = 1.0 if done else math.log(min(reached, 1.0)) / math.log(wanted)
            # the stopping criterion may change during a solve, but the bar does not go back
            self._progress = max(self._progress, progress)
            text = f"iteration {iteration.number}, {iteration.products} products"
            if configuration is not None:
                done = iteration.ended
                text = f"configuration {configuration}, iteration {iteration.number}"
        bar = f"{'#' * round(12 * self._progress):<12}"
        text += f", residual {residual:7.1e}, {time.perf_counter() - self._start:.0f} s"
        line = f"contact {self._progress:4.0%} |{bar}| {text}"
        sys.stderr.write("\r" + line[: shutil.get_terminal_size().columns - 1])
        sys.stderr.flush()
        self._line_is_open = True
        if done:
            self._end_line()

    def _end_line(self) -> None:
        """End the line, so that other output begins below it."""
        if self._line_is_open:
            sys.stderr.write("\n")
        self._line_is_open = False

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *error: object) -> None:
        self._end_line()
