"""Scalar and vector fields given by the user: types, checks and descriptions."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

import ufl
from dolfinx import fem
from ufl.classes import Argument, Coefficient, Derivative, Expr, GeometricQuantity
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_tresca._base.arrays import Array, real
from dolfinx_tresca.errors import InputError, shown

#: A scalar on the contact surface; the Constants and Functions in it may be changed in place.
ScalarField: TypeAlias = (
    "float | fem.Constant | fem.Function | fem.Expression | Expr | Callable[[Any], Any]"
)

#: A vector of three components on the contact surface; the Constants and Functions in it may be
#: changed in place.
VectorField: TypeAlias = (
    "Sequence[float] | fem.Constant | fem.Function | fem.Expression | Expr | Callable[[Any], Any]"
)

_CONTINUOUS = "Interpolate it into a continuous space, such as Lagrange 1, or project it there."


def check_scalar_field(value: ScalarField, name: str, rounding: float = math.inf) -> None:
    """Check the type of a scalar that a user gives; a number must not be NaN or too negative.

    Args:
        value: the scalar.
        name: the name of the quantity, for error messages.
        rounding: a number must be greater than minus `rounding`. The default accepts every finite
            negative number: a gap may be negative, and slip bounds are checked later, with a
            tolerance that depends on the stresses of the problem.

    Raises:
        InputError: the value is not a scalar, is complex, or has no value at nodes; or it is a
            number that is NaN or negative by `rounding` or more.
    """
    number = _numbers(value, (), name)
    if number is not None and not number > -rounding:
        raise InputError(f"{name} must not be {invalid(float(number))}, found {number:g}.")


def _numbers(value: Any, shape: tuple[int, ...], name: str) -> Array | None:
    """Return plain numbers as an array; None for functions and expressions, which are checked.

    Raises:
        InputError: the value has another shape, is no number, or see `check_expression`.
    """
    if isinstance(value, Expr | fem.Constant | fem.Expression):
        expression = value.ufl_expression if isinstance(value, fem.Expression) else value
        numbers, actual = None, expression.ufl_shape
    elif callable(value) and not isinstance(value, type):
        return None
    else:
        number = real(value)
        numbers = np.asarray(value if number is None else number)
        expression, actual = None, numbers.shape
    if numbers is not None and numbers.dtype.kind not in "iuf":
        raise InputError(
            f"{name} must be {'three numbers' if shape else 'a number'}, a fem.Constant, "
            "fem.Function, fem.Expression or UFL expression of this shape, or a function of "
            f"points, found {shown(value)}."
        )
    if actual != shape:
        kind = "a vector of three components" if shape else "a scalar"
        raise InputError(f"{name} must be {kind}, found shape {actual}.")
    if expression is not None:
        check_expression(expression, name)
    return numbers


def invalid(number: float) -> str:
    """Return the word for a number that is no slip bound: NaN passes no comparison with a bound."""
    return "NaN" if math.isnan(number) else "negative"


def check_expression(expression: Expr, name: str) -> None:
    """Check that a UFL expression is real and has a single value at each node.

    Raises:
        InputError: the expression contains a part that is not float64 or not continuous, a trial or
            test function, or free indices.
    """
    if expression.ufl_free_indices:
        raise InputError(f"{name} must have no free indices, found them in {_text(expression)}.")
    for operand in unique_pre_traversal(expression):
        dtype = np.dtype(getattr(operand, "dtype", np.float64))
        if dtype != np.float64:
            raise InputError(f"{name} must be of type float64, found {dtype} in {_text(operand)}.")
        if isinstance(operand, Argument):
            raise InputError(
                f"{name} must not depend on a trial or test function, found "
                f"{_text(operand)}. To make it depend on a displacement use a fem.Function."
            )
        if isinstance(operand, Derivative | GeometricQuantity) and not isinstance(
            operand, ufl.SpatialCoordinate
        ):
            raise InputError(
                f"{name} {_text(expression)} has no value at nodes, since {_text(operand)} "
                f"jumps from cell to cell. {_CONTINUOUS}"
            )
        if isinstance(operand, Coefficient) and operand.ufl_element() not in ufl.H1:
            raise InputError(
                f"{name} has no value at nodes: "
                f"'{getattr(operand, 'name', operand)}' is a discontinuous Function, of "
                f"{operand.ufl_element()}. {_CONTINUOUS}"
            )


def field_text(value: ScalarField | VectorField) -> str:
    """Return a short description of a field, for tables and messages."""
    if isinstance(value, fem.Function):
        return f"Function '{value.name}'"
    if isinstance(value, fem.Constant):
        return f"Constant, now {numbers_text(value.value)}"
    if isinstance(value, fem.Expression):
        value = value.ufl_expression
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


def check_vector_field(value: VectorField, name: str) -> None:
    """Check the type of a vector that is a direction; numbers must be finite and not all zero.

    Args:
        value: the vector.
        name: the name of the quantity, for error messages.

    Raises:
        InputError: the vector does not have three components, is complex, or has no value at
            nodes; or it consists of numbers that are not finite, or are all zero.
    """
    numbers = _numbers(value, (3,), name)
    if numbers is not None and not (np.isfinite(numbers).all() and numbers.any()):
        raise InputError(f"{name} must be finite and not zero, found {shown(value)}.")
