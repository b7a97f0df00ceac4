"""Coefficients of friction that are functions of the pressure and of the slip."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx import fem
from ufl.classes import Expr

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.errors import InputError, shown

#: Step of difference quotients, relative to pressure or slip. With a tenth or ten times this step
#: the quotients have one digit less, which costs iterations only.
DIFFERENCE = float(np.cbrt(np.finfo(float).eps))


@dataclass(frozen=True)
class FrictionCurve:
    """A coefficient of friction F(p, v) that depends on the pressure and on the slip of the step.

    The tangential traction is at most F(p, v) p, with the pressure and the slip of the same
    solution. In `Coulomb(...)` a function of two arguments is a curve without derivatives.

    Bodies that only contact or soft springs hold cannot have a coefficient that depends on the
    slip: hold them by Dirichlet conditions.

    The theory of Coulomb's law remains valid if the bound F(p, v) p increases with p and with v. If
    the bound decreases with v (slip weakening), there is one solution if the bound decreases more
    slowly than the stiffness of the bodies increases the traction; the solve warns of bounds that
    decrease faster, and of bounds that decrease with p.

    Attributes:
        function: function that returns F >= 0 [1], a number or an array (n,), for the pressures
            p >= 0 (n,) [stress] and the slips v >= 0 (n,) [length], in the units of the problem. A
            slip is the length of the tangential displacement since the last accepted step or, in
            the first step, since the undeformed state; a law for the rate of slip divides the slip
            by the time step. The function is called with arrays of any length, and with any values
            that occur during the iteration. Values of Constants that it reads may be changed before
            each solve, and they may be controls of derivatives.
        derivatives: dF/dp [1 / stress] and dF/dv [1 / length], as a function with the same
            arguments that returns a pair; None: difference quotients of F.

    Example:
        >>> import numpy as np
        >>> from dolfinx_tresca import Coulomb, FrictionCurve
        >>> weakening = FrictionCurve(lambda p, v: 0.2 + 0.3 * np.exp(-v / 0.01))
        >>> Coulomb(weakening, limit=40.0)
        Coulomb(a function of pressure and slip, limit=40)
    """

    function: Callable[[Any, Any], Any]
    derivatives: Callable[[Any, Any], tuple[Any, Any]] | None = None

    def __post_init__(self) -> None:
        """Check the types.

        Raises:
            InputError: the function or the derivatives cannot be called.
        """
        for name, value in (("function", self.function), ("derivatives", self.derivatives)):
            if not (callable(value) or (name == "derivatives" and value is None)):
                raise InputError(
                    f"the {name} of a friction curve must be a function of pressures and slips, "
                    f"found {shown(value)}."
                )

    @property
    def depends_on_slip(self) -> bool:
        """Whether F changes with the slip, at any of many pressures and slips."""
        sizes = np.append(0.0, np.logspace(-12.0, 12.0, 49))
        pressure, slip = (grid.ravel() for grid in np.meshgrid(sizes, sizes, indexing="ij"))
        with np.errstate(all="ignore"):
            F = self.values(pressure, slip).reshape(len(sizes), len(sizes))
        return not np.array_equal(F, np.broadcast_to(F[:, :1], F.shape), equal_nan=True)

    def values(self, pressure: Array, slip: Array) -> Array:
        """Return F (n,) at pressures (n,) [stress] and slips (n,) [length].

        Raises:
            InputError: the function returns neither a number nor a number for each node.
        """
        return _values(self.function(pressure, slip), len(pressure), "a friction curve")

    def slopes(self, pressure: Array, slip: Array) -> tuple[Array, Array]:
        """Return dF/dp (n,) [1 / stress] and dF/dv (n,) [1 / length].

        Raises:
            InputError: a function returns neither a number nor a number for each node.
        """
        if self.derivatives is not None:
            name = "the derivatives of a friction curve"
            slopes = self.derivatives(pressure, slip)
            if not isinstance(slopes, tuple) or len(slopes) != 2:
                raise InputError(f"{name} must be a pair (dF/dp, dF/dv), found {shown(slopes)}.")
            by_pressure, by_slip = (_values(slope, len(pressure), name) for slope in slopes)
            return by_pressure, by_slip

        def difference(low: Array, high: Array, function: Callable[[Array], Array]) -> Array:
            change, result = function(high) - function(low), np.zeros_like(low)
            return np.divide(change, high - low, out=result, where=high > low)

        p, v = ((1.0 - DIFFERENCE) * argument for argument in (pressure, slip))
        q, w = ((1.0 + DIFFERENCE) * argument for argument in (pressure, slip))
        return (
            difference(p, q, lambda x: self.values(x, slip)),
            difference(v, w, lambda x: self.values(pressure, x)),
        )


def curve_of(coefficient: object) -> FrictionCurve | None:
    """Return a coefficient of friction as a curve, or None if it is not a curve.

    A function that requires two arguments is a curve; a function that requires one argument is a
    function of points.
    """
    if isinstance(coefficient, FrictionCurve):
        return coefficient
    if isinstance(coefficient, type | fem.Constant | fem.Expression | Expr):
        return None
    if not callable(coefficient):
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


def _values(result: Any, number: int, name: str) -> Array:
    """Return the result of a user's function as an array (n,) of floats.

    Args:
        result: the result.
        number: the number n of nodes.
        name: the name of the function, for error messages.

    Raises:
        InputError: the result is neither a real number nor an array with a number for each node.
    """
    values = np.asarray(result)
    if values.shape not in ((), (number,)) or not np.issubdtype(values.dtype, np.number):
        raise InputError(
            f"{name} must return a number or an array of shape ({number},), found {shown(result)}."
        )
    if np.iscomplexobj(values):
        raise InputError(f"{name} must be real, found {values.dtype}.")
    return np.broadcast_to(values.astype(np.float64), (number,))
