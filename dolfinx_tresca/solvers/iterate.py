"""The present multipliers and their gradient, computed as accurately as the iteration needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.tolerances import FORCING, FULL_ACCURACY, ROUGH, SLACK
from dolfinx_tresca.solvers.problem import DualProblem, KnownProducts, Point


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


class Iterate:
    """A point in the friction cones with its gradient, and steps from it with their products.

    Products are exact to rounding, as with a direct solver for K; see `InexactIterate`.

    Attributes:
        x: (size,) multipliers of the point.
        c: (k,) multipliers of the constraints.
        r: (size,) A x - b, the gradient at the point without constraints.
        error: estimated error of r in the norm sqrt(e'A^-1 e); 0 for exact products.
        finest: least error that is requested of a gradient.
        initial_part: sufficient error of the first gradient, relative to the energy norm of its
            multipliers.
        learned: whether the last step has changed the model of A, or the accuracy of gradients.
        store: known products with A, to which new products are added.
    """

    initial_part = FULL_ACCURACY

    def __init__(self, problem: DualProblem, store: KnownProducts) -> None:
        """Begin at zero, where no product is needed.

        Args:
            problem: the dual problem (38.4), for products and gradients.
            store: known products, to which new products are added.
        """
        self._problem, self.store, self.finest, self.learned = problem, store, 0.0, True
        self.c: Array = np.zeros(len(problem.constraints))
        self.move_to(np.zeros_like(problem.b), -problem.b, problem.response.b_error)

    @property
    def point(self) -> Point:
        """The point with its gradient, which includes the terms of the constraints."""
        return self.point_after(self.zero_step())

    def point_after(self, step: Step) -> Point:
        """Return the end of a step."""
        r = self.r + step.product - self._problem.constraints.columns @ step.c
        return Point(self.x + step.direction, step.c, r)

    def move_to(self, x: Array, r: Array, error: float) -> None:
        """Set the point, with a known gradient and its error. Not collective."""
        self.x, self.r, self.error = x, r, error

    def move(self, step: Step) -> None:
        """Set the point to the end of a step. Not collective."""
        self.move_to(self.x + step.direction, self.r + step.product, step.error)
        self.c = step.c

    def zero_step(self) -> Step:
        """Return a step of length zero. Not collective."""
        return Step(np.zeros_like(self.r), np.zeros_like(self.r), self.error, self.c)

    def step(self, direction: Array, c: Array) -> Step:
        """Return the step along a direction and its product with A. Collective.

        Known products give A times a part of the direction. The rest of the direction is new, and
        is added to the store with its product.

        Args:
            direction: (size,) change of the multipliers.
            c: (k,) multipliers of the constraints at the end of the step.
        """
        before = len(self.store)
        product = self._product(direction)
        self.learned = len(self.store) != before
        return Step(direction, product, self.error, c)

    def _product(self, x: Array) -> Array:
        """Return A x. Only the part of x without known product is multiplied by A."""
        # subtracting the known part from a product of the whole x would leave rounding errors that
        # grow from pair to pair
        new, product_of_known = self.store.split(x)
        if float(self._problem.inner(new, new)) == 0.0:
            return product_of_known
        product = self._problem.operator.apply(new)
        self.store.add(new, product)
        return product_of_known + product

    def initial_gradient(self, x: Array) -> tuple[Array, float]:
        """Return the gradient at an initial point, and its error. Collective.

        Known products may determine the gradient, for example if a solve with another load has
        ended at these multipliers.
        """
        response, b = self._problem.response, self._problem.b
        product, error = self.store.product(x)
        wanted = max(self.initial_part * self._energy_norm(x), self.finest)
        if error + response.b_error <= wanted:
            return product - b, error + response.b_error
        # an accuracy below the error of b is useless: for tiny multipliers, the product would
        # consist of the error of b only
        r, error = response.gradient(x, max(wanted, response.b_error))
        self.store.add(x, r + b, error + response.b_error)
        return r, error

    def _energy_norm(self, x: Array) -> float:
        """Return the energy norm of x (size,), with the model in place of A. Collective."""
        return float(np.sqrt(float(self._problem.inner(x, self.store.model().apply(x)))))

    def increase_accuracy(self) -> None:
        """Compute the gradient and later products more accurately, if that is possible."""


class InexactIterate(Iterate):
    """The point and its gradient with an iterative solver for K.

    The error of the gradient in the norm sqrt(e'A^-1 e) is limited to a part of the energy norm of
    the steps. A product is the difference of two gradients, and contains the errors of both.
    """

    initial_part = ROUGH

    def __init__(self, problem: DualProblem, store: KnownProducts) -> None:
        """Begin at zero, where no product is needed. The arguments are those of `Iterate`."""
        super().__init__(problem, store)
        self._length, self._least, self._part = 0.0, 0.0, FORCING

    def _wanted(self) -> float:
        """Return the requested error of the next gradient."""
        return max(self._part * self._length, self.finest)

    def _gradient(
        self, x: Array, accuracy: float, origin: Array | None = None
    ) -> tuple[Array, float]:
        """Return a gradient and its error; record the error if the solver cannot reduce it."""
        r, error = self._problem.response.gradient(x, accuracy, origin)
        if error > SLACK * accuracy:
            self._least = max(self._least, error)
        return r, error

    def step(self, direction: Array, c: Array) -> Step:
        """Return the step along a direction and its product with A. Collective.

        The direction is added to the store with its product.
        """
        if float(self._problem.inner(direction, direction)) == 0.0:
            return Step(direction, 0.0 * direction, self.error, c)
        self._length = self._energy_norm(direction)
        r, error = self._gradient(self.x + direction, self._wanted(), self.x)
        # the difference of gradients: errors of gradients do not accumulate over the steps
        product = r - self.r
        self.learned = self.store.add(direction, product, error + self.error)
        if self.learned:
            self._part = FORCING
        return Step(direction, product, error, c)

    def increase_accuracy(self) -> None:
        """Compute the gradient and later products more accurately, if that is possible."""
        if self._part >= FULL_ACCURACY:
            self._part *= FORCING
            self.finest *= FORCING
            self.learned = True
            self.refine(self._wanted())

    def refine(self, accuracy: float) -> None:
        """Compute the gradient again if its error exceeds `accuracy` and can be reduced."""
        if self.error > max(accuracy, SLACK * self._least):
            self.r, self.error = self._gradient(self.x, accuracy)
