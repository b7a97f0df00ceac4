"""Frames of linear bodies that turn: a rigid motion of each body, from which it deforms little.

A point X of a body is at x = X + u with u = u_R + R v. Here u_R = t + (R - 1)(X - c) is the rigid
motion of the body's frame, with the centre c, the translation t and the rotation R, and v is the
displacement in the frame. If v is small, the strain energy is 1/2 v'K v with the K of the
undeformed body, also if R turns by whole revolutions: this is the corotational formulation, with a
frame for each body (Nour-Omid and Rankin 1991; Shabana 1997), see docs/theory/frames.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import bsr_array, csr_array
from scipy.spatial.transform import Rotation

from dolfinx import fem

from dolfinx_tresca._base.arrays import ROUNDING, Array, Mask, in_space
from dolfinx_tresca._base.bodies import Bodies
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca._base.petsc import sparse_matrix
from dolfinx_tresca._base.tolerances import ASSEMBLY_ROUNDING
from dolfinx_tresca.errors import StiffnessError
from dolfinx_tresca.scene.friction import Bonded
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.stiffness.forms import has_stresses


@dataclass(frozen=True)
class BodyFrames:
    """The frame of each body of a mesh; bodies without a frame have R = 1 and t = 0.

    Attributes:
        label: (nodes of V,) the body of each node of this rank, with ghosts.
        has_frame: (bodies,) whether the body has a frame that moves.
        axis: (bodies, 3) unit vector about which alone the body can turn; zero: it can turn freely.
        guides: (owned nodes,) whether the node is one of those that determine its body's frame:
            nodes whose whole displacement is prescribed, if they suffice; otherwise all nodes.
        centre: (bodies, 3) mean undeformed position of the guides, c [length].
        translation: (bodies, 3) t [length].
        rotation: (bodies, 3, 3) R.
    """

    V: Any
    label: npt.NDArray[np.int64]
    has_frame: Mask
    axis: Array
    guides: Mask
    centre: Array
    translation: Array
    rotation: Array

    @classmethod
    def at_rest(
        cls, system: Any, bodies: Bodies, pairs: Sequence[ContactPair]
    ) -> BodyFrames | None:
        """Return the frames of undeformed bodies; None if no body can have a frame. Collective.

        There are frames with finite sliding alone. A body has no frame if it is nonlinear, a body
        of revolution in its meridian, or one of a mixed space; if directions of prescribed
        displacements let it turn about no axis; if K, which is assembled, resists its rigid
        motions, as with springs that tie it to a place in space; if L has derivatives of the test
        function, which are stresses inside the bodies and would turn with them; or if it has nodes
        on surfaces with small sliding, whose normals do not turn, except bonded ones.
        """
        V, count = system.V, bodies.count
        slides_far = any(pair.sliding == "finite" for pair in pairs)
        if not slides_far or system.is_tangent or system.component is not None:
            return None
        if system.axisymmetric or has_stresses(system.loads):
            return None
        owned, dim = V.dofmap.index_map.size_local, V.mesh.geometry.dim
        label = system.body_of_node
        prescribed = system.prescribed_displacements.reshape(owned, dim)
        whole = prescribed.all(axis=1)
        # for each body and axis, the number of nodes that keep the body from turning about other
        # axes, since their displacement along this axis, but not as a whole, is prescribed; nodes
        # with small sliding count for all axes, so that their body has no frame
        guided = np.zeros((count, 3), dtype=np.int64)
        np.add.at(guided[:, :dim], label[:owned], prescribed & ~whole[:, None])
        for pair in pairs:
            if pair.sliding != "finite" and not isinstance(pair.friction, Bonded):
                sides = [pair.secondary, *([] if pair.obstacle else [pair.primary])]
                facets = np.concatenate([pair.facet_tags.find(side) for side in sides])
                guided[label[fem.locate_dofs_topological(V, dim - 1, facets)]] = 1
        guided[:] = reduce_array(system.comm, guided)
        has_single_axis = guided.sum(axis=1) == guided.max(axis=1)
        axis = np.where((guided > 0) & has_single_axis[:, None], 1.0, 0.0)
        # in 3D a body that is guided along one axis can turn about it; in 2D it cannot turn
        has_frame = (np.count_nonzero(guided, axis=1) <= dim - 2) & ~_resisted(system, bodies)
        if dim == 2:
            axis[:] = [0.0, 0.0, 1.0]
        if not has_frame.any():
            return None
        everywhere, zero = np.ones(owned, dtype=np.bool_), np.zeros((count, 3))
        unmoved = zero, zero, np.broadcast_to(np.eye(3), (count, 3, 3))
        frames = cls(V, label, has_frame, axis, everywhere, *unmoved)
        centre, moment = frames._moments(frames._points[:owned])
        held_centre, held_moment = replace(frames, guides=whole)._moments(frames._points[:owned])
        spread, held_spread = np.linalg.eigvalsh([moment, held_moment])[:, :, 1 - dim]
        # nodes determine a rotation if they are spread, in one direction in 2D and in two in 3D;
        # rotations of closer nodes have the rounding of their displacements, divided by 1e-6
        is_held = held_spread > 1e-6**2 * spread
        return replace(
            frames,
            guides=np.where(is_held[label[:owned]], whole, everywhere),
            centre=np.where(is_held[:, None], held_centre, centre),
        )

    def check_kept(self, at_rest: BodyFrames | None) -> None:
        """Check that with a new K, whose frames are `at_rest`, the same bodies have frames."""
        if at_rest is None or (at_rest.has_frame != self.has_frame).any():
            raise StiffnessError(
                "bodies have turned in their frames, and the new K resists the rigid motions of "
                "one of them, as springs do that refer to a place in space. Have such springs in a "
                "from the start: the body then has no frame."
            )

    @cached_property
    def _points(self) -> Array:
        """(nodes, 3) undeformed positions of this rank's nodes, with ghosts [length]."""
        return np.asarray(self.V.tabulate_dof_coordinates())

    def _positions(self, u: fem.Function) -> Array:
        """Return the displaced positions (nodes, 3) of this rank's nodes, with ghosts [length]."""
        return self._points + in_space(u.x.array.reshape(-1, self.V.mesh.geometry.dim))

    def _moments(self, x: Array) -> tuple[Array, Array]:
        """Return means of guides' positions x, and their moments, sums of (x - mean) (X - mean)'.

        The x are (owned nodes, 3), and results are (bodies, 3) and (bodies, 3, 3). Collective.
        """
        comm, label, X = self.V.mesh.comm, self.label[: len(x)], self._points[: len(x)]
        sums = np.zeros((len(self.has_frame), 7))  # of X, x and 1, then means of X and x
        np.add.at(sums, label[self.guides], np.column_stack([X, x, np.ones(len(x))])[self.guides])
        sums = np.asarray(reduce_array(comm, sums))
        sums[:, :6] /= np.maximum(sums[:, 6:], 1.0)
        x, X = x - sums[label, 3:6], X - sums[label, :3]
        moments = np.zeros((len(sums), 3, 3))
        np.add.at(moments, label[self.guides], (x[:, :, None] * X[:, None, :])[self.guides])
        return sums[:, 3:6], np.asarray(reduce_array(comm, moments))

    def moved_with(self, u: fem.Function) -> BodyFrames | None:
        """Return the frames that move with a displacement; None if all are at rest. Collective.

        R maps the undeformed guides best, in the least-squares sense, onto their displaced
        positions, among the rotations that the body's axis allows: with the singular value
        decomposition M = U S V' of the moments, R = U diag(1, 1, det(U V')) V'.
        """
        mean, moments = self._moments(self._positions(u)[: len(self.guides)])
        translation = np.where(self.has_frame[:, None], mean - self.centre, 0.0)
        # about a given axis only moments normal to it count, and a large one along it keeps it
        along = self.axis[:, :, None] * self.axis[:, None, :]
        normal = np.eye(3) - along
        norms = np.linalg.norm(moments, axis=(1, 2), keepdims=True)
        left, _, right = np.linalg.svd(normal @ moments @ normal + norms * along)
        left[:, :, 2] *= np.linalg.det(left @ right)[:, None]  # no reflections
        rotation = left @ right
        turned = np.abs(rotation - np.eye(3)).max(axis=(1, 2)) > ROUNDING
        rotation[~(turned & self.has_frame)] = np.eye(3)
        extent = np.abs(self._points).max(initial=0.0) + np.abs(translation).max(initial=0.0)
        extent = float(reduce_array(self.V.mesh.comm, extent, MPI.MAX))
        translation[np.abs(translation).max(axis=1) <= ROUNDING * extent] = 0.0
        moves = translation.any() or (rotation != np.eye(3)).any()
        return replace(self, translation=translation, rotation=rotation) if moves else None

    @cached_property
    def rigid(self) -> fem.Function:
        """The rigid motions u_R [length] at all nodes. Collective at first."""
        arm = self._points - self.centre[self.label]
        motion = np.einsum("nij,nj->ni", (self.rotation - np.eye(3))[self.label], arm)
        motion += self.translation[self.label]
        result = fem.Function(self.V)
        result.x.array[:] = motion[:, : self.V.mesh.geometry.dim].ravel()
        return result

    def into_space(self, v: Array) -> Array:
        """Return R v for nodal values (nodes * d,) of this rank, with or without ghosts."""
        return self._rotated(v, self.rotation)

    def into_frames(self, values: Array) -> Array:
        """Return R'f for nodal values (nodes * d,) of this rank, with or without ghosts."""
        return self._rotated(values, self.rotation.swapaxes(1, 2))

    def _rotated(self, values: Array, rotation: Array) -> Array:
        """Return nodal values (nodes * d,), multiplied by a matrix (bodies, 3, 3) of each body."""
        dim = self.V.mesh.geometry.dim
        vectors = values.reshape(-1, dim)
        matrices = rotation[self.label[: len(vectors)], :dim, :dim]
        return np.asarray(np.einsum("nij,nj->ni", matrices, vectors).ravel())

    def displacement(self, v: fem.Function) -> fem.Function:
        """Return u = u_R + R v [length] of a displacement v in the frames. Collective."""
        u = v.copy()
        u.name = v.name
        u.x.array[:] = self.rigid.x.array + self.into_space(v.x.array)
        return u

    def deformation(self, u: fem.Function) -> fem.Function:
        """Return v = R'(u - u_R) [length] of a displacement u. Collective."""
        v = u.copy()
        v.x.array[:] = self.into_frames(u.x.array - self.rigid.x.array)
        return v

    def work(self, forces: fem.Function) -> float:
        """Return the work of `forces` in the frames [force] on u_R [energy]. Collective."""
        owned = self.guides.size * self.V.mesh.geometry.dim
        own = self.into_space(forces.x.array[:owned]) @ self.rigid.x.array[:owned]
        return float(reduce_array(self.V.mesh.comm, own))

    def continued(self, before: fem.Function, after: fem.Function, fraction: float) -> fem.Function:
        """Return a displacement at which bodies with frames have gone on moving. Collective.

        Their rigid motions from the displacement `before` to `after` go on by a fraction of them:
        means of guides straight ahead, and rotations about the same axes. Other bodies stay.
        """
        owned, label = len(self.guides), self.label
        positions = [self._positions(u) for u in (before, after)]
        means = [self._moments(x[:owned])[0] for x in positions]
        frames = [self.moved_with(u) or self for u in (before, after)]
        turn = frames[1].rotation @ frames[0].rotation.swapaxes(1, 2)
        turn = (Rotation.from_matrix(turn) ** fraction).as_matrix()
        arm = positions[1] - means[1][label]
        next_means = means[1] + fraction * (means[1] - means[0])
        x = next_means[label] + np.einsum("nij,nj->ni", turn[label], arm)
        result, has_frame = after.copy(), self.has_frame[label]
        dim = self.V.mesh.geometry.dim
        result.x.array.reshape(-1, dim)[has_frame] = (x - self._points)[has_frame, :dim]
        return result

    def columns(self, B: PETSc.Mat) -> PETSc.Mat:
        """Return B R, owned by the caller, for a matrix B on displacements in space. Collective."""
        dim, owned = self.V.mesh.geometry.dim, len(self.guides)
        node = self.V.dofmap.index_map.local_range[0] + np.arange(owned)
        blocks = self.rotation[self.label[:owned], :dim, :dim], node, np.arange(owned + 1)
        shape = owned * dim, self.V.dofmap.index_map.size_global * dim
        R = csr_array(bsr_array(blocks, shape))
        return B.matMult(sparse_matrix(R, B.getSizes()[1], B.comm))


def _resisted(system: Any, bodies: Bodies) -> Mask:
    """Return for each body (count,) whether K resists any of its rigid motions. Collective."""
    dim, free = system.V.mesh.geometry.dim, ~system.prescribed
    label, modes = np.repeat(bodies.label, dim)[free], bodies.rigid_modes(dim)
    # a mode of all bodies at once, times another factor for each body, so that springs between
    # bodies are seen, too
    factors = 1.0 + 0.618 * np.arange(bodies.count) % 1.0
    diagonal = system.K.getDiagonal()
    largest, force = np.zeros((2, bodies.count))
    np.maximum.at(largest, label, np.abs(diagonal.array[free]))
    for mode in np.eye(modes.shape[1] // bodies.count):
        forces = system.product(modes @ np.kron(factors, mode))
        np.maximum.at(force, label, np.abs(forces.array[free]))
    largest, force = reduce_array(system.comm, np.array([largest, force]), MPI.MAX)
    return np.asarray(force > ASSEMBLY_ROUNDING * largest)
