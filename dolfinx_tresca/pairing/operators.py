"""The operators N and T of a pair, and B, the rows of all pairs, for the solvers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array, vstack

from dolfinx_tresca._base.arrays import Array, LocalNumbers, Mask, scaled_rows
from dolfinx_tresca._base.petsc import as_petsc
from dolfinx_tresca.pairing.undeformed import Undeformed

#: Attributes of `PairOperators` with a row for each node.
NODE_ARRAYS = (
    *("nodes", "weights", "shares", "areas", "places", "normals", "distance", "added_gap"),
    *("secondary_sagitta", "jump", "primary", "prescribed", "has_normal_row"),
)
#: Attributes of `PairOperators` with a row for each row of T.
TANGENTIAL_ARRAYS = ("tangents", "tangent_node", "semi_axes")


@dataclass(frozen=True)
class PairOperators:
    """The jump operators of one pair at the contact nodes that this rank owns.

    N u and T u are jumps of the displacement [length], secondary minus primary; d is the dimension
    of space. A node whose displacement is prescribed along its normal has no row of N. Its row of T
    stays if it is prescribed along a tangent, as do rows of N on an edge with several patches that
    face the same place; they act on the primary body alone. There are none for an obstacle, for
    `Bonded`, or if an opposite primary node is prescribed.

    Attributes:
        bonded: whether the jumps are constrained to zero and multipliers have any sign.
        nodes: (n,) local numbers of the contact nodes (blocks of V), repeated at sharp edges.
        weights: (n,) covered area of each node [length^2, in 2D length].
        shares: (n, pairs) part of the covered area that belongs to each pair of the group.
        areas: (n,) whole area of each node, covered or not [length^2, in 2D length].
        places: (n, d) points where the nodal forces act on the secondary side [length].
        normals: (n, d) unit contact normals, out of the secondary side.
        distance: (n,) initial distance of the surfaces along the normal [length], positive if open,
            and zero within rounding, or where surfaces are bonded.
        added_gap: (n,) present value of `ContactPair.gap` at each node [length], 0 after pairing.
        secondary_sagitta: (n,) height of the curved secondary surface over its straight facets,
            by which it reduces `distance` [length]; zero for degree 1.
        jump: (n, nodes of V) sparse matrix of the jump, the weighted means over the secondary side
            minus those over the primary side, with global column numbers.
        primary: (n, nodes of V) sparse matrix of means over the primary side; empty for obstacles.
        prescribed: (n,) whether the displacement of the node is prescribed along the normal.
        has_normal_row: (n,) whether N has a row for the node.
        tangents: (n_tangential, d) unit vector along each row of T; none if there is no friction.
        tangent_node: (n_tangential,) index in `nodes` of each row of T.
        semi_axes: (n_tangential,) slip bound along each row of T, relative to the node's largest.
        undeformed: the undeformed surfaces, which are displaced for each later pairing.
    """

    bonded: bool
    nodes: LocalNumbers
    weights: Array
    shares: Array
    areas: Array
    places: Array
    normals: Array
    distance: Array
    added_gap: Array
    secondary_sagitta: Array
    jump: Any
    primary: Any
    prescribed: Mask
    has_normal_row: Mask
    tangents: Array
    tangent_node: LocalNumbers
    semi_axes: Array
    undeformed: Undeformed

    def at_nodes(self, keep: Mask) -> PairOperators:
        """Return the operators at the nodes in a mask (n,), such as those that a pair owns."""
        if keep.all():
            return self
        rows, number = keep[self.tangent_node], np.cumsum(keep, dtype=np.int32) - 1
        changes: dict[str, Any] = {name: getattr(self, name)[keep] for name in NODE_ARRAYS}
        changes |= {name: getattr(self, name)[rows] for name in TANGENTIAL_ARRAYS}
        changes["tangent_node"] = number[changes["tangent_node"]]
        return replace(self, **changes)

    @cached_property
    def normal_node(self) -> LocalNumbers:
        """The index (n_normal,) in `nodes` of each row of N."""
        return np.flatnonzero(self.has_normal_row).astype(np.int32)

    @cached_property
    def N(self) -> Any:
        """Sparse matrix (n_normal, dofs of V) of normal jumps, with global column numbers."""
        return _directional_rows(self.jump, self.normal_node, self.normals[self.normal_node])

    @cached_property
    def T(self) -> Any:
        """Sparse matrix (n_tangential, dofs of V) of the jumps along `tangents`."""
        return _directional_rows(self.jump, self.tangent_node, self.tangents)

    @property
    def secondary(self) -> Any:
        """Sparse matrix (n, nodes of V) of the weighted means over the secondary side."""
        return self.jump + self.primary

    @property
    def gap(self) -> Array:
        """(n,) initial gap along the normal [length], positive if open."""
        return self.distance + self.added_gap

    @property
    def sizes(self) -> Array:
        """(n,) linear size of each node's whole area [length]; for a ring its width."""
        if not self.undeformed.sides[0].axisymmetric:
            return np.asarray(self.areas ** (1.0 / (self.normals.shape[1] - 1)))
        radii = np.maximum(self.places[:, 0], np.sqrt(self.areas / np.pi))  # at the axis: a disc
        return np.asarray(self.areas / (2.0 * np.pi * radii))

    @property
    def row_node(self) -> LocalNumbers:
        """The index (n_normal + n_tangential,) in `nodes` of each row of N, then of T."""
        return np.concatenate([self.normal_node, self.tangent_node])

    def nodal_vectors(self, normal: Array, tangential: Array) -> Array:
        """Return normal component and tangential vector (n, 1 + d) from values of rows of N and T.

        Each is 0 at nodes without rows of N or T. Values are (n_normal,) and (n_tangential,).
        """
        result = np.pad(np.zeros_like(self.normals), ((0, 0), (1, 0)))
        result[self.normal_node, 0] = normal
        np.add.at(result[:, 1:], self.tangent_node, tangential[:, None] * self.tangents)
        return result


