"""Friction laws, coefficients that depend on pressure and slip, and the fields that users give."""

from __future__ import annotations

import inspect
import math
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias, cast

import numpy as np

import ufl
from dolfinx import fem
from ufl.classes import Argument, Coefficient, Derivative, Expr, GeometricQuantity
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_tresca._base.arguments import checked_number
from dolfinx_tresca._base.arrays import Array, real
from dolfinx_tresca.errors import InputError, shown

#: A scalar on the contact surface; the Constants and Functions in it may be changed in place.
ScalarField: TypeAlias = (
    "float | fem.Constant | fem.Function | fem.Expression | Expr | Callable[[Any], Any]"
)

#: A vector of three components on the contact surface; its Constants and Functions may change.
VectorField: TypeAlias = (
    "Sequence[float] | fem.Constant | fem.Function | fem.Expression | Expr | Callable[[Any], Any]"
)


def check_field(value: ScalarField | VectorField, shape: tuple[int, ...], name: str) -> None:
    """Check the type and the shape, () or (3,), of a field that the user gave as `name`.

    Values, and what functions of points return, are checked when rooms above evaluate the field.
    """
    field = expression_of(value)
    if not isinstance(field, Expr):
        if callable(field) and not isinstance(field, type):
            return
        number = real(field)
        numbers = np.asarray(field if number is None else number)
        if numbers.dtype.kind not in "iuf" or numbers.shape != shape or np.isnan(numbers).any():
            kind = "three numbers" if shape else "a number"
            raise InputError(
                f"{name} must be {kind}, a fem.Constant, fem.Function, fem.Expression or UFL "
                f"expression of this shape, or a function of points, found {shown(value)}."
            )
        return
    # an expression is real, has the given shape, and has single values at nodes
    if field.ufl_shape != shape or field.ufl_free_indices:
        kind = "a vector of three components" if shape else "a scalar"
        free = " and free indices" if field.ufl_free_indices else ""
        raise InputError(f"{name} must be {kind}, found shape {field.ufl_shape}{free}.")
    for operand in unique_pre_traversal(field):
        dtype = np.dtype(getattr(operand, "dtype", np.float64))
        if dtype != np.float64:
            raise InputError(f"{name} must be of type float64, found {dtype} in {_text(operand)}.")
        if isinstance(operand, Argument):
            raise InputError(
                f"{name} must not depend on a trial or test function: take a fem.Function instead."
            )
        # derivatives, and quantities such as cell sizes, jump between cells
        if isinstance(operand, Coefficient):
            continuous = operand.ufl_element() in ufl.H1
        else:
            continuous = not isinstance(operand, Derivative | GeometricQuantity)
        if not (continuous or isinstance(operand, ufl.SpatialCoordinate)):
            raise InputError(
                f"{name} {_text(field)} has no value at nodes, since {_text(operand)} is not "
                "continuous. Interpolate or project it into a continuous space."
            )


def expression_of(field: ScalarField | VectorField) -> Any:
    """Return the UFL expression in a `fem.Expression`, and fields of other types unchanged."""
    return field.ufl_expression if isinstance(field, fem.Expression) else field


def field_text(value: ScalarField | VectorField) -> str:
    """Return a short description of a field, for tables and messages."""
    if isinstance(value, fem.Function):
        return f"Function '{value.name}'"
    if isinstance(value, fem.Constant):
        return f"Constant, now {numbers_text(value.value)}"
    value = expression_of(value)
    if isinstance(value, Expr):  # UFL's text of vectors has free indices, which nobody can read
        return _text(value) if value.ufl_shape == () else "an expression"
    return "a function of points" if callable(value) else numbers_text(value)


def numbers_text(value: Any) -> str:
    """Return the text of a number, or of the components of a vector."""
    if np.ndim(value) == 0:
        return f"{float(value):g}"
    return f"({', '.join(f'{component:g}' for component in value)})"


def _text(expression: Expr) -> str:
    """Return the text of an expression, cut off if it is long."""
    return textwrap.shorten(str(expression), 80, placeholder=" ...")


#: Step of difference quotients, relative to pressure or slip. With a tenth or ten times this step
#: the quotients have one digit less, which costs iterations only.
DIFFERENCE = float(np.cbrt(np.finfo(float).eps))


