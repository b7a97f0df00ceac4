"""Rigid obstacles, given by signed distances, and their rigid motions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from dolfinx import fem

from dolfinx_tresca._base.arguments import checked_number, checked_vector, real_array
from dolfinx_tresca._base.arrays import Array, unit
from dolfinx_tresca.errors import InputError, PairingError, shown, shown_place
from dolfinx_tresca.scene.friction import numbers_text

#: Function from points x (3, n) to their signed distances (n,) from the obstacle [length], positive
#: outside, and to the gradients (3, n): unit normals that point away from the obstacle.
SignedDistance: TypeAlias = Callable[[Array], tuple[Any, Any]]


@dataclass(frozen=True)
class RigidMotion:
    """The motion x -> R x + t, with a `rotation` R (3, 3) and a `translation` t (3,) [length]."""

    rotation: Array
    translation: Array

    @classmethod
    def about(cls, point: Array, rotation_vector: Array, translation: Array) -> RigidMotion:
        """Return a rotation about a point (3,), by a vector (3,) [rad], then a translation (3,)."""
        R = Rotation.from_rotvec(rotation_vector).as_matrix()
        return cls(R, point - R @ point + translation)

    def after(self, earlier: RigidMotion) -> RigidMotion:
        """Return an earlier motion, followed by this one."""
        translation = self.rotation @ earlier.translation + self.translation
        return RigidMotion(self.rotation @ earlier.rotation, translation)

    def towards(self, end: RigidMotion, fraction: float, centre: Array) -> RigidMotion:
        """Return the motion at a fraction, from 0 to 1, of the way from this motion to an end.

        The rotation, at most 180 degrees, has a fixed axis; the centre (3,) moves straight ahead.
        """
        turn = Rotation.from_matrix(end.rotation @ self.rotation.T) ** fraction
        R = turn.as_matrix() @ self.rotation
        before = self.applied_to(centre[:, None])[:, 0]
        after = end.applied_to(centre[:, None])[:, 0]
        return RigidMotion(R, (1.0 - fraction) * before + fraction * after - R @ centre)

    def applied_to(self, points: Array) -> Array:
        """Return the positions (3, n) to which points (3, n) move [length]."""
        return np.asarray(self.rotation @ points + self.translation[:, None])

    def reversed_from(self, positions: Array) -> Array:
        """Return the points (3, n) that this motion moves to the positions (3, n) [length]."""
        return np.asarray(self.rotation.T @ (positions - self.translation[:, None]))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RigidMotion) and np.array_equal(self.matrix, other.matrix)

    def __hash__(self) -> int:
        return hash(self.matrix.tobytes())

    @property
    def matrix(self) -> Array:
        """(3, 4) array of R and t, in which states of load steps keep motions."""
        return np.column_stack([self.rotation, self.translation])

    @classmethod
    def from_matrix(cls, matrix: Array) -> RigidMotion:
        """Return the motion with a given (3, 4) array of R and t."""
        return cls(matrix[:, :3], matrix[:, 3])


#: Names of motions that an obstacle may be free to make, by dimension: along axes, and about them.
FREEDOMS = {2: ("x", "y", "rz"), 3: ("x", "y", "z", "rx", "ry", "rz")}


class GivenForces(NamedTuple):
    """Forces that hold an obstacle, see `RigidObstacle.held_by`.

    Attributes:
        force: function that returns the present force (3,) on the obstacle.
        moment: function that returns the present moment (3,) about `about` [force length].
        free: names of the motions that are free, of `FREEDOMS`; None: all.
        about: (3,) point at which the force acts, at the obstacle's original place [length].
    """

    force: Callable[[], Array]
    moment: Callable[[], Array]
    free: tuple[str, ...] | None
    about: Array


class RigidObstacle:
    """A rigid obstacle of any shape, given by its signed distance.

    `RigidPlane`, `RigidSphere` and `RigidCylinder` are common shapes. In 2D the third coordinate of
    points is 0, and the third component of normals must be 0.

    An obstacle is moved by `move_to`, or by forces (`held_by`). It has no attributes for its
    dimensions, but Constants on which its signed distance depends can be changed: parameters of the
    scene, such as a position that is optimised, whose change is no motion and does not cause slip.

    Attributes:
        signed_distance: signed distance from the obstacle at its original place.
        constants: the listed Constants on which the signed distance depends.
        centre: (3,) point about which the obstacle turns, at its original place [length].
        motion: rigid motion of the obstacle from its original to its present place.
        given_forces: the forces that hold the obstacle; None if it is where `move_to` has put it.

    Example:
        A wavy floor. The distance is exact only near the surface, which is sufficient.

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

    # no other attributes can be set
    __slots__ = "_for_facets _name centre constants given_forces motion signed_distance".split()

    def __init__(
        self,
        signed_distance: SignedDistance,
        name: str = "a rigid obstacle",
        constants: Sequence[fem.Constant] = (),
    ) -> None:
        """Create an obstacle from a function. Not collective.

        Args:
            signed_distance: function from points x (3, n) to distances (n,) [length], positive
                outside, and unit normals (3, n) that point away from the obstacle.
            name: the name of the obstacle in tables, pictures and messages.
            constants: Constants whose present values the function uses. A change of the distance
                without `move_to` is then taken to be a change of these parameters, and the log does
                not warn of it. Controls of derivatives need not be listed.

        Raises:
            InputError: `signed_distance` is not callable, or one of `constants` no `fem.Constant`.
        """
        if not callable(signed_distance):
            raise InputError(
                f"an obstacle needs a function of points, found {shown(signed_distance)}."
            )
        if not all(isinstance(constant, fem.Constant) for constant in constants):
            raise InputError(f"constants must be a list of fem.Constant, found {shown(constants)}.")
        self.signed_distance = signed_distance
        self.constants = tuple(constants)
        self._name = str(name)
        # of a file: size of a body's facets -> signed distance with normals for this size
        self._for_facets: Callable[[float], SignedDistance] | None = None
        self.centre: Array = np.zeros(3)
        self.motion = RigidMotion(np.eye(3), np.zeros(3))
        self.given_forces: GivenForces | None = None

    @staticmethod
    def from_file(path: str | PathLike[str], *, smooth: float = 30.0) -> RigidObstacle:
        """Return the obstacle inside a closed surface of triangles. Not collective.

        The gap is the distance from the triangles. An edge between triangles of a curved surface
        would show as a ridge in the pressure: within the size of a body's facets from such an edge,
        normals are interpolated between the triangles' corners. Elsewhere they are those of the
        triangles, so flat faces stay flat. All ranks read the file, with pyvista.

        Args:
            path: file of a closed surface that pyvista reads: `.stl`, `.ply`, `.obj`, `.vtp` ...
            smooth: angle [degree] of two triangles' normals up to which they are a curved surface.

        Raises:
            InputError: the file cannot be read, its surface is not closed, or there is no pyvista.
        """
        try:
            import pyvista

            surface = pyvista.read(path).triangulate().clean()
            open_edges = surface.n_open_edges if surface.n_cells else 0
        except Exception as error:  # pyvista and VTK raise errors of many types
            raise InputError(f"RigidObstacle cannot read '{path}' with pyvista: {error}") from error
        if not surface.n_cells or open_edges:
            raise InputError(
                f"the surface in '{path}' is not closed: {open_edges} edges belong to one "
                "triangle only. An obstacle needs an inside: close it in the program that made it."
            )
        surface.points = surface.points.astype(np.float64)
        surface = surface.compute_normals(auto_orient_normals=True)
        smoothed = surface.compute_normals(split_vertices=True, feature_angle=smooth)
        flat, triangles = smoothed.cell_data["Normals"], smoothed.faces.reshape(-1, 4)[:, 1:]
        corners, normals = smoothed.points[triangles], smoothed.point_data["Normals"][triangles]
        # (triangles, 2, 3), which maps a vector from the first corner to the other corners' weights
        weights_of = np.linalg.pinv((corners[:, 1:] - corners[:, :1]).swapaxes(1, 2))
        # edges on curved surfaces; sharp edges are boundaries of `smoothed`
        bends = smoothed.extract_feature_edges(0.1, boundary_edges=False, non_manifold_edges=False)

        def distance(x: Array, facet_size: float = np.inf) -> tuple[Array, Array]:
            points = pyvista.PolyData(np.array(x.T))
            signed = points.compute_implicit_distance(surface)["implicit_distance"]
            cells, places = smoothed.find_closest_cell(points.points, return_closest_point=True)
            # the weights (n, 3) of the triangles' corners at the nearest places
            weights = np.einsum("nij,nj->ni", weights_of[cells], places - corners[cells, 0])
            weights = np.column_stack([1.0 - weights.sum(axis=1), weights])
            normal = np.einsum("ni,nij->nj", weights, normals[cells])
            if bends.n_cells and facet_size < np.inf:  # beyond this size, flat normals
                _, nearest = bends.find_closest_cell(places, return_closest_point=True)
                away = np.linalg.norm(places - nearest, axis=1) / facet_size
                # from 0, up to half a facet's size away from an edge, to 1 at a facet's size
                flatness = np.clip(2.0 * away - 1.0, 0.0, 1.0)
                normal += flatness[:, None] * (flat[cells] - normal)
            return signed, unit(normal).T

        obstacle = RigidObstacle(distance, f"the body in {Path(path).name}")
        obstacle._for_facets = lambda size: partial(distance, facet_size=size)
        obstacle.centre = np.array(surface.center)
        return obstacle

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self}>"

    def __str__(self) -> str:
        return self._name

    def values_to_agree(self) -> dict[str, Any]:
        """Return the values that must be equal on all ranks, by name. Not collective."""
        given = self.given_forces
        held = None if given is None else [given.force(), given.moment(), given.free, given.about]
        return {
            "name": self._name,
            "motion": self.motion.matrix,
            "constants": [np.ravel(constant.value) for constant in self.constants],
            "given forces": held,
        }

    def move_to(
        self,
        translation: npt.ArrayLike = (0.0, 0.0, 0.0),
        rotation: npt.ArrayLike = 0.0,
        about: npt.ArrayLike | None = None,
    ) -> None:
        """Move the obstacle by a rotation, then a translation, from its original place.

        Not collective; the motion, from where the obstacle was created, must be equal on all ranks.
        The next `solve()` pairs the surfaces again if necessary, and the slip includes the motion
        since the last accepted step: a turning wheel drives the body that it touches.

        Args:
            translation: vector of 2 or 3 components [length].
            rotation: angle about the z axis [rad], or a vector (3,), the axis times the angle.
            about: a point on the axis, at the original place [length]; by default the centre of a
                sphere or file, or the point of a plane or cylinder, as created; else the origin.

        Raises:
            InputError: an argument is not a vector of finite numbers.
        """
        vector = _axial_vector("rotation", rotation)
        centre = self.centre if about is None else _coordinates("about", about)
        self.motion = RigidMotion.about(centre, vector, _coordinates("translation", translation))

    def held_by(
        self,
        force: npt.ArrayLike | fem.Constant = (0.0, 0.0, 0.0),
        moment: npt.ArrayLike | fem.Constant = 0.0,
        *,
        free: Sequence[str] | None = None,
        about: npt.ArrayLike | None = None,
    ) -> None:
        """Let forces hold the obstacle: its motion is then an unknown of each solve.

        Not collective. Contact forces and the given forces are in equilibrium along all free
        motions; the others stay as `move_to` prescribes them. A solve finds small motions from the
        present place, and `accept()` leaves the obstacle where it is then: it may go far in many
        load steps. Its place in a solution is `ContactSolution.surfaces[k].obstacle.motion`.

        Args:
            force: vector of 2 or 3 components [force]; in 2D per unit of thickness.
            moment: number, about the z axis, or vector (3,) [force length], at the point `about`.
            free: names of the free motions: "x", "y", "z" along axes, "rx", "ry", "rz" about them;
                None: all ("x", "y", "rz" in 2D, "y" with axisymmetry); (): forces hold it no more.
            about: the point at which the force acts, and about which the obstacle turns, at the
                original place [length]; by default as in `move_to`.

        Raises:
            InputError: an argument is not a vector of finite numbers, or a name is unknown.
        """
        names = None if free is None else tuple(free)
        if isinstance(free, str) or not set(names or ()) <= set(FREEDOMS[3]):
            raise InputError(
                f"free must be a list of {', '.join(FREEDOMS[3])}, found {shown(free)}."
            )
        present_force = _present(_coordinates, "force", force)
        present_moment = _present(_axial_vector, "moment", moment)
        point = self.centre if about is None else _coordinates("about", about)
        given = GivenForces(present_force, present_moment, names, point)
        self.given_forces = None if names == () else given

    def distance(self, points: Array) -> Array:
        """Return signed distances (n,) of points (n, 3) [length], for pictures. Not collective.

        Where the user's function returns no finite distance, the largest of the others is taken.
        """
        with np.errstate(all="ignore"):
            returned = self.signed_distance(self.motion.reversed_from(points.T))
            distance = np.asarray(returned[0], float)
        is_finite = np.isfinite(distance)
        return np.where(is_finite, distance, distance[is_finite].max(initial=0.0))

    def at(self, points: Array) -> tuple[Array, Array]:
        """Return signed distances (n,) [length] and unit normals (n, 3) at points (n, 3).

        Raises:
            InputError: the shapes differ, values are not finite, or normals do not have length 1.
            PairingError: points are not finite, since cells at the surface have turned inside out.
        """
        n = len(points)
        if n == 0:  # users' functions need not take empty arrays
            return np.zeros(0), np.zeros((0, 3))
        if not np.isfinite(points).all():
            raise PairingError(f"the surface that faces {self} has folded over.")
        returned = self.signed_distance(self.motion.reversed_from(points.T))
        try:
            distance, normal = map(real_array, returned)
            if distance.shape != (n,) or normal.shape != (3, n):
                raise ValueError(f"found shapes {distance.shape} and {normal.shape}")
        except (TypeError, ValueError) as error:
            raise InputError(
                f"the signed distance of {self} must return two arrays, distances of shape ({n},) "
                f"and normals of shape (3, {n}) for {n} points: {error}."
            ) from error
        length = np.linalg.norm(normal, axis=0)
        wrong = ~(np.isfinite(distance) & (np.abs(length - 1.0) < 1e-6))
        if wrong.any():
            k = int(wrong.argmax())
            raise InputError(
                f"the signed distance of {self} must return finite distances and normals of length "
                f"1; found distance {distance[k]:g} and length {length[k]:g} at "
                f"{shown_place(points[k])}."
            )
        return distance, (self.motion.rotation @ normal).T


