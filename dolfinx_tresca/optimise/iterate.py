"""The present multipliers and their gradient, which is as accurate as the iteration needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.recycling import RecycledProducts

#: Error of a product over the length of its step, both in the energy norm.
ACCURACY = 0.1

#: By how much that shrinks when errors hide what a step brings, and where there is no more to gain.
SHARPER, SHARPEST = 0.3, 1e-10

#: Error over what was asked for that is as good.
WITHIN = 1.01

#: By how much it grows again with each product that shows what it has to.
RECOVER = 1.5


@dataclass(frozen=True)
class Step:
    """A step from the present point.

    Attributes:
        direction: (size,) change of the multipliers.
        product: (size,) A times that: the change of the gradient.
        error: of the gradient at the end, in the norm sqrt(e'A^-1 e).
    """

    direction: Array
    product: Array
    error: float


class Iterate:
    """A point of Lambda, with products that are as accurate as is of use there.

    Where products are exact, so is the gradient. Where the problem solves with K only so far, the
    error of the gradient, in the norm sqrt(e'A^-1 e), is kept at a part of the energy norm of the
    steps, and known: a product is the difference of two gradients, so the errors of both are in it.

    Attributes:
        multipliers: (size,) the point.
        r: (size,) the gradient there.
        error: of r, about, in that norm; 0 for exact products.
        clear: whether the last product showed more than its error.
    """

    def __init__(self, problem: DualProblem, recycled: RecycledProducts, finest: float) -> None:
        """Begin at zero, where no product is needed.

        Args:
            problem: gives products.
            recycled: where they are kept.
            finest: error of a gradient that is good enough, unless it hides what steps bring.
        """
        self._problem = problem
        self._recycled = recycled
        self._finest = finest
        self._least = 0.0
        self._part = ACCURACY
        self._length = 0.0
        self.place(np.zeros_like(problem.b), -problem.b, 0.0)
        self.clear = True

    def place(self, multipliers: Array, r: Array, error: float) -> None:
        """Go to a point whose gradient is known. Not collective."""
        self.multipliers, self.r, self.error = multipliers, r, error

    def zero_step(self) -> Step:
        """Return the step that leads nowhere. Not collective."""
        return Step(np.zeros_like(self.r), np.zeros_like(self.r), self.error)

    def step(self, direction: Array) -> Step:
        """Return a step with its product, and keep that. Collective.

        Args:
            direction: (size,); nothing is computed for zero.
        """
        problem = self._problem
        if float(problem.inner(direction, direction)) == 0.0:
            return self.zero_step()
        if problem.exact:
            # a product of what is new only: what is known, subtracted afterwards, would leave its
            # rounding errors, and these would grow from pair to pair
            new, known = self._recycled.split(direction)
            product = problem.apply(new)
            self._recycled.add(new, product)
            return Step(direction, known + product, 0.0)
        known = self._recycled.model().apply(direction)
        self._length = np.sqrt(float(problem.inner(direction, known)))
        r, error = self._gradient(self.multipliers + direction, self._wanted())
        # errors of the present gradient are made up for, so that they do not pile up
        product = r - self.r
        self.clear = self._recycled.add(direction, product, error + self.error)
        if self.clear:
            self._part = min(self._part * RECOVER, ACCURACY)
        return Step(direction, product, error)

    def _wanted(self) -> float:
        """Return the error that a product may have now."""
        return max(self._part * self._length, self._finest)

    def _gradient(self, multipliers: Array, accuracy: float) -> tuple[Array, float]:
        """Return a gradient and its error; remember it if that is the least there is."""
        r, error = self._problem.gradient(multipliers, accuracy)
        if error > WITHIN * accuracy:
            self._least = max(self._least, error)
        return r, error

    def tighten(self) -> bool:
        """Compute the gradient, and later products, more accurately, if that is possible."""
        if self._problem.exact or self._part < SHARPEST:
            return False
        self._part *= SHARPER
        self._finest *= SHARPER
        self.refine(self._wanted())
        return True

    def refine(self, accuracy: float) -> None:
        """Compute the gradient again if its error is larger than this. Collective.

        In vain where the problem was seen to do no better.
        """
        if self.error > max(accuracy, WITHIN * self._least):
            self.r, self.error = self._gradient(self.multipliers, accuracy)

    def move(self, step: Step) -> None:
        """Go to the end of a step. Not collective."""
        self.place(self.multipliers + step.direction, self.r + step.product, step.error)
