"""Numbers that a user wants to know from a solution: what meshes are refined for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.number import integer, real
from dolfinx_tresca.errors import InputError, shown


@dataclass(frozen=True)
class NormalForce:
    """Integral of the contact pressure of a pair [force; in 2D force per length].

    Attributes:
        pair: number of the pair.
    """

    pair: int = 0

    def __post_init__(self) -> None:
        _check_pair(self.pair)


@dataclass(frozen=True)
class ContactForce:
    """Component of the force that a pair's secondary side feels [force; in 2D per length].

    Of pressure and friction: along the surface it is the tangential force. See
    `ContactSolution.resultants`.

    Attributes:
        direction: (d,) along which it is taken; its length does not matter.
        pair: number of the pair.

    Example:
        >>> from dolfinx_tresca import ContactForce
        >>> ContactForce(direction=(1, 0, 0))  # what drags along x
        ContactForce(direction=(1, 0, 0), pair=0)
    """

    direction: npt.ArrayLike
    pair: int = 0

    def __post_init__(self) -> None:
        _check_pair(self.pair)
        _check_vector("direction", self.direction)


@dataclass(frozen=True)
class MeanPressure:
    """Mean contact pressure round a point [stress], with the weight (1 - r^2/R^2)^2.

    The weight fades out, since the pressure at a point, or over a patch with a sharp edge, has no
    adjoint of finite energy: no estimate of its error would converge. For a peak take a patch as
    small as the accuracy asks for, where pressures are bounded; at the edge of a rigid or stiffer
    body they are not, and means depend on the radius however fine the mesh.

    Attributes:
        point: (d,) in the middle of the patch [length], on the secondary side or near it.
        radius: R [length].
        pair: number of the pair.

    Example:
        >>> from dolfinx_tresca import MeanPressure
        >>> MeanPressure(point=(0, 0, 0), radius=0.5)
        MeanPressure(point=(0, 0, 0), radius=0.5, pair=0)
    """

    point: npt.ArrayLike
    radius: float
    pair: int = 0

    def __post_init__(self) -> None:
        _check_pair(self.pair)
        object.__setattr__(self, "radius", _checked_patch(self.point, self.radius))


@dataclass(frozen=True)
class MeanSlip:
    """Mean slip round a point along a direction [length], with the weight of `MeanPressure`.

    Secondary minus primary, as in `ContactSolution.slip`.

    Attributes:
        point: (d,) in the middle of the patch [length], on the secondary side or near it.
        radius: of the patch [length].
        direction: (d,) along which it is taken; its length does not matter.
        pair: number of the pair.
    """

    point: npt.ArrayLike
    radius: float
    direction: npt.ArrayLike
    pair: int = 0

    def __post_init__(self) -> None:
        _check_pair(self.pair)
        object.__setattr__(self, "radius", _checked_patch(self.point, self.radius))
        _check_vector("direction", self.direction)


#: What can be asked for.
Goal: TypeAlias = NormalForce | ContactForce | MeanPressure | MeanSlip


def checked_goal(goal: Any, pairs: int, dim: int) -> Goal:
    """Return a goal of a problem. Not collective.

    Args:
        goal: maybe one.
        pairs: how many pairs there are.
        dim: of space.

    Raises:
        InputError: it is none, its pair is not there, or its vectors are of another dimension.
    """
    if not isinstance(goal, Goal):
        raise InputError(
            "goal must be a NormalForce, ContactForce, MeanPressure or MeanSlip, found "
            f"{shown(goal)}."
        )
    if goal.pair >= pairs:
        raise InputError(f"goal is of pair {goal.pair}, but there are {pairs}, from 0 on.")
    for name in ("point", "direction"):
        vector = np.asarray(getattr(goal, name, np.zeros(dim)))
        if vector.shape != (dim,):
            raise InputError(f"{name} of the goal must have {dim} numbers, found {shown(vector)}.")
    return goal


def _check_pair(pair: Any) -> None:
    """Check the number of a pair.

    Raises:
        InputError: it is none.
    """
    number = integer(pair)
    if number is None or number < 0:
        raise InputError(f"pair must be its number, 0 for the first one, found {shown(pair)}.")


def _check_vector(name: str, vector: Any, zero: bool = False) -> None:
    """Check a vector.

    Raises:
        InputError: it is none of finite numbers, or is zero where it must not be.
    """
    try:
        found = np.asarray(vector, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.full(1, np.nan)
    if found.ndim != 1 or not np.isfinite(found).all() or not (zero or found.any()):
        kind = "finite numbers" if zero else "finite numbers, not all zero"
        raise InputError(f"{name} must be a vector of {kind}, found {shown(vector)}.")


def _checked_patch(point: Any, radius: Any) -> float:
    """Check a patch, and return its radius [length].

    Raises:
        InputError: its middle is no point, or its radius not positive.
    """
    _check_vector("point", point, zero=True)
    number = real(radius)
    if number is None or not 0.0 < number < np.inf:
        raise InputError(f"radius must be a positive number [length], found {shown(radius)}.")
    return number
