"""The present multipliers and their gradient, computed as accurately as the iteration needs."""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import FORCING, FULL_ACCURACY, SLACK
from dolfinx_tresca.optimise.problem import DualProblem, KnownProducts, Point


@dataclass(frozen=True)
class Step:
    """A step from the present point.

    Attributes:
        direction: (size,) change of the multipliers.
        product: (size,) A times the direction, which is the change of the gradient.
        error: error of the gradient at the end of the step, in the norm sqrt(e'A^-1 e).
        c: (k,) multipliers of the constraints at the end of the step.
    """

    direction: Array
    product: Array
    error: float
    c: Array


class Iterate(ABC):
    """A point of Lambda with its gradient, and steps from it with their products.

    The class decides how accurately gradients and products are computed. There are two policies:
    `ExactIterate` and `InexactIterate`.

    Attributes:
        x: (size,) multipliers of the point.
        c: (k,) multipliers of the constraints.
        r: (size,) A x - b, the gradient at the point without constraints.
        error: estimated error of r in the norm sqrt(e'A^-1 e); 0 for exact products.
        finest: least error that is requested of a gradient. This limit is lowered if errors are as
            large as the change of the gradient by a step.
        resolved: whether the new part of the last product was larger than the product's error.
        learned: whether the last step has changed the model of A, or the accuracy of gradients.
        store: known products with A, to which new products are added.
    """

    def __init__(self, problem: DualProblem, store: KnownProducts) -> None:
        """Begin at zero, where no product is needed.

        Args:
            problem: the dual problem (38.4), for products and gradients.
            store: known products, to which new products are added.
        """
        self._problem = problem
        self.store = store
        self.finest = 0.0
        self._least = 0.0
        self._part = FORCING
        self.c: Array = np.zeros(len(problem.constraints))
        self.move_to(np.zeros_like(problem.b), -problem.b, problem.response.b_error)
        self.resolved = self.learned = True

    @classmethod
    def of(cls, problem: DualProblem, store: KnownProducts) -> Iterate:
        """Return an iterate at zero, with the policy for the problem's products.

        The arguments are those of `__init__`.
        """
        return (ExactIterate if problem.operator.exact else InexactIterate)(problem, store)

    @property
    def point(self) -> Point:
        """The point with its gradient, which includes the terms of the constraints."""
        return Point(self.x, self.c, self.r - self._problem.constraints.columns @ self.c)

    def point_after(self, step: Step) -> Point:
        """Return the end of a step."""
        r = self.r + step.product - self._problem.constraints.columns @ step.c
        return Point(self.x + step.direction, step.c, r)

    @abstractmethod
    def step(self, direction: Array, c: Array) -> Step:
        """Return the step along a direction and its product with A. Collective.

        Known products give A times a part of the direction. The rest of the direction is new, and
        is added to the store with its product.

        Args:
            direction: (size,) change of the multipliers; zero needs no product.
            c: (k,) multipliers of the constraints at the end of the step.
        """

    @abstractmethod
    def initial_gradient(self, multipliers: Array, part: float) -> tuple[Array, float]:
        """Return the gradient at an initial point, and its error. Collective.

        No product is needed at zero, or if known products determine the gradient, for example if a
        solve with another load has ended at these multipliers.

        Args:
            multipliers: (size,) the point.
            part: sufficient error of the gradient, divided by the energy norm of the multipliers;
                it is used for inexact products only.
        """

    def increase_accuracy(self) -> bool:
        """Compute the gradient and later products more accurately; return False if impossible."""
        return False

    def refine_fully(self) -> bool:
        """Compute b and the gradient again, as accurately as possible. Collective.

        Returns:
            True if b and the gradient were computed again; False if they are already exact.
        """
        return False

    def move_to(self, multipliers: Array, r: Array, error: float) -> None:
        """Set the point, with a known gradient and its error. Not collective."""
        self.x, self.r, self.error = multipliers, r, error

    def zero_step(self) -> Step:
        """Return a step of length zero. Not collective."""
        return Step(np.zeros_like(self.r), np.zeros_like(self.r), self.error, self.c)

    def refine_for_step(self, direction: Array) -> bool:
        """Compute the gradient again if its error exceeds the length of the step. Collective.

        Args:
            direction: (size,) the step that the present gradient proposes.

        Returns:
            True if the gradient is more accurate now; the step must then be computed again.
        """
        before = self.error
        if before > 0.0 and before > (length := self._expected_length(direction)):
            self.refine(max(self._part * length, self.finest))
        return self.error < before

    def _expected_length(self, direction: Array) -> float:
        """Return the energy norm of a vector, with the model in place of A. Collective."""
        image = self.store.model().apply(direction)
        return float(np.sqrt(float(self._problem.inner(direction, image))))

    def _gradient(
        self, multipliers: Array, accuracy: float, origin: Array | None = None
    ) -> tuple[Array, float]:
        """Return a gradient and its error; record the error if the solver cannot reduce it."""
        r, error = self._problem.response.gradient(multipliers, accuracy, origin)
        if error > SLACK * accuracy:
            self._least = max(self._least, error)
        return r, error

    def refine(self, accuracy: float) -> None:
        """Compute the gradient again if its error exceeds `accuracy`. Collective.

        If the error is near the least error that the solver for K has reached, the gradient is not
        computed again.
        """
        if self.error > max(accuracy, SLACK * self._least):
            self.r, self.error = self._gradient(self.x, accuracy)

    def move(self, step: Step) -> None:
        """Set the point to the end of a step. Not collective."""
        self.move_to(self.x + step.direction, self.r + step.product, step.error)
        self.c = step.c

    def _known_gradient(self, multipliers: Array, part: float) -> tuple[Array, float, float]:
        """Return the gradient from b and known products, its error, and the error that suffices."""
        problem = self._problem
        if float(problem.inner(multipliers, multipliers)) == 0.0:
            return -problem.b, problem.response.b_error, np.inf
        known, error = self.store.product(multipliers)
        wanted = max(part * self._expected_length(multipliers), self.finest)
        return known - problem.b, error + problem.response.b_error, wanted


