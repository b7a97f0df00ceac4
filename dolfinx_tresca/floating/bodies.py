"""Bodies of a mesh: parts that no cell connects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.bodies import body_bounds, label_bodies
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.scene.mesh import NamedTags

#: Number of bodies that a message names, at most, of those that move together with another body.
#: With twice the number, messages about walls of bricks are twice as long.
MOST_COMPANIONS = 6


@dataclass(frozen=True)
class Bodies:
    """The bodies of a mesh.

    Attributes:
        number: number of bodies.
        tag_names: for each body the name of the tag that all its cells have; "" if there is none.
        label: (owned nodes of V,) the body of each node, in 0, ..., number - 1.
        bounds: (number, 6) bounding box of each body: least x, y, z, then largest [length].
        nodes: (number,) number of nodes of V in each body.
        arm: (owned nodes of V, 3) coordinates from the centre of the bounding box of the node's
            body, divided by the length of the box's diagonal.
    """

    number: int
    tag_names: tuple[str, ...]
    label: npt.NDArray[np.int64]
    bounds: Array
    nodes: npt.NDArray[np.int64]
    arm: Array

    @classmethod
    def from_space(cls, V: Any, cell_tags: NamedTags | None = None) -> Bodies:
        """Find the bodies of a space's mesh. Collective.

        Args:
            V: the space of the displacement.
            cell_tags: tags of cells with the names of bodies; None: bodies have numbers only.
        """
        label = label_bodies(V)
        number = V.mesh.comm.allreduce(int(label.max(initial=-1)), op=MPI.MAX) + 1
        bounds = body_bounds(V, label, number)
        tag_names = _tag_names(V, label, number, cell_tags)
        label = label[: V.dofmap.index_map.size_local]
        centre = 0.5 * (bounds[:, :3] + bounds[:, 3:])
        size = np.linalg.norm(bounds[:, 3:] - bounds[:, :3], axis=1)
        points = V.tabulate_dof_coordinates()[: len(label)]
        arm = (points - centre[label]) / size[label, None]
        nodes = reduce_array(V.mesh.comm, np.bincount(label, minlength=number))
        return cls(int(number), tag_names, label, bounds, nodes, arm)

    @property
    def names(self) -> tuple[str, ...]:
        """Unique names: the name of the tag, with the body's number if bodies share the tag.

        A body without a tag name is named by its number.
        """
        count = Counter(self.tag_names)
        return tuple(
            name if name and count[name] == 1 else f"body {k}" + (f" ({name})" if name else "")
            for k, name in enumerate(self.tag_names, start=1)
        )

    @property
    def mean_nodes(self) -> float:
        """The mean number of nodes per body, weighted by this number: large bodies decide."""
        return float(self.nodes @ self.nodes / self.nodes.sum())

    def rigid_modes(self, dim: int) -> csr_array:
        """Return rigid body modes (owned degrees of freedom, 3 or 6 for each body), sparse.

        The translations along the axes and then the rotations about the centre of each body have
        the order of `rigid_modes.MODES`.

        Args:
            dim: the dimension of space.
        """
        translations = np.broadcast_to(np.eye(dim)[:, None], (dim, len(self.arm), dim))
        rotations = np.cross(np.eye(3)[2 * (3 - dim) :, None], self.arm)[:, :, :dim]
        modes = np.concatenate([translations, rotations])  # (mode, node, component)
        mode, node, component = np.nonzero(modes)
        entries = (node * dim + component, self.label[node] * len(modes) + mode)
        shape = (len(self.arm) * dim, self.number * len(modes))
        return csr_array((modes[mode, node, component], entries), shape=shape)

    def describe(self, index: int, companions: Sequence[int] = ()) -> str:
        """Return the number, the name and the bounding box of a body, in words.

        Args:
            index: the body.
            companions: bodies that move together with it, of which the text has the names.
        """
        box = self.bounds[index]
        size = float(np.linalg.norm(box[3:] - box[:3]))
        tags = [f" ({name})" if name else "" for name in self.tag_names]
        text = f"body {index + 1} of {self.number}{tags[index]}, between "
        text += f"{_point(box[:3], size)} and {_point(box[3:], size)}"
        if companions:
            names = ", ".join(f"{k + 1}{tags[k]}" for k in companions[:MOST_COMPANIONS])
            more = len(companions) - MOST_COMPANIONS
            text += f", together with {'bodies' if len(companions) > 1 else 'body'} {names}"
            text += f" and {more} more" * (more > 0)
        return text


def _tag_names(
    V: Any, body: npt.NDArray[np.int64], number: int, cell_tags: NamedTags | None
) -> tuple[str, ...]:
    """Return for each body the name of the tag that all its cells have, else "". Collective.

    Args:
        V: the space of the displacement.
        body: the body of each node of V on this rank, with ghosts.
        number: number of bodies.
        cell_tags: tags of cells with names.
    """
    if cell_tags is None:
        return ("",) * number
    body_of_cell = body[V.dofmap.list[:, 0]]
    tag = np.full(len(body_of_cell), np.iinfo(np.int32).max, dtype=np.int64)
    tag[cell_tags.indices] = cell_tags.values
    bounds = np.full((number, 2), np.iinfo(np.int64).max)
    np.minimum.at(bounds, body_of_cell, np.column_stack([tag, -tag]))
    return tuple(
        cell_tags.names.get(int(least), "") if least == -negated else ""
        for least, negated in reduce_array(V.mesh.comm, bounds, MPI.MIN)
    )


def _point(x: Array, size: float) -> str:
    """Return coordinates as text; rounding errors relative to a body's size become zero."""
    shown = np.where(np.abs(x) > 1e-12 * size, x, 0.0)
    return "(" + ", ".join(f"{value:.3g}" for value in shown) + ")"
