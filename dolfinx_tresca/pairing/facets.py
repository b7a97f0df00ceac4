"""Facets of a surface with the shape functions of the displacement, and their corners."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import basix

from dolfinx_tresca._base.arrays import (
    ROUNDING,
    Array,
    GlobalNumbers,
    Indices,
    Mask,
    cross,
    dots,
    unit,
)

#: Deviation, relative to the size of a facet, that counts as rounding beside that of coordinates,
#: in shapes, heights and areas. Mesh files have at least ten digits.
MESH_ROUNDING = 1e-10

#: Attributes of `Facets` with a row for each facet; other attributes describe the whole surface.
FACET_ARRAYS = (
    *("nodes", "points", "free", "file_numbers"),
    *("outward", "offsets", "origins", "tag_index"),
)

#: Degree of the interpolation of the offsets on a facet. With degree 2 the sagitta of a facet of 30
#: degrees of a cylinder is 0.4 % too small, an error as large as the gap of close fits.
OFFSET_DEGREE = 4
#: Largest number of Newton steps that find a reference point.
NEWTON_STEPS = 20

#: Distance of two corners, relative to the facet, up to which they match, in addition to rounding,
#: and part of an area that may be uncovered. Meshes of mesh generators differ by 1e-10 or less.
MISMATCH = 1e-8
#: What is nothing beside a facet, above the mismatch of meshes and far below their resolution: a
#: part of its area, the distance of surfaces that touch relative to its radius, the cosine between
#: its normal and a line along it, the length of a sum of normals relative to their weights.
NEGLIGIBLE = 1e-6

#: Least cosine between the normal of a facet and the reversed normal of a facet that it faces (84
#: degrees): beyond, its area is more than ten times that of its projection. Also the least length
#: of the projection of a unit normal onto the free directions with which it replaces the normal.
FACING_COSINE = 0.1
#: Angle between the normals of two facets at a node [degrees] beyond which there is a sharp edge
#: between them: polygons of seven or more sides are smooth; boxes and hexagons have sharp edges.
EDGE_ANGLE = 55.0


@dataclass(frozen=True)
class Facets:
    """The facets of a surface on this rank: curves in 2D, triangles or quadrilaterals in 3D.

    The shape of a facet is the interpolation of the geometry in the space of the displacement, so
    that N, T and the gap treat positions like displacements. In 2D the third coordinate is 0.

    Attributes:
        cell: type of the facets, "interval", "triangle" or "quadrilateral".
        degree: polynomial degree of the displacement.
        nodes: (n, k) global numbers of the displacement's nodes, corners first.
        points: (n, k, 3) positions of the nodes [length].
        free: (n, corners, dim of space) mask of the free components of corners' displacements.
        file_numbers: (n, corners) numbers of the corners in the mesh file.
        outward: (n,) 1 if the order of the nodes gives the outward normal, else -1.
        offsets: (n, q, 3) vectors from the nodes of a Lagrange basis of `OFFSET_DEGREE` to the
            exact surface [length]; NaN where that is unknown, (n, 0, 3) if it is on both sides.
        origins: (n, 9) see `facet_origins`; (n, 0) on surfaces that do not touch themselves.
        tag_index: (n,) position of the facet's tag in the list of tags of its side.
        bent: whether any edge of the whole surface is curved, which is possible with degree 2 only.
        axisymmetric: whether each facet is the meridian of a ring about the axis x = 0.
    """

    cell: str
    degree: int
    nodes: GlobalNumbers
    points: Array
    free: Mask
    file_numbers: GlobalNumbers
    outward: Array
    offsets: Array
    origins: Array
    tag_index: Indices
    bent: bool
    axisymmetric: bool = False

    @property
    def dim(self) -> int:
        """The dimension of the facets: 1 for curves, 2 for surfaces."""
        return 1 if self.cell == "interval" else 2

    @property
    def corners(self) -> int:
        """The number of corners of a facet."""
        return int(self.free.shape[1])

    @property
    def corners_round(self) -> Indices:
        """The numbers of a facet's corners in the order round it."""
        return np.array([0, 1, 3, 2]) if self.cell == "quadrilateral" else np.arange(self.corners)

    @property
    def rounding(self) -> Array:
        """The rounding (n,) of differences of coordinates, relative to the size of each facet."""
        return rounding_of(self.points)

    @property
    def affine(self) -> bool:
        """Whether the map from the reference facet is affine."""
        return not self.bent and self.cell != "quadrilateral"

    @property
    def has_exact_surface(self) -> bool:
        """Whether the exact surface of any facet of the pair is known."""
        return bool(self.offsets.shape[1])

    @property
    def areas(self) -> Array:
        """The areas (n,) of the facets [length^2]; in 2D lengths, even of rings [length]."""
        points, weights = quadrature(self.cell, 2 * self.degree)
        return np.asarray(np.linalg.norm(self.area_vectors(points), axis=2) @ weights)

    @property
    def mean_normals(self) -> Array:
        """The outward unit normals (n, 3) at the centre of each facet."""
        return unit(self.area_vectors(quadrature(self.cell, 1)[0])[:, 0])

    def lagrange_points(self, degree: int) -> Array:
        """Return the reference points (k, dim) of the nodes of a Lagrange basis of a degree."""
        return np.asarray(_element(self.cell, degree).points)

    def hats(self, x: Array) -> Array:
        """Return the hat functions (q, corners) of the corners at reference points (q, dim)."""
        return np.asarray(tabulate(self.cell, 1, 0, x)[0])

    def basis(self, x: Array) -> Array:
        """Return the basis functions (q, k) of the displacement at reference points (q, dim)."""
        return np.asarray(tabulate(self.cell, self.degree, 0, x)[0])

    def selected(self, index: Indices) -> Facets:
        """Return the facets with indices (m,)."""
        return replace(self, **{name: getattr(self, name)[index] for name in FACET_ARRAYS})

    def moved_to(self, points: Array) -> Facets:
        """Return the facets with nodes at points (n, k, 3); `bent` is that of this rank."""
        displaced = replace(self, points=points)
        if self.has_exact_surface:
            # the offsets turn with the facets: they keep their components along axes of these
            axes = frames_along(self.points[:, 1] - self.points[:, 0], self.mean_normals)
            turned_axes = frames_along(points[:, 1] - points[:, 0], displaced.mean_normals)
            components = np.einsum("nqi,ndi->nqd", self.offsets, axes)
            offsets = np.einsum("nqd,ndi->nqi", components, turned_axes)
            displaced = replace(displaced, offsets=offsets)
        # a facet is bent if its nodes are not where they would be if all its edges were straight
        corners = points[:, : self.corners]
        straight = self.hats(self.lagrange_points(self.degree)) @ corners
        sizes = np.ptp(corners, axis=1).max(axis=1)
        rounding = MESH_ROUNDING + rounding_of(corners)
        bent = bool((np.abs(points - straight).max(axis=(1, 2)) > rounding * sizes).any())
        return replace(displaced, bent=bent)

    def area_vectors(self, x: Array) -> Array:
        """Return outward normals (n, q, 3), as long as area elements, at reference x (q, dim)."""
        gradients = tabulate(self.cell, self.degree, 1, x)[1:]
        along = np.einsum("dqk,nki->dnqi", gradients, self.points)
        return np.asarray(cross_products(along) * self.outward[:, None, None])

    def area_elements(self, x: Array) -> Array:
        """Return area elements (n, q), of rings if axisymmetric, at reference points (q, dim)."""
        areas: Array = np.linalg.norm(self.area_vectors(x), axis=2)
        if self.axisymmetric:
            radii = (self.basis(x) @ self.points)[:, :, 0]
            areas = 2.0 * np.pi * radii * areas
        return areas

    def area_vectors_at(self, facet: Indices, x: Array) -> Array:
        """Return `area_vectors` (m, 3) of facets (m,), each at its own reference point (m, dim)."""
        gradients = tabulate(self.cell, self.degree, 1, x)[1:]
        along = (gradients[:, :, None] @ self.points[facet])[:, :, 0]
        return np.asarray(cross_products(along) * self.outward[facet, None])

    def coincide(self, facet: Indices, primary: Facets, partner: Indices) -> Mask:
        """Return whether each corner of facets (p,) is at a corner of its primary facet (p,)."""
        corners = self.points[facet, : self.corners]
        offset = primary.points[partner, None, : primary.corners] - corners[:, :, None]
        diameters = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
        allowed = (MISMATCH + self.rounding[facet]) * diameters
        nearest = np.linalg.norm(offset, axis=3).min(axis=2)
        return np.asarray((nearest <= allowed[:, None]).all(axis=1))

    def exact_surface_at(self, facet: Indices, x: Array) -> tuple[Array, Array]:
        """Return vectors to the exact surface [length], and its outward unit normals, (m, 3).

        Each belongs to a facet (m,), whose `offsets` are known, and a reference point x (m, dim).
        """
        # the nodes (n, q, 3) that interpolate the exact surface
        nodes = self.basis(self.lagrange_points(OFFSET_DEGREE)) @ self.points + self.offsets
        table = tabulate(self.cell, OFFSET_DEGREE, 1, x)[:, :, None]  # values, then gradients
        offsets = (table[0] @ self.offsets[facet])[:, 0]
        along = (table[1:] @ nodes[facet])[:, :, 0]  # tangents (dim, m, 3)
        return offsets, unit(cross_products(along) * self.outward[facet, None])


