"""Offsets from facets to the exact surfaces that they approximate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.search.facets import Facets, cross_products, lagrange_points, tabulate
from dolfinx_tresca.scene.geometry import Projection, open_projections, project_points
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair

#: Degree of the interpolation of the offsets on a facet. With degree 2 the sagitta of a facet that
#: spans 30 degrees of a cylinder is 0.4 % too small, an error as large as the gap of close fits.
OFFSET_DEGREE = 4

#: Distance of a corner from its surface, relative to the size of the facet, beyond which the
#: geometry must be wrong. Nodes that could not be snapped to the surface are nearer than this.
FAR_CORNER = 0.5


def with_offsets(V: Any, pair: ContactPair, sides: dict[int, Facets]) -> dict[int, Facets]:
    """Return the sides of a pair with the `Facets.offsets` of their facets. Collective.

    The projections of `pair.geometry` are evaluated at the nodes of a Lagrange basis of
    `OFFSET_DEGREE`. A side without a projection is returned unchanged.

    Args:
        V: the space of the displacement.
        pair: the contact pair.
        sides: tag -> facets of a side that this rank owns, undeformed.

    Raises:
        InputError: a projection fails, or facets are not on their surface.
        MeshError: Gmsh cannot read the geometry file any more.
    """
    if pair.geometry is None or isinstance(pair.primary, RigidObstacle):
        return sides
    result = dict(sides)
    with errors_on_all_ranks(V.mesh.comm), open_projections(pair.geometry) as surfaces:
        for tag, facets in sides.items():
            if tag in surfaces:
                offsets = _offsets(facets, tag, surfaces[tag], V.mesh.geometry.dim)
                result[tag] = replace(facets, offsets=offsets)
    for tag, facets in result.items():
        if any_known_surface(facets):
            _check_corners(V.mesh.comm, tag, facets)
    return result


def _offsets(facets: Facets, tag: int, projection: Projection, dim: int) -> Array:
    """Return the `Facets.offsets` of facets by a projection onto their surface. Not collective."""
    values = facets.basis(lagrange_points(facets.cell, OFFSET_DEGREE))
    points = np.einsum("qk,nki->nqi", values, facets.points)
    places, index = np.unique(points.reshape(-1, 3), axis=0, return_inverse=True)
    moved = (project_points(places, f"geometry[{tag}]", projection, dim) - places)[index.ravel()]
    return np.asarray(moved.reshape(points.shape))


def _check_corners(comm: MPI.Comm, tag: int, facets: Facets) -> None:
    """Check that all corners are near their surface, see `FAR_CORNER`. Collective.

    Raises:
        InputError: a corner is too far away.
    """
    size = np.ptp(facets.points, axis=1).max(axis=1)
    off = np.linalg.norm(facets.offsets[:, : facets.corners], axis=2).max(axis=1, initial=0.0)
    worst = float(reduce_array(comm, (off / size).max(initial=0.0), MPI.MAX))
    if worst > FAR_CORNER:
        raise InputError(
            f"facets with tag {tag} are not on their surface in `geometry`: the distance of a "
            f"corner is {worst:.2g} times the size of its facet. Give the geometry from which the "
            "mesh was made, in its units; for a mesh that was moved, give functions of points."
        )


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
