"""Goals: functionals of the solution for which adaptive solves control the error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy.typing as npt

from dolfinx_tresca._base.arguments import check_type, checked_number, checked_vector
from dolfinx_tresca._base.arrays import integer
from dolfinx_tresca.errors import InputError, shown


class _OnPair:
    """Base class of goals, which checks their attributes."""

    pair: int

    def __post_init__(self) -> None:
        pair = integer(self.pair)
        if pair is None or pair < 0:
            raise InputError(
                f"pair must be its number, 0 for the first one, found {shown(self.pair)}."
            )
        for name, value in vars(self).items():
            if name in ("point", "direction"):
                checked_vector(name, value, 2, 3, nonzero=name == "direction")
            elif name in ("radius", "exponent"):
                interval = "(0, inf)" if name == "radius" else "[1, inf)"
                object.__setattr__(self, name, checked_number(name, value, interval))


@dataclass(frozen=True)
class NormalForce(_OnPair):
    """Integral of the contact pressure of a pair [force; in 2D force per length].

    Attributes:
        pair: number of the pair in the list of the problem, from 0 on.

    Raises:
        InputError: `pair` is not the number of a pair.
    """

    pair: int = 0


@dataclass(frozen=True)
class ContactForce(_OnPair):
    """Component of the contact force on the secondary body [force; in 2D force per length].

    The force includes pressure and friction; see `ContactSolution.resultants`.

    Attributes:
        direction: (d,) direction of the component, a vector of any length.
        pair: number of the pair in the list of the problem, from 0 on.

    Raises:
        InputError: `pair` is not the number of a pair, or `direction` is not a nonzero vector.

    Example:
        >>> from dolfinx_tresca import ContactForce
        >>> ContactForce(direction=(1, 0, 0))  # the component along x
        ContactForce(direction=(1, 0, 0), pair=0)
    """

    direction: npt.ArrayLike
    pair: int = 0


@dataclass(frozen=True)
class MeanPressure(_OnPair):
    """Mean contact pressure around a point [stress], with the weight (1 - r^2/R^2)^2.

    The weight is smooth because the pressure at a point, or its mean over a patch with a sharp
    edge, has no adjoint solution of finite energy, so that no error estimate would converge. For
    the peak of a bounded pressure choose a patch so small that the mean is as close to the peak as
    required. At the edge of a rigid or stiffer body the pressure is unbounded: the mean depends on
    the radius, however fine the mesh.

    Attributes:
        point: (d,) centre of the patch [length], on the secondary side or near it.
        radius: radius R of the patch [length].
        pair: number of the pair in the list of the problem, from 0 on.

    Raises:
        InputError: `pair` is not the number of a pair, or the point or the radius is wrong.

    Example:
        >>> from dolfinx_tresca import MeanPressure
        >>> MeanPressure(point=(0, 0, 0), radius=0.5)
        MeanPressure(point=(0, 0, 0), radius=0.5, pair=0)
    """

    point: npt.ArrayLike
    radius: float
    pair: int = 0


@dataclass(frozen=True)
class MeanSlip(_OnPair):
    """Mean component of the slip along a direction, around a point [length].

    The mean has the weight of `MeanPressure`. The slip is the displacement of the secondary side
    minus the displacement of the primary side, as in `ContactSolution.slip`.

    Attributes:
        point: (d,) centre of the patch [length], on the secondary side or near it.
        radius: radius of the patch [length].
        direction: (d,) direction of the component, a vector of any length.
        pair: number of the pair in the list of the problem, from 0 on.

    Raises:
        InputError: `pair` is not the number of a pair, or the point, the radius or the direction is
            wrong.
    """

    point: npt.ArrayLike
    radius: float
    direction: npt.ArrayLike
    pair: int = 0


@dataclass(frozen=True)
class PressureNorm(_OnPair):
    """Norm of the contact pressure in L^m, (integral of p^m)^(1/m) [stress area^(1/m)].

    The norm is a smooth measure of the peak: the larger m is, the more the largest pressures count.
    For a given force the norm is smallest if the pressure is uniform.

    Attributes:
        exponent: m, at least 1; the norm for m = 1 is the normal force.
        pair: number of the pair in the list of the problem, from 0 on.

    Raises:
        InputError: `pair` is not the number of a pair, or the exponent is less than 1 or infinite.
    """

    exponent: float
    pair: int = 0


#: All goals.
Goal: TypeAlias = NormalForce | ContactForce | MeanPressure | MeanSlip | PressureNorm


def checked_goal(goal: Any, pairs: int, dim: int) -> Goal:
    """Check the user's argument `goal` and return it. Not collective.

    Args:
        goal: the argument.
        pairs: number of pairs of the problem.
        dim: dimension of space.

    Raises:
        InputError: the argument is not a goal, its pair does not exist, or its vectors do not have
            the dimension of space.
    """
    kinds = "a NormalForce, ContactForce, MeanPressure, MeanSlip or PressureNorm"
    check_type("goal", goal, Goal, kinds)
    if goal.pair >= pairs:
        raise InputError(
            f"goal belongs to pair {goal.pair}, but the problem has {pairs}, numbered from 0."
        )
    for name in ("point", "direction"):
        if hasattr(goal, name):
            checked_vector(f"{name} of the goal", getattr(goal, name), dim)
    checked: Goal = goal
    return checked
