"""What a case at an extreme is: a group's first one is its ordinary scene, to compare with."""

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

#: Of the laws at single nodes: residuals are norms, and a node has at least 1e-4 of the area.
LAWS = 100 * RTOL

#: Of forces at single degrees of freedom, over what is added there: rounding where K is factored,
#: else what the iteration leaves.
ROUNDING, ITERATED = 1e3 * EPS, LAWS


@dataclass(frozen=True)
class Check:
    """Something that is zero in the exact solution, or at most one if it is a yes or no.

    Attributes:
        measure: what it is.
        error: its value.
        allowed: the largest value with which the case passes.
    """

    measure: str
    error: float
    allowed: float

    @property
    def passed(self) -> bool:
        """NaN does not."""
        return bool(self.error <= self.allowed)


@dataclass(frozen=True)
class Outcome:
    """How a case went.

    Attributes:
        status: of the solution, or the name of an error.
        iterations: of the solution.
        products: of the solution.
        checks: of the answer.
        wanted: names of statuses and errors that are right.
    """

    status: str
    iterations: int
    products: int
    checks: tuple[Check, ...]
    wanted: tuple[str, ...] = (ContactStatus.CONVERGED.name,)

    @property
    def passed(self) -> bool:
        """Whether the status is right and the answer as well."""
        return self.status in self.wanted and all(check.passed for check in self.checks)

    @property
    def worst(self) -> Check:
        """The check that is nearest to its limit, or farthest above."""
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
        """Return a decorator that adds a function of a communicator, and of more arguments."""

        def add(run: Callable[..., Outcome]) -> Callable[..., Outcome]:
            # of several decorators of one function the last comes first
            if self._newest[0] is not run:
                self._newest = (run, len(self))
            found = Case(group, name, lambda comm: run(comm, *arguments, **named))
            self.insert(self._newest[1], found)
            return run

        return add


def yes(measure: str, true: Any) -> Check:
    """A check of what is true or not."""
    return Check(measure, 0.0 if true else 1.0, 0.0)


def equal(measure: str, found: Any, wanted: Any, allowed: float) -> Check:
    """A check of numbers, or arrays of this rank, relative to the largest wanted."""
    found, wanted = np.atleast_1d(found), np.atleast_1d(wanted)
    size = float(np.abs(wanted).max(initial=0.0)) or 1.0
    return Check(measure, float((np.abs(found / size - wanted / size)).max(initial=0.0)), allowed)


def solve(model: Scene, *, options: dict[str, Any] | None = None, **asked: Any) -> ContactSolution:
    """Solve to `RTOL`, unless something else is asked for. Collective."""
    if "accuracy" not in asked:
        asked.setdefault("rtol", RTOL)
    with model.problem(**(options or {})) as problem:
        return problem.solve(**asked)


def outcome(solution: ContactSolution, *checks: Check) -> Outcome:
    """Return an outcome of a solution."""
    return Outcome(solution.status.name, solution.iterations, solution.products, checks)


def judged(
    model: Scene,
    solution: ContactSolution,
    *,
    held: bool = True,
    allowed: float = LAWS,
    balance: float = ROUNDING,
) -> Outcome:
    """Return the outcome of a solution by the laws. Collective."""
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
    """Solve, and judge by the laws; soft bodies are balanced as residuals are. Collective."""
    iterated = soft or (options or {}).get("stiffness") == "multigrid"
    solution = solve(model, options=options, **asked)
    return judged(
        model, solution, held=held, allowed=allowed, balance=ITERATED if iterated else ROUNDING
    )


def refused(run: Callable[[], Any], error: type[ContactError], words: Sequence[str]) -> Outcome:
    """Return the outcome of what should raise an error with some words in its message."""
    try:
        run()
    except ContactError as found:
        missing = [word for word in words if word not in str(found)]
        check = yes(f"says {', '.join(missing or words)}", not missing)
        return Outcome(type(found).__name__, 0, 0, (check,), (error.__name__,))
    return Outcome("NO ERROR", 0, 0, (yes("raises an error", False),), (error.__name__,))