def frames_along(sides: Array, normals: Array) -> Array:
    """Return orthonormal axes (n, 3, 3): the side in the plane, normal x this axis, the normal."""
    along = unit(sides - dots(sides, normals)[:, None] * normals)
    return np.stack([along, cross(normals, along), normals], axis=1)


def rounding_of(points: Array) -> Array:
    """Return the rounding (n,) of differences of points (n, k, 3), relative to their extent."""
    extent = np.linalg.norm(np.ptp(points, axis=1), axis=1)
    relative = np.abs(points).max(axis=(1, 2)) / np.where(extent > 0.0, extent, 1.0)
    return np.asarray(ROUNDING * relative)


def cross_products(along: Array) -> Array:
    """Return the cross products (..., 3) of two tangents (2, ..., 3), or of one tangent and e_z."""
    if len(along) == 2:
        return cross(along[0], along[1])
    return cross(along[0], np.array([0.0, 0.0, 1.0]))


@cache
def _element(cell: str, degree: int) -> Any:
    """Return the Lagrange element of a reference cell."""
    variant = basix.LagrangeVariant.gll_warped
    return basix.create_element(basix.ElementFamily.P, basix.CellType[cell], degree, variant)


def tabulate(cell: str, degree: int, derivatives: int, x: Array) -> Array:
    """Return the Lagrange basis (1, q, k), or with gradients (1 + dim, q, k), at x (q, dim)."""
    if len(x) == 0:  # basix requires at least one point
        return np.zeros((1 + derivatives * x.shape[1], 0, _element(cell, degree).dim))
    return np.asarray(_element(cell, degree).tabulate(derivatives, x)[..., 0])


