"""The bodies (connected parts) of a mesh, with numbers that do not depend on the partition."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from dolfinx import la

from dolfinx_tresca._base.arrays import ROUNDING, Array
from dolfinx_tresca._base.compat import geometry_dofmap
from dolfinx_tresca._base.parallel import gather_rows, reduce_array


def label_bodies(V: Any) -> npt.NDArray[np.int64]:
    """Return the body, 0, 1, ..., of each node of V on this rank, ghosts included. Collective.

    On any number of ranks, bodies are sorted by their least x, then y, then z, then by their
    largest x, y and z, up to rounding, and finally by their order in the mesh file.
    """
    comm, nodes, cells = V.mesh.comm, V.dofmap.index_map, V.dofmap.list
    node_count = nodes.size_local + nodes.num_ghosts
    # a graph of nodes and cells, since a graph of nodes alone would have many times the edges
    cell = np.repeat(np.arange(node_count, node_count + len(cells)), cells.shape[1])
    shape = (node_count + len(cells),) * 2
    graph = coo_array((np.ones(cells.size, np.int8), (cells.ravel(), cell)), shape=shape)
    fragment = connected_components(graph, directed=False)[1][:node_count]

    # Fragments on two ranks belong to one body if a node of one is a ghost in the other. They get
    # numbers over all ranks; `label` is the number of a node's fragment on the rank that owns it.
    counts = comm.allgather(int(fragment.max(initial=-1)) + 1)
    fragment = fragment + sum(counts[: comm.rank])
    label = la.vector(nodes, 1, np.float64)
    label.array[:] = fragment
    label.scatter_forward()
    links = np.unique(np.column_stack([fragment, label.array.astype(int)]), axis=0)
    links, total = gather_rows(comm, links), sum(counts)
    graph = csr_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(total, total))
    count, body_of_fragment = connected_components(graph, directed=False)
    body = body_of_fragment[fragment]
    return np.asarray(_final_numbers(V, body, count)[body])


def couples_bodies(K: Any, body: npt.NDArray[np.int64]) -> bool:
    """Return whether the matrix K couples bodies, as springs between them do. Collective.

    `body` (n,) is the body of each of this rank's rows. Without coupling, K D x = D K x for any x,
    where D multiplies each body by a power of 2: to the last bit. Powers repeat from body 1,000.
    """
    D, (x, y) = np.exp2(body % 1000 - 500), K.createVecs()
    x.array = values = np.random.default_rng(0).uniform(0.5, 1.0, len(body))
    K.mult(x, y)
    expected, x.array = D * y.array, D * values
    K.mult(x, y)
    differs = np.abs(y.array - expected) > ROUNDING * np.abs(expected)
    return bool(K.comm.tompi4py().allreduce(bool(differs.any()), op=MPI.LOR))


def _final_numbers(V: Any, body: npt.NDArray[Any], count: int) -> npt.NDArray[np.int64]:
    """Return the number (count,) of each body in the order of `label_bodies`. Collective.

    `body` (nodes,) is a preliminary number of the body of each node on this rank, with ghosts.
    """
    # the box of each body, and the least number of its nodes in the mesh file
    comm, geometry = V.mesh.comm, V.mesh.geometry
    bounds = _extremes(comm, body, count, V.tabulate_dof_coordinates())
    in_file = np.asarray(geometry.input_global_indices)[geometry_dofmap(V.mesh)]
    body_of_cell = body[V.dofmap.list[: len(in_file), 0]]
    least = _extremes(comm, body_of_cell, count, in_file.min(axis=1, keepdims=True))[:, 0]
    # coordinates as levels 0, 1, ...: those that are equal up to rounding have the same level
    levels, rounding = np.empty(bounds.shape), 1e-10 * np.abs(bounds).max(initial=0.0)
    for level, values in zip(levels.T, bounds.T, strict=True):
        ascending = np.argsort(values)
        steps = np.diff(values[ascending], prepend=values[ascending[:1]])
        level[ascending] = np.cumsum(steps > rounding)
    # the last key of lexsort counts first; argsort inverts the order
    return np.asarray(np.argsort(np.lexsort([least, *levels.T[::-1]])))


def _extremes(comm: MPI.Comm, body: npt.NDArray[Any], count: int, values: Array) -> Array:
    """Return for each body the least of each column of values, then the largest: (count, 2 k).

    The rows of the values (n, k) belong to `body` (n,); without rows: inf, then -inf. Collective.
    """
    k = values.shape[1]
    ranges: Array = np.full((count, 2 * k), np.inf)
    np.minimum.at(ranges, body, np.hstack([values, -values]))
    ranges = reduce_array(comm, ranges, MPI.MIN)
    ranges[:, k:] *= -1.0
    return ranges


@dataclass(frozen=True)
class Bodies:
    """The bodies of a mesh, `count` in number.

    Attributes:
        tag_names: for each body the name of the tag that all its cells have; "" if there is none.
        label: (owned nodes of V,) the body of each node, from 0 to count - 1.
        bounds: (count, 6) bounding box of each body: least x, y, z, then largest [length].
        node_counts: (count,) number of nodes of V in each body.
        arm: (owned nodes of V, 3) coordinates from the centre of the bounding box of the node's
            body, divided by the length of the box's diagonal [1], as arms of rotations.
    """

    count: int
    tag_names: tuple[str, ...]
    label: npt.NDArray[np.int64]
    bounds: Array
    node_counts: npt.NDArray[np.int64]
    arm: Array

    @classmethod
    def from_labels(cls, V: Any, label: npt.NDArray[np.int64], cell_tags: Any = None) -> Bodies:
        """Measure the bodies of `label_bodies(V)`; `NamedTags` of cells name them. Collective."""
        count = V.mesh.comm.allreduce(int(label.max(initial=-1)), op=MPI.MAX) + 1
        bounds = _extremes(V.mesh.comm, label, count, V.tabulate_dof_coordinates())
        tag_names = _tag_names(V, label, count, cell_tags)
        label = label[: V.dofmap.index_map.size_local]
        centre = 0.5 * (bounds[:, :3] + bounds[:, 3:])
        diagonal = np.linalg.norm(bounds[:, 3:] - bounds[:, :3], axis=1)
        # scaled coordinates, for rotations of each body
        arm = (V.tabulate_dof_coordinates()[: len(label)] - centre[label]) / diagonal[label, None]
        node_counts = reduce_array(V.mesh.comm, np.bincount(label, minlength=count))
        return cls(int(count), tag_names, label, bounds, node_counts, arm)

    @property
    def names(self) -> tuple[str, ...]:
        """Unique names: that of the tag; without it "body 2"; "body 2 (tag)" if bodies share it."""
        holders = Counter(self.tag_names)
        return tuple(
            name if name and holders[name] == 1 else f"body {k}" + (f" ({name})" if name else "")
            for k, name in enumerate(self.tag_names, start=1)
        )

    def rigid_modes(self, dim: int) -> csr_array:
        """Return rigid body modes (owned degrees of freedom, 3 or 6 for each body), sparse.

        Each body has translations by 1 along the axes, and then rotations about the centre of its
        box by the small angle 1 / (diagonal of the box), about the axes, in 2D about z.
        """
        translations = np.broadcast_to(np.eye(dim)[:, None], (dim, len(self.arm), dim))
        rotations = np.cross(np.eye(3)[2 * (3 - dim) :, None], self.arm)[:, :, :dim]
        modes = np.concatenate([translations, rotations])  # (mode, node, component)
        mode, node, component = np.nonzero(modes)
        entries = (node * dim + component, self.label[node] * len(modes) + mode)
        shape = (len(self.arm) * dim, self.count * len(modes))
        return csr_array((modes[mode, node, component], entries), shape=shape)

    def describe(self, index: int, companions: Sequence[int] = ()) -> str:
        """Return a text with number, name and box of a body, and with bodies that move with it."""
        box = self.bounds[index]
        diagonal = float(np.linalg.norm(box[3:] - box[:3]))
        tags = [f" ({name})" if name else "" for name in self.tag_names]
        text = f"body {index + 1} of {self.count}{tags[index]}, between "
        text += f"{_point(box[:3], diagonal)} and {_point(box[3:], diagonal)}"
        if companions:
            named = companions[:6]  # a wall of bricks has many
            names = ", ".join(f"{k + 1}{tags[k]}" for k in named)
            text += f", together with {'bodies' if len(companions) > 1 else 'body'} {names}"
            text += f" and {len(companions) - 6} more" * (len(companions) > 6)
        return text


def _tag_names(V: Any, body: npt.NDArray[np.int64], count: int, cell_tags: Any) -> tuple[str, ...]:
    """Return for each body the name of the tag that all its cells have, else "". Collective."""
    if cell_tags is None:
        return ("",) * count
    # the least and the largest tag of a body's cells differ if they have several, or none
    body_of_cell = body[V.dofmap.list[:, 0]]
    tag = np.full((len(body_of_cell), 1), np.inf)
    tag[cell_tags.indices, 0] = cell_tags.values
    return tuple(
        cell_tags.names.get(least, "") if least == largest else ""
        for least, largest in _extremes(V.mesh.comm, body_of_cell, count, tag)
    )


def _point(x: Array, diagonal: float) -> str:
    """Return coordinates as text; rounding errors relative to a body's diagonal become zero."""
    shown = np.where(np.abs(x) > 1e-12 * diagonal, x, 0.0)
    return "(" + ", ".join(f"{value:.3g}" for value in shown) + ")"
