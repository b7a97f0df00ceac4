"""The present multipliers and their gradient, which is as accurate as the iteration needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.products import ProductStore

#: Accuracy of a product: the gradient's error over the length of the step, both in the energy
#: norm. Each step leaves a tenth or more of what it begins with, since sets and the model change.
STEP_ACCURACY = 0.1

#: Factor on that accuracy each time errors are as large as what a step changes, and the accuracy at
#: which double precision has no more.
TIGHTER, TIGHTEST = 0.3, 1e-10

#: Error of a solve, over the one that was asked for, up to which it counts as reached.
SUCCESS_FACTOR = 1.01

#: Factor on the accuracy after each resolved product, one whose new part is larger than its error,
#: until it is what it was at the start.
LOOSER = 1.5


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
        resolved: whether the last product's new part was larger than its error.
    """

    def __init__(self, problem: DualProblem, store: ProductStore, finest: float) -> None:
        """Begin at zero, where no product is needed.

        Args:
            problem: gives products.
            store: where they are kept.
            finest: error of a gradient that is good enough, unless it hides what steps bring.
        """
        self._problem = problem
        self._store = store
        self._finest = finest
        self._least = 0.0
        self._part = STEP_ACCURACY
        self._length = 0.0
        self.move_to(np.zeros_like(problem.b), -problem.b, problem.b_error)
        self.resolved = True

    def move_to(self, multipliers: Array, r: Array, error: float) -> None:
        """Go to a point whose gradient is known. Not collective."""
        self.multipliers, self.r, self.error = multipliers, r, error

    def zero_step(self) -> Step:
        """Return a step of length zero. Not collective."""
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
            new, known = self._store.split(direction)
            product = problem.apply(new)
            self._store.add(new, product)
            return Step(direction, known + product, self.error)
        self._length = self._expected_length(direction)
        r, error = self._gradient(self.multipliers + direction, self._wanted(), self.multipliers)
        # errors of the present gradient are made up for, so that they do not pile up
        product = r - self.r
        self.resolved = self._store.add(direction, product, error + self.error)
        if self.resolved:
            self._part = min(self._part * LOOSER, STEP_ACCURACY)
        return Step(direction, product, error)

    def refine_for_step(self, direction: Array) -> bool:
        """Compute the gradient again if its error exceeds the length of the step. Collective.

        Args:
            direction: (size,) the step that the present gradient proposes.

        Returns:
            whether the gradient is more accurate now; the step must then be computed again.
        """
        before = self.error
        if before > 0.0 and before > (length := self._expected_length(direction)):
            self.refine(max(self._part * length, self._finest))
        return self.error < before

    def _expected_length(self, direction: Array) -> float:
        """Return the energy norm of a step by the model of A. Collective."""
        image = self._store.model().apply(direction)
        return float(np.sqrt(float(self._problem.inner(direction, image))))

    def _wanted(self) -> float:
        """Return the accuracy that the next product needs."""
        return max(self._part * self._length, self._finest)

    def _gradient(
        self, multipliers: Array, accuracy: float, origin: Array | None = None
    ) -> tuple[Array, float]:
        """Return a gradient and its error; note the error if the solver cannot reduce it."""
        r, error = self._problem.gradient(multipliers, accuracy, origin)
        if error > SUCCESS_FACTOR * accuracy:
            self._least = max(self._least, error)
        return r, error

    def increase_accuracy(self) -> bool:
        """Compute the gradient and later products more accurately, and return whether it can."""
        if self._problem.exact or self._part < TIGHTEST:
            return False
        self._part *= TIGHTER
        self._finest *= TIGHTER
        self.refine(self._wanted())
        return True

    def refine(self, accuracy: float) -> None:
        """Compute the gradient again if its error exceeds an accuracy. Collective.

        Nothing is done if the solver for K has missed such an accuracy before.
        """
        if self.error > max(accuracy, SUCCESS_FACTOR * self._least):
            self.r, self.error = self._gradient(self.multipliers, accuracy)

    def move(self, step: Step) -> None:
        """Go to the end of a step. Not collective."""
        self.move_to(self.multipliers + step.direction, self.r + step.product, step.error)
