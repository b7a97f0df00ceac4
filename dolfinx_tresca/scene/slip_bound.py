"""Slip bounds in every form that DOLFINx has for a scalar: checks, and values at nodes."""

from __future__ import annotations

import numbers
import textwrap
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

import ufl
from dolfinx import fem
from ufl.classes import Argument, Coefficient, Derivative, Expr, GeometricQuantity
from ufl.corealg.traversal import unique_pre_traversal

from dolfinx_tresca.errors import InputError, shown

FloatArray: TypeAlias = npt.NDArray[np.float64]
NodeArray: TypeAlias = npt.NDArray[np.int32]

#: A scalar on the contact surface. What it depends on may be changed in place.
ScalarField: TypeAlias = (
    "float | fem.Constant | fem.Function | fem.Expression | Expr | Callable[[Any], Any]"
)

_CONTINUOUS = "Interpolate it into a continuous space, such as Lagrange 1, or project it there."


def check_slip_bound(bound: ScalarField) -> None:
    """Check the kind of a bound, and numbers.

    Raises:
        InputError: it is no scalar, or complex, or has no value at nodes; or it is a number that
            is negative or NaN.
    """
    if isinstance(bound, fem.Constant | fem.Expression | Expr):
        expression = bound.ufl_expression if isinstance(bound, fem.Expression) else bound
        _check_shape(tuple(expression.ufl_shape))
        _check_parts(expression)
    elif not callable(bound) or isinstance(bound, type):
        _check_shape(np.asarray(bound).shape)
        if not isinstance(bound, numbers.Real):
            raise InputError(
                "the slip bound must be a number, a scalar fem.Constant, fem.Function or UFL "
                f"expression, or a function of points, found {shown(bound)}."
            )
        if not float(bound) >= 0.0:
            raise InputError(f"the slip bound must not be negative, found {bound:g}.")


def _check_shape(shape: tuple[int, ...]) -> None:
    if shape != ():
        raise InputError(
            f"the slip bound must be a scalar, found shape {shape}. For a bound that varies "
            "give a scalar fem.Function or a function of points."
        )


def _check_parts(expression: Expr) -> None:
    """Check that an expression is real and has one value at each node.

    Raises:
        InputError: it does not.
    """
    if expression.ufl_free_indices:
        raise InputError(
            f"the slip bound must be a scalar, found free indices in {_text(expression)}."
        )
    for part in unique_pre_traversal(expression):
        dtype = np.dtype(getattr(part, "dtype", np.float64))
        if dtype != np.float64:
            raise InputError(
                f"the slip bound must be of type float64, found {dtype} in {_text(part)}."
            )
        if isinstance(part, Argument):
            raise InputError(
                "the slip bound must not depend on a trial or test function, found "
                f"{_text(part)}. For a bound that depends on a displacement use a fem.Function."
            )
        if isinstance(part, Derivative | GeometricQuantity) and not isinstance(
            part, ufl.SpatialCoordinate
        ):
            raise InputError(
                f"the slip bound {_text(expression)} has no value at nodes, since {_text(part)} "
                f"jumps from cell to cell. {_CONTINUOUS}"
            )
        if isinstance(part, Coefficient) and part.ufl_element() not in ufl.H1:
            raise InputError(
                "the slip bound has no value at nodes: "
                f"'{getattr(part, 'name', part)}' is a discontinuous Function, of "
                f"{part.ufl_element()}. {_CONTINUOUS}"
            )


def slip_bound_text(bound: ScalarField) -> str:
    """Return what a bound is, for people."""
    if isinstance(bound, fem.Function):
        return f"Function '{bound.name}'"
    if isinstance(bound, fem.Constant):
        return f"Constant, now {float(bound.value):g}"
    if isinstance(bound, Expr):
        return _text(bound)
    if isinstance(bound, fem.Expression):
        return _text(bound.ufl_expression)
    return "a function of points" if callable(bound) else f"{bound:g}"


def _text(expression: Expr) -> str:
    """Return an expression, or the beginning of a long one."""
    return textwrap.shorten(str(expression), 80, placeholder=" ...")
