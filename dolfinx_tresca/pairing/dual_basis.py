"""The dual (biorthogonal) multiplier basis on secondary facets, and assembly of its rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import coo_array

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask
from dolfinx_tresca.pairing.search.facets import Facets, quadrature
from dolfinx_tresca.pairing.search.nodes import SurfaceNodes

#: An entry of a weighted jump counts as rounding if it is at most this factor times the relative
#: rounding of the coordinates times the node's area. (Integrals over overlaps are sums of
#: differences of coordinates.)
ENTRY_ROUNDING = 8.0

EPSILON = float(np.finfo(np.float64).eps)

#: Least eigenvalue of the scaled mass matrix of a covered part. If an eigenvalue is smaller, the
#: inverse of the matrix would amplify rounding, and a shift raises the eigenvalue to this value
#: (`_regularised_dual`). This occurs only if the covered part is a strip or a corner of some
#: thousandths of the facet.
LEAST_EIGENVALUE = 1e-6


def whole_facet_integrals(facets: Facets) -> tuple[Array, Array]:
    """Return integrals as if every facet were covered completely. Not collective.

    Returns:
        (n, corners, corners) integrals of the products of two hat functions, and (n, corners, k)
        integrals of hat functions times basis functions of the displacement.
    """
    x, w = quadrature(facets.cell, 4 * facets.degree + 2)
    area = facets.area_elements(x) * w
    hats, basis = facets.hats(x), facets.basis(x)
    return (
        np.einsum("nq,qa,qb->nab", area, hats, hats, optimize=True),
        np.einsum("nq,qa,qk->nak", area, hats, basis, optimize=True),
    )


def dual_coefficients(hats: Array, full: Mask, carries: Mask | None = None) -> Array:
    """Return the coefficients (n, corners, corners) of hat functions in the dual basis functions.

    The basis psi is biorthogonal to the hat functions phi on the covered part of each facet
    (Wohlmuth 2000; Cichosz and Bischoff 2011): the integral of psi_i phi_j is the integral of phi_i
    for i = j, and zero otherwise. So a nodal pressure is the nodal force divided by the node's
    covered area. If corners have no multiplier, their hat functions are first added, in equal
    parts, to the hat functions of the other corners of the facet, and the basis is biorthogonal to
    these sums. In both cases the basis functions sum to 1, so that constant pressures are
    transferred exactly.

    Args:
        hats: (n, corners, corners) integrals of the products of two hat functions over the covered
            parts of facets.
        full: (n,) whether the whole facet is covered, so that no regularisation is needed.
        carries: (n, corners) whether a corner carries a multiplier; None: all do. A facet without
            such corners has no basis functions.
    """
    weights, corners = hats.sum(axis=2), hats.shape[1]
    if carries is None:
        carries = np.ones(hats.shape[:2], dtype=np.bool_)
    result = np.zeros_like(hats)
    plain = full & carries.all(axis=1)
    result[plain] = weights[plain][:, :, None] * np.linalg.inv(hats[plain])
    rest = ~plain & (weights.sum(axis=1) > 0.0)
    sums = redistributed(np.broadcast_to(np.eye(corners), hats[rest].shape), carries[rest])
    result[rest] = _regularised_dual(sums @ hats[rest] @ sums.transpose(0, 2, 1)) @ sums
    return result


def _regularised_dual(masses: Array) -> Array:
    """Return the coefficients (n, k, k) of each facet's dual basis, whose k functions sum to 1.

    With the mass matrix M, the diagonal matrix D of its row sums and S = D^-1/2 M D^-1/2, the
    coefficients are D M^-1. If the covered part is a narrow strip, M is nearly singular, and the
    coefficients are (1 + t) D (M + t D)^-1 with the least t for which the eigenvalues of S + t I
    are at least `LEAST_EIGENVALUE`. Since M 1 = D 1, the basis sums to 1 for any t; it is
    biorthogonal for t = 0 only.

    Args:
        masses: (n, k, k) mass matrices of the functions from which the bases are formed, which sum
            to 1; a zero row stands for a missing function.
    """
    weights: Array = masses.sum(axis=2)
    absent: Mask = np.logical_not(masses.any(axis=2))
    # on a sliver at the opposite corner, rounding may make the integral of a hat function negative
    weights = np.maximum(weights, EPSILON * weights.sum(axis=1, keepdims=True))
    root = np.sqrt(np.where(absent, 1.0, weights))
    scaled = masses / (root[:, :, None] * root[:, None, :])
    scaled += absent[:, :, None] * np.eye(masses.shape[2])
    least = np.linalg.eigvalsh(scaled)[:, :1, None]
    shift = np.maximum(LEAST_EIGENVALUE - least, 0.0)
    inverse = np.linalg.inv(scaled + shift * np.eye(masses.shape[2]))
    return np.asarray((1.0 + shift) * root[:, :, None] * inverse / root[:, None, :])


def redistributed(values: Array, some: Mask) -> Array:
    """Distribute the values of corners that are not in `some` over the corners in `some`.

    The sum over the corners of a facet does not change, so that a facet transfers a constant
    pressure even if some of its corners have no multiplier.

    Args:
        values: (n, corners, k) values at the corners of facets.
        some: (n, corners) whether a corner receives values of the other corners, in equal parts.

    Returns:
        The new values (n, corners, k), zero at corners that are not in `some`.
    """
    number = np.maximum(some.sum(axis=1), 1)[:, None, None]
    lost = np.where(some[:, :, None], 0.0, values).sum(axis=1, keepdims=True)
    return np.where(some[:, :, None], values + lost / number, 0.0)


def assemble_rows(
    nodes: SurfaceNodes, rows: Indices, columns: GlobalNumbers, values: Array, width: int
) -> Any:
    """Assemble dense blocks, one for each facet, into a sparse matrix (nodes, width).

    Args:
        nodes: the secondary nodes, one row for each.
        rows: (n, corners) indices in `nodes` of the rows of each block.
        columns: (n, k) global numbers of the columns of each block.
        values: (n, corners, k) the blocks.
        width: number of columns of the matrix.
    """
    places = np.repeat(rows, values.shape[2], axis=1), np.tile(columns, values.shape[1])
    entries = values.ravel(), (places[0].ravel(), places[1].ravel())
    return coo_array(entries, shape=(len(nodes.numbers), width)).tocsr()


def drop_rounding(matrix: Any, nodes: SurfaceNodes, rows: Indices, areas: Array) -> Any:
    """Remove entries that are rounding errors from a csr matrix of `assemble_rows`.

    Args:
        matrix: (nodes, columns) integrals over the facets.
        nodes: the secondary nodes.
        rows: (n, corners) indices in `nodes` of the rows of each facet.
        areas: (nodes,) covered area of each node [length^2, in 2D length].
    """
    rounding = np.zeros(matrix.shape[0])
    np.maximum.at(rounding, rows, nodes.facets.rounding[:, None])
    row = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
    matrix.data[np.abs(matrix.data) <= ENTRY_ROUNDING * (rounding * areas)[row]] = 0.0
    matrix.eliminate_zeros()
    return matrix
