"""Extraction of the facets with a tag from a mesh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np

import dolfinx

from dolfinx_tresca._base.arrays import Array, LocalNumbers, Mask
from dolfinx_tresca._base.compat import same_topology
from dolfinx_tresca._base.exchange import row_of_least
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array
from dolfinx_tresca._base.vertices import entities_per_cell, numbers_in_file
from dolfinx_tresca.errors import InputError, PairingError
from dolfinx_tresca.pairing.search.facets import Facets, oriented, quadrature

#: Area of a facet relative to the square of its size, in 2D its length relative to the longest
#: facet, up to which the facet counts as degenerate, in addition to the rounding of coordinates.
AREA_ROUNDING = 1e-10


def tagged_facets(V: Any, prescribed: Mask, facet_tags: Any, tag: int, side: str) -> Facets:
    """Return the facets with a tag that this rank owns. Collective.

    Args:
        V: vector space of degree 1 or 2.
        prescribed: (owned dofs,) whether a Dirichlet condition prescribes the degree of freedom.
        facet_tags: tags of the facets of V's mesh.
        tag: the tag of the surface.
        side: "secondary" or "primary", for error messages.

    Raises:
        InputError: the tags belong to another mesh or to entities other than facets, or no facet
            has the tag.
        PairingError: facets are inside a body, or have no area.
    """
    mesh = V.mesh
    comm, dim = mesh.comm, mesh.topology.dim - 1
    with errors_on_all_ranks(comm):
        if not same_topology(facet_tags, mesh):
            raise InputError(
                "facet_tags belong to another mesh than the function space of the forms."
            )
        if facet_tags.dim != dim:
            raise InputError(
                f"facet_tags mark entities of dimension {facet_tags.dim}, facets have {dim}."
            )
    for first, second in ((dim, dim + 1), (dim + 1, dim)):
        mesh.topology.create_connectivity(first, second)
    facets = facet_tags.find(tag)
    facets = facets[facets < mesh.topology.index_map(dim).size_local]
    exterior = np.isin(facets, dolfinx.mesh.exterior_facet_indices(mesh.topology))
    number, outside = comm.allreduce(np.array([len(facets), exterior.sum()]))
    if number == 0:
        known = sorted(set().union(*comm.allgather(set(np.unique(facet_tags.values).tolist()))))
        raise InputError(
            f"no facet has the tag {tag} of the {side} side; the tags in use are {known}."
        )
    if outside < number:
        raise PairingError(
            f"{number - outside} of the {number} facets with tag {tag} ({side} side) lie inside a "
            "body: contact needs two surfaces with nodes of their own. Do not merge the nodes of "
            "the bodies when meshing."
        )

    result = _facets_with_nodes(V, prescribed, facets)
    return checked(comm, result, f"tag {tag}", side)


def displaced(V: Any, facets: Facets, u: Array, surface: str, side: str) -> Facets:
    """Return facets that this rank owns, displaced; their `offsets` turn with them. Collective.

    Args:
        V: the space of the displacement.
        facets: the undeformed facets.
        u: (nodes, dim of space) displacement of this rank's nodes [length].
        surface: the name or the tags of the surface, for error messages.
        side: "secondary" or "primary", for error messages.

    Raises:
        PairingError: displaced facets have no area.
    """
    node = V.dofmap.index_map.global_to_local(facets.nodes.ravel()).reshape(facets.nodes.shape)
    points = facets.points.copy()
    points[:, :, : u.shape[1]] += u[node]
    moved = facets.moved_to(points)
    if facets.offsets.shape[1]:
        local = np.einsum("nqi,ndi->nqd", facets.offsets, facets.frames())
        moved = replace(moved, offsets=np.einsum("nqd,ndi->nqi", local, moved.frames()))
    return checked(V.mesh.comm, moved, surface, side)


def checked(comm: MPI.Comm, facets: Facets, surface: str, side: str) -> Facets:
    """Check the areas of facets; return the facets with `bent` and `plane` set for all ranks.

    Before the call these two may describe the facets of this rank only. Collective.

    Raises:
        PairingError: a facet has no area.
    """
    size = np.linalg.norm(np.ptp(facets.points, axis=1), axis=1)
    of_rank = [float(size.max(initial=0.0)), float(facets.bent), float(not facets.plane)]
    largest, bent, uneven = reduce_array(comm, of_rank, MPI.MAX)
    # in 2D the area of a facet is its size, so it is compared with the largest facet
    _check_areas(comm, facets, size**2 if facets.dim == 2 else largest, surface, side)
    return replace(facets, bent=bool(bent), plane=not uneven)


def _facets_with_nodes(V: Any, prescribed: Mask, facets: LocalNumbers) -> Facets:
    """Return the facets with local numbers (n,) of the mesh as `Facets`. Collective."""
    mesh, dofmap = V.mesh, V.dofmap
    dim = mesh.topology.dim - 1
    to_cell = mesh.topology.connectivity(dim, dim + 1)
    cells = to_cell.array[to_cell.offsets[facets]]
    kind = dolfinx.mesh.to_string(mesh.topology.cell_type)
    cell = {"triangle": "interval", "quadrilateral": "interval", "tetrahedron": "triangle",
            "hexahedron": "quadrilateral"}[kind]  # fmt: skip
    sides = entities_per_cell(V, dim)
    of_cell = mesh.topology.connectivity(dim + 1, dim).array.reshape(-1, sides)
    side = (of_cell[cells] == facets[:, None]).argmax(axis=1) if len(facets) else facets
    closures = np.array(
        [dofmap.dof_layout.entity_closure_dofs(dim, i) for i in range(sides)], dtype=np.int64
    )
    closure = closures[side]
    corners = {"interval": 2, "triangle": 3, "quadrilateral": 4}[cell]

    x = V.tabulate_dof_coordinates()
    cell_nodes = dofmap.list[cells]
    nodes = np.take_along_axis(cell_nodes, closure, axis=1)
    points = x[nodes]
    middle = x[cell_nodes[:, : entities_per_cell(V, 0)]].mean(axis=1)
    free = _free_with_ghosts(V, prescribed)
    numbers = dofmap.index_map.local_to_global(nodes.ravel().astype(np.int32)).reshape(nodes.shape)
    return oriented(
        cell,
        V.element.basix_element.degree,
        np.asarray(numbers, dtype=np.int64),
        points,
        free[nodes[:, :corners]],
        numbers_in_file(V)[nodes[:, :corners]],
        middle,
    )


def _free_with_ghosts(V: Any, prescribed: Mask) -> Mask:
    """Return a mask (nodes, dim of space) of the free components of this rank's nodes.

    Collective.
    """
    dim = V.dofmap.index_map_bs
    vector = dolfinx.la.vector(V.dofmap.index_map, dim, np.float64)
    vector.array[: len(prescribed)] = ~prescribed
    vector.scatter_forward()
    return np.asarray(vector.array.reshape(-1, dim) > 0.5)


def _check_areas(
    comm: MPI.Comm, facets: Facets, whole: Array | float, surface: str, side: str
) -> None:
    """Check that no facet is degenerate: its area must not be rounding, compared with `whole`.

    `whole` is one value for all facets, or an array (n,). Collective.

    Raises:
        PairingError: a facet has no area.
    """
    points, weights = quadrature(facets.cell, 2 * facets.degree)
    area = np.linalg.norm(facets.area_vectors(points), axis=2) @ weights
    flat = area <= (AREA_ROUNDING + facets.rounding) * whole
    number, total = reduce_array(comm, np.array([flat.sum(), len(flat)]))
    if number > 0:
        where = row_of_least(comm, facets.file_numbers[flat, 0], facets.points[flat].mean(axis=1))
        raise PairingError(
            f"{number} of the {total} facets of {surface} ({side} side) have no area; "
            f"one is at {tuple(float(f'{c:.6g}') for c in where)}. Repair the mesh there."
        )
