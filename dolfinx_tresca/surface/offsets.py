"""Where the surfaces that facets stand for are, by the geometry that the mesh was made of."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.scene.geometry import Projection, open_projections, project_points
from dolfinx_tresca.scene.obstacle import RigidObstacle
from dolfinx_tresca.scene.pair import ContactPair
from dolfinx_tresca.surface.facets import Facets, cross_products, lagrange_points, tabulate
from dolfinx_tresca.surface.tagged import tagged_facets

#: Degree of the surface over its facets: with 2 a facet across 30 degrees of a cylinder has 0.4 %
#: of its height too little, which may be as much as bodies that fit closely overlap by.
DEGREE = 4

#: Distance of a corner from its surface, over the size of a facet, that is a mistake: where nodes
#: could not be moved to the surface they are nearer.
FAR_CORNER = 0.5


def surface_offsets(V: Any, prescribed: Mask, pair: ContactPair) -> dict[int, Array]:
    """Return tag -> `Facets.offsets` of the facets that this rank owns. Collective.

    For the sides whose geometry the pair tells, which is asked for the nodes of `DEGREE`.

    Args:
        V: vector space of degree 1 or 2.
        prescribed: (owned dofs,) those with a Dirichlet condition.
        pair: the surfaces.

    Raises:
        InputError: a projection fails, or facets are not on their surface.
        MeshError: Gmsh cannot read its file any more.
    """
    if pair.geometry is None or isinstance(pair.primary, RigidObstacle):
        return {}
    sides = {
        tag: tagged_facets(V, prescribed, pair.facet_tags, tag, name)
        for tag, name in ((pair.secondary, "secondary"), (pair.primary, "primary"))
    }
    found: dict[int, Array] = {}
    with errors_on_all_ranks(V.mesh.comm), open_projections(pair.geometry) as surfaces:
        for tag, facets in sides.items():
            if tag in surfaces:
                found[tag] = _offsets(facets, tag, surfaces[tag], V.mesh.geometry.dim)
    for tag, offsets in found.items():
        _check_corners(V.mesh.comm, tag, sides[tag], offsets)
    return found


def _offsets(facets: Facets, tag: int, projection: Projection, dim: int) -> Array:
    """Return `Facets.offsets` to a surface. Not collective."""
    values = facets.basis(lagrange_points(facets.cell, DEGREE))
    points = np.einsum("qk,nki->nqi", values, facets.points)
    places, index = np.unique(points.reshape(-1, 3), axis=0, return_inverse=True)
    moved = (project_points(places, f"geometry[{tag}]", projection, dim) - places)[index.ravel()]
    return np.asarray(moved.reshape(points.shape))


def _check_corners(comm: MPI.Comm, tag: int, facets: Facets, offsets: Array) -> None:
    """Check that corners are on their surface, about. Collective.

    Raises:
        InputError: they are not.
    """
    size = np.ptp(facets.points, axis=1).max(axis=1)
    off = np.linalg.norm(offsets[:, : facets.corners], axis=2).max(axis=1, initial=0.0) / size
    worst = float(reduce_array(comm, off.max(initial=0.0), MPI.MAX))
    if worst > FAR_CORNER:
        raise InputError(
            f"facets with tag {tag} are not on the surface that geometry has for them: a corner is "
            f"{worst:.2g} times the size of its facet away. Give the geometry that the mesh was "
            "made of, in its units; for a mesh that was moved since, functions of points."
        )


def known_surfaces(*sides: Facets) -> bool:
    """Return whether it is known of a side where its surface is. Not collective."""
    return any(side.offsets.shape[1] > 0 for side in sides)


def offsets_at(facets: Facets, facet: Indices, x: Array) -> Array:
    """Return the vectors (n, 3) from points of facets to their known surface [length].

    Args:
        facets: of the surface.
        facet: (n,) facets.
        x: (n, dim) reference points, one for each of them.
    """
    values = tabulate(facets.cell, DEGREE, 0, x)[0]
    return np.asarray(np.einsum("nk,nki->ni", values, facets.offsets[facet]))


def normals_at(facets: Facets, facet: Indices, x: Array) -> Array:
    """Return outward unit normals (n, 3) of the known surface of facets, as `offsets_at`."""
    along = sum(
        np.einsum("dnk,nki->dni", tabulate(facets.cell, degree, 1, x)[1:], vectors[facet])
        for degree, vectors in ((facets.degree, facets.points), (DEGREE, facets.offsets))
    )
    normals = cross_products(along) * facets.outward[facet, None]
    return np.asarray(normals / np.linalg.norm(normals, axis=1)[:, None])
