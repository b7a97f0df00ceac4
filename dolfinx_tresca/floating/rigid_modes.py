"""Rigid body modes of bodies that K resists little or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca.floating.bodies import Bodies

#: An error message mentions translations and rotations whose share in a motion exceeds NAMED_PART,
#: and counts bodies that move more than NAMED_PART of the largest motion. A motion of a body is
#: left out as rounding if its singular value is at most MOVED_PART times the largest singular
#: value.
NAMED_PART, MOVED_PART = 0.1, 1e-3

#: Names of the rigid body modes, by their number.
MODES = {
    3: ("translation along x", "translation along y", "rotation"),
    6: ("translation along x", "translation along y", "translation along z",
        "rotation about x", "rotation about y", "rotation about z"),
}  # fmt: skip

#: A message describes the first body that moves by at least this fraction of the largest motion.
#: With half the fraction, it may describe a body that turns little while another body falls.
CHOSEN_PART = 0.9


@dataclass(frozen=True)
class RigidBodyModes:
    """Rigid body modes R, orthonormal in the degrees of freedom, that K hardly resists.

    Attributes:
        comm: communicator of the mesh.
        bodies: the bodies of the mesh.
        basis: R (owned degrees of freedom, k), sparse; zero where u is prescribed.
        stiffness: (k,) approximate stiffness against deformation of the body that the mode moves,
            for a displacement vector of length 1.
        floats: (k,) True: K does not resist the mode at all; False: K resists it a little, by soft
            springs.
        body: (k,) the body of each mode, ascending.
        parts: (3 or 6 for each body, k) components of each mode in `Bodies.rigid_modes`, sparse.
            Lever arms of rotations are divided by the body's size.
    """

    comm: Any
    bodies: Bodies
    basis: csr_array
    stiffness: Array
    floats: Mask
    body: Indices
    parts: csr_array

    def __len__(self) -> int:
        return len(self.floats)

    @property
    def summary(self) -> str:
        """The numbers of floating and of softly held bodies, as the end of a sentence."""
        floating = np.unique(self.body[self.floats])
        soft = np.setdiff1d(self.body, floating)
        return f", {len(floating)} of them held by contact alone" * (
            len(floating) > 0
        ) + f", {len(soft)} of them held softly" * (len(soft) > 0)

    @property
    def dim(self) -> int:
        """The dimension of space."""
        return 3 if self.parts.shape[0] == 6 * self.bodies.number else 2

    def describe(self, components: Array) -> str:
        """Return in words a body that moves, its motion, and the bodies that also move. Collective.

        The body is the first of those that move most. Bodies count as moving if they move by more
        than `NAMED_PART` of the largest motion.

        Args:
            components: (k,) or (k, columns) components of one or of several motions.
        """
        moved = self.parts @ components.reshape(len(self), -1)
        moved = moved.reshape(self.bodies.number, -1, moved.shape[1])
        lengths = np.linalg.norm(moved, axis=(1, 2))
        moving = np.flatnonzero(lengths > NAMED_PART * lengths.max())
        chosen = int(np.argmax(lengths > CHOSEN_PART * lengths.max()))
        axes, sizes, _ = np.linalg.svd(moved[chosen], full_matrices=False)
        share = np.square(axes[:, sizes > MOVED_PART * sizes[0]]).sum(axis=1)
        free = [
            name for name, part in zip(MODES[len(share)], share, strict=True) if part > NAMED_PART
        ]
        text = self.bodies.describe(chosen, moving[moving != chosen].tolist())
        # ranks may differ by rounding
        return str(self.comm.bcast(f"{text}: {', '.join(free)}"))
