"""What Newton's method did, and the knobs of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dolfinx_tresca._base.number import integer, real
from dolfinx_tresca.errors import InputError, shown


@dataclass(frozen=True)
class NewtonOptions:
    """Options of Newton's method.

    Attributes:
        accuracy: stop when what is out of balance is at most this part of the displacement, or of
            its change in this solve where that is larger: of |u|_K the norm
            |R(u) + B'lambda|_{K^-1}, with the tangent K of the last step. What contact lacks is a
            matter of `SolverOptions`.
        max_iterations: Newton steps for a part of the load; up to four times as many where what is
            out of balance falls by a factor that gets there by then.
        max_halvings: how often the part of the load that is brought on at once may be halved.
    """

    accuracy: float = 1e-6
    max_iterations: int = 15
    max_halvings: int = 6

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            InputError: one is of the wrong type or out of its range.
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
        number: from 1 on, for each part of the load.
        fraction: of the change of load that the step solves for.
        correction: |u_{k+1} - u_k|_K over |u_{k+1}|_K.
        residual: |R(u_{k+1}) + B'lambda|_{K^-1} over |u_{k+1}|_K, or over how far that is from the
            start of the solve where it is larger; NaN where there is none.
        contact_residual: natural residual of the contact problem, over its value without contact.
        iterations: of that.
        products: of that, with A.
        pressed: nodes in contact, of all pairs and ranks.
        added: what was added to the tangent: nothing as a rule.
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
    """What Newton's method did in one `solve`.

    `print` shows it as a table.

    Attributes:
        steps: all of them, those too that came to nothing.
        fraction: of the change of load that the solution is for: 1, or less where it failed.
        message: what went wrong, and what to do; empty where nothing did.
    """

    steps: tuple[NewtonStep, ...]
    fraction: float
    message: str

    @property
    def residual(self) -> float:
        """That of the last step."""
        return self.steps[-1].residual if self.steps else math.nan

    def __repr__(self) -> str:
        return (
            f"<NewtonRecord: {len(self.steps)} steps, {self.fraction:.4g} of the load, residual "
            f"{self.residual:.1e}>"
        )

    def __str__(self) -> str:
        lines = ["   load  step  correction  residual  contact  pressed  products  added to K"]
        for one in self.steps:
            lines.append(
                f"{one.fraction:7.4f}  {one.number:4d}  {one.correction:10.1e}  "
                f"{one.residual:8.1e}  {one.contact_residual:7.0e}  {one.pressed:7d}  "
                f"{one.products:8d}  {one.added}".rstrip()
            )
        return "\n".join([*lines, self.message] if self.message else lines)
