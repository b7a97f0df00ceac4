"""Biorthogonal multipliers on the facets of the secondary side, and the rows they make."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca.surface.facets import Facets, quadrature
from dolfinx_tresca.surface.nodes import SurfaceNodes

#: An entry of a weighed jump, over the node's weight, that is rounding.
ENTRY_ROUNDING = 1e-13

EPSILON = float(np.finfo(np.float64).eps)

#: Least eigenvalue of a covered part's scaled mass matrix, which amplifies rounding by its inverse.
#: Less is met on strips and in corners of some thousandths of a facet only.
LEAST_EIGENVALUE = 1e-6


@dataclass(frozen=True)
class FacetIntegrals:
    """Integrals over the part of each secondary facet that is in contact, dA included.

    Attributes:
        hats: (n, corners, corners) of products of hat functions.
        values: (n, corners, k) of hat functions times basis functions of the displacement.
    """

    hats: Array
    values: Array

    @property
    def weights(self) -> Array:
        """Integrals (n, corners) of the hat functions."""
        return np.asarray(self.hats.sum(axis=2))


def whole_facet_integrals(facets: Facets) -> FacetIntegrals:
    """Return the integrals over whole facets."""
    x, w = quadrature(facets.cell, 4 * facets.degree + 2)
    area = np.linalg.norm(facets.area_vectors(x), axis=2) * w
    hats, basis = facets.hats(x), facets.basis(x)
    return FacetIntegrals(
        np.einsum("nq,qa,qb->nab", area, hats, hats, optimize=True),
        np.einsum("nq,qa,qk->nak", area, hats, basis, optimize=True),
    )


def dual_coefficients(integrals: FacetIntegrals, full: Mask, carries: Mask | None = None) -> Array:
    """Return the multiplier basis (n, corners, corners) of each facet in its hat functions.

    The basis psi is biorthogonal on the covered part of each facet (Wohlmuth 2000; Cichosz and
    Bischoff 2011): the integral of psi_i phi_j is the integral of phi_i for i = j, and zero
    otherwise. A nodal pressure is then the nodal force over the node's covered area, a mean of the
    pressure there and no extrapolation. Corners without a multiplier of their own are eliminated
    first: each other corner of the facet takes an equal part of their hat functions, and the basis
    is biorthogonal to these sums. In either case it sums to 1, so that constant pressures pass.

    Args:
        integrals: over the covered parts.
        full: (n,) facets that are covered as a whole.
        carries: (n, corners) corners that carry a multiplier; None: all. A facet where none does
            has no functions.
    """
    hats, corners = integrals.hats, integrals.hats.shape[1]
    if carries is None:
        carries = np.ones(hats.shape[:2], dtype=np.bool_)
    result = np.zeros_like(hats)
    plain = full & carries.all(axis=1)
    result[plain] = integrals.weights[plain][:, :, None] * np.linalg.inv(hats[plain])
    rest = ~plain & (integrals.weights.sum(axis=1) > 0.0)
    sums = moved_to(np.broadcast_to(np.eye(corners), hats[rest].shape), carries[rest])
    result[rest] = _regularised_dual(sums @ hats[rest] @ sums.transpose(0, 2, 1)) @ sums
    return result


def _regularised_dual(masses: Array) -> Array:
    """Return dual bases (n, k, k) for functions that sum to 1, in these functions.

    With masses M, their row sums D and S = D^-1/2 M D^-1/2 the basis is D M^-1, where the functions
    are independent. On a covered part that is a narrow strip they hardly are: there
    (1 + t) D (M + t D)^-1 with the least t that keeps the eigenvalues of S + t I above
    `LEAST_EIGENVALUE`. Since M 1 = D 1, that sums to 1 for any t.

    Args:
        masses: (n, k, k) integrals of products of the functions; zero rows have no function.
    """
    weights: Array = masses.sum(axis=2)
    absent: Mask = np.logical_not(masses.any(axis=2))
    # rounding may leave the integral of a hat function negative on a sliver at the opposite corner
    weights = np.maximum(weights, EPSILON * weights.sum(axis=1, keepdims=True))
    root = np.sqrt(np.where(absent, 1.0, weights))
    scaled = masses / (root[:, :, None] * root[:, None, :])
    scaled += absent[:, :, None] * np.eye(masses.shape[2])
    least = np.linalg.eigvalsh(scaled)[:, :1, None]
    shift = np.maximum(LEAST_EIGENVALUE - least, 0.0)
    inverse = np.linalg.inv(scaled + shift * np.eye(masses.shape[2]))
    return np.asarray((1.0 + shift) * root[:, :, None] * inverse / root[:, None, :])


def moved_to(values: Array, some: Mask) -> Array:
    """Return values (n, corners, k) of facets, with those of other corners moved to some of them.

    A facet passes on a constant pressure even if some of its corners have no multiplier.

    Args:
        values: (n, corners, k).
        some: (n, corners) those that take the others' in equal parts.
    """
    number = np.maximum(some.sum(axis=1), 1)[:, None, None]
    lost = np.where(some[:, :, None], 0.0, values).sum(axis=1, keepdims=True)
    return np.where(some[:, :, None], values + lost / number, 0.0)


def assembled_rows(
    nodes: SurfaceNodes,
    facet_corners: Indices,
    columns: GlobalNumbers,
    values: Array,
    shape: int,
) -> Any:
    """Return the sum (nodes, shape) over facets of blocks of rows, sparse.

    Args:
        nodes: of the secondary side.
        facet_corners: (n, corners) positions in `nodes`.
        columns: (n, k) global numbers.
        values: (n, corners, k).
        shape: number of columns.
    """
    row = np.broadcast_to(facet_corners[:, :, None], values.shape)
    column = np.broadcast_to(columns[:, None, :], values.shape)
    return coo_array(
        (values.ravel(), (row.ravel(), column.ravel())), shape=(len(nodes.numbers), shape)
    ).tocsr()


def places(nodes: SurfaceNodes, facet_corners: Indices, points: Array, values: Array) -> Array:
    """Return where the forces of such rows act (nodes, 3), times their weights.

    Args:
        nodes: of the secondary side.
        facet_corners: (n, corners) positions in `nodes`.
        points: (n, k, 3) those of the columns.
        values: (n, corners, k).
    """
    result = np.zeros((len(nodes.numbers), 3))
    np.add.at(result, facet_corners, values @ points)
    return result


def without_rounding(matrix: Any, scale: Array) -> Any:
    """Return a csr matrix without entries that are rounding; `scale` has the size of each row."""
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    matrix.data[np.abs(matrix.data) <= ENTRY_ROUNDING * scale[row]] = 0.0
    matrix.eliminate_zeros()
    return matrix