def resolved(obstacle: RigidObstacle, size: float) -> RigidObstacle:
    """Return an obstacle for facets of a size [length]: normals of `from_file` depend on it."""
    if obstacle._for_facets is None:
        return obstacle
    result = copy(obstacle)
    result.signed_distance = obstacle._for_facets(size)
    return result


class RigidPlane(RigidObstacle):
    """A rigid half-space behind a plane; in 2D a half-plane behind a line."""

    __slots__ = ()

    def __init__(
        self, point: npt.ArrayLike | fem.Constant, normal: npt.ArrayLike | fem.Constant
    ) -> None:
        """Create a half-space. Not collective.

        Args:
            point: any point of the plane [length], 2 or 3 coordinates.
            normal: vector of any length, normal to the plane, that points away from the obstacle.
                Here and in other obstacles, a `fem.Constant` may take the place of numbers: its
                value may be changed before a solve, and it may be a control of derivatives.

        Raises:
            InputError: an argument is not a vector of 2 or 3 numbers, or the normal is zero.
        """
        p, n = _present(_coordinates, "point", point), _present(_direction, "normal", normal)

        def distance(x: Array) -> tuple[Array, Array]:
            return n() @ (x - p()[:, None]), np.broadcast_to(n()[:, None], x.shape)

        name = f"a rigid plane through {numbers_text(p())} with normal {numbers_text(n())}"
        super().__init__(distance, name, _constants_of(point, normal))
        self.centre = p()


