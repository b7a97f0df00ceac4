"""Observers of the iteration: what they are told, and a progress bar."""

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
    """How far Newton's method has come: nonlinear bodies solve a contact problem in each step.

    Attributes:
        number: of the step, from 1 on, since the solve began.
        fraction: part of the change of load that the step is for; it falls where a larger part
            failed.
        residual: of the step before, as in `NewtonStep`; infinite in the first one.
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
        number: 0 at the start.
        products: applications of A so far.
        residual: natural residual over its value at lambda = 0.
        reached: what decides: that residual, or the bound of the relative energy error.
        wanted: the solver stops when `reached` is at most this: `rtol`, `accuracy`, or by default a
            part of the mesh's error.
        q: the dual energy q(lambda) [energy].
        newton: of nonlinear bodies: which step of Newton's method this is an iteration of.
    """

    number: int
    products: int
    residual: float
    reached: float
    wanted: float
    q: float
    newton: NewtonProgress | None = None


#: Called on every rank before each iteration; returning True on any rank stops the solver
#: (STOPPED).
Observer: TypeAlias = Callable[[Iteration], "bool | None"]


class ProgressBar:
    """An observer that shows how many of the wanted digits are reached.

    In a terminal it is a line that is written again and again, in a notebook a bar; elsewhere, as
    in log files, there is nothing. Observers are called on all ranks: of those of `comm` the first
    one shows the bar. It serves any number of solves::

        bar = ProgressBar(comm)
        solution = problem.solve(observer=bar)

    Used as a context manager it ends its line after a solve that did not converge, too.
    """

    def __init__(self, comm: Any = None, *, disable: bool | None = None) -> None:
        """Choose where to show it. Not collective.

        Args:
            comm: its first rank shows the bar; None: every rank that has one.
            disable: True: show nothing; False: also where standard error is no terminal.
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
        """Show an iteration."""
        if self._view is None:
            return
        newton = iteration.newton
        if iteration.number == 0 and (newton is None or newton.number == 1):
            self._view.end()
            self._part, self._start = 0.0, time.perf_counter()
        seconds = time.perf_counter() - self._start
        done = iteration.reached <= iteration.wanted
        if newton is None:
            part = 1.0
            if not done:
                part = math.log(min(iteration.reached, 1.0)) / math.log(iteration.wanted)
            self._part = max(self._part, part)  # what decides may change on the way
            text = (
                f"iteration {iteration.number}, {iteration.products} products, "
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
    """A line on standard error that is written again and again."""

    _open = False

    def show(self, part: float, text: str) -> None:
        """Write the line, as long as the terminal is wide."""
        line = f"contact {part:4.0%} |{'#' * round(12 * part):<12}| {text}"
        sys.stderr.write("\r" + line[: shutil.get_terminal_size().columns - 1])
        sys.stderr.flush()
        self._open = True

    def end(self) -> None:
        """Let others write below."""
        if self._open:
            sys.stderr.write("\n")
        self._open = False


class _NotebookBar:
    """A bar in the output of a cell, drawn by the browser."""

    def __init__(self, display: Any) -> None:
        self._display = display
        self._handle: Any = None

    def show(self, part: float, text: str) -> None:
        """Show the bar, in the place of the last one."""
        data = {
            "text/html": f'contact <progress value="{part:.3f}"></progress> {text}',
            "text/plain": f"contact {part:4.0%}, {text}",
        }
        if self._handle is None:
            self._handle = self._display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)

    def end(self) -> None:
        """Leave the bar as it is; the next one is another."""
        self._handle = None


def _notebook_display() -> Any:
    """Return the function `display` of IPython if this is a notebook, else None."""
    ipython = sys.modules.get("IPython")  # where it is not imported there is no notebook
    if ipython is None or not hasattr(ipython.get_ipython(), "kernel"):
        return None
    return import_module("IPython.display").display