def quadrature(cell: str, degree: int) -> tuple[Array, Array]:
    """Return quadrature points (q, dim) and weights (q,) on a reference cell."""
    points, weights = basix.make_quadrature(basix.CellType[cell], degree)
    return np.asarray(points), np.asarray(weights)


def project(facets: Facets, nodes: Array, target: Array) -> Array:
    """Find the reference points (n, dim) whose images are the `target` points (n, dim) of a plane.

    Each point has a facet, with nodes (n, k, dim) in the plane; `facets` has the shape functions.
    """
    # the affine map is exact for straight segments, triangles and parallelograms
    sides = np.stack([nodes[:, 1 + i] - nodes[:, 0] for i in range(facets.dim)], axis=2)
    x = _solve(sides, target - nodes[:, 0])
    if facets.affine:
        return x
    for _ in range(NEWTON_STEPS):
        table = tabulate(facets.cell, facets.degree, 1, x)  # values, then gradients
        defect = target - (table[0][:, None] @ nodes)[:, 0]
        jacobians = np.einsum("jnk,nki->nij", table[1:], nodes)
        step = _solve(jacobians, defect)
        x = x + step
        if np.abs(step).max(initial=0.0) <= ROUNDING:
            break
    return x


def _solve(matrix: Array, right: Array) -> Array:
    """Solve n systems (n, dim, dim) x = (n, dim), dim = 1 or 2; x is zero if one is singular."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if matrix.shape[1] == 1:
            result = right / matrix[:, 0]
        else:  # Cramer's rule
            (a, b), (c, d) = np.moveaxis(matrix, 0, 2)
            x, y = right.T
            result = np.stack([d * x - b * y, a * y - c * x], axis=1) / (a * d - b * c)[:, None]
    return np.nan_to_num(np.asarray(result), nan=0.0, posinf=0.0, neginf=0.0)


class SurfaceNodes:
    """The corners of facets; a node on a sharp edge has one entry for each of its `smooth_patches`.

    Weights and normals are valid at nodes whose adjacent facets are all on this rank.

    Attributes:
        numbers: (n,) global numbers of the nodes in V, ascending; of the entries of one node the
            patch with the largest weight comes last.
        points: (n, 3) positions [length].
        weights: (n,) integral of the node's hat function over its patch [length^2, in 2D length].
        normals: (n, 3) outward unit normals: means over the facets of the patch at the node,
            without prescribed components, since means over one side of a symmetry plane are tilted.
        free: (n, dim of space) mask of the components that are not prescribed.
        facet_nodes: (facets, corners) index of each facet's corners in the arrays of n entries.
        has_no_normal: (n,) whether the normals of the facets cancel.
    """

    def __init__(self, facets: Facets) -> None:
        """Find the nodes at the corners of facets, and their smooth patches."""
        self.facets, corners = facets, facets.corners
        unique, node_of_corner = np.unique(facets.nodes[:, :corners], return_inverse=True)
        # normals of facets at their corners, with the weight sin(angle) / (|a| |b|) for the two
        # sides a and b that meet there, in 2D 1 / length: the weighted mean is exact on a sphere
        # (Max 1999, Weights for computing vertex normals from facet normals)
        normals = unit(facets.area_vectors(facets.lagrange_points(1)))  # (facets, corners, 3)
        order = facets.corners_round
        place = np.argsort(order)  # the place of each corner in the order round the facet
        corner_points = facets.points[:, :corners]
        before = corner_points[:, order[place - 1]] - corner_points
        after = corner_points[:, np.roll(order, -1)[place]] - corner_points
        squares = np.square(before).sum(axis=2) * np.square(after).sum(axis=2)
        if facets.dim == 1:
            normal_weights = squares**-0.25
        else:
            normal_weights = np.linalg.norm(cross(before, after), axis=2) / squares
        patch, node_of_patch = smooth_patches(node_of_corner.ravel(), normals.reshape(-1, 3))
        x, w = quadrature(facets.cell, 2 * facets.degree + 2)
        corner_weights = facets.area_elements(x) @ (facets.hats(x) * w[:, None])
        # an entry is a patch; entries are sorted by node, then by the weight of the patch
        weights = np.bincount(patch, corner_weights.ravel(), minlength=len(node_of_patch))
        order = np.lexsort((weights, node_of_patch))
        self.weights: Array = weights[order].astype(np.float64)
        self.numbers: GlobalNumbers = unique[node_of_patch[order]]
        entry_of_patch = np.argsort(order)
        self.facet_nodes: Indices = entry_of_patch[patch].reshape(-1, corners)
        vectors = self.reduced(np.add, normal_weights[:, :, None] * normals, 0.0)
        total_weights = self.reduced(np.add, normal_weights, 0.0)
        _, corner = np.unique(self.facet_nodes, return_index=True)  # any corner at each entry
        self.points: Array = corner_points.reshape(-1, 3)[corner]
        self.free: Mask = facets.free.reshape(-1, facets.free.shape[2])[corner]
        self.has_no_normal = np.linalg.norm(vectors, axis=1) <= NEGLIGIBLE * total_weights
        # any unit vector for the error message's sake
        vectors[self.has_no_normal] = np.eye(3)[0]
        self.normals = free_normals(vectors, self.free)

    def reduced(self, ufunc: np.ufunc, values: Any, initial: Any, facets: Any = slice(None)) -> Any:
        """Return sums, or other reductions, at nodes of values (facets, corners or 1, ...) there.

        Nodes at none of the `facets`, by default all, keep the `initial` value of the reduction.
        """
        result = np.full((len(self.numbers), *values.shape[2:]), initial)
        ufunc.at(result, self.facet_nodes[facets], values)
        return result


def free_normals(vectors: Array, free: Mask) -> Array:
    """Return unit normals (n, 3) along vectors, without components that are not `free` (n, dim).

    A vector keeps all components if the free ones have at most `FACING_COSINE` of its length.
    """
    normals = unit(vectors)
    movable = normals.copy()
    movable[:, : free.shape[1]][~free] = 0.0
    length = np.linalg.norm(movable, axis=1)
    turned = (length > FACING_COSINE) & ~free.all(axis=1)
    normals[turned] = movable[turned] / length[turned, None]
    return normals


def smooth_patches(node: Indices, normals: Array) -> tuple[Indices, Indices]:
    """Return the smooth patch (n,) of facets' corners (n,), and the node (patches,) of each patch.

    The corners are at `node` (n,), where their facets have unit normals (n, 3). Two corners at one
    node are in the same patch if their normals differ by at most `EDGE_ANGLE`, or if a chain of
    such corners connects them. So a fillet is smooth.
    """
    corners = np.arange(len(node))
    shape = len(node), int(node.max(initial=-1)) + 1
    # all pairs of corners at one node
    at_node = coo_array((np.ones(len(node)), (corners, node)), shape=shape)
    corner, partner = (at_node @ at_node.T).nonzero()
    near = dots(normals[corner], normals[partner]) >= math.cos(math.radians(EDGE_ANGLE))
    links = np.ones(near.sum()), (corner[near], partner[near])
    graph = coo_array(links, shape=(len(node), len(node)))
    count, component = connected_components(graph, directed=False)
    # numbers of patches ascend with their nodes
    patches, patch = np.unique(node * count + component, return_inverse=True)
    return patch, patches // max(count, 1)


def tangents(normals: Array) -> Array:
    """Return orthonormal tangents (n, d - 1, d) at nodes with unit normals (n, d).

    In 3D the first one is perpendicular to the coordinate axis that is farthest from the normal.
    """
    if normals.shape[1] == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None]
    along = unit(cross(np.eye(3)[np.abs(normals).argmin(axis=1)], normals))
    return np.stack([along, cross(normals, along)], axis=1)
