"""Friction laws."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TypeAlias, cast

from dolfinx_tresca._base.number import real
from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.scalar_field import (
    ScalarField,
    check_scalar_field,
    scalar_field_text,
)
from dolfinx_tresca.scene.vector_field import (
    VectorField,
    check_vector_field,
    vector_field_text,
)

#: A scalar for all directions, or one along a direction and one across it: semi-axes of an ellipse.
Bound: TypeAlias = "ScalarField | tuple[ScalarField, ScalarField]"

#: Which of two semi-axes is meant, for errors.
SIDES = ("along the direction", "across the direction")

#: How far below zero a coefficient of friction may be by rounding.
COEFFICIENT_ROUNDING = 1e-12

#: Coefficient of friction with which a bound that holds in contact only sets in.
ONSET = 10.0


@dataclass(frozen=True)
class BoundTerms:
    """A slip bound c + min(F p, l) on surfaces with the pressure p.

    With a direction one of the terms is a pair: its values along the direction and across it. These
    give the ellipse its shape; the bound is that of its longer semi-axis, with the larger value.

    Attributes:
        constant: c >= 0 [stress].
        coefficient: F >= 0.
        limit: l >= 0 [stress].
        direction: of one semi-axis, where it is projected into the tangent plane; None: circles.
    """

    constant: Bound = 0.0
    coefficient: Bound = 0.0
    limit: Bound = math.inf
    direction: VectorField | None = None


class DryFriction(ABC):
    """A law with a bound on the tangential traction, a circle or an ellipse: in it nothing slips.

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
            1e-12 of the largest finite one of the pair, or than what rounding of coordinates makes
            of pressures, it is zero; where by more, that is an error: of a number when the problem
            is made, else of `solve()`. Or two such bounds (g1, g2), both finite or both infinite,
            in 3D: along `direction` and across it. The traction stays in the ellipse
            (t1 / g1)^2 + (t2 / g2)^2 <= 1, and slip is normal to it. Where one is zero the surfaces
            slide freely in that direction; whether they stick or slip is about the other one.
        only_in_contact: no traction where the surfaces are open, as many codes understand Tresca's
            law. So that a bound of its own belongs to each pressure, it is min(10 p, g): friction
            sets in with the pressure, and has reached g where p is a tenth of it. An ellipse keeps
            its shape: what is meant is its longer semi-axis.
        direction: of the first of two bounds; a vector, which is projected into the tangent plane
            and may have any length: three numbers, or a `fem.Constant`, `fem.Function`, UFL
            expression or function of points, x of shape (3, n) -> (3,) or (3, n). Where it, or the
            ratio of the bounds, has changed a solve keeps no products of earlier ones.

    Example:
        >>> from dolfinx_tresca import Tresca
        >>> Tresca(0.09)
        Tresca(0.09)
        >>> Tresca(lambda x: 0.09 * (x[0] < 1.0))  # nothing rubs beyond x = 1
        Tresca(a function of points)
        >>> Tresca(0.09, only_in_contact=True)
        Tresca(0.09, only_in_contact=True)
        >>> Tresca((0.09, 0.03), direction=(1, 0, 0))  # grooves across x
        Tresca((0.09, 0.03), direction=(1, 0, 0))
    """

    slip_bound: Bound
    only_in_contact: bool = False
    direction: VectorField | None = None

    def __post_init__(self) -> None:
        """Check the kind of bound.

        Raises:
            InputError: it is no real scalar, has no value at nodes, or is NaN; there are two
                without a direction, or the other way round, or that is no vector; or the second
                argument is neither True nor False.
        """
        _check_bound(self.slip_bound, self.direction, "the slip bound")
        if not isinstance(self.only_in_contact, bool):
            raise InputError(
                f"only_in_contact must be True or False, found {shown(self.only_in_contact)}."
            )

    @property
    def terms(self) -> BoundTerms:
        """The bound, in terms of the pressure."""
        if self.only_in_contact:
            return BoundTerms(coefficient=ONSET, limit=self.slip_bound, direction=self.direction)
        return BoundTerms(constant=self.slip_bound, direction=self.direction)

    def __repr__(self) -> str:
        more = ", only_in_contact=True" if self.only_in_contact else ""
        return f"Tresca({_arguments(self.slip_bound, more, self.direction)})"

    def __str__(self) -> str:
        more = " in contact" if self.only_in_contact else ""
        return f"slip bound {_words(self.slip_bound, self.direction)}{more}"


@dataclass(frozen=True)
class Coulomb(DryFriction):
    """Coulomb friction: the norm of the tangential traction is at most F p, with the pressure p.

    A solve finds the fixed point: multipliers that solve Tresca's problem with the bounds of their
    own pressures. Discretised, the law has a solution for any coefficient, and a single one for
    small coefficients; where none is found the status is NO_FIXED_POINT. In a process it is the one
    that goes on from the last tractions. Nodes whose normal displacement is prescribed have no
    pressure: nothing rubs there; nor does it along a tangential direction that is prescribed.

    Attributes:
        coefficient: F >= 0, in the forms that `Tresca.slip_bound` has; or two (F1, F2), along
            `direction` and across it: the traction stays in an ellipse with the semi-axes F1 p and
            F2 p.
        limit: largest bound [stress], one in the same forms: min(F p, limit), as for the shear
            limit in metal forming. An ellipse keeps its shape, and its longer semi-axis is limited:
            no traction exceeds the limit. None: no limit.
        direction: of the first of two coefficients; see `Tresca.direction`.

    Example:
        >>> from dolfinx_tresca import Coulomb
        >>> Coulomb(0.3)
        Coulomb(0.3)
        >>> print(Coulomb(0.3, limit=40.0))
        coefficient of friction 0.3, slip bound at most 40
        >>> print(Coulomb((0.3, 0.1), direction=(1, 0, 0)))
        coefficient of friction along (1, 0, 0) and across: 0.3 and 0.1
    """

    coefficient: Bound
    limit: ScalarField | None = None
    direction: VectorField | None = None

    def __post_init__(self) -> None:
        """Check the kind of coefficient and limit.

        Raises:
            InputError: one is no real scalar, has no value at nodes, or is NaN; a coefficient is
                a number that is negative, or infinite; or there are two coefficients without a
                direction, or the other way round, or that is no vector.
        """
        name = "the coefficient of friction"
        _check_bound(self.coefficient, self.direction, name, COEFFICIENT_ROUNDING)
        pair = self.coefficient if isinstance(self.coefficient, tuple) else (self.coefficient,)
        if any(math.isinf(real(value) or 0.0) for value in pair):
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
        return BoundTerms(coefficient=self.coefficient, limit=limit, direction=self.direction)

    def __repr__(self) -> str:
        more = "" if self.limit is None else f", limit={scalar_field_text(self.limit)}"
        return f"Coulomb({_arguments(self.coefficient, more, self.direction)})"

    def __str__(self) -> str:
        more = "" if self.limit is None else f", slip bound at most {scalar_field_text(self.limit)}"
        return f"coefficient of friction {_words(self.coefficient, self.direction)}{more}"


def _check_bound(
    bound: Bound, direction: VectorField | None, name: str, rounding: float = math.inf
) -> None:
    """Check the kind of one bound, or of two and their direction; see `check_scalar_field`.

    Raises:
        InputError: see `check_scalar_field` and `check_vector_field`; or one of the two is missing.
    """
    if not isinstance(bound, tuple):
        check_scalar_field(bound, name, rounding)
        if direction is not None:
            raise InputError(
                f"a direction needs two values of {name}, along it and across it, found one: "
                f"{scalar_field_text(bound)}."
            )
        return
    if len(bound) != 2:
        raise InputError(
            f"{name} must be one value, or two of them with a direction, found {len(bound)}."
        )
    for value, side in zip(bound, SIDES, strict=True):
        check_scalar_field(value, f"{name} {side}", rounding)
    if direction is None:
        raise InputError(
            f"two values of {name} need a direction: that of the first one, such as "
            "direction=(1, 0, 0)."
        )
    check_vector_field(direction, f"the direction of {name}")


def _arguments(bound: Bound, between: str, direction: VectorField | None) -> str:
    """Return the arguments of a law, for people."""
    if isinstance(bound, tuple) and direction is not None:
        pair = ", ".join(scalar_field_text(value) for value in bound)
        return f"({pair}){between}, direction={vector_field_text(direction)}"
    return f"{_words(bound, direction)}{between}"


def _words(bound: Bound, direction: VectorField | None) -> str:
    """Return what a bound is, for people."""
    if isinstance(bound, tuple) and direction is not None:
        first, second = (scalar_field_text(value) for value in bound)
        return f"along {vector_field_text(direction)} and across: {first} and {second}"
    return scalar_field_text(cast(ScalarField, bound))


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