class ExactIterate(Iterate):
    """The point and its gradient with a direct solver for K: products are exact to rounding."""

    def step(self, direction: Array, c: Array) -> Step:
        """Return the step along a direction and its product with A. Collective.

        Known products give A times a part of the direction; only the rest is multiplied by A.
        """
        problem, known_pairs = self._problem, len(self.store)
        self.learned = False
        if float(problem.inner(direction, direction)) == 0.0:
            return dataclasses.replace(self.zero_step(), c=c)
        # only the new part is multiplied by A: subtracting the known part from a product of the
        # whole direction would leave rounding errors that grow from pair to pair
        new, known = self.store.split(direction)
        if float(problem.inner(new, new)) == 0.0:
            return Step(direction, known, self.error, c)
        product = problem.operator.apply(new)
        self.store.add(new, product)
        self.learned = len(self.store) != known_pairs
        return Step(direction, known + product, self.error, c)

    def initial_gradient(self, multipliers: Array, part: float) -> tuple[Array, float]:
        """Return the gradient at an initial point, exact to rounding. Collective."""
        r, error, wanted = self._known_gradient(multipliers, FULL_ACCURACY)
        if error <= wanted:
            return r, error
        new, known = self.store.split(multipliers)
        product = self._problem.operator.apply(new)
        self.store.add(new, product)
        return known + product - self._problem.b, 0.0


class InexactIterate(Iterate):
    """The point and its gradient with an iterative solver for K.

    The error of the gradient in the norm sqrt(e'A^-1 e) is limited to a part of the energy norm of
    the steps. A product is the difference of two gradients, and contains the errors of both.
    """

    def __init__(self, problem: DualProblem, store: KnownProducts) -> None:
        """Begin at zero, where no product is needed. The arguments are those of `Iterate`."""
        super().__init__(problem, store)
        self._length = 0.0

    def _wanted(self) -> float:
        """Return the requested error of the next gradient."""
        return max(self._part * self._length, self.finest)

    def step(self, direction: Array, c: Array) -> Step:
        """Return the step along a direction and its product with A. Collective.

        Known products give A times a part of the direction. The rest of the direction is new, and
        is added to the store with its product.
        """
        if float(self._problem.inner(direction, direction)) == 0.0:
            return dataclasses.replace(self.zero_step(), c=c)
        self._length = self._expected_length(direction)
        r, error = self._gradient(self.x + direction, self._wanted(), self.x)
        # the difference of gradients: errors of gradients do not accumulate over the steps
        product = r - self.r
        self.resolved = self.learned = self.store.add(direction, product, error + self.error)
        if self.resolved:
            self._part = FORCING
        return Step(direction, product, error, c)

    def initial_gradient(self, multipliers: Array, part: float) -> tuple[Array, float]:
        """Return the gradient at an initial point, and its error. Collective."""
        problem = self._problem
        r, error, wanted = self._known_gradient(multipliers, part)
        if error <= wanted:
            return r, error
        # an accuracy below the error of b is useless: for tiny multipliers, the product would
        # consist of the error of b only
        r, error = problem.response.gradient(multipliers, max(wanted, problem.response.b_error))
        self.store.add(multipliers, r + problem.b, error + problem.response.b_error)
        return r, error

    def increase_accuracy(self) -> bool:
        """Compute the gradient and later products more accurately; return False if impossible."""
        if self._part < FULL_ACCURACY:
            return False
        self._part *= FORCING
        self.finest *= FORCING
        self.learned = True
        self.refine(self._wanted())
        return True

    def refine_fully(self) -> bool:
        """Compute b and the gradient as accurately as possible. Collective."""
        self._problem.response.refine_b()
        self.move_to(self.x, *self.initial_gradient(self.x, 0.0))
        return True
