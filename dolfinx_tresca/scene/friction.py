"""Friction laws."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from dolfinx_tresca.scene.slip_bound import (
    ScalarField,
    check_slip_bound,
    slip_bound_text,
)


@dataclass(frozen=True)
class Tresca:
    """Tresca friction: the norm of the tangential traction is at most `slip_bound`.

    The bound does not depend on the contact pressure. In particular nodes that are out of contact
    are dragged too, as (38.3) has it for every node: set the bound to zero where nothing should
    rub.

    Attributes:
        slip_bound: g >= 0 [stress], on the mesh of the problem: a number; a scalar `fem.Constant`,
            `fem.Function` or UFL expression of those (or `fem.Expression`), all continuous, whose
            values at the nodes count; or a function of points, x of shape (3, n) -> a number or
            (n,), called with the contact nodes. What these depend on may be changed in place
            before each solve. Where g is infinite nothing slips; where it is negative by less than
            1e-12 of the largest finite one of the pair, by rounding, it is zero.

    Example:
        >>> from dolfinx_tresca import Tresca
        >>> Tresca(0.09)
        Tresca(0.09)
        >>> Tresca(lambda x: 0.09 * (x[0] < 1.0))  # nothing rubs beyond x = 1
        Tresca(a function of points)
    """

    slip_bound: ScalarField

    def __post_init__(self) -> None:
        """Check the kind of bound.

        Raises:
            InputError: it is no real scalar, has no value at nodes, or is a number that is negative
                or NaN.
        """
        check_slip_bound(self.slip_bound)

    def __repr__(self) -> str:
        return f"Tresca({slip_bound_text(self.slip_bound)})"

    def __str__(self) -> str:
        return f"slip bound {slip_bound_text(self.slip_bound)}"


@dataclass(frozen=True)
class Frictionless:
    """No friction: a multiplier for the pressure, none for tangential traction."""

    def __str__(self) -> str:
        return "no friction"


@dataclass(frozen=True)
class Bonded:
    """Surfaces that are tied to each other: no jump in any direction, and no inequality.

    An initial gap stays as it is. The pressure may be negative: tension.
    """

    def __str__(self) -> str:
        return "bonded"


#: What may happen between two surfaces.
Friction: TypeAlias = "Tresca | Frictionless | Bonded"
