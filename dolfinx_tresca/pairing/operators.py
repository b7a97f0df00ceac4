"""The operators N and T of a pair: what every pairing produces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import diags_array, vstack

IntArray = npt.NDArray[np.int32]
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class PairOperators:
    """One pair's jump operators at the contact nodes that this rank owns.

    N u and T u are displacement jumps [length], secondary minus primary. A node has no row for a
    direction in which its own displacement is prescribed.

    Attributes:
        nodes: (n,) contact nodes: their numbers (blocks of V) on this rank.
        weights: (n,) their areas [length^2].
        normals: (n, 3) outward unit normals of the secondary side.
        gap: (n,) initial distance along the normal [length], positive: open.
        N: (n_normal, dofs of V) sparse, with global column numbers.
        normal_node: (n_normal,) the position in `nodes` of each row of N.
        T: (n_tangential, dofs of V) sparse.
        tangents: (n_tangential, 3) the direction of each row of T.
        tangent_node: (n_tangential,) the position in `nodes` of each row of T.
    """

    nodes: IntArray
    weights: FloatArray
    normals: FloatArray
    gap: FloatArray
    N: Any
    normal_node: IntArray
    T: Any
    tangents: FloatArray
    tangent_node: IntArray

    @property
    def row_node(self) -> IntArray:
        """The position in `nodes` of each row of (N; T)."""
        return np.concatenate([self.normal_node, self.tangent_node])


def assemble_B(V: Any, pairs: Sequence[PairOperators]) -> PETSc.Mat:
    """Return B, the rows N and T of each pair after the other's, times sqrt(weight). Collective.

    With these weights the multipliers are stress times sqrt(area): their Euclidean norm is the L2
    norm of the stress on the surface, and nothing depends on the fineness of the mesh.
    """
    dofs = V.dofmap.index_map
    blocks = [
        diags_array(np.sqrt(pair.weights[pair.row_node])) @ vstack([pair.N, pair.T])
        for pair in pairs
    ]
    rows = vstack(blocks, format="csr")
    B = PETSc.Mat().createAIJ(
        ((rows.shape[0], None), (3 * dofs.size_local, 3 * dofs.size_global)),
        csr=(rows.indptr.astype(PETSc.IntType), rows.indices.astype(PETSc.IntType), rows.data),
        comm=V.mesh.comm,
    )
    B.assemble()
    return B