@dataclass(frozen=True)
class FrictionCurve:
    """A coefficient of friction F(p, v): the user's `function` of pressures p and slips v."""

    function: Callable[[Any, Any], Any]

    @property
    def depends_on_slip(self) -> bool:
        """Whether F depends on the slip, as tested at 50 pressures and 50 slips from 0 to 1e12."""
        grid = np.append(0.0, np.logspace(-12.0, 12.0, 49))
        pressures, slips = np.meshgrid(grid, grid, indexing="ij")  # slips differ along a row
        with np.errstate(all="ignore"):
            F = self.values(pressures.ravel(), slips.ravel()).reshape(slips.shape)
        without_slip = np.broadcast_to(F[:, :1], F.shape)
        return not np.array_equal(F, without_slip, equal_nan=True)

    def values(self, pressure: Array, slip: Array) -> Array:
        """Return F (n,) at pressures (n,) [stress] and slips (n,) [length]."""
        result = self.function(pressure, slip)
        values = np.asarray(result)
        if values.shape not in ((), pressure.shape) or values.dtype.kind not in "biuf":
            raise InputError(
                "a coefficient that depends on pressure and slip must be real, a number or an "
                f"array of shape {pressure.shape}, found {shown(result)} of type {values.dtype}."
            )
        return np.broadcast_to(values.astype(np.float64), pressure.shape)

    def slopes(self, pressure: Array, slip: Array) -> tuple[Array, Array]:
        """Return the difference quotients dF/dp (n,) [1 / stress] and dF/dv (n,) [1 / length].

        dF/dp is 0 where the pressure is 0, and dF/dv where the slip is 0.
        """
        low, high = 1.0 - DIFFERENCE, 1.0 + DIFFERENCE
        dp = high * pressure - low * pressure
        dv = high * slip - low * slip
        change_with_p = self.values(high * pressure, slip) - self.values(low * pressure, slip)
        change_with_v = self.values(pressure, high * slip) - self.values(pressure, low * slip)
        slope_with_p = np.divide(change_with_p, dp, out=np.zeros_like(dp), where=dp > 0.0)
        slope_with_v = np.divide(change_with_v, dv, out=np.zeros_like(dv), where=dv > 0.0)
        return slope_with_p, slope_with_v


def curve_of(coefficient: object) -> FrictionCurve | None:
    """Return a user's coefficient as a curve if it is a function F(p, v), and None otherwise.

    F has two arguments without default; a function with one is a function of points x (3, n).
    """
    if isinstance(coefficient, type | fem.Expression | Expr) or not callable(coefficient):
        return None
    try:
        parameters = inspect.signature(coefficient).parameters.values()
    except (TypeError, ValueError):  # a function in another language than Python
        return None
    required = [
        parameter
        for parameter in parameters
        if parameter.default is parameter.empty
        and parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD)
    ]
    return FrictionCurve(coefficient) if len(required) == 2 else None


#: One scalar for all directions, or two semi-axes of an ellipse, along a direction and across it.
Bound: TypeAlias = "ScalarField | tuple[ScalarField, ScalarField]"

#: Negative coefficients above minus this, and bounds above minus this times the largest, are zero.
COEFFICIENT_ROUNDING = 1e-12


@dataclass(frozen=True)
class BoundTerms:
    """A slip bound c + min(F p, l), where p is the contact pressure.

    If there is a direction, the bound is an ellipse, and one of the three terms is a pair of
    values, along the direction and across it. The ratio of the two is that of the semi-axes, and
    the longer semi-axis is c + min(F p, l) with the larger of them.

    Attributes:
        constant: c >= 0 [stress].
        coefficient: F >= 0 [1].
        limit: l >= 0 [stress].
        direction: direction of the first semi-axis, which is projected into the tangent plane;
            None: the bound is a circle.
        curve: F(p, v), of which `coefficient` is then an upper guess for the start; else None.
    """

    constant: Bound = 0.0
    coefficient: Bound = 0.0
    limit: Bound = math.inf
    direction: VectorField | None = None
    curve: FrictionCurve | None = None


class Friction:
    """Base class of all laws of a contact pair, with the slip bound zero."""

    constant_name: ClassVar[str] = "the slip bound"  #: name of `terms.constant` in error messages

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self}>"

    def __str__(self) -> str:
        return type(self).__name__

    @property
    def terms(self) -> BoundTerms:
        """The slip bound as a function of the pressure: zero, unless a derived law defines it."""
        return BoundTerms()


class DryFriction(Friction):
    """Base class of friction laws: the tangential traction stays within a circle or an ellipse.

    A node slips only if its traction is on the boundary. To add a law, derive a class that defines
    `terms`.
    """


