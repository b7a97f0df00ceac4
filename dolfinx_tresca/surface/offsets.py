"""Offsets from facets to the exact surfaces that they approximate."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.parallel import errors_on_all_ranks, log, reduce_array
from dolfinx_tresca.errors import InputError, MeshError
from dolfinx_tresca.scene.geometry import (
    ON_SURFACE,
    Geometry,
    Projection,
    open_pieces,
    project_points,
)
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.facets import Facets, cross_products, lagrange_points, tabulate

#: Degree of the interpolation of the offsets on a facet. With degree 2 the sagitta of a facet that
#: spans 30 degrees of a cylinder is 0.4 % too small, an error as large as the gap of close fits.
OFFSET_DEGREE = 4

#: Distance of a corner from its surface, relative to the size of the facet, beyond which the
#: geometry must be wrong. Nodes that could not be snapped to the surface are nearer than this.
FAR_CORNER = 0.5


def with_offsets(V: Any, pair: ContactPair, sides: dict[int, Facets]) -> dict[int, Facets]:
    """Return the sides of a pair with the `Facets.offsets` of their facets. Collective.

    The projections of `pair.geometry`, or else of the geometry that the pair's tags know, are
    evaluated at the nodes of a Lagrange basis of `OFFSET_DEGREE`. A side without a projection is
    returned unchanged. If a geometry that the user did not give fails, a warning is logged, and all
    sides are returned unchanged.

    Args:
        V: the space of the displacement.
        pair: the contact pair.
        sides: tag -> facets of a side that this rank owns, undeformed.

    Raises:
        InputError: a projection fails, or facets are not on their surface.
        MeshError: Gmsh cannot read the geometry file any more.
    """
    if isinstance(pair.primary, RigidObstacle):
        return sides
    if pair.geometry is not None:
        return _offset_sides(V, pair.geometry, sides, FAR_CORNER)
    geometry = getattr(pair.facet_tags, "geometry", None)
    if geometry is None or geometry.curved.keys().isdisjoint(sides):
        return sides
    try:
        return _offset_sides(V, geometry, sides, ON_SURFACE)
    except (InputError, MeshError) as error:
        log(
            V.mesh.comm,
            "contact pair %s: the curved surfaces in the file from which Gmsh made the mesh are "
            "not used: %s Smooth surfaces through the nodes take their place, as with "
            "ContactPair(geometry={}).",
            *(pair, f"{error}".rstrip(".") + "."),
            level=logging.WARNING,
            about=str(pair),
        )
        return sides


def _offset_sides(
    V: Any, geometry: Geometry, sides: dict[int, Facets], limit: float
) -> dict[int, Facets]:
    """Return the sides with the offsets to a geometry. Collective.

    `limit` is the largest distance of a corner from its surface, relative to the size of the facet:
    `FAR_CORNER`, or `ON_SURFACE` if the user did not ask for this geometry.

    Raises:
        InputError: a projection fails, or facets are not on their surface.
        MeshError: Gmsh cannot read the geometry file any more.
    """
    comm, result = V.mesh.comm, dict(sides)
    with errors_on_all_ranks(comm), open_pieces(geometry) as surfaces:
        for tag in sides.keys() & surfaces.keys():
            offsets = _offsets(sides[tag], tag, surfaces[tag], V.mesh.geometry.dim)
            result[tag] = replace(sides[tag], offsets=offsets)
    for tag, facets in result.items():
        size = np.ptp(facets.points, axis=1).max(axis=1)
        off = np.linalg.norm(facets.offsets[:, : facets.corners], axis=2).max(axis=1, initial=0.0)
        of_rank = [(off / size).max(initial=0.0), off.max(initial=0.0)]
        relative, distance = map(float, reduce_array(comm, of_rank, MPI.MAX))
        if relative > limit:
            raise InputError(
                f"facets with tag {tag} are not on their surface in `geometry`: a corner is "
                f"{distance:.2g} away from it, {relative:.2g} times the size of its facet. Give "
                "the geometry from which the mesh was made, in its units; for a mesh that was "
                "moved, give functions of points."
            )
    return result


def _offsets(facets: Facets, tag: int, pieces: Sequence[Projection], dim: int) -> Array:
    """Return the `Facets.offsets` of facets by projection onto their surface. Not collective.

    A facet belongs to the piece of the surface that is nearest to its corners; of pieces that all
    corners are on, to the one that is nearest to its centre. So a facet at an edge is not projected
    onto the surface beyond the edge.
    """
    points = np.einsum(
        "qk,nki->nqi", facets.basis(lagrange_points(facets.cell, OFFSET_DEGREE)), facets.points
    )

    def moves(piece: Projection, points: Array) -> Array:
        places, index = np.unique(points.reshape(-1, 3), axis=0, return_inverse=True)
        moved = project_points(places, f"geometry[{tag}]", piece, dim) - places
        return np.asarray(moved[index.ravel()].reshape(points.shape))

    if len(pieces) == 1:
        return moves(pieces[0], points)
    corners = points[:, : facets.corners]
    probes = np.concatenate([corners, corners.mean(axis=1, keepdims=True)], axis=1)
    away = np.stack([np.linalg.norm(moves(piece, probes), axis=2) for piece in pieces])
    of_corners = away[:, :, :-1].max(axis=2)
    rounding = ON_SURFACE * np.ptp(corners, axis=1).max(axis=1)
    tied = of_corners <= of_corners.min(axis=0) + rounding
    nearest = np.where(tied, away[:, :, -1], np.inf).argmin(axis=0)
    result: Array = np.zeros_like(points)
    for k, piece in enumerate(pieces):
        result[nearest == k] = moves(piece, points[nearest == k])
    return result


def any_known_surface(*sides: Facets) -> bool:
    """Return whether any of the sides has offsets to its exact surface. Not collective."""
    return any(side.offsets.shape[1] > 0 for side in sides)


def offsets_at(facets: Facets, facet: Indices, x: Array) -> Array:
    """Return the vectors (n, 3) from points on facets to the exact surface [length].

    Args:
        facets: the facets of the surface, with offsets.
        facet: (n,) the facet of each point.
        x: (n, dim) reference coordinates of each point.
    """
    values = tabulate(facets.cell, OFFSET_DEGREE, 0, x)[0]
    return np.asarray(np.einsum("nk,nki->ni", values, facets.offsets[facet]))


def normals_at(facets: Facets, facet: Indices, x: Array) -> Array:
    """Return outward unit normals (n, 3) of the surface of the facets with their offsets.

    The arguments are those of `offsets_at`.
    """
    along = sum(
        np.einsum("dnk,nki->dni", tabulate(facets.cell, degree, 1, x)[1:], vectors[facet])
        for degree, vectors in ((facets.degree, facets.points), (OFFSET_DEGREE, facets.offsets))
    )
    normals = cross_products(along) * facets.outward[facet, None]
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])
