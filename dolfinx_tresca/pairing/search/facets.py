"""Facets of a surface with the shape functions of the displacement, and their straight pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

import basix

from dolfinx_tresca._base.arrays import ROUNDING, Array, GlobalNumbers, Indices, Mask, cross

#: Distance of a facet's nodes from its straight shape or plane, relative to the size of the facet,
#: that counts as rounding, in addition to the rounding of coordinates.
SHAPE_ROUNDING = 1e-10

#: Attributes of `Facets` with a row for each facet; other attributes describe the whole surface.
FACET_ARRAYS = (
    *("nodes", "points", "free", "file_numbers"),
    *("outward", "offsets", "origins", "tag_index"),
)

#: Largest number of Newton steps; the length of a step, in reference coordinates, that counts as
#: rounding.
NEWTON_STEPS, STEP_ROUNDING = 20, 1e-14

# corners of each piece, in the order round it, as indices of the facet's nodes in basix' order
_WHOLE = {"interval": [[0, 1]], "triangle": [[0, 1, 2]], "quadrilateral": [[0, 1, 3, 2]]}
_QUARTERS = {
    "interval": [[0, 2], [2, 1]],
    "triangle": [[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]],
    "quadrilateral": [[0, 4, 8, 5], [4, 1, 6, 8], [8, 6, 3, 7], [5, 8, 7, 2]],
}

#: Distance of two corners, relative to the size of the facet, up to which they match, in addition
#: to the rounding of coordinates. Twice as much would admit meshes that are twice as far apart;
#: those of a mesh generator differ by 1e-10 or less.
MATCHING_DISTANCE = 1e-8

#: Overlap of two facets, relative to the area of the secondary facet, up to which the facets count
#: as sharing only an edge or a corner. A mismatch of `MATCHING_DISTANCE` causes smaller overlaps.
RIM_PART = 1e-6


#: Least cosine between the normal of a facet and the reversed normal of a facet that it faces (84
#: degrees). At larger angles the facet's area is more than ten times the area of its projection.
FACING_COSINE = 0.1

#: Penetration, relative to the radius of a facet, that is always accepted: facets of curved
#: surfaces penetrate each other by a part of their size.
SHALLOW_DEPTH = 0.1

#: A point's penetration along the normal counts only if the point's least distance from the other
#: side's surface, in any direction, is at least this part of the penetration. The distance is equal
#: to the penetration for parallel surfaces, and zero if the normal runs along a face.
CREDIBLE_PART = 0.1


@dataclass(frozen=True)
class Facets:
    """The facets with one tag on this rank: curves in 2D, triangles or quadrilaterals in 3D.

    The shape of a facet is the interpolation of the geometry in the space of the displacement, so
    that N, T and the gap treat positions like displacements. In 2D the third coordinate is 0.

    Attributes:
        cell: type of the facets, "interval", "triangle" or "quadrilateral".
        degree: polynomial degree of the displacement.
        nodes: (n, k) global numbers of the displacement's nodes, corners first.
        points: (n, k, 3) positions of the nodes [length].
        free: (n, corners, dim) whether a component of a corner's displacement is not prescribed.
        file_numbers: (n, corners) numbers of the corners in the mesh file, independent of the
            partition.
        outward: (n,) 1 if the order of the nodes gives the outward normal, -1 if it gives the
            inward normal.
        offsets: (n, q, 3) vectors from points of the facet to the exact surface [length], see
            search/tagged.py; NaN for facets whose exact surface is unknown, (n, 0, 3) if those of
            both sides are.
        origins: (n, 12) body and undeformed shape of the facet on a surface that may touch itself,
            see search/self_contact.py; (n, 0) on other surfaces.
        tag_index: (n,) position of the facet's tag in the list of tags of its side.
        bent: whether any edge of the whole surface is curved, which is possible with degree 2 only.
        plane: whether each facet of the whole surface lies in a plane of its own.
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
    plane: bool
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
    def rounding(self) -> Array:
        """The rounding (n,) of differences of coordinates, relative to the size of each facet."""
        return rounding_of(self.points)

    @property
    def affine(self) -> bool:
        """Whether the map from the reference facet is affine."""
        return not self.bent and self.cell != "quadrilateral"

    @property
    def mean_normals(self) -> Array:
        """The outward unit normals (n, 3) at the centre of each facet."""
        normals = self.area_vectors(quadrature(self.cell, 1)[0])[:, 0]
        return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])

    def hats(self, x: Array) -> Array:
        """Return the hat functions (q, corners) of the corners at reference points (q, dim)."""
        return np.asarray(tabulate(self.cell, 1, 0, x)[0])

    def basis(self, x: Array) -> Array:
        """Return the basis functions (q, k) of the displacement at reference points (q, dim)."""
        return np.asarray(tabulate(self.cell, self.degree, 0, x)[0])

    def moved_to(self, points: Array) -> Facets:
        """Return the facets with their nodes at other points (n, k, 3).

        `bent` and `plane` of the result describe the facets of this rank only; see `checked` in
        pairing/search/tagged.py.
        """
        if self.degree == 1 and self.cell != "quadrilateral":
            return replace(self, points=points)  # always straight and plane
        corners = points[:, : self.corners]
        hats = self.hats(lagrange_points(self.cell, self.degree))
        straight = np.einsum("kc,nci->nki", hats, corners)
        size = np.ptp(corners, axis=1).max(axis=1)
        rounding = SHAPE_ROUNDING + rounding_of(corners)
        bent = bool((np.abs(points - straight).max(axis=(1, 2)) > rounding * size).any())
        plane = not bent
        if plane and self.cell == "quadrilateral":
            sides = corners[:, 1:] - corners[:, :1]
            volume = np.einsum("ni,ni->n", cross(sides[:, 0], sides[:, 1]), sides[:, 2])
            plane = bool((np.abs(volume) <= rounding * size**3).all())
        return replace(self, points=points, bent=bent, plane=plane)

    def frames(self) -> Array:
        """Return right-handed orthonormal axes (n, 3, 3) in rows: a side, across it, the normal."""
        return frames_along(self.points[:, 1] - self.points[:, 0], self.mean_normals)

    def area_vectors(self, x: Array) -> Array:
        """Return outward normals (n, q, 3) whose length is the area element at reference points.

        Args:
            x: (q, dim) reference points, the same for all facets.
        """
        gradients = tabulate(self.cell, self.degree, 1, x)[1:]
        along = np.einsum("dqk,nki->dnqi", gradients, self.points)
        return np.asarray(cross_products(along) * self.outward[:, None, None])

    def area_elements(self, x: Array) -> Array:
        """Return area elements (n, q), of rings if axisymmetric, at reference points (q, dim)."""
        sizes = np.linalg.norm(self.area_vectors(x), axis=2)
        return np.asarray(sizes * self.circumferences(self.points[:, :, 0] @ self.basis(x).T))

    def circumferences(self, radii: Array) -> Array:
        """Return the factor of integrals over rings, 2 pi times radii; 1 without axisymmetry."""
        return 2.0 * np.pi * radii if self.axisymmetric else np.ones_like(radii)

    def area_vectors_at(self, facet: Indices, x: Array) -> Array:
        """Return the `area_vectors` (m, 3) of facets (m,) at one reference point (m, dim) each."""
        gradients = tabulate(self.cell, self.degree, 1, x)[1:]
        along = np.einsum("dmk,mki->dmi", gradients, self.points[facet])
        return np.asarray(cross_products(along) * self.outward[facet, None])