def joined(operators: Sequence[PairOperators]) -> PairOperators:
    """Join operators of pairs of a group at the nodes that act on one pair (`by_pair`)."""
    changes: dict[str, Any] = {}
    for name in (*NODE_ARRAYS, *TANGENTIAL_ARRAYS):
        arrays = [getattr(pair, name) for pair in operators]
        is_sparse = name in ("jump", "primary")
        changes[name] = vstack(arrays, format="csr") if is_sparse else np.concatenate(arrays)
    starts = np.cumsum([0, *(len(pair.nodes) for pair in operators[:-1])], dtype=np.int32)
    changes["tangent_node"] += np.repeat(starts, [len(pair.tangents) for pair in operators])
    return replace(operators[0], bonded=all(pair.bonded for pair in operators), **changes)


def _directional_rows(jump: Any, rows: LocalNumbers, directions: Array) -> Any:
    """Return `rows` (n,) of a jump (nodes, nodes of V) along unit vectors (n, d): sparse (n, dofs).

    Each entry becomes d entries, in the columns of its node's components.
    """
    dim, of_rows = directions.shape[1], jump[rows]
    values = np.repeat(directions, np.diff(of_rows.indptr), axis=0) * of_rows.data[:, None]
    columns = of_rows.indices.astype(np.int64)[:, None] * dim + np.arange(dim)
    shape = len(rows), dim * jump.shape[1]
    result = csr_array((values.ravel(), columns.ravel(), dim * of_rows.indptr), shape)
    result.eliminate_zeros()  # no columns for directions normal to an axis
    return result


def assemble_B(V: Any, pairs: Sequence[PairOperators]) -> PETSc.Mat:
    """Assemble B: the rows of N and T of all pairs, times sqrt(weight). Collective.

    The multipliers are stress times sqrt(area): their Euclidean norm is the L2 norm of the stress.
    """
    blocks = [
        scaled_rows(vstack([pair.N, pair.T], format="csr"), np.sqrt(pair.weights[pair.row_node]))
        for pair in pairs
    ]
    return as_petsc(V.dofmap.index_map, V.dofmap.index_map_bs, blocks, V.mesh.comm)
