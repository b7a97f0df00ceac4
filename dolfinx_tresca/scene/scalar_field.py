"""Scalars on a surface in every form that DOLFINx has for them: checks, and words for people."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

import ufl
from dolfinx import fem
from ufl.classes import Argument, Coefficient, Derivative, Expr, GeometricQuantity
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_tresca._base.number import real
from dolfinx_tresca.errors import InputError, shown

#: A scalar on the contact surface. What it depends on may be changed in place.
ScalarField: TypeAlias = (
    "float | fem.Constant | fem.Function | fem.Expression | Expr | Callable[[Any], Any]"
)

_CONTINUOUS = "Interpolate it into a continuous space, such as Lagrange 1, or project it there."


def check_scalar_field(value: ScalarField, name: str, rounding: float = math.inf) -> None:
    """Check the kind of a scalar that may not be negative, and numbers.

    Args:
        value: the scalar.
        name: what it is, for errors.
        rounding: how far below zero a number may be; by default that is known only where the
            problem is made, from the size of its stresses.

    Raises:
        InputError: it is no scalar, or complex, or has no value at nodes; or it is a number that
            is negative by more than rounding, or NaN.
    """
    if isinstance(value, fem.Constant | fem.Expression | Expr):
        expression = value.ufl_expression if isinstance(value, fem.Expression) else value
        _check_shape(tuple(expression.ufl_shape), name)
        check_parts(expression, name)
    elif not callable(value) or isinstance(value, type):
        _check_shape(np.asarray(value).shape, name)
        number = real(value)
        if number is None:
            raise InputError(
                f"{name} must be a number, a scalar fem.Constant, fem.Function or UFL "
                f"expression, or a function of points, found {shown(value)}."
            )
        if not number > -rounding:
            raise InputError(f"{name} must not be negative, found {number:g}.")


def _check_shape(shape: tuple[int, ...], name: str) -> None:
    if shape != ():
        raise InputError(
            f"{name} must be a scalar, found shape {shape}. For one that varies "
            "give a scalar fem.Function or a function of points."
        )


def check_parts(expression: Expr, name: str) -> None:
    """Check that an expression is real and has one value at each node.

    Raises:
        InputError: it does not.
    """
    if expression.ufl_free_indices:
        raise InputError(f"{name} must have no free indices, found them in {_text(expression)}.")
    for part in unique_pre_traversal(expression):
        dtype = np.dtype(getattr(part, "dtype", np.float64))
        if dtype != np.float64:
            raise InputError(f"{name} must be of type float64, found {dtype} in {_text(part)}.")
        if isinstance(part, Argument):
            raise InputError(
                f"{name} must not depend on a trial or test function, found "
                f"{_text(part)}. For one that depends on a displacement use a fem.Function."
            )
        if isinstance(part, Derivative | GeometricQuantity) and not isinstance(
            part, ufl.SpatialCoordinate
        ):
            raise InputError(
                f"{name} {_text(expression)} has no value at nodes, since {_text(part)} "
                f"jumps from cell to cell. {_CONTINUOUS}"
            )
        if isinstance(part, Coefficient) and part.ufl_element() not in ufl.H1:
            raise InputError(
                f"{name} has no value at nodes: "
                f"'{getattr(part, 'name', part)}' is a discontinuous Function, of "
                f"{part.ufl_element()}. {_CONTINUOUS}"
            )


def scalar_field_text(value: ScalarField) -> str:
    """Return what a scalar is, for people."""
    if isinstance(value, fem.Function):
        return f"Function '{value.name}'"
    if isinstance(value, fem.Constant):
        return f"Constant, now {float(value.value):g}"
    if isinstance(value, Expr):
        return _text(value)
    if isinstance(value, fem.Expression):
        return _text(value.ufl_expression)
    return "a function of points" if callable(value) else f"{float(value):g}"


def _text(expression: Expr) -> str:
    """Return an expression, or the beginning of a long one."""
    return textwrap.shorten(str(expression), 80, placeholder=" ...")
