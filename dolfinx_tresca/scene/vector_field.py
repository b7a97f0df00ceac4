"""Vector fields given by the user: types, checks and descriptions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

from dolfinx import fem
from ufl.classes import Expr

from dolfinx_tresca.errors import InputError, shown
from dolfinx_tresca.scene.scalar_field import check_expression

#: A vector of three components on the contact surface; the Constants and Functions in it may be
#: changed in place.
VectorField: TypeAlias = (
    "Sequence[float] | fem.Constant | fem.Function | fem.Expression | Expr | Callable[[Any], Any]"
)


def check_vector_field(value: VectorField, name: str) -> None:
    """Check the type of a vector that is a direction; numbers must be finite and not all zero.

    Args:
        value: the vector.
        name: the name of the quantity, for error messages.

    Raises:
        InputError: the vector does not have three components, is complex, or has no value at
            nodes; or it consists of numbers that are not finite, or are all zero.
    """
    if isinstance(value, fem.Constant | fem.Expression | Expr):
        expression = value.ufl_expression if isinstance(value, fem.Expression) else value
        _check_shape(tuple(expression.ufl_shape), name)
        check_expression(expression, name)
    elif not callable(value) or isinstance(value, type):
        numbers = np.asarray(value)
        if numbers.dtype.kind not in "iuf":
            raise InputError(
                f"{name} must be three numbers, a fem.Constant, fem.Function or UFL expression "
                f"with three components, or a function of points, found {shown(value)}."
            )
        _check_shape(numbers.shape, name)
        if not np.isfinite(numbers).all() or not numbers.any():
            raise InputError(f"{name} must be finite and not zero, found {shown(value)}.")


def _check_shape(shape: tuple[int, ...], name: str) -> None:
    """Raise InputError unless the shape is that of a vector of three components."""
    if shape != (3,):
        raise InputError(f"{name} must be a vector of three components, found shape {shape}.")


def vector_field_text(value: VectorField) -> str:
    """Return a short description of a vector field, for tables and messages."""
    if isinstance(value, fem.Function):
        return f"Function '{value.name}'"
    if isinstance(value, fem.Constant):
        return f"Constant, now {_components(value.value)}"
    if isinstance(value, fem.Expression | Expr):
        return "an expression"  # UFL's text has free indices, which nobody can read
    return "a function of points" if callable(value) else _components(value)


def _components(value: Any) -> str:
    return f"({', '.join(f'{component:g}' for component in value)})"
