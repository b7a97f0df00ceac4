"""Friction laws."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TypeAlias

from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.scalar_field import (
    ScalarField,
    check_scalar_field,
    scalar_field_text,
)

#: Coefficient of friction with which a bound that holds in contact only sets in.
ONSET = 10.0


@dataclass(frozen=True)
class BoundTerms:
    """A slip bound c + min(F p, l) on surfaces with the pressure p.

    Attributes:
        constant: c >= 0 [stress].
        coefficient: F >= 0.
        limit: l >= 0 [stress].
    """

    constant: ScalarField = 0.0
    coefficient: ScalarField = 0.0
    limit: ScalarField = math.inf


class DryFriction(ABC):
    """A law with a bound on the norm of the tangential traction: below it nothing slips.

    A further law of this kind is a class with these terms.
    """

    @property
    @abstractmethod
    def terms(self) -> BoundTerms:
        """The bound, in terms of the pressure."""


@dataclass(frozen=True)
class Tresca(DryFriction):
    """Tresca friction: the norm of the tangential traction is at most `slip_bound`.

    The bound does not depend on the contact pressure. In particular nodes that are out of contact
    are dragged too, as (38.3) has it for every node: where nothing should rub set the bound to
    zero, or say `only_in_contact`.

    Attributes:
        slip_bound: g >= 0 [stress], on the mesh of the problem: a number; a scalar `fem.Constant`,
            `fem.Function` or UFL expression of those (or `fem.Expression`), all continuous, whose
            values at the nodes count; or a function of points, x of shape (3, n) -> a number or
            (n,), called with the contact nodes. What these depend on may be changed in place
            before each solve. Where g is infinite nothing slips; where it is negative by less than
            1e-12 of the largest finite one of the pair, by rounding, it is zero.
        only_in_contact: no traction where the surfaces are open, as many codes understand Tresca's
            law. So that a bound of its own belongs to each pressure, it is min(10 p, g): friction
            sets in with the pressure, and has reached g where p is a tenth of it.

    Example:
        >>> from dolfinx_tresca import Tresca
        >>> Tresca(0.09)
        Tresca(0.09)
        >>> Tresca(lambda x: 0.09 * (x[0] < 1.0))  # nothing rubs beyond x = 1
        Tresca(a function of points)
        >>> Tresca(0.09, only_in_contact=True)
        Tresca(0.09, only_in_contact=True)
    """

    slip_bound: ScalarField
    only_in_contact: bool = False

    def __post_init__(self) -> None:
        """Check the kind of bound.

        Raises:
            InputError: it is no real scalar, has no value at nodes, or is a number that is negative
                or NaN; or the second argument is neither True nor False.
        """
        check_scalar_field(self.slip_bound, "the slip bound")
        if not isinstance(self.only_in_contact, bool):
            raise InputError(
                f"only_in_contact must be True or False, found {shown(self.only_in_contact)}."
            )

    @property
    def terms(self) -> BoundTerms:
        """The bound, in terms of the pressure."""
        if self.only_in_contact:
            return BoundTerms(coefficient=ONSET, limit=self.slip_bound)
        return BoundTerms(constant=self.slip_bound)

    def __repr__(self) -> str:
        more = ", only_in_contact=True" if self.only_in_contact else ""
        return f"Tresca({scalar_field_text(self.slip_bound)}{more})"

    def __str__(self) -> str:
        more = " in contact" if self.only_in_contact else ""
        return f"slip bound {scalar_field_text(self.slip_bound)}{more}"


@dataclass(frozen=True)
class Coulomb(DryFriction):
    """Coulomb friction: the norm of the tangential traction is at most F p, with the pressure p.

    A solve finds the fixed point: multipliers that solve Tresca's problem with the bounds of their
    own pressures. There is one for coefficients that are not too large, and then only one for
    still smaller ones; what is returned satisfies the law as well as its `residuals` say.

    Attributes:
        coefficient: F >= 0, in the forms that `Tresca.slip_bound` has.
        limit: largest bound [stress], in the same forms: min(F p, limit), as for the shear limit in
            metal forming. None: no limit.

    Example:
        >>> from dolfinx_tresca import Coulomb
        >>> Coulomb(0.3)
        Coulomb(0.3)
        >>> print(Coulomb(0.3, limit=40.0))
        coefficient of friction 0.3, slip bound at most 40
    """

    coefficient: ScalarField
    limit: ScalarField | None = None

    def __post_init__(self) -> None:
        """Check the kind of coefficient and limit.

        Raises:
            InputError: one is no real scalar, has no value at nodes, or is a number that is
                negative, NaN, or infinite.
        """
        check_scalar_field(self.coefficient, "the coefficient of friction")
        if isinstance(self.coefficient, float) and math.isinf(self.coefficient):
            raise InputError(
                "the coefficient of friction must be finite. Surfaces that never slide are "
                "Bonded(), or have Tresca(math.inf) if they may open."
            )
        if self.limit is not None:
            check_scalar_field(self.limit, "the limit of the slip bound")

    @property
    def terms(self) -> BoundTerms:
        """The bound, in terms of the pressure."""
        limit = math.inf if self.limit is None else self.limit
        return BoundTerms(coefficient=self.coefficient, limit=limit)

    def __repr__(self) -> str:
        more = "" if self.limit is None else f", limit={scalar_field_text(self.limit)}"
        return f"Coulomb({scalar_field_text(self.coefficient)}{more})"

    def __str__(self) -> str:
        more = "" if self.limit is None else f", slip bound at most {scalar_field_text(self.limit)}"
        return f"coefficient of friction {scalar_field_text(self.coefficient)}{more}"


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
Friction: TypeAlias = "DryFriction | Frictionless | Bonded"
