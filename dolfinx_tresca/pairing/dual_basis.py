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


def dual_coefficients(integrals: FacetIntegrals, full: Mask) -> Array:
    """Return the multiplier basis (n, corners, corners) of each facet in its hat functions.

    On whole facets it is dual: the integral of psi_i phi_j is that of phi_i for i = j, else 0, for
    hat functions phi (Wohlmuth 2000). On facets that are covered in part the dual functions would
    extrapolate from what may be a sliver, so there it consists of the hat functions themselves.
    Both sum to 1, so that constant pressures pass.
    """
    corners = integrals.hats.shape[1]
    result = np.broadcast_to(np.eye(corners), integrals.hats.shape).copy()
    result[full] = integrals.weights[full][:, :, None] * np.linalg.inv(integrals.hats[full])
    return result


def moved_to(values: Array, some: Mask) -> Array:
    """Return values (n, corners, k) of facets, with those of other corners moved to some of them.

    So a facet passes on a constant pressure even if one of its corners has no multiplier there.

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
