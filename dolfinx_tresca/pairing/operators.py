"""The operators N and T of a pair: what every pairing produces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array, diags_array, vstack

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, LocalNumbers, Mask
from dolfinx_tresca.pairing.coupling import Coupling
from dolfinx_tresca.scene.friction import Bonded, Friction, Frictionless
from dolfinx_tresca.surface.facets import Facets
from dolfinx_tresca.surface.nodes import FREE_PART, SurfaceNodes, tangents
from dolfinx_tresca.surface.whole import WholeSurface

#: Gap over the largest coordinate of the surface that is rounding of the coordinates.
GAP_ROUNDING = 64 * float(np.finfo(float).eps)


@dataclass(frozen=True)
class PairOperators:
    """One pair's jump operators at the contact nodes that this rank owns.

    N u and T u are displacement jumps [length], secondary minus primary; d is the dimension of
    space. A node whose own displacement is prescribed along its normal has no row of N. Where it is
    prescribed along the surface, friction acts on the primary side alone: the row of T stays,
    except where a primary node opposite is held as well, before an obstacle, and with `Bonded`.

    Attributes:
        pairing: how the surfaces were paired, for people.
        bonded: whether the jumps are zero, with nothing to say about the sign of multipliers.
        nodes: (n,) contact nodes: their numbers (blocks of V) on this rank.
        weights: (n,) the part of their areas that is in contact [length^2, in 2D length].
        areas: (n,) all of it.
        places: (n, d) where their forces act on the secondary side, as a whole [length].
        normals: (n, d) outward unit normals of the secondary side.
        gap: (n,) initial distance along the normal [length], positive: open; zero where that is
            rounding, so that what nothing loads stays at rest.
        raised: (n,) what it is less by for the height of a curved surface over straight edges.
        secondary: (n, nodes of V) sparse, with global column numbers: the mean of what the
            secondary side has round the nodes, weighed as in N and T.
        primary: (n, nodes of V) the same of the primary side before the nodes; empty before an
            obstacle.
        N: (n_normal, dofs of V) sparse, with global column numbers.
        normal_node: (n_normal,) the position in `nodes` of each row of N.
        T: (n_tangential, dofs of V) sparse; without rows where nothing rubs.
        tangents: (n_tangential, d) the direction of each row of T.
        tangent_node: (n_tangential,) the position in `nodes` of each row of T.
        semi_axes: (n_tangential,) the bound along each row of T over the largest one of its node:
            1 for circles.
    """

    pairing: str
    bonded: bool
    nodes: LocalNumbers
    weights: Array
    areas: Array
    places: Array
    normals: Array
    gap: Array
    raised: Array
    secondary: Any
    primary: Any
    N: Any
    normal_node: LocalNumbers
    T: Any
    tangents: Array
    tangent_node: LocalNumbers
    semi_axes: Array

    @classmethod
    def of(
        cls,
        V: Any,
        coupling: Coupling,
        nodes: SurfaceNodes,
        whole: WholeSurface,
        friction: Friction,
        primary: Facets | None = None,
    ) -> PairOperators:
        """Choose directions along which nodes can move, and as many as the friction needs.

        Not collective.

        Args:
            V: the space.
            coupling: the jumps.
            nodes: of the secondary side.
            whole: the secondary side as all ranks have it.
            friction: the law.
            primary: facets of the primary side; None before an obstacle.
        """
        dim = V.mesh.geometry.dim
        free = nodes.free[coupling.position]
        normals = coupling.normals[:, :dim]
        moves = np.linalg.norm(normals * free, axis=1) > FREE_PART
        numbers = nodes.numbers[coupling.position]
        rubs = free
        if primary is not None and not isinstance(friction, Bonded):
            rubs = free | _primary_moves(coupling.primary, primary)
        room = _room_beside_normals(numbers, normals, rubs, moves)
        normal_node = np.flatnonzero(moves).astype(np.int32)
        frame = (
            whole.reference_points[None, :, :dim] - nodes.points[coupling.position][:, None, :dim]
        )
        along, tangent_node = _free_tangents(normals, frame, room)
        if isinstance(friction, Frictionless):
            along, tangent_node = along[:0], tangent_node[:0]
        bonded = isinstance(friction, Bonded)
        gap = np.einsum("ni,ni->n", coupling.gap_vector[:, :dim], normals)
        gap[np.abs(gap) <= GAP_ROUNDING * whole.largest_coordinate] = 0.0
        first = V.dofmap.index_map.local_range[0]
        return cls(
            pairing=coupling.pairing,
            bonded=bonded,
            nodes=(numbers - first).astype(np.int32),
            weights=coupling.weights,
            areas=nodes.weights[coupling.position],
            places=coupling.place[:, :dim],
            normals=normals,
            gap=np.zeros_like(gap) if bonded else gap,
            raised=coupling.raised,
            secondary=coupling.jump + coupling.primary,
            primary=coupling.primary,
            N=_directed(coupling.jump[normal_node], normals[normal_node]),
            normal_node=normal_node,
            T=_directed(coupling.jump[tangent_node], along),
            tangents=along,
            tangent_node=tangent_node,
            semi_axes=np.ones(len(tangent_node)),
        )

    @property
    def row_node(self) -> LocalNumbers:
        """The position in `nodes` of each row of (N; T)."""
        return np.concatenate([self.normal_node, self.tangent_node])

    def tangential_vectors(self, values: Array) -> Array:
        """Return the vectors (n, d) of nodes with components (n_tangential,) along `tangents`."""
        result = np.zeros_like(self.normals)
        np.add.at(result, self.tangent_node, values[:, None] * self.tangents)
        return result


def _primary_moves(primary: Any, facets: Facets) -> Mask:
    """Return the directions (n, dim of space) that no primary node before a node is held along.

    Args:
        primary: (n, nodes of V) sparse, the mean of the primary side before each node.
        facets: of the primary side.
    """
    columns, row = primary.indices, np.repeat(np.arange(primary.shape[0]), np.diff(primary.indptr))
    result = np.repeat((np.diff(primary.indptr) > 0)[:, None], facets.free.shape[2], axis=1)
    for axis in range(facets.free.shape[2]):
        held = facets.nodes[:, : facets.corners][~facets.free[:, :, axis]]
        result[row[np.isin(columns, held)], axis] = False
    return result


def _directed(jump: Any, directions: Array) -> Any:
    """Return the rows (n, nodes) of a scalar jump, each along its direction: (n, dofs)."""
    dim = directions.shape[1]
    counts = np.diff(jump.indptr)
    columns = jump.indices.astype(np.int64)[:, None] * dim + np.arange(dim)
    values = jump.data[:, None] * np.repeat(directions, counts, axis=0)
    return csr_array(
        (values.ravel(), columns.ravel(), jump.indptr.astype(np.int64) * dim),
        shape=(jump.shape[0], jump.shape[1] * dim),
    )


def _room_beside_normals(
    numbers: GlobalNumbers,
    normals: Array,
    free: Mask,
    moves: Mask,
) -> Array:
    """Return projections (n, d, d) on the directions that are left for tangential rows.

    Where several smooth patches in contact meet in a node, each has a row for its normal. Their
    rows must not depend on each other: a further normal needs a direction of its own, else `moves`
    (n,) is cleared, and friction acts along what all patches have in common, on the largest one.
    """
    room = free[:, :, None] * np.eye(free.shape[1])
    _, first, count = np.unique(numbers, return_index=True, return_counts=True)
    for start, end in zip(first[count > 1], (first + count)[count > 1], strict=True):
        left = room[end - 1].copy()
        for i in range(end - 1, start - 1, -1):
            own = left @ normals[i]
            length = np.linalg.norm(own)
            moves[i] = length > FREE_PART
            if moves[i]:
                left -= np.outer(own, own) / length**2
            room[i] = 0.0
        room[end - 1] = left
    return room


def _free_tangents(normals: Array, frame: Array, room: Array) -> tuple[Array, LocalNumbers]:
    """Return the tangents (n_tangential, d) along which nodes can move, and the node of each.

    Args:
        normals: (n, d).
        frame: (n, 2, d) see `tangents`.
        room: (n, d, d) projections on the directions that nodes have.
    """
    along = tangents(normals, frame)
    some = np.flatnonzero((room != np.eye(normals.shape[1])).any(axis=(1, 2)))
    keep = np.ones(along.shape[:2], dtype=np.bool_)
    # where not all directions are left, turn the tangents into and out of those
    mobility = np.einsum("nai,nij,nbj->nab", along[some], room[some], along[some])
    values, vectors = np.linalg.eigh(mobility)
    along[some] = np.einsum("nba,nbi->nai", vectors, along[some])
    keep[some] = values > FREE_PART
    return along[keep], np.nonzero(keep)[0].astype(np.int32)


def assemble_B(V: Any, pairs: Sequence[PairOperators]) -> PETSc.Mat:
    """Return B, the rows N and T of each pair after the other's, times sqrt(weight). Collective.

    With these weights the multipliers are stress times sqrt(area): their Euclidean norm is the L2
    norm of the stress on the surface, and nothing depends on the fineness of the mesh.
    """
    blocks = [
        diags_array(np.sqrt(pair.weights[pair.row_node])) @ vstack([pair.N, pair.T])
        for pair in pairs
    ]
    return as_petsc(V.dofmap.index_map, V.dofmap.index_map_bs, blocks, V.mesh.comm)


def as_petsc(index_map: Any, block_size: int, blocks: Sequence[Any], comm: Any) -> PETSc.Mat:
    """Return sparse rows of this rank, with global column numbers, as a matrix. Collective.

    Args:
        index_map: of the columns.
        block_size: columns at each index.
        blocks: of rows, one after the other's.
        comm: the ranks.
    """
    rows = vstack(blocks, format="csr")
    matrix = PETSc.Mat().createAIJ(
        (
            (rows.shape[0], None),
            (block_size * index_map.size_local, block_size * index_map.size_global),
        ),
        csr=(rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data),
        comm=comm,
    )
    matrix.assemble()
    return matrix


def multiplier_slices(pairs: Sequence[PairOperators]) -> list[tuple[slice, slice]]:
    """Return the rows of B, on this rank, that hold each pair's N and T."""
    result, first = [], 0
    for pair in pairs:
        middle = first + len(pair.normal_node)
        last = middle + len(pair.tangent_node)
        result.append((slice(first, middle), slice(middle, last)))
        first = last
    return result
