"""Several bodies in one mesh, with tags on single faces or on all facets, as users may tag them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from mpi4py import MPI

import numpy as np

import basix.ufl
import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca import ContactPair
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.pairing.pair_surfaces import pair_surfaces
from scenes.patches import block

#: Functions of points (n, dim): `Where` selects some, (n,) bool; `Map` moves them, (n, dim).
Where: TypeAlias = Callable[[np.ndarray], np.ndarray]
Map: TypeAlias = Callable[[np.ndarray], np.ndarray]


def near(axis: int, value: float) -> Where:
    """Return a function that selects the points that have a value as coordinate."""
    return lambda x: np.isclose(x[:, axis], value, rtol=1e-9, atol=1e-9)


@dataclass(frozen=True)
class Body:
    """A box of cells, from which cells may be left out, and whose points may be moved.

    Attributes:
        divisions: number of cells along each axis but the last, and along the last axis.
        box: start and end along each axis.
        keep: selects the cells of the body by their midpoints; None: all.
        move: moves the points of the box to those of the body; None: not at all.
    """

    divisions: tuple[int, int]
    box: Sequence[tuple[float, float]]
    keep: Where | None = None
    move: Map | None = None


@dataclass(frozen=True)
class Boxes:
    """Bodies in one mesh.

    Attributes:
        mesh: mesh of all bodies.
        V: space of the displacement.
        facets: (n,) exterior facets of this rank.
        body: (n,) index of the body of each facet.
        middles: (n, dim) midpoints of the facets before bodies are moved.
    """

    mesh: Any
    V: Any
    facets: np.ndarray
    body: np.ndarray
    middles: np.ndarray

    def tags(self, *marks: tuple[int, Sequence[int], Where | None]) -> Any:
        """Return facet tags. A mark is a tag, bodies, and a selection by midpoints (None: all)."""
        values = np.zeros(len(self.facets), dtype=np.int32)
        for tag, bodies, where in marks:
            some = np.isin(self.body, bodies)
            values[some if where is None else some & where(self.middles)] = tag
        some = values > 0
        return dolfinx.mesh.meshtags(
            self.mesh, self.mesh.topology.dim - 1, self.facets[some], values[some]
        )

    def operators(self, pair: ContactPair) -> PairOperators:
        """Return N, T and the gap of a pair, without prescribed degrees of freedom."""
        owned = self.V.dofmap.index_map.size_local * self.V.dofmap.index_map_bs
        return pair_surfaces(self.V, np.zeros(owned, dtype=np.bool_), pair)


def boxes(
    comm: MPI.Comm,
    kind: str,
    bodies: Sequence[Body],
    degree: int = 1,
    *,
    turn: np.ndarray | None = None,
) -> Boxes:
    """Return bodies in one mesh; `turn` is a rotation (dim, dim) of the whole mesh. Collective."""
    dim = len(bodies[0].box)
    points, cells, sizes, first = [], [], [], 0
    moved = []
    for seed, body in enumerate(bodies):
        x, connected = block(kind, body.divisions, body.box, 0.0, seed)
        if body.keep is not None:
            connected = connected[body.keep(x[connected].mean(axis=1))]
        shape = connected.shape
        used, connected = np.unique(connected, return_inverse=True)
        x = x[used]
        cells.append(connected.reshape(shape) + first)
        after = x if body.move is None else body.move(x)
        # merge the nodes of a body that is bent round until its ends meet
        _, unique, merged = np.unique(
            np.round(after, 9) + 0.0, axis=0, return_index=True, return_inverse=True
        )
        cells[-1] = merged.ravel()[cells[-1] - first] + first
        points.append(x[unique])
        moved.append(after[unique])
        sizes.append(len(cells[-1]))
        first += len(unique)
    R = np.eye(dim) if turn is None else turn
    before, after = np.concatenate(points), np.concatenate(moved) @ R.T
    some = slice(None) if comm.rank == 0 else slice(0)
    element = basix.ufl.element("Lagrange", kind, 1, shape=(dim,))
    mesh = dolfinx.mesh.create_mesh(
        comm=comm, cells=np.concatenate(cells).astype(np.int64)[some], x=after[some],
        e=ufl.Mesh(element),
    )  # fmt: skip
    mesh.topology.create_connectivity(dim - 1, dim)
    facets = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    to_cell = mesh.topology.connectivity(dim - 1, dim)
    cell = to_cell.array[to_cell.offsets[facets]]
    number = np.asarray(mesh.topology.original_cell_index)[cell]
    body_of = np.searchsorted(np.cumsum(sizes), number, side="right")
    x = mesh.geometry.x
    held = x[:, :dim].copy()
    x[:, :dim] = before[np.asarray(mesh.geometry.input_global_indices)]
    middles = dolfinx.mesh.compute_midpoints(mesh, dim - 1, facets)[:, :dim]
    x[:, :dim] = held
    V = fem.functionspace(mesh, ("Lagrange", degree, (dim,)))
    return Boxes(mesh, V, facets, body_of.astype(int), middles)


def same(comm: MPI.Comm, one: PairOperators, other: PairOperators, tolerance: float) -> None:
    """Check that two pairs couple the same nodes with the same weights, gaps and rows."""
    assert comm.allreduce(len(one.nodes)) == comm.allreduce(len(other.nodes)) > 0
    assert np.array_equal(one.nodes, other.nodes)
    size = comm.allreduce(one.weights.max(initial=0.0), op=MPI.MAX)
    assert np.allclose(one.weights, other.weights, rtol=0.0, atol=tolerance * size)
    assert np.allclose(one.normals, other.normals, atol=tolerance)
    assert np.allclose(one.gap, other.gap, atol=tolerance)
    assert one.N.shape == other.N.shape and one.T.shape == other.T.shape
    # the tangents may be turned in their plane
    for difference in (one.N - other.N, one.T.T @ one.T - other.T.T @ other.T):
        assert np.abs(difference.tocsr().data).max(initial=0.0) <= tolerance
