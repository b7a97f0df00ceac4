"""Rigid obstacles: bodies that do not deform and need no mesh."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.number import real
from dolfinx_tresca.errors import InputError, shown

#: Points x of shape (3, n) -> their signed distance (n,) from the obstacle [length], positive
#: outside, and its gradient (3, n), the unit normal that points away from the obstacle.
SignedDistance: TypeAlias = Callable[[Array], tuple[Any, Any]]


class RigidObstacle:
    """A rigid obstacle of any shape, given by its signed distance.

    `RigidPlane`, `RigidSphere` and `RigidCylinder` are ready-made. In 2D points have a third
    coordinate 0, and the third component of the normal must be 0.

    Example:
        A wavy floor, nearly: the distance has to be right near the surface only.

        >>> import numpy as np
        >>> from dolfinx_tresca import RigidObstacle
        >>> def waves(x):  # of height 0.01
        ...     slope = 0.01 * np.cos(x[0])
        ...     upwards = np.array([-slope, 0 * slope, 1 + 0 * slope])
        ...     length = np.hypot(1, slope)
        ...     return (x[2] - 0.01 * np.sin(x[0])) / length, upwards / length
        >>> RigidObstacle(waves, name="a wavy floor")
        <RigidObstacle: a wavy floor>
    """

    def __init__(self, signed_distance: SignedDistance, name: str = "a rigid obstacle") -> None:
        """Keep the function.

        Args:
            signed_distance: points x (3, n) -> distance (n,) [length], positive outside, and unit
                normal (3, n) pointing away from the obstacle.
            name: for people.

        Raises:
            InputError: it is no function.
        """
        if not callable(signed_distance):
            raise InputError(
                "an obstacle needs a function of points that returns distances and normals, found "
                f"{shown(signed_distance)}."
            )
        self._signed_distance = signed_distance
        self._name = str(name)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self}>"

    def __str__(self) -> str:
        return self._name

    def values_to_agree(self) -> dict[str, Any]:
        """Return what the ranks compare of an obstacle that a call is given. Not collective."""
        return {"name": self._name}

    def distance(self, points: Array) -> Array:
        """Return distances (n,) at points (n, 3), for pictures. Not collective.

        Points may be anywhere, so nothing is checked; where the function has no answer they are
        as far as the farthest.
        """
        with np.errstate(all="ignore"):
            distance = np.asarray(self._signed_distance(np.ascontiguousarray(points.T))[0], float)
        known = np.isfinite(distance)
        return np.where(known, distance, distance[known].max(initial=0.0))

    def at(self, points: Array) -> tuple[Array, Array]:
        """Return distances (n,) and normals (n, 3) at points (n, 3). Not collective.

        Raises:
            InputError: the function returns something else, NaN, or normals without length 1.
        """
        n = len(points)
        if n == 0:  # users' functions need not take empty arrays
            return np.zeros(0), np.zeros((0, 3))
        found = self._signed_distance(np.ascontiguousarray(points.T))
        try:
            distance, normal = (_real(part) for part in found)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"the signed distance of {self} must return two arrays, distances of shape (n,) "
                f"and normals of shape (3, n): {error}."
            ) from error
        if distance.shape != (n,) or normal.shape != (3, n):
            raise InputError(
                f"the signed distance of {self} must return distances of shape ({n},) and normals "
                f"of shape (3, {n}) for {n} points, found {distance.shape} and {normal.shape}."
            )
        length = np.linalg.norm(normal, axis=0)
        wrong = ~(np.isfinite(distance) & (np.abs(length - 1.0) < 1e-6))
        if wrong.any():
            first = int(wrong.argmax())
            raise InputError(
                f"the signed distance of {self} must return finite distances and normals of length "
                f"1; found distance {distance[first]:g} and length {length[first]:g} at "
                f"{tuple(float(f'{c:.6g}') for c in points[first])}."
            )
        return distance, normal.T


class RigidPlane(RigidObstacle):
    """The half-space behind a plane; in 2D that behind a line.

    Example:
        >>> from dolfinx_tresca import RigidPlane
        >>> RigidPlane(point=(0, 0, 0), normal=(0, 0, 2))
        <RigidPlane: a rigid plane through (0, 0, 0) with normal (0, 0, 1)>
    """

    def __init__(self, point: npt.ArrayLike, normal: npt.ArrayLike) -> None:
        """Set the plane.

        Args:
            point: any point of it [length], 2 or 3 coordinates.
            normal: points away from the obstacle; of any length.

        Raises:
            InputError: no such point, or a normal of length zero.
        """
        p, n = _vector("point", point), _direction("normal", normal)

        def distance(x: Array) -> tuple[Array, Array]:
            normals = np.broadcast_to(n[:, None], x.shape)
            return n @ (x - p[:, None]), normals

        super().__init__(distance, f"a rigid plane through {_text(p)} with normal {_text(n)}")


class RigidSphere(RigidObstacle):
    """A ball, or all of space around a spherical hole; in 2D a disc.

    Example:
        >>> from dolfinx_tresca import RigidSphere
        >>> RigidSphere(center=(0, 0, -5), radius=5)
        <RigidSphere: a rigid sphere around (0, 0, -5) of radius 5>
    """

    def __init__(self, center: npt.ArrayLike, radius: float, *, hollow: bool = False) -> None:
        """Set the sphere.

        Args:
            center: its centre [length], 2 or 3 coordinates.
            radius: its radius [length].
            hollow: whether bodies are inside of it.

        Raises:
            InputError: no such point, or a radius that is not positive.
        """
        c, r = _vector("center", center), _radius(radius)
        super().__init__(
            lambda x: _round(x - c[:, None], r, hollow),
            f"a rigid {'hollow ' if hollow else ''}sphere around {_text(c)} of radius {r:g}",
        )


class RigidCylinder(RigidObstacle):
    """An endless circular cylinder, or all of space around a cylindrical hole.

    In 3D; in 2D its cross-section, a disc, is a `RigidSphere`.

    Example:
        >>> from dolfinx_tresca import RigidCylinder
        >>> RigidCylinder(point=(0, 0, 0), axis=(0, 0, 1), radius=2, hollow=True)
        <RigidCylinder: a rigid hollow cylinder through (0, 0, 0) along (0, 0, 1) of radius 2>
    """

    def __init__(
        self,
        point: npt.ArrayLike,
        axis: npt.ArrayLike,
        radius: float,
        *,
        hollow: bool = False,
    ) -> None:
        """Set the cylinder.

        Args:
            point: any point of its axis [length], 2 or 3 coordinates.
            axis: direction of the axis, 3 components, of any length.
            radius: its radius [length].
            hollow: whether bodies are inside of it.

        Raises:
            InputError: no such point or direction, or a radius that is not positive.
        """
        if np.shape(axis) == (2,):
            raise InputError(
                f"axis must have 3 components, found {shown(axis)}: in 2D the cross-section of a "
                "cylinder is a disc, RigidSphere(center, radius)."
            )
        p, a, r = _vector("point", point), _direction("axis", axis), _radius(radius)

        def distance(x: Array) -> tuple[Array, Array]:
            offset = x - p[:, None]
            return _round(offset - np.outer(a, a @ offset), r, hollow)

        super().__init__(
            distance,
            f"a rigid {'hollow ' if hollow else ''}cylinder through {_text(p)} along {_text(a)} "
            f"of radius {r:g}",
        )


def _round(offset: Array, radius: float, hollow: bool) -> tuple[Array, Array]:
    """Return distance and normal of a sphere or cylinder for vectors (3, n) from its middle."""
    length = np.linalg.norm(offset, axis=0)
    sign = -1.0 if hollow else 1.0
    # in the very middle no direction is nearer than another
    normal = np.where(length > 0.0, offset, np.array([[1.0], [0.0], [0.0]]))
    normal = sign * normal / np.where(length > 0.0, length, 1.0)
    return sign * (length - radius), normal


def _real(value: npt.ArrayLike) -> Array:
    """Return a value as an array.

    Raises:
        TypeError: it holds something else than real numbers.
    """
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"found {array.dtype} where real numbers are wanted")
    return array.astype(np.float64)


def _vector(name: str, value: npt.ArrayLike) -> Array:
    """Return three coordinates.

    Raises:
        InputError: it is no finite vector of 2 or 3.
    """
    try:
        vector = _real(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be 2 or 3 numbers, found {shown(value)}.") from error
    if vector.shape not in ((2,), (3,)) or not np.isfinite(vector).all():
        raise InputError(f"{name} must be 2 or 3 finite numbers, found {shown(value)}.")
    return np.append(vector, np.zeros(3 - len(vector)))


def _direction(name: str, value: npt.ArrayLike) -> Array:
    """Return a unit vector.

    Raises:
        InputError: it is no finite vector of 2 or 3, or has length zero.
    """
    vector = _vector(name, value)
    size = np.abs(vector).max()
    if size == 0.0:
        raise InputError(f"{name} must have a direction, found {shown(value)}.")
    return np.asarray(vector / size / np.linalg.norm(vector / size))


def _radius(value: float) -> float:
    """Return a radius.

    Raises:
        InputError: it is not a positive finite number.
    """
    number = real(value)
    if number is None or not 0.0 < number < math.inf:
        raise InputError(f"radius must be a positive number, found {shown(value)}.")
    return number


def _text(vector: Array) -> str:
    return "(" + ", ".join(f"{value:g}" for value in vector) + ")"
