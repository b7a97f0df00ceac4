"""Sums over ranks, systems of equations with models of A, and sparse factors. Numpy only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.sparse import block_diag, csc_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca.solvers.feasible_set import Face, FeasibleSet


class InnerProduct(Protocol):
    """The inner product of distributed vectors."""

    def inner(self, x: Array | csr_array, y: Array | csr_array) -> Array:
        """Return x'y over all ranks; x and y of shape (size,) or (size, k). Collective."""


class Reductions(InnerProduct, Protocol):
    """Sums over all ranks, and values on which all ranks agree. All methods are collective."""

    def total(self, x: Array) -> Array:
        """Return the sum of x over all ranks."""

    def sparse_inner(self, x: csr_array, y: csr_array) -> csr_array:
        """Return x'y over all ranks, equal on all ranks, for sparse x and y of shape (size, k)."""

    def stacked(self, rows: csr_array) -> csr_array:
        """Return the rows (size, k) of all ranks in the order of ranks, (n, k)."""

    def from_first_rank(self, x: Array) -> Array:
        """Return the first rank's x; on the other ranks, x may differ by rounding."""


def norm(space: InnerProduct, v: Array) -> float:
    """Return the Euclidean norm of v (size,) over all ranks. Collective."""
    return float(np.sqrt(space.inner(v, v)))


class NodalPattern:
    """The sparsity of a matrix that couples only multipliers of the same node."""

    def __init__(self, nodes: Indices) -> None:
        """Group multipliers.

        Args:
            nodes: (size,) the node of each multiplier.
        """
        size = len(nodes)
        index = np.unique(nodes, return_inverse=True)[1]
        member = csr_array((np.ones(size), (np.arange(size), index)), shape=(size, size))
        self._pattern = csr_array(member @ member.T)
        self._pattern.sort_indices()  # as operations with a matrix that shares its indices may do
        # multipliers of one node have different colours
        order = np.argsort(index, kind="stable")
        numbers = np.bincount(index)
        colour = np.empty(size, dtype=np.intp)
        colour[order] = np.arange(size) - (np.cumsum(numbers) - numbers)[index[order]]
        self._units = (colour[:, None] == np.arange(colour.max(initial=0) + 1)).astype(np.float64)
        row = np.repeat(np.arange(size), np.diff(self._pattern.indptr))
        self._entries = row, colour[self._pattern.indices]

    def matrix(self, nodal: Callable[[Array], Array]) -> csr_array:
        """Return the matrix (size, size) of a linear map of arrays (size, columns)."""
        pattern, values = self._pattern, nodal(self._units)[self._entries]
        return csr_array((values, pattern.indices, pattern.indptr), shape=pattern.shape, copy=True)


#: Least softness S of the equality constraints G'lambda + S c = e, times the compliance of the
#: multipliers. With this softness, the linear systems have a solution even if the constraints have
#: none.
LEAST_SOFTNESS = 1e-10


#: Largest stiffness C in `NodalMaps.on_face`, divided by the diagonal of the model: a larger one,
#: where a bound of friction is nearly zero, would hide the other equations of its node. With 1e150,
#: a slip bound of 1e-300 overflows.
STIFFEST = 1e8


@dataclass(frozen=True)
class NodalMaps:
    """The maps T and R in the equations T M s + R s - T G c = T r and G's + S c = e.

    Here M is the model of A, and G and S belong to equality constraints. Such equations determine
    Newton steps s on a face, and steps towards an adjoint solution. Each map couples only
    multipliers of the same node, and is applied to arrays (size,) or (size, columns).

    Attributes:
        test: T, applied to both sides of the equation.
        added: R, such as the curvature of the circles of slipping nodes, and the identity at
            multipliers that do not change.
        inverse: (T D + R)^-1 T with the diagonal D of the model.
    """

    test: Callable[[Array], Array]
    added: Callable[[Array], Array]
    inverse: Callable[[Array], Array]

    @classmethod
    def on_face(
        cls,
        cones: FeasibleSet,
        x: Array,
        face: Face,
        diagonal: Array,
        stiffness: Array,
    ) -> NodalMaps:
        """Return the maps for Newton steps s on a face. Not collective.

        With the projector P onto the face, the diagonal C of curvatures, the change Q of slip
        bounds with the pressure and their change H with the slip, s solves

            P (M s + C s - G c) = P r,  s - (I + Q) P s = H (r - M s + G c).

        Args:
            cones: the friction cones, with the functions Q and H.
            x: (size,) point on the face.
            face: the face.
            diagonal: (size,) D, the same for all degrees of freedom of a friction disc.
            stiffness: (size,) C >= 0, the same for all degrees of freedom of a disc.
        """
        stiffness = np.minimum(stiffness, STIFFEST * diagonal)
        project, weight = face.project, np.reciprocal(diagonal + stiffness)
        follow = cones.with_bound_change(x, face, diagonal)
        change = cones.with_bound_change(x, face, np.zeros_like(diagonal))

        def scaled(factors: Array, v: Array) -> Array:
            return np.asarray((factors * v.T).T)

        def added(v: Array) -> Array:
            along = project(v)
            return scaled(stiffness, along) + scaled(diagonal, v - change(along, np.zeros_like(v)))

        return cls(
            test=lambda v: project(v) + scaled(diagonal, change(np.zeros_like(v), v)),
            added=added,
            inverse=lambda v: follow(scaled(weight, project(v)), v),
        )


def solve_or_fit(matrix: Array, right: Array) -> Array:
    """Return the solution; for a singular matrix, the least-squares solution of least norm."""
    try:
        return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(matrix, right)[0], dtype=np.float64)


def eigenpairs(matrix: csr_array) -> tuple[Array, csr_array]:
    """Return eigenvalues (k,) and eigenvectors (k, k) of a symmetric matrix.

    Rows that nonzero entries connect, directly or through other rows, are treated as one dense
    block: the cost grows with the sum of the cubes of the blocks' sizes. Eigenpair number j belongs
    to the block of row j; the eigenvalues of a block ascend.

    Args:
        matrix: (k, k) symmetric, k > 0.
    """
    label = connected_components(matrix, directed=False)[1]
    order = np.argsort(label, kind="stable")
    blocks = np.split(order, np.cumsum(np.bincount(label))[:-1])
    rows = csr_array(matrix)
    pairs = [np.linalg.eigh(rows[block][:, block].toarray()) for block in blocks]
    vectors = csr_array(block_diag([csr_array(vectors) for _, vectors in pairs]))
    place = np.argsort(order)
    return np.concatenate([values for values, _ in pairs])[place], vectors[place][:, place]


def factored(matrix: csr_array) -> Any | None:
    """Return SciPy's triangular factors of a symmetric matrix; None if there is a zero pivot.

    The matrix is factored as L U without pivoting, which for positive definite matrices is as
    stable as Cholesky's method.
    """
    try:
        return splu(csc_array(matrix), "MMD_AT_PLUS_A", 0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return None


def is_positive_definite(matrix: csr_array) -> bool:
    """Return whether all pivots of a sparse symmetric matrix are positive (Sylvester)."""
    factors = factored(matrix)
    return factors is not None and bool((factors.U.diagonal() > 0.0).all())
