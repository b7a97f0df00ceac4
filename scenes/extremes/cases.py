"""Cases at extremes; the first case of each group is an ordinary scene, for comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca import ContactError, ContactSolution, ContactStatus
from scenes.extremes.laws import defects
from scenes.scene import EPS, Scene

#: Requested residual.
RTOL = 1e-8

#: Largest defect in a law at one node: residuals are norms, and a node has at least 1e-4 of the
#: area.
LAWS = 100 * RTOL

#: Largest unbalanced force at a degree of freedom, divided by the forces that are added there: with
#: K factored, and with iterative solves or soft bodies.
ROUNDING, ITERATED = 1e3 * EPS, LAWS


@dataclass(frozen=True)
class Check:
    """An error that is zero in the exact solution; for a condition 0 if true, and 1 if false.

    Attributes:
        measure: name of the error or of the condition.
        error: value of the error.
        allowed: largest error with which the case passes.
    """

    measure: str
    error: float
    allowed: float

    @property
    def passed(self) -> bool:
        """Whether the error is small enough; NaN is not."""
        return bool(self.error <= self.allowed)


@dataclass(frozen=True)
class Outcome:
    """The result of a case.

    Attributes:
        status: name of the solution's status, or of the error that was raised.
        iterations: number of iterations.
        products: number of products.
        checks: checks of the answer.
        wanted: names of the statuses and errors with which the case passes.
    """

    status: str
    iterations: int
    products: int
    checks: tuple[Check, ...]
    wanted: tuple[str, ...] = (ContactStatus.CONVERGED.name, ContactStatus.OUTSIDE_THEORY.name)

    @property
    def passed(self) -> bool:
        """Whether the status is a wanted one, and all checks pass."""
        return self.status in self.wanted and all(check.passed for check in self.checks)

    @property
    def worst(self) -> Check:
        """The check whose error is the largest multiple of the allowed error."""
        return max(self.checks, key=lambda check: check.error / max(check.allowed, EPS))

    def and_also(self, *checks: Check) -> Outcome:
        """Return the outcome with more checks."""
        return replace(self, checks=(*self.checks, *checks))


@dataclass(frozen=True)
class Case:
    """A scene at an extreme; `run` is collective."""

    group: str
    name: str
    run: Callable[[MPI.Comm], Outcome]

    def __str__(self) -> str:
        return f"{self.group}: {self.name}"


class Cases(list[Case]):
    """The cases of a module, in the order in which they are written."""

    def __init__(self) -> None:
        super().__init__()
        self._newest: tuple[Any, int] = (None, 0)

    def case(self, group: str, name: str, *arguments: Any, **named: Any) -> Callable[..., Any]:
        """Return a decorator that adds a case: a function of a communicator and these arguments."""

        def add(run: Callable[..., Outcome]) -> Callable[..., Outcome]:
            # Python applies the last decorator of a function first
            if self._newest[0] is not run:
                self._newest = (run, len(self))
            found = Case(group, name, lambda comm: run(comm, *arguments, **named))
            self.insert(self._newest[1], found)
            return run

        return add


def yes(measure: str, true: Any) -> Check:
    """Return a check of a condition."""
    return Check(measure, 0.0 if true else 1.0, 0.0)


def equal(measure: str, found: Any, wanted: Any, allowed: float) -> Check:
    """Return a check of numbers, or arrays of this rank, relative to the largest wanted value."""
    found, wanted = np.atleast_1d(found), np.atleast_1d(wanted)
    size = float(np.abs(wanted).max(initial=0.0)) or 1.0
    return Check(measure, float((np.abs(found / size - wanted / size)).max(initial=0.0)), allowed)


def solve(model: Scene, *, options: dict[str, Any] | None = None, **asked: Any) -> ContactSolution:
    """Solve to the residual `RTOL`, or to what `asked` requests. Collective."""
    if "accuracy" not in asked:
        asked.setdefault("rtol", RTOL)
    with model.problem(**(options or {})) as problem:
        return problem.solve(**asked)


def outcome(solution: ContactSolution, *checks: Check) -> Outcome:
    """Return the outcome with the status and the counts of a solution, and with checks."""
    return Outcome(solution.status.name, solution.iterations, solution.products, checks)


def judged(
    model: Scene,
    solution: ContactSolution,
    *,
    held: bool = True,
    allowed: float = LAWS,
    balance: float = ROUNDING,
) -> Outcome:
    """Return the outcome of a solution, checked by balance and by the laws. Collective."""
    found = defects(model, solution, held=held)
    missing = found.pop("balance")
    law = max(found, key=found.__getitem__)
    return outcome(
        solution, Check("balance of forces", missing, balance), Check(law, found[law], allowed)
    )


def lawful(
    model: Scene,
    *,
    held: bool = True,
    allowed: float = LAWS,
    options: dict[str, Any] | None = None,
    soft: bool = False,
    **asked: Any,
) -> Outcome:
    """Solve, and check the laws; `soft` bodies need only the balance `ITERATED`. Collective."""
    iterated = soft or (options or {}).get("stiffness") == "multigrid"
    solution = solve(model, options=options, **asked)
    return judged(
        model, solution, held=held, allowed=allowed, balance=ITERATED if iterated else ROUNDING
    )


def refused(run: Callable[[], Any], error: type[ContactError], words: Sequence[str]) -> Outcome:
    """Return the outcome of a call that should raise an error with some words in its message."""
    try:
        run()
    except ContactError as found:
        missing = [word for word in words if word not in str(found)]
        check = yes(f"says {', '.join(missing or words)}", not missing)
        return Outcome(type(found).__name__, 0, 0, (check,), (error.__name__,))
    return Outcome("NO ERROR", 0, 0, (yes("raises an error", False),), (error.__name__,))
