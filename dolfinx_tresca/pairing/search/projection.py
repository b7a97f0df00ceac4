"""Inverse of the map from a reference facet to a plane."""

from __future__ import annotations

import numpy as np

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca.pairing.search.facets import Facets, tabulate

#: Largest number of Newton steps; the length of a step, in reference coordinates, that counts as
#: rounding.
NEWTON_STEPS, STEP_ROUNDING = 20, 1e-14


def project(facets: Facets, nodes: Array, target: Array) -> Array:
    """Find the reference points (n, dim) of facets whose images are given points of a plane.

    Args:
        facets: the facets; only their cell and degree are used.
        nodes: (n, k, dim) nodes of one facet for each point, projected into the plane [length].
        target: (n, dim) the given points in the plane [length].
    """
    dim = facets.dim
    # the affine map is exact for straight segments, triangles and parallelograms
    sides = np.stack([nodes[:, 1 + i] - nodes[:, 0] for i in range(dim)], axis=2)
    x = _solve(sides, target - nodes[:, 0])
    if facets.affine:
        return x
    for _ in range(NEWTON_STEPS):
        table = tabulate(facets.cell, facets.degree, 1, x)
        defect = target - np.einsum("nk,nki->ni", table[0], nodes)
        step = _solve(np.einsum("jnk,nki->nij", table[1:], nodes), defect)
        x = x + step
        if np.abs(step).max(initial=0.0) <= STEP_ROUNDING:
            break
    return x


def _solve(matrix: Array, right: Array) -> Array:
    """Solve n systems of size dim = 1 or 2; the solution of a singular system is zero."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if matrix.shape[1] == 1:
            result = right / matrix[:, 0]
        else:
            (a, b), (c, d) = np.moveaxis(matrix, 0, 2)
            x, y = right.T
            result = np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None]
    return np.nan_to_num(np.asarray(result), nan=0.0, posinf=0.0, neginf=0.0)