class RigidSphere(RigidObstacle):
    """A rigid ball, or the space around a spherical hole; in 2D a disc or the plane around it."""

    __slots__ = ()

    def __init__(
        self,
        center: npt.ArrayLike | fem.Constant,
        radius: float | fem.Constant,
        *,
        hollow: bool = False,
    ) -> None:
        """Create a sphere. Not collective.

        Args:
            center: centre of the sphere [length], 2 or 3 coordinates.
            radius: radius of the sphere [length].
            hollow: whether the sphere is a hole with the deformable body inside it.

        Raises:
            InputError: the centre is not a point, or the radius is not positive.
        """
        c = _present(_coordinates, "center", center)
        r = _present(checked_number, "radius", radius)

        def distance(x: Array) -> tuple[Array, Array]:
            return _spherical_distance(x - c()[:, None], r(), hollow)

        place = f"around {numbers_text(c())} of radius {r():g}"
        name = f"a rigid {'hollow ' if hollow else ''}sphere {place}"
        super().__init__(distance, name, _constants_of(center, radius))
        self.centre = c()


class RigidCylinder(RigidObstacle):
    """A rigid infinite circular cylinder, or the space around a cylindrical hole, in 3D.

    In 2D the cross-section of a cylinder is a `RigidSphere`.
    """

    __slots__ = ()

    def __init__(
        self,
        point: npt.ArrayLike | fem.Constant,
        axis: npt.ArrayLike | fem.Constant,
        radius: float | fem.Constant,
        *,
        hollow: bool = False,
    ) -> None:
        """Create a cylinder. Not collective.

        Args:
            point: any point of the axis [length], 2 or 3 coordinates.
            axis: direction of the axis, a vector (3,) of any length.
            radius: radius of the cylinder [length].
            hollow: whether the cylinder is a hole with the deformable body inside it.

        Raises:
            InputError: the point or axis is no vector, the axis zero, or the radius not positive.
        """
        checked_vector("axis", getattr(axis, "value", axis), 3)
        p, a = _present(_coordinates, "point", point), _present(_direction, "axis", axis)
        r = _present(checked_number, "radius", radius)

        def distance(x: Array) -> tuple[Array, Array]:
            offset, along = x - p()[:, None], a()
            return _spherical_distance(offset - np.outer(along, along @ offset), r(), hollow)

        place = f"through {numbers_text(p())} along {numbers_text(a())} of radius {r():g}"
        name = f"a rigid {'hollow ' if hollow else ''}cylinder {place}"
        super().__init__(distance, name, _constants_of(point, axis, radius))
        self.centre = p()