def frames_along(sides: Array, normals: Array) -> Array:
    """Return right-handed orthonormal axes (n, 3, 3) in rows: along a side, across it, the normal.

    Args:
        sides: (n, 3) vectors, which are projected onto the planes of the normals.
        normals: (n, 3) unit normals.
    """
    along = sides - np.einsum("ni,ni->n", sides, normals)[:, None] * normals
    along /= np.linalg.norm(along, axis=1)[:, None]
    return np.stack([along, cross(normals, along), normals], axis=1)


def joined(groups: Sequence[Facets]) -> Facets:
    """Return the facets of several tags as one surface."""
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(group, name) for group in groups]) for name in FACET_ARRAYS
    }
    counts = [len(group.points) for group in groups]
    arrays["tag_index"] = np.repeat(np.arange(len(groups)), counts)
    bent, plane = any(group.bent for group in groups), all(group.plane for group in groups)
    return replace(groups[0], bent=bent, plane=plane, **arrays)


def rounding_of(points: Array) -> Array:
    """Return the rounding (n,) of differences of points (n, k, 3), relative to their extent.

    It is zero for points that are all at one place.
    """
    rounding = ROUNDING * np.abs(points).max(axis=(1, 2))
    extent = np.linalg.norm(np.ptp(points, axis=1), axis=1)
    result = np.zeros(len(points))
    np.divide(rounding, extent, out=result, where=extent > 0.0)
    return result


def cross_products(along: Array) -> Array:
    """Return the cross products (..., 3) of two tangents (2, ..., 3), or of one tangent and e_z."""
    return cross(along[0], along[1] if len(along) == 2 else np.array([0.0, 0.0, 1.0]))


@cache
def _element(cell: str, degree: int) -> Any:
    """Return the Lagrange element of a reference cell."""
    variant = basix.LagrangeVariant.gll_warped
    return basix.create_element(basix.ElementFamily.P, basix.CellType[cell], degree, variant)


def lagrange_points(cell: str, degree: int) -> Array:
    """Return the nodes (k, dim) of a Lagrange basis on a reference cell."""
    return np.asarray(_element(cell, degree).points)


def tabulate(cell: str, degree: int, derivatives: int, x: Array) -> Array:
    """Return the Lagrange basis, and its gradient if `derivatives` = 1, at points x (q, dim).

    The shape is (1 or 1 + dim, q, k): values first, then derivatives along each coordinate.
    """
    if len(x) == 0:  # basix requires at least one point
        return np.zeros((1 + derivatives * x.shape[1], 0, _element(cell, degree).dim))
    return np.asarray(_element(cell, degree).tabulate(derivatives, x)[..., 0])


