"""Facets of a surface, as the displacement sees them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import basix

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices, Mask

#: Distance of a facet's nodes from its straight shape or plane, over its size, that is rounding.
SHAPE_ROUNDING = 1e-10


@dataclass(frozen=True)
class Facets:
    """Facets with a tag, those that a rank works with: curves in 2D, triangles or quadrilaterals.

    Their shape is the interpolation of the geometry in the space of the displacement, so that N, T
    and the gap treat positions as they treat displacements. In 2D points have a third coordinate 0.

    Attributes:
        cell: "interval", "triangle" or "quadrilateral".
        degree: of the displacement.
        nodes: (n, k) global numbers of the displacement's nodes, corners first.
        points: (n, k, 3) where they are [length].
        free: (n, corners, dim) directions in which the corners' displacement is not prescribed.
        file_numbers: (n, corners) numbers of the corners in the mesh file: no partition
            changes them.
        outward: (n,) 1 or -1: the sign of the normal that follows from the order of the nodes.
        offsets: (n, k, 3) the vectors from a facet to the surface that it stands for
            (surface/offsets.py) [length]; (n, 0, 3): that is not known.
        bent: whether edges are curved anywhere on the surface, which takes degree 2.
        plane: whether each facet of the surface lies in a plane.
    """

    cell: str
    degree: int
    nodes: GlobalNumbers
    points: Array
    free: Mask
    file_numbers: GlobalNumbers
    outward: Array
    offsets: Array
    bent: bool
    plane: bool

    @property
    def dim(self) -> int:
        """1 for curves, 2 for surfaces."""
        return 1 if self.cell == "interval" else 2

    @property
    def corners(self) -> int:
        """The number of corners of a facet."""
        return int(self.free.shape[1])

    @property
    def affine(self) -> bool:
        """Whether the map from the reference facet is affine."""
        return not self.bent and self.cell != "quadrilateral"

    @property
    def mean_normals(self) -> Array:
        """The outward unit normals (n, 3) in the middle, of corners that are joined straight."""
        normals = self.area_vectors(np.full((1, self.dim), 1.0 / 3.0))[:, 0]
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])

    def hats(self, x: Array) -> Array:
        """Return the hat functions (q, corners) of the corners at reference points (q, dim)."""
        return np.asarray(tabulate(self.cell, 1, 0, x)[0])

    @property
    def hats_at_nodes(self) -> Array:
        """The hat functions (k, corners) of the corners at the displacement's nodes."""
        return _hats_at_nodes(self.cell, self.degree)

    def basis(self, x: Array) -> Array:
        """Return the basis functions (q, k) of the displacement at reference points (q, dim)."""
        return np.asarray(tabulate(self.cell, self.degree, 0, x)[0])

    def area_vectors(self, x: Array) -> Array:
        """Return outward normals (n, q, 3) at reference points; their length is dA over dx."""
        gradients = tabulate(self.cell, self.degree, 1, x)[1:]
        along = np.einsum("dqk,nki->dnqi", gradients, self.points)
        return np.asarray(cross_products(along) * self.outward[:, None, None])

    def area_vectors_at(self, facet: Indices, x: Array) -> Array:
        """Return the same (m, 3) at one reference point (m, dim) each of some facets (m,)."""
        gradients = tabulate(self.cell, self.degree, 1, x)[1:]
        along = np.einsum("dmk,mki->dmi", gradients, self.points[facet])
        return np.asarray(cross_products(along) * self.outward[facet, None])


def cross_products(along: Array) -> Array:
    """Return the cross products of tangents (dim, ..., 3); in 2D the second points along z."""
    second = along[1] if len(along) == 2 else np.array([0.0, 0.0, 1.0])
    return np.asarray(np.cross(along[0], second))


@cache
def _element(cell: str, degree: int) -> Any:
    return basix.create_element(
        basix.ElementFamily.P,
        basix.CellType[cell],
        degree,
        basix.LagrangeVariant.gll_warped if degree > 0 else basix.LagrangeVariant.unset,
    )


def lagrange_points(cell: str, degree: int) -> Array:
    """Return the nodes (k, dim) of a Lagrange basis on a reference cell."""
    return np.asarray(_element(cell, degree).points)


def tabulate(cell: str, degree: int, derivatives: int, x: Array) -> Array:
    """Return values, then first derivatives, (1 + dim, q, k) of a Lagrange basis."""
    if len(x) == 0:  # basix wants at least one point
        return np.zeros((1 + derivatives * x.shape[1], 0, _element(cell, degree).dim))
    return np.asarray(_element(cell, degree).tabulate(derivatives, x)[..., 0])


def _hats_at_nodes(cell: str, degree: int) -> Array:
    """Return the hat functions (k, corners) of the corners at the nodes of a degree."""
    return np.asarray(tabulate(cell, 1, 0, lagrange_points(cell, degree))[0])


def quadrature(cell: str, degree: int) -> tuple[Array, Array]:
    """Return points (q, dim) and weights (q,) on a reference cell."""
    points, weights = basix.make_quadrature(basix.CellType[cell], degree)
    return np.asarray(points), np.asarray(weights)


def oriented(
    cell: str,
    degree: int,
    nodes: GlobalNumbers,
    points: Array,
    free: Mask,
    file_numbers: GlobalNumbers,
    middle: Array,
) -> Facets:
    """Return facets with the sign of their outward normals: away from their cells.

    Args:
        cell: the kind of facet.
        degree: of the displacement.
        nodes: (n, k) their global numbers.
        points: (n, k, 3) where they are.
        free: (n, corners, dim) what is not prescribed.
        file_numbers: (n, corners) in the mesh file.
        middle: (n, 3) middles of the cells that they belong to.
    """
    corners = points[:, : free.shape[1]]
    straight = np.einsum("kc,nci->nki", _hats_at_nodes(cell, degree), corners)
    size = np.ptp(corners, axis=1).max(axis=1)
    bent = bool((np.abs(points - straight).max(axis=(1, 2)) > SHAPE_ROUNDING * size).any())
    result = Facets(
        cell,
        degree,
        nodes,
        points,
        free,
        file_numbers,
        np.ones(len(points)),
        np.zeros((len(points), 0, 3)),
        bent,
        not bent and _flat(cell, corners, size),
    )
    centre, _ = quadrature(cell, 1)
    away = np.einsum("ni,ni->n", result.area_vectors(centre)[:, 0], corners.mean(axis=1) - middle)
    result.outward[away < 0.0] = -1.0
    return result


def _flat(cell: str, corners: Array, size: Array) -> bool:
    """Whether the corners of each facet lie in a plane."""
    if cell != "quadrilateral":
        return True
    sides = corners[:, 1:] - corners[:, :1]
    volume = np.einsum("ni,ni->n", np.cross(sides[:, 0], sides[:, 1]), sides[:, 2])
    return bool((np.abs(volume) <= SHAPE_ROUNDING * size**3).all())