def _present(check: Callable[[str, Any], Any], name: str, value: Any) -> Callable[[], Any]:
    """Return a function that returns the present value of a user's argument, checked.

    `check` takes a name, for errors, and a value; a Constant is checked at each call, others once.
    """
    if isinstance(value, fem.Constant):
        check(name, value.value)
        return lambda: check(name, value.value)
    fixed = check(name, value)
    return lambda: fixed


def _constants_of(*values: Any) -> list[fem.Constant]:
    """Return the values that are Constants."""
    return [value for value in values if isinstance(value, fem.Constant)]


def _spherical_distance(offset: Array, radius: float, hollow: bool) -> tuple[Array, Array]:
    """Return distances (n,) and normals (3, n) of a sphere or a cylinder.

    The offsets (3, n) of points are from its centre or axis [length]. If `hollow`, it is a hole.
    """
    length = np.linalg.norm(offset, axis=0)
    sign = -1.0 if hollow else 1.0
    # at the centre or on the axis, a radius away from the surface, any unit vector will do
    normal = np.where(length > 0.0, offset, np.array([[1.0], [0.0], [0.0]]))
    return sign * (length - radius), sign * normal / np.where(length > 0.0, length, 1.0)


def _coordinates(name: str, value: npt.ArrayLike, *, nonzero: bool = False) -> Array:
    """Return a vector (3,) from the user's 2 or 3 components; without a third, it is 0."""
    vector = checked_vector(name, value, 2, 3, nonzero=nonzero)
    return np.append(vector, np.zeros(3 - len(vector)))


def _axial_vector(name: str, value: npt.ArrayLike) -> Array:
    """Return a rotation or moment (3,) from the user's 3 components, or a number about z."""
    if np.shape(value) == ():
        return np.array([0.0, 0.0, checked_number(name, value, "(-inf, inf)")])
    return checked_vector(name, value, 3)


def _direction(name: str, value: npt.ArrayLike) -> Array:
    """Return the unit vector (3,) along a vector of 2 or 3 components."""
    vector = _coordinates(name, value, nonzero=True)
    vector /= np.abs(vector).max()  # squares then neither overflow nor vanish
    return np.asarray(vector / np.linalg.norm(vector))
