"""Rigid motions of obstacles, and of tools that several obstacles belong to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from dolfinx_tresca._base.arrays import Array


@dataclass(frozen=True)
class RigidMotion:
    """The motion x -> R x + t.

    Attributes:
        rotation: (3, 3) orthogonal matrix R.
        translation: (3,) vector t [length].
    """

    rotation: Array
    translation: Array

    @classmethod
    def none(cls) -> RigidMotion:
        """Return the motion that leaves all points where they are."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def about(cls, point: Array, rotation_vector: Array, translation: Array) -> RigidMotion:
        """Return a rotation about a point, followed by a translation.

        Args:
            point: (3,) point that the rotation leaves where it is [length].
            rotation_vector: (3,) axis of the rotation times the angle [rad].
            translation: (3,) translation [length].
        """
        R = Rotation.from_rotvec(rotation_vector).as_matrix()
        return cls(R, point - R @ point + translation)

    def after(self, earlier: RigidMotion) -> RigidMotion:
        """Return an earlier motion, followed by this one."""
        return RigidMotion(
            self.rotation @ earlier.rotation,
            self.rotation @ earlier.translation + self.translation,
        )

    def towards(self, end: RigidMotion, fraction: float, centre: Array) -> RigidMotion:
        """Return the motion at a fraction of the way to another motion.

        Args:
            end: the motion at the end of the way.
            fraction: fraction of the way, from 0 to 1.
            centre: (3,) point that moves along a straight line [length].
        """
        turned = Rotation.from_matrix(end.rotation @ self.rotation.T).as_rotvec()
        R = Rotation.from_rotvec(fraction * turned).as_matrix() @ self.rotation
        ends = [motion.applied_to(centre[:, None])[:, 0] for motion in (self, end)]
        return RigidMotion(R, (1.0 - fraction) * ends[0] + fraction * ends[1] - R @ centre)

    def applied_to(self, points: Array) -> Array:
        """Return the positions (3, n) to which points (3, n) move [length]."""
        moved: Array = self.rotation @ points + self.translation[:, None]
        return moved

    def reversed_from(self, positions: Array) -> Array:
        """Return the points (3, n) that move to positions (3, n) [length]."""
        points: Array = self.rotation.T @ (positions - self.translation[:, None])
        return points

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RigidMotion) and np.array_equal(self.matrix, other.matrix)

    def __hash__(self) -> int:
        return hash(self.matrix.tobytes())

    @property
    def matrix(self) -> Array:
        """(3, 4) array of R and t."""
        return np.column_stack([self.rotation, self.translation])

    @classmethod
    def from_matrix(cls, matrix: npt.ArrayLike) -> RigidMotion:
        """Return the motion with a given (3, 4) array of R and t."""
        array = np.asarray(matrix, dtype=np.float64)
        return cls(array[:, :3], array[:, 3])
