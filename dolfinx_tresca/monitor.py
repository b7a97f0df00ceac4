"""Observers of the iteration: the records that they receive, and a progress bar."""

from __future__ import annotations

import math
import shutil
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, TypeAlias


@dataclass(frozen=True)
class NewtonProgress:
    """The progress of Newton's method for nonlinear bodies; each step solves a contact problem.

    Attributes:
        number: number of the step since the solve began, from 1 on.
        fraction: fraction of the whole change of load at which this step seeks the equilibrium, in
            (0, 1]. The fraction is reduced if the method has failed for a larger fraction.
        residual: residual of the previous step, as in `NewtonStep`; infinite in the first step.
        ended: whether Newton's method has converged.
    """

    number: int
    fraction: float
    residual: float
    ended: bool = False


@dataclass(frozen=True)
class Iteration:
    """The state of the solver at the beginning of an outer iteration.

    Attributes:
        number: number of the iteration, from 0 on.
        products: number of applications of A so far.
        residual: natural residual, relative to its value at lambda = 0.
        reached: value of the first stopping criterion that is not met: the imbalance of forces on
            floating bodies, the residual, the bound of the relative energy error, or
            `ContactSolution.local_error`.
        wanted: value of `reached` at which the criterion is met: 1e-10, `rtol`, `accuracy` (by
            default a fraction of the estimated error of the mesh), or `local_accuracy`.
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


#: Function that is called on every rank before each iteration. If it returns True on any rank, the
#: solve ends with the status STOPPED.
Observer: TypeAlias = Callable[[Iteration], "bool | None"]


class ProgressBar:
    """An observer that shows the progress of a solve.

    The progress is the fraction of the requested digits that are reached; for nonlinear bodies, it
    is the fraction of the change of load. The progress bar rewrites one line in a terminal, is a
    graphical bar in a notebook, and shows nothing elsewhere, as in log files. The same object
    serves any number of solves::

        bar = ProgressBar(comm)
        solution = problem.solve(observer=bar)

    Used as a context manager, it also ends its line after a solve that did not converge.
    """

    def __init__(self, comm: Any = None, *, disable: bool | None = None) -> None:
        """Choose where the bar appears. Not collective.

        Args:
            comm: communicator whose first rank shows the bar. None: each rank with a bar shows it.
            disable: True: show nothing; False: show the bar even if standard error is not a
                terminal; None: show it in terminals and notebooks.
        """
        self._part, self._start = 0.0, 0.0
        self._view: _Line | _NotebookBar | None = None
        if disable or (comm is not None and comm.rank != 0):
            return
        display = _notebook_display()
        if display is not None:
            self._view = _NotebookBar(display)
        elif disable is False or sys.stderr.isatty():
            self._view = _Line()

    def __call__(self, iteration: Iteration) -> None:
        """Show the progress at an iteration.

        A new solve begins a new bar, which ends when the solve has converged.
        """
        if self._view is None:
            return
        newton = iteration.newton
        configuration = iteration.configuration
        starts_solve = configuration in (None, 1) and (newton is None or newton.number == 1)
        if iteration.number == 0 and starts_solve:
            self._view.end()
            self._part, self._start = 0.0, time.perf_counter()
        seconds = time.perf_counter() - self._start
        done = iteration.reached <= iteration.wanted
        if newton is None:
            progress = 1.0
            if not done:
                progress = math.log(min(iteration.reached, 1.0)) / math.log(iteration.wanted)
            done = iteration.ended if configuration is not None else done
            # the stopping criterion may change during a solve
            self._part = max(self._part, progress)
            where, products = "", f"{iteration.products} products, "
            if configuration is not None:
                where, products = f"configuration {configuration}, ", ""
            text = (
                f"{where}iteration {iteration.number}, {products}"
                f"residual {iteration.residual:7.1e}, {seconds:.0f} s"
            )
        else:
            done = newton.ended
            self._part = newton.fraction if done else 0.99 * newton.fraction
            text = (
                f"of load, Newton step {newton.number}, residual {newton.residual:7.1e}, "
                f"{seconds:.0f} s"
            )
        self._view.show(self._part, text)
        if done:
            self._view.end()

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *error: object) -> None:
        if self._view is not None:
            self._view.end()


class _Line:
    """A line on standard error that is overwritten at each iteration."""

    _open = False

    def show(self, progress: float, text: str) -> None:
        """Write the line, cut to the width of the terminal."""
        line = f"contact {progress:4.0%} |{'#' * round(12 * progress):<12}| {text}"
        sys.stderr.write("\r" + line[: shutil.get_terminal_size().columns - 1])
        sys.stderr.flush()
        self._open = True

    def end(self) -> None:
        """End the line, so that other output begins below it."""
        if self._open:
            sys.stderr.write("\n")
        self._open = False


class _NotebookBar:
    """A bar in the output of a cell, drawn by the browser."""

    def __init__(self, display: Any) -> None:
        self._display = display
        self._handle: Any = None

    def show(self, progress: float, text: str) -> None:
        """Show the bar, or update the bar of the current solve."""
        data = {
            "text/html": f'contact <progress value="{progress:.3f}"></progress> {text}',
            "text/plain": f"contact {progress:4.0%}, {text}",
        }
        if self._handle is None:
            self._handle = self._display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)

    def end(self) -> None:
        """Leave the bar as it is; the next solve shows a new bar."""
        self._handle = None


def _notebook_display() -> Any:
    """Return the function `display` of IPython if this is a notebook, else None."""
    ipython = sys.modules.get("IPython")  # a notebook has imported it
    if ipython is None or not hasattr(ipython.get_ipython(), "kernel"):
        return None
    return import_module("IPython.display").display
