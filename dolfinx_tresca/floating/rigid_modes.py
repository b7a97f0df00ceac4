"""Rigid body modes of bodies that K resists little or not at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import broadcast_array

#: An error message mentions translations and rotations whose share in a motion exceeds NAMED_PART,
#: and counts bodies that move more than NAMED_PART of the largest motion. A motion of a body is
#: left out as rounding if its singular value is at most MOVED_PART times the largest singular
#: value.
NAMED_PART, MOVED_PART = 0.1, 1e-3

#: Names of the rigid body modes, by the dimension of space.
MODES = {
    2: ("translation along x", "translation along y", "rotation"),
    3: ("translation along x", "translation along y", "translation along z",
        "rotation about x", "rotation about y", "rotation about z"),
}  # fmt: skip


@dataclass(frozen=True)
class RigidBodyModes:
    """Rigid body modes R, orthonormal in the degrees of freedom, that K hardly resists.

    Attributes:
        comm: communicator of the mesh.
        basis: R (owned degrees of freedom, k), sparse; zero where u is prescribed.
        stiffness: (k,) approximate stiffness against deformation of the body that the mode moves,
            for a displacement vector of length 1.
        floats: (k,) True: K does not resist the mode at all; False: K resists it a little, by soft
            springs.
        body: (k,) the body of each mode, ascending.
        label: (owned nodes,) the body of each node.
        name: function that describes a body in words, with other bodies that move together with it.
        parts: (k, 3 or 6) components of each mode in the order of `MODES`. Lever arms of rotations
            are divided by the body's size.
    """

    comm: Any
    basis: csr_array
    stiffness: Array
    floats: Mask
    body: Indices
    label: Indices
    name: Callable[..., str]
    parts: Array

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

    def split(self, u: Array, some: Indices) -> csr_array:
        """Return the parts of u on single bodies as a sparse matrix with a column for each mode.

        This splits the answer of a solve that treats one mode of every body at once.

        Args:
            u: (n,) values at the owned degrees of freedom.
            some: numbers of modes, at most one for each body. The column of such a mode has the
                values of u on the mode's body; other columns are zero.
        """
        mode = np.full(max(self.label.max(initial=-1), self.body.max(initial=-1)) + 1, -1)
        mode[self.body[some]] = some
        column = np.repeat(mode[self.label], self.dim)
        row = np.flatnonzero((column >= 0) & (u != 0.0))
        return csr_array((u[row], (row, column[row])), shape=(len(u), len(self)))

    @property
    def dim(self) -> int:
        """The dimension of space."""
        return 3 if self.parts.shape[1] == 6 else 2

    def describe(self, components: Array) -> str:
        """Return in words a body that moves, its motion, and the bodies that also move. Collective.

        Bodies count as moving if they move by more than `NAMED_PART` of the largest motion.

        Args:
            components: (k,) components of a motion, of which the body that moves most is described,
                or (k, columns) of several motions, of which the first moving body is described.
        """
        names = MODES[self.dim]
        bodies, index = np.unique(self.body, return_inverse=True)
        moved = np.zeros((len(bodies), self.parts.shape[1], components.size // len(self)))
        np.add.at(moved, index, self.parts[:, :, None] * components.reshape(len(self), 1, -1))
        lengths = broadcast_array(self.comm, np.linalg.norm(moved, axis=(1, 2)))
        moving = np.flatnonzero(lengths > NAMED_PART * lengths.max())
        chosen = int(lengths.argmax() if components.ndim == 1 else moving[0])
        axes, sizes = (
            broadcast_array(self.comm, factor)
            for factor in np.linalg.svd(moved[chosen], full_matrices=False)[:2]
        )
        share = np.square(axes[:, sizes > MOVED_PART * sizes[0]]).sum(axis=1)
        free = [name for name, part in zip(names, share, strict=True) if part > NAMED_PART]
        text = self.name(int(bodies[chosen]), bodies[moving[moving != chosen]].tolist())
        return f"{text}: {', '.join(free or [names[int(share.argmax())]])}"