@dataclass(frozen=True, repr=False)
class Tresca(DryFriction):
    """Tresca friction: the norm of the tangential traction is at most `slip_bound`.

    The bound does not depend on the contact pressure. By (38.3) it holds at every node, so friction
    also acts at nodes that are not in contact: if it should not, set the bound to zero there or use
    `Coulomb(10.0, limit=g)`, whose bound min(10 p, g) reaches g at the pressure p = g / 10.

    Attributes:
        slip_bound: g >= 0 [stress] at the contact nodes: a number; a continuous scalar
            `fem.Constant`, `fem.Function`, `fem.Expression` or UFL expression; or a function from
            points x (3, n) to a number or an array (n,). Constants and Functions may be changed in
            place before each solve. Nodes with infinite g never slip. Negative values within
            rounding (1e-12 of the pair's largest finite bound, or the pressure that rounding of
            coordinates causes) count as zero. Other negative values are an error, raised when the
            problem is created if the bound is a number, else by `solve()`. In 3D the bound may also
            be a pair (g1, g2), along `direction` and across it, both finite or both infinite: the
            traction stays within the ellipse (t1 / g1)^2 + (t2 / g2)^2 <= 1, and the slip is normal
            to the ellipse. If one bound is zero, sliding in its direction is free, and the other
            bound decides between stick and slip.
        direction: direction of the first of two bounds, a vector of any length that is projected
            into the tangent plane: three numbers, a `fem.Constant`, `fem.Function` or UFL
            expression, or a function from points x (3, n) to (3,) or (3, n). A solve discards the
            stored products after a change of the direction or of the ratio of the bounds.

    Example:
        >>> from dolfinx_tresca import Tresca
        >>> Tresca(0.09)
        <Tresca: slip bound 0.09>
        >>> Tresca(lambda x: 0.09 * (x[0] < 1.0))  # no friction beyond x = 1
        <Tresca: slip bound a function of points>
        >>> Tresca((0.09, 0.03), direction=(1, 0, 0))  # grooves across x
        <Tresca: slip bound along (1, 0, 0) and across: 0.09 and 0.03>
    """

    slip_bound: Bound
    direction: VectorField | None = None

    def __post_init__(self) -> None:
        """Check the types of the attributes; raise an InputError for types not listed above."""
        _check_bound(self.slip_bound, self.direction, self.constant_name)

    @property
    def terms(self) -> BoundTerms:
        """The slip bound as a function of the pressure."""
        return BoundTerms(constant=self.slip_bound, direction=self.direction)

    def __str__(self) -> str:
        return f"slip bound {_bound_text(self.slip_bound, self.direction)}"


@dataclass(frozen=True, repr=False)
class Coulomb(DryFriction):
    """Coulomb friction: the norm of the tangential traction is at most F p, with the pressure p.

    With an adhesion c the norm is at most c + F p (Mohr-Coulomb), and with an adhesion and a limit
    l at most c + min(F p, l).

    The coefficient may depend on the pressure and on the slip of the same solution: it is then a
    function that returns F >= 0 [1], a number or an array (n,), for the pressures p >= 0 (n,)
    [stress] and the slips v >= 0 (n,) [length], in the units of the problem. A slip is the length
    of the tangential displacement since the last accepted step or, in the first step, since the
    undeformed state; a law for the rate of slip divides the slip by the time step. The function is
    called with arrays of any length, and with any values that occur during the iteration. Values of
    Constants that it reads may be changed before each solve, and they may be controls of
    derivatives. Bodies that only contact or soft springs hold cannot have a coefficient that
    depends on the slip: hold them by Dirichlet conditions. The theory of Coulomb's law remains
    valid if the bound F(p, v) p increases with p and with v. If the bound decreases with v (slip
    weakening), there is one solution if it decreases more slowly than the stiffness of the bodies
    increases the traction; the solve warns of bounds that decrease faster, or with p.

    A solve finds a fixed point: multipliers that solve the Tresca problem whose bounds follow from
    their own pressures. The discrete problem has a solution for any coefficient, and a unique one
    for small coefficients; the status is NO_FIXED_POINT if none is found. After an accepted load
    step, the search starts from the tractions of this step. Nodes whose normal displacement is
    prescribed have no pressure and so no friction; friction does not act along prescribed
    tangential directions either.

    Attributes:
        coefficient: F >= 0 [1], finite (surfaces that never slide are `Bonded`), of any type that
            `Tresca.slip_bound` may have; in 3D also two coefficients (F1, F2), along `direction`
            and across it: the traction stays within an ellipse with the semi-axes F1 p and F2 p; or
            a function of two arguments, such as `lambda p, v: 0.3 / (1 + v)`, see above.
        limit: largest value of the part of the bound that grows with the pressure [stress], a
            scalar of any type that `Tresca.slip_bound` may have: the bound is min(F p, limit), as
            with the shear limit in metal forming. For an ellipse the longer semi-axis is limited,
            and the ratio of the semi-axes does not change. None: no limit.
        direction: direction of the first of two coefficients; see `Tresca.direction`.
        adhesion: c >= 0 [stress], the bound without pressure, a scalar of the types of `limit`.
            Like the bound of `Tresca` it acts at open nodes as well: make it zero where surfaces
            open. It resists sliding only, and surfaces open without tension. For an ellipse it is a
            part of the longer semi-axis, and the ratio of the semi-axes does not change.

    Example:
        >>> from dolfinx_tresca import Coulomb
        >>> Coulomb(0.3)
        <Coulomb: coefficient of friction 0.3>
        >>> print(Coulomb(0.3, limit=40.0))
        coefficient of friction 0.3, slip bound at most 40
        >>> print(Coulomb(lambda p, v: 0.5 / (1 + p / 40)))
        coefficient of friction a function of pressure and slip
    """

    constant_name: ClassVar[str] = "the adhesion"

    coefficient: Bound | Callable[[Any, Any], Any]
    limit: ScalarField | None = None
    direction: VectorField | None = None
    adhesion: ScalarField = 0.0

    def __post_init__(self) -> None:
        """Check the types of the attributes; raise an InputError for types not listed above."""
        if curve_of(self.coefficient) is None or self.direction is not None:
            _check_bound(self.coefficient, self.direction, "the coefficient of friction")
        if self.limit is not None:
            check_field(self.limit, (), "the limit of the slip bound")
        check_field(self.adhesion, (), self.constant_name)

    @property
    def terms(self) -> BoundTerms:
        """The slip bound as a function of the pressure."""
        limit = math.inf if self.limit is None else self.limit
        curve = curve_of(self.coefficient)
        # The iteration begins with a coefficient that should exceed all values of the curve: then
        # no traction is cut off, and loads count as impossible only if no friction can bear them.
        fixed = cast(Bound, self.coefficient) if curve is None else 100.0
        return BoundTerms(self.adhesion, fixed, limit, self.direction, curve)

    def __str__(self) -> str:
        more = "" if self.limit is None else f", slip bound at most {field_text(self.limit)}"
        if real(self.adhesion) != 0.0:
            more += ", adhesion " if self.limit is None else " beside the adhesion "
            more += field_text(self.adhesion)
        return f"coefficient of friction {_bound_text(self.coefficient, self.direction)}{more}"


