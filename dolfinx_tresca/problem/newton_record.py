"""Options of Newton's method, the record of its steps, and the result of a nonlinear solve."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dolfinx import fem

from dolfinx_tresca._base.arrays import integer, real
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.result import ContactSolution
from dolfinx_tresca.status import ContactStatus
from dolfinx_tresca.table import Row


@dataclass(frozen=True)
class NewtonOptions:
    """Options of Newton's method.

    Attributes:
        accuracy: requested residual |R(u) + B'lambda|_{K^-1}, where R(u) are internal minus
            external forces and K is the tangent of the last step. It is relative to the larger of
            |u|_K and |u - u_0|_K, where u_0 is the displacement at the start of the solve; if
            stiffness was added to the tangent, whose energy is then no measure, relative to at most
            100 |B'lambda|_{K^-1}. A larger residual is accepted if it no longer halves and has the
            size of its rounding errors: a rigid motion has no energy and no other residual. The
            residual of the contact conditions has an accuracy of its own, in `SolverOptions`.
        max_iterations: largest number of Newton steps for a part of the load. Up to four times this
            number are taken while the error (with finite sliding also the error of the
            configuration) falls fast enough to reach the requested error within these steps.
        max_halvings: largest number of halvings of the part of the load that is applied at once.
    """

    accuracy: float = 1e-6
    max_iterations: int = 15
    max_halvings: int = 6

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            InputError: a value is of the wrong type or out of its range.
        """
        accuracy = real(self.accuracy)
        if accuracy is None or not 0.0 < accuracy < 1.0:
            raise InputError(
                f"accuracy of Newton's method must be a number in (0, 1), found "
                f"{shown(self.accuracy)}."
            )
        object.__setattr__(self, "accuracy", accuracy)
        for name, least in (("max_iterations", 1), ("max_halvings", 0)):
            value = getattr(self, name)
            number = integer(value)
            if number is None or number < least:
                raise InputError(
                    f"{name} of Newton's method must be an integer from {least} on, found "
                    f"{shown(value)}."
                )
            object.__setattr__(self, name, number)


@dataclass(frozen=True)
class NewtonStep:
    """One step of Newton's method: one contact problem.

    Attributes:
        number: number of the step, from 1 for each part of the load.
        fraction: fraction of the whole change of load at which the step seeks the equilibrium.
        correction: |u_{k+1} - u_k|_K relative to the larger of |u_{k+1}|_K and |u_{k+1} - u_0|_K,
            where u_0 is the displacement at the start of the solve.
        residual: |R(u_{k+1}) + B'lambda|_{K^-1}, see `NewtonOptions.accuracy`, divided by the same
            norm as `correction`; NaN if it cannot be computed.
        contact_residual: natural residual of the contact problem, relative to its value without
            contact.
        iterations: iterations of the contact solver.
        products: products with A in this step.
        pressed: number of nodes in contact, of all pairs and ranks.
        added: stiffness that was added to the tangent, in words; empty if there was none.
    """

    number: int
    fraction: float
    correction: float
    residual: float
    contact_residual: float
    iterations: int
    products: int
    pressed: int
    added: str

    def __repr__(self) -> str:
        return (
            f"<NewtonStep {self.number}: {self.fraction:.4g} of the load, residual "
            f"{self.residual:.1e}, {self.products} products>"
        )


@dataclass(frozen=True)
class NewtonRecord:
    """The steps of Newton's method in one `solve`.

    `print` shows it as a table.

    Attributes:
        steps: all steps, including the steps of parts of the load that failed.
        fraction: part of the change of load to which the solution belongs: 1, or less after a
            failure.
        message: the failure, and advice; empty after a success.
        released: energy that is neither stored nor dissipated by friction between the displacement
            from which the solve started and the solution [energy]: the work of loads, prescribed
            values and obstacles, minus the change of the stored energy, minus `dissipation`. Where
            bodies snap, it becomes motion and heat; in smooth steps it is small, of third order in
            the size of the step. NaN if it cannot be computed, or after a failure.
        snaps: whether most of the energy that the bodies exchange in this step is released: they
            jump to another equilibrium, or the step is too large to follow them.
        unbalanced: after a failure the forces R(u) + B'lambda [force] that are out of balance in
            its last Newton step, zero where prescribed; else None.
        flips: after a failure the number of Newton steps in which contact at each node began or
            ended, for the last part of the load that was tried; else None.
    """

    steps: tuple[NewtonStep, ...]
    fraction: float
    message: str
    released: float = math.nan
    snaps: bool = False
    unbalanced: fem.Function | None = None
    flips: fem.Function | None = None

    @property
    def residual(self) -> float:
        """The residual of the last step."""
        return self.steps[-1].residual if self.steps else math.nan

    def __repr__(self) -> str:
        return (
            f"<NewtonRecord: {len(self.steps)} steps, {self.fraction:.4g} of the load, residual "
            f"{self.residual:.1e}>"
        )

    def __str__(self) -> str:
        lines = ["   load  step  correction  residual  contact  pressed  products  added to K"]
        for step in self.steps:
            lines.append(
                f"{step.fraction:7.4f}  {step.number:4d}  {step.correction:10.1e}  "
                f"{step.residual:8.1e}  {step.contact_residual:7.0e}  {step.pressed:7d}  "
                f"{step.products:8d}  {step.added}".rstrip()
            )
        return "\n".join([*lines, self.message] if self.message else lines)


#: Rows of a linear solution's table that mean nothing for nonlinear bodies: they describe the
#: quadratic problem of the last step.
OF_LINEAR_BODIES = ("energy error", "energy")


@dataclass(frozen=True, repr=False)
class NonlinearContactSolution(ContactSolution):
    """A `ContactSolution` of nonlinear bodies: the last Newton step, and the record of all steps.

    Iterations, products and seconds are sums over all Newton steps. Energies and errors belong to
    the quadratic problem of the last step, and the norm |u|_K is that of this step's tangent K.

    Attributes:
        newton: record of Newton's method.
    """

    newton: NewtonRecord

    @property
    def failure(self) -> str:
        """Reason why the iterations failed, and what helps; empty if they converged."""
        if self.status is ContactStatus.NO_EQUILIBRIUM:
            return self.newton.message
        return super().failure

    def _rows(self) -> list[Row]:
        steps = self.newton.steps
        fractions = len({step.fraction for step in steps})
        newton = f"{len(steps)} steps, residual {self.newton.residual:.1e}"
        newton += f", load in {fractions} parts" * (fractions > 1)
        rows = [row for row in super()._rows() if row[0] not in OF_LINEAR_BODIES]
        result = [rows[0], ("Newton", newton), *rows[1:]]
        if self.newton.snaps:
            result.insert(2, ("released", f"energy {self.newton.released:.4g}: bodies snap"))
        return result
