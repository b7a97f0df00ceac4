"""The facets with a tag: extraction from a mesh, and offsets to the exact surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np

import basix
import dolfinx

from dolfinx_tresca._base.arrays import Array, Indices, Mask
from dolfinx_tresca._base.functions import entities_per_cell, numbers_in_file, with_owned_values
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array, row_of_least, warn
from dolfinx_tresca.errors import InputError, MeshError, PairingError
from dolfinx_tresca.pairing.search.facets import (
    MESH_ROUNDING,
    Facets,
    cross_products,
    lagrange_points,
    quadrature,
    tabulate,
)
from dolfinx_tresca.scene.geometry import (
    ON_SURFACE,
    Geometry,
    Projection,
    open_geometry,
    project_points,
)
from dolfinx_tresca.scene.pair import ContactPair

#: Degree of the interpolation of the offsets on a facet. With degree 2 the sagitta of a facet that
#: spans 30 degrees of a cylinder is 0.4 % too small, an error as large as the gap of close fits.
OFFSET_DEGREE = 4

#: Distance of a corner from its surface, relative to the size of the facet, beyond which the
#: geometry must be wrong. Nodes that could not be snapped to the surface are nearer than this.
FAR_CORNER = 0.5


def tagged_facets(V: Any, prescribed: Mask, facet_tags: Any, tag: int, side: str) -> Facets:
    """Return the facets with a tag that this rank owns. Collective.

    Args:
        V: vector space of degree 1 or 2.
        prescribed: (owned dofs,) whether a Dirichlet condition prescribes the degree of freedom.
        facet_tags: tags of the facets of V's mesh.
        tag: the tag of the surface.
        side: "secondary" or "primary", for error messages.

    Raises:
        InputError: no facet has the tag.
        PairingError: facets are inside a body, or have no area.
    """
    mesh = V.mesh
    comm, dim = mesh.comm, mesh.topology.dim - 1
    for entity, neighbour in ((dim, dim + 1), (dim + 1, dim)):
        mesh.topology.create_connectivity(entity, neighbour)
    facets = facet_tags.find(tag)
    facets = facets[facets < mesh.topology.index_map(dim).size_local]
    exterior = np.isin(facets, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    number, outside = comm.allreduce(np.array([len(facets), exterior.sum()]))
    if number == 0:
        in_use = sorted(set().union(*comm.allgather(np.unique(facet_tags.values).tolist())))
        raise InputError(
            f"no facet has the tag {tag} of the {side} side; the tags in use are {in_use}."
        )
    if outside < number:
        raise PairingError(
            f"{number - outside} of the {number} facets with tag {tag} ({side} side) lie inside a "
            "body: contact needs two surfaces with nodes of their own. Do not merge the nodes of "
            "the bodies when meshing."
        )

    dofmap = V.dofmap
    to_cell = mesh.topology.connectivity(dim, dim + 1)
    cells = to_cell.array[to_cell.offsets[facets]]
    kinds = basix.cell.subentity_types(V.element.basix_element.cell_type)[dim]
    cell, sides = kinds[0].name, len(kinds)
    of_cell = mesh.topology.connectivity(dim + 1, dim).array.reshape(-1, sides)
    place = (of_cell[cells] == facets[:, None]).argmax(axis=1)
    closures = [dofmap.dof_layout.entity_closure_dofs(dim, i) for i in range(sides)]
    corners = len(lagrange_points(cell, 1))

    x = V.tabulate_dof_coordinates()
    cell_nodes = dofmap.list[cells]
    nodes = np.take_along_axis(cell_nodes, np.array(closures)[place], axis=1)
    points = x[nodes]
    middle = x[cell_nodes[:, : entities_per_cell(V, 0)]].mean(axis=1)
    free = with_owned_values(V, (~prescribed).astype(np.float64)).x.array
    is_free = free.reshape(-1, dofmap.index_map_bs) > 0.5
    numbers = dofmap.index_map.local_to_global(nodes.ravel().astype(np.int32)).reshape(nodes.shape)
    result = Facets(
        cell,
        V.element.basix_element.degree,
        np.asarray(numbers, dtype=np.int64),
        points,
        is_free[nodes[:, :corners]],
        numbers_in_file(V)[nodes[:, :corners]],
        outward=np.ones(len(facets)),
        offsets=np.zeros((len(facets), 0, 3)),
        origins=np.zeros((len(facets), 0)),
        tag_index=np.zeros(len(facets), dtype=np.intp),
        bent=False,
    ).moved_to(points)
    ahead = points[:, :corners].mean(axis=1) - middle
    vectors = result.area_vectors(quadrature(cell, 1)[0])[:, 0]
    result.outward[np.einsum("ni,ni->n", vectors, ahead) < 0.0] = -1.0
    return checked(comm, result, f"tag {tag}", side)


def checked(comm: MPI.Comm, facets: Facets, surface: str, side: str) -> Facets:
    """Check the areas of facets; return the facets with `bent` set for all ranks.

    Before the call it may describe the facets of this rank only. Collective.

    Raises:
        PairingError: a facet has no area.
    """
    size = np.linalg.norm(np.ptp(facets.points, axis=1), axis=1)
    largest, bent = reduce_array(comm, [size.max(initial=0.0), float(facets.bent)], MPI.MAX)
    points, weights = quadrature(facets.cell, 2 * facets.degree)
    area = np.linalg.norm(facets.area_vectors(points), axis=2) @ weights
    # in 2D the area of a facet is its size, so it is compared with the largest facet
    whole = size**2 if facets.dim == 2 else largest
    flat = area <= (MESH_ROUNDING + facets.rounding) * whole
    number, total = reduce_array(comm, np.array([flat.sum(), len(flat)]))
    if number > 0:
        where = row_of_least(comm, facets.file_numbers[flat, 0], facets.points[flat].mean(axis=1))
        raise PairingError(
            f"{number} of the {total} facets of {surface} ({side} side) have no area; "
            f"one is at {tuple(float(f'{c:.6g}') for c in where)}. Repair the mesh there."
        )
    return replace(facets, bent=bool(bent))


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
    if pair.obstacle is not None:
        return sides
    if pair.geometry is not None:
        return _offset_sides(V, pair.geometry, sides, FAR_CORNER)
    geometry = getattr(pair.facet_tags, "geometry", None)
    if geometry is None or geometry.curved.keys().isdisjoint(sides):
        return sides
    try:
        return _offset_sides(V, geometry, sides, ON_SURFACE)
    except (InputError, MeshError) as error:
        warn(
            V.mesh.comm,
            "contact pair %s: the curved surfaces in the file from which Gmsh made the mesh are "
            "not used: %s Smooth surfaces through the nodes take their place, as with "
            "ContactPair(geometry={}).",
            *(pair, f"{error}".rstrip(".") + "."),
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
    with errors_on_all_ranks(comm), open_geometry(geometry) as surfaces:
        known_tags = sorted(sides.keys() & surfaces.keys())
        for tag, facets in sides.items() if known_tags else ():
            count = len(lagrange_points(facets.cell, OFFSET_DEGREE))
            offsets: Array = np.full((len(facets.points), count, 3), np.nan)
            if tag in known_tags:
                offsets = _offsets(facets, tag, surfaces[tag].pieces, V.mesh.geometry.dim)
            result[tag] = replace(facets, offsets=offsets)
    for tag in known_tags:
        facets = result[tag]
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
