"""The displacement that follows multipliers which an iteration changes from step to step."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.forcing import FULL_ACCURACY
from dolfinx_tresca.dual.products.compliance import ContactCompliance

#: Requested error of the displacement after a step, divided by the size of the step, both in the
#: energy norm. The first step is the displacement at y = 0. With twice the value, which is
#: `FORCING`, derivatives of a rubbing block have an error of 1.2e-4 in place of 3e-5, since errors
#: of products enter y.
STEP_ACCURACY = 0.05


class FollowedDisplacement:
    """The displacement z with K z = f - B'y while the iteration for adjoint or tangent changes y.

    This class is for a direct solver for K: each product is one solve, and z is computed once, at
    the end. `ImprovedDisplacement` is for iterative solvers.
    """

    def __init__(self, compliance: ContactCompliance, f: PETSc.Vec, z: PETSc.Vec) -> None:
        """Begin with y = 0, before any solve. Not collective.

        Args:
            compliance: A, with K.
            f: right-hand side, with prescribed values in their rows. It is not copied: it must
                neither change nor be destroyed.
            z: vector of zeros for the result.
        """
        self._operator, self._f, self._z = compliance.operator, f, z
        self._solver, self._jump = compliance.operator.solver, compliance.jump
        self._error = 0.0

    @classmethod
    def of(cls, compliance: ContactCompliance, f: PETSc.Vec, z: PETSc.Vec) -> FollowedDisplacement:
        """Return an object of the class that suits the solver for K. Not collective.

        The arguments are those of `__init__`.
        """
        kind = FollowedDisplacement if compliance.operator.exact else ImprovedDisplacement
        return kind(compliance, f, z)

    def solve_start(self) -> Array:
        """Return B z (size,) for y = 0: one solve with K, unless f is zero. Collective."""
        if self._f.norm() > 0.0:
            self._operator.products += 1
            self._error = self._solver.improve(self._f, self._z, rtol=STEP_ACCURACY, accuracy=0.0)
            self._set_prescribed(self._z)
        return self._jump.of(self._z)

    def _set_prescribed(self, z: PETSc.Vec) -> None:
        """Set the prescribed values of z, which iterations change a little. Not collective."""
        prescribed = self._jump.system.prescribed
        z.array[prescribed] = self._f.array[prescribed]

    def _force(self, y: Array) -> PETSc.Vec:
        """Return f - B'y. Collective."""
        force = self._jump.contact_force(y)
        force.aypx(-1.0, self._f)
        return force

    def product(self, y: Array, step: Array, size: float) -> tuple[Array, float]:
        """Return A s for a step s from the present y, and its error. Collective.

        Args:
            y: (size,) present multipliers.
            step: (size,) s.
            size: the energy norm sqrt(s'A s), approximately.

        Returns:
            the product (size,), and the norm sqrt(e'A^-1 e) of its error e; 0 with a direct solver.
        """
        return self._operator.product(step)

    def combine(self, factors: Array, scale: float) -> None:
        """Orthogonalise the last step of z, as the iteration orthogonalises its step of y.

        The kept steps of z, times `factors`, are subtracted from the last step. The difference is
        multiplied by `scale` and kept. A direct solver keeps no steps. Not collective.

        Args:
            factors: (kept steps,) one factor for each kept step.
            scale: factor for the difference.
        """

    def advance(self, length: float) -> None:
        """Add `length` times the last step to z, unless z is computed at the end."""

    def end_at(self, y: Array, rtol: float) -> None:
        """Solve for z at multipliers y (size,) near the present multipliers. Collective.

        Args:
            y: multipliers at which the iteration has ended.
            rtol: relative error of z in the energy norm.
        """
        self._solver.improve(self._force(y), self._z, rtol=rtol, accuracy=0.0)
        self._set_prescribed(self._z)


class ImprovedDisplacement(FollowedDisplacement):
    """The displacement z, computed by an iterative solver for K that starts from the last z.

    The solver stops when the error is a given part of the step. As steps become smaller, z becomes
    more accurate, and all steps together cost little more than one accurate solve. (If each product
    had the accuracy of the result instead, the derivatives of a goal on the two bricks with N = 16
    would take 90 to 117 iterations of the solver for K in place of 33 to 40.) The product A s of a
    step s is the difference of two jumps B z. The change of z in each step is kept.
    """

    def __init__(self, compliance: ContactCompliance, f: PETSc.Vec, z: PETSc.Vec) -> None:
        """Begin with y = 0. The arguments are those of `FollowedDisplacement`. Not collective."""
        super().__init__(compliance, f, z)
        self._step: Array = np.zeros(len(z.array))
        self._steps: list[Array] = []

    def product(self, y: Array, step: Array, size: float) -> tuple[Array, float]:
        """Return A s for a step s from the present y, and its error. Collective."""
        self._operator.products += 1
        z, before = self._z.copy(), self._error
        self._error = self._solver.improve(
            self._force(y + step), z, rtol=FULL_ACCURACY, accuracy=STEP_ACCURACY * size
        )
        self._set_prescribed(z)
        product = self._jump.of(self._z) - self._jump.of(z)
        self._step = z.array - self._z.array
        z.destroy()
        return product, float(np.hypot(self._error, before))

    def combine(self, factors: Array, scale: float) -> None:
        """Orthogonalise the last step, see `FollowedDisplacement.combine`. Not collective."""
        for factor, step in zip(factors, self._steps, strict=True):
            self._step -= factor * step
        self._step *= scale
        self._steps.append(self._step)

    def advance(self, length: float) -> None:
        """Add `length` times the last step to z. Not collective."""
        self._z.array += length * self._step