def quadrature(cell: str, degree: int) -> tuple[Array, Array]:
    """Return quadrature points (q, dim) and weights (q,) on a reference cell."""
    points, weights = basix.make_quadrature(basix.CellType[cell], degree)
    return np.asarray(points), np.asarray(weights)


@dataclass(frozen=True)
class Pieces:
    """Segments, triangles or quadrilaterals that approximate facets.

    If any facet of the surface is curved (`Facets.bent`), each facet is cut into two (in 2D) or
    four pieces; else each facet is one piece.

    Attributes:
        facet: (n,) the facet of each piece, ascending.
        nodes: (n, corners) global numbers of the displacement's nodes at the corners.
        points: (n, corners, 3) corners in the order round the piece [length].
        centres: (n, 3) means of the corners [length].
        radii: (n,) largest distance of a corner from the centre [length].
        normals: (n, 3) outward unit normals of the (mean) planes.
        areas: (n,) areas of the pieces, projected onto these planes [length^2, in 2D length].
    """

    facet: Indices
    nodes: GlobalNumbers
    points: Array
    centres: Array
    radii: Array
    normals: Array
    areas: Array

    @classmethod
    def from_facets(cls, facets: Facets) -> Pieces:
        """Cut facets into pieces."""
        corners = np.array((_QUARTERS if facets.bent else _WHOLE)[facets.cell])
        points = facets.points[:, corners].reshape(-1, corners.shape[1], 3)
        nodes = facets.nodes[:, corners].reshape(-1, corners.shape[1])
        facet = np.repeat(np.arange(len(facets.points)), len(corners))
        centres = points.mean(axis=1)
        if facets.dim == 1:
            vectors = cross(points[:, 1] - points[:, 0], np.array([0.0, 0.0, 1.0]))
        else:  # the area vector is half the cross product of the diagonals, or of two sides
            vectors = cross(points[:, 2] - points[:, 0], points[:, -1] - points[:, 1])
            vectors *= 0.5
        areas = np.linalg.norm(vectors, axis=1)
        return cls(
            facet,
            nodes,
            points,
            centres,
            np.linalg.norm(points - centres[:, None], axis=2).max(axis=1),
            np.asarray(vectors / (facets.outward[facet] * areas)[:, None]),
            np.asarray(areas),
        )

    @cached_property
    def frames(self) -> Array:
        """Orthonormal axes (n, dim + 1, 3) of the pieces: tangents, and the normal last."""
        axes = frames_along(self.points[:, 1] - self.points[:, 0], self.normals)
        return axes[:, [0, 2]] if self.points.shape[1] == 2 else axes

    def local_coordinates(self, piece: Indices, points: Array) -> Array:
        """Return the coordinates (n, k, dim + 1) of points (n, k, 3) in the frames of pieces (n,).

        The origin is the centre of the piece; the last coordinate is the height over its plane.
        """
        relative = points - self.centres[piece][:, None]
        return np.asarray(np.einsum("nki,ndi->nkd", relative, self.frames[piece]))

    def distances(self, chosen: Indices, points: Array) -> Array:
        """Return the distance (n,) of points (n, 3), each from a piece `chosen` (n,) [length]."""
        corners = self.points[chosen] - points[:, None]
        normals = self.normals[chosen]
        along = np.roll(corners, -1, axis=1) - corners
        # parameter in [0, 1] of the nearest point of each side
        share = -np.einsum("nci,nci->nc", corners, along) / np.square(along).sum(axis=2)
        share = np.clip(share, 0.0, 1.0)
        result = np.linalg.norm(corners + share[:, :, None] * along, axis=2).min(axis=1)
        if corners.shape[1] > 2:
            turns = np.einsum("nci,ni->nc", cross(corners, along), normals)
            projects_inside = (turns >= 0.0).all(axis=1) | (turns <= 0.0).all(axis=1)
            height = np.abs(np.einsum("ni,ni->n", corners.mean(axis=1), normals))
            result = np.where(projects_inside, height, result)
        return np.asarray(result)


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


def facets_coincide(secondary: Facets, facet: Indices, primary: Facets, partner: Indices) -> Mask:
    """Return whether each pair (p,) of a secondary and a primary facet has the same corners.

    Args:
        secondary: facets of the secondary side.
        facet: (p,) secondary facet of each pair.
        primary: facets of the primary side.
        partner: (p,) primary facet of each pair.
    """
    corners = secondary.points[facet, : secondary.corners]
    offset = primary.points[partner, None, : primary.corners] - corners[:, :, None]
    size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
    allowed = (MATCHING_DISTANCE + secondary.rounding[facet]) * size
    nearest = np.linalg.norm(offset, axis=3).min(axis=2)
    return np.asarray((nearest <= allowed[:, None]).all(axis=1))