def two_bounds(bounds: Sequence[Any], name: str) -> list[tuple[Any, str]]:
    """Return the bounds along a direction and across it, each with its name for messages."""
    return [(bounds[0], f"{name} along the direction"), (bounds[1], f"{name} across the direction")]


def _check_bound(bound: Any, direction: VectorField | None, name: str) -> None:
    """Check the number and types of bounds: one, or two with a direction; see `BoundTerms`."""
    values = bound if isinstance(bound, tuple) else (bound,)
    if len(values) != (1 if direction is None else 2):
        given = "no direction" if direction is None else "a direction"
        raise InputError(
            f"{name} must be one value, or two values with a direction, along which the first one "
            f"holds, such as direction=(1, 0, 0); found {len(values)} and {given}."
        )
    if direction is None:
        check_field(bound, (), name)
        return
    for value, words in two_bounds(values, name):
        check_field(value, (), words)
    check_field(direction, (3,), f"the direction of {name}")


def _bound_text(bound: Bound | Callable[[Any, Any], Any], direction: VectorField | None) -> str:
    """Return a short description of a bound, for tables and messages."""
    if curve_of(bound) is not None:
        return "a function of pressure and slip"
    if isinstance(bound, tuple) and direction is not None:
        along, across = field_text(bound[0]), field_text(bound[1])
        return f"along {field_text(direction)} and across: {along} and {across}"
    return field_text(cast(ScalarField, bound))


@dataclass(frozen=True, repr=False)
class Frictionless(Friction):
    """Contact without friction: the only multiplier is the contact pressure."""

    def __str__(self) -> str:
        return "no friction"


@dataclass(frozen=True, repr=False)
class Bonded(Friction):
    """Tied surfaces: the jump of the displacement is zero in all directions.

    An initial gap stays as it is. The pressure may be negative, which is tension.
    """

    def __str__(self) -> str:
        return "bonded"


@dataclass(frozen=True, repr=False)
class Preload(Bonded):
    """Law of the two faces at which a bolt was cut: the force in the bolt pulls them together.

    In the first load step, the faces overlap so far that the force in the bolt is the given one.
    When this step is accepted, the overlap stays: the bolt is locked, and its force follows from
    the loads (`ContactSolution.bolts`). Along the cut, and against tilting, the faces are bonded.

    Attributes:
        force: force in the bolt [force], positive in tension; in 2D per unit of thickness. A
            `fem.Constant` may be changed before a solve.
    """

    force: float | fem.Constant

    def __post_init__(self) -> None:
        """Check the force, as `value` does."""
        _ = self.value

    @property
    def value(self) -> float:
        """The present force [force]; an InputError is raised if it is not a finite number."""
        force = getattr(self.force, "value", self.force)
        return checked_number("the force of a preload", force, "(-inf, inf)")

    def __str__(self) -> str:
        return f"preload {self.value:g}"
