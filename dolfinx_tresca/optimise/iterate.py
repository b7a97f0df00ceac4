"""The present multipliers and their gradient, computed as accurately as the iteration needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.optimise.problem import DualProblem
from dolfinx_tresca.optimise.products import ProductStore

#: Accuracy of a product: error of the gradient over the length of the step, both in the energy
#: norm. A step reduces the error of the multipliers to no less than a tenth, since active sets and
#: model change.
STEP_ACCURACY = 0.1

#: Factor on the accuracy each time errors are as large as the change by a step; and the accuracy
#: at which double precision ends.
TIGHTER, TIGHTEST = 0.3, 1e-10

#: Error of a solve, over the requested error, up to which the accuracy counts as reached.
SUCCESS_FACTOR = 1.01

#: Factor on the accuracy after each product whose new part is larger than its error, until the
#: accuracy is `STEP_ACCURACY` again.
LOOSER = 1.5


@dataclass(frozen=True)
class Step:
    """A step from the present point.

    Attributes:
        direction: (size,) change of the multipliers.
        product: (size,) A times the direction, which is the change of the gradient.
        error: error of the gradient at the end of the step, in the norm sqrt(e'A^-1 e).
    """

    direction: Array
    product: Array
    error: float


class Iterate:
    """A point of Lambda with its gradient, and steps from it with their products.

    With an exact solver for K the gradient is exact. With an iterative solver, the error of the
    gradient in the norm sqrt(e'A^-1 e) is limited to a part of the energy norm of the steps. A
    product is then the difference of two gradients, and contains the errors of both.

    Attributes:
        multipliers: (size,) the point.
        r: (size,) gradient at the point.
        error: estimated error of r in the norm sqrt(e'A^-1 e); 0 for exact products.
        resolved: whether the last product's new part was larger than its error.
    """

    def __init__(self, problem: DualProblem, store: ProductStore, finest: float) -> None:
        """Begin at zero, where no product is needed.

        Args:
            problem: the dual problem (38.4), for products and gradients.
            store: known products; new ones are added.
            finest: least error of a gradient that is requested at first. It is reduced if errors
                are as large as the change by a step.
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
        """Set the point, with a known gradient and its error. Not collective."""
        self.multipliers, self.r, self.error = multipliers, r, error

    def zero_step(self) -> Step:
        """Return a step of length zero. Not collective."""
        return Step(np.zeros_like(self.r), np.zeros_like(self.r), self.error)

    def step(self, direction: Array) -> Step:
        """Return a step with its product, which is added to the store. Collective.

        Args:
            direction: (size,) change of the multipliers; zero needs no product.
        """
        problem = self._problem
        if float(problem.inner(direction, direction)) == 0.0:
            return self.zero_step()
        if problem.exact:
            # only the new part is multiplied by A: subtracting the known part from a product of the
            # whole direction would leave rounding errors that grow from pair to pair
            new, known = self._store.split(direction)
            if self._store.matrix is not None:
                return Step(direction, known, self.error)
            product = problem.apply(new)
            self._store.add(new, product)
            return Step(direction, known + product, self.error)
        self._length = self._expected_length(direction)
        r, error = self._gradient(self.multipliers + direction, self._wanted(), self.multipliers)
        # the difference of gradients: errors of gradients do not accumulate over the steps
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
            True if the gradient is more accurate now; the step must then be computed again.
        """
        before = self.error
        if before > 0.0 and before > (length := self._expected_length(direction)):
            self.refine(max(self._part * length, self._finest))
        return self.error < before

    def _expected_length(self, direction: Array) -> float:
        """Return the energy norm of a step, with the model in place of A. Collective."""
        image = self._store.model().apply(direction)
        return float(np.sqrt(float(self._problem.inner(direction, image))))

    def _wanted(self) -> float:
        """Return the requested error of the next gradient."""
        return max(self._part * self._length, self._finest)

    def _gradient(
        self, multipliers: Array, accuracy: float, origin: Array | None = None
    ) -> tuple[Array, float]:
        """Return a gradient and its error; record the error if the solver cannot reduce it."""
        r, error = self._problem.gradient(multipliers, accuracy, origin)
        if error > SUCCESS_FACTOR * accuracy:
            self._least = max(self._least, error)
        return r, error

    def increase_accuracy(self) -> bool:
        """Compute the gradient and later products more accurately; return False if impossible."""
        if self._problem.exact or self._part < TIGHTEST:
            return False
        self._part *= TIGHTER
        self._finest *= TIGHTER
        self.refine(self._wanted())
        return True

    def refine(self, accuracy: float) -> None:
        """Compute the gradient again if its error exceeds an accuracy. Collective.

        Nothing is done if the solver for K did not reach such an accuracy before.
        """
        if self.error > max(accuracy, SUCCESS_FACTOR * self._least):
            self.r, self.error = self._gradient(self.multipliers, accuracy)

    def move(self, step: Step) -> None:
        """Set the point to the end of a step. Not collective."""
        self.move_to(self.multipliers + step.direction, self.r + step.product, step.error)
