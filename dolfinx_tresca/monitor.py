"""Observers of the iteration: what they are told, and a progress bar."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(frozen=True)
class Iteration:
    """The state of the solver at the beginning of an outer iteration.

    Attributes:
        number: 0 at the start.
        products: applications of A so far.
        residual: natural residual over its value at lambda = 0.
        reached: what decides: that residual, or the bound of the relative energy error.
        wanted: the solver stops when `reached` is at most this: `rtol` or `accuracy`.
        q: the dual energy q(lambda) [energy].
    """

    number: int
    products: int
    residual: float
    reached: float
    wanted: float
    q: float


#: Called on every rank before each iteration; returning True on any rank stops the solver
#: (STOPPED).
Observer: TypeAlias = Callable[[Iteration], "bool | None"]


class ProgressBar:
    """An observer that shows how many of the wanted digits are reached; needs tqdm.

    It appears in terminals only. Use it as a context manager, on the rank that should show it::

        with ProgressBar() as bar:
            problem.solve(observer=bar)
    """

    def __init__(self, *, disable: bool | None = None) -> None:
        from tqdm import tqdm

        self._bar: Any = tqdm(
            disable=disable,
            bar_format="contact {percentage:3.0f}% |{bar:30}| {elapsed}, {desc}",
        )

    def __call__(self, iteration: Iteration) -> None:
        """Show an iteration."""
        wanted = -math.log10(iteration.wanted)
        reached = -math.log10(max(iteration.reached, iteration.wanted))
        self._bar.total = wanted
        self._bar.n = min(max(self._bar.n, reached, 0.0), wanted)
        self._bar.set_description_str(
            f"iteration {iteration.number}, {iteration.products} products, "
            f"residual {iteration.residual:.1e}"
        )

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.close()
