"""The nodes of a tagged surface with their weights and normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import dolfinx
import ufl
from dolfinx import fem

from dolfinx_tresca._compat import same_topology
from dolfinx_tresca._parallel import errors_on_all_ranks, reduce_array
from dolfinx_tresca.errors import InputError, PairingError


@dataclass(frozen=True)
class SurfaceNodes:
    """Nodes of a surface that this rank owns.

    Attributes:
        nodes: (n,) their numbers (blocks of V) on this rank.
        points: (n, 3) where they are [length].
        weights: (n,) area of each node: the integral of its basis function [length^2].
        normals: (n, 3) outward unit normals, averaged over the facets around the node.
    """

    nodes: npt.NDArray[np.int32]
    points: npt.NDArray[np.float64]
    weights: npt.NDArray[np.float64]
    normals: npt.NDArray[np.float64]


def surface_nodes(V: Any, facet_tags: Any, tag: int, side: str) -> SurfaceNodes:
    """Return the nodes of the facets with a tag. Collective.

    Args:
        V: vector space of degree 1.
        facet_tags: tags of the facets of its mesh.
        tag: the surface.
        side: "secondary" or "primary", for error messages.

    Raises:
        InputError: the tags belong to another mesh or to other entities, or the tag marks nothing.
        PairingError: the tag marks facets inside a body.
    """
    mesh = V.mesh
    comm = mesh.comm
    dim = mesh.topology.dim - 1
    with errors_on_all_ranks(comm):
        if not same_topology(facet_tags, mesh):
            raise InputError(
                "facet_tags belong to another mesh than the function space of the forms."
            )
        if facet_tags.dim != dim:
            raise InputError(
                f"facet_tags mark entities of dimension {facet_tags.dim}, facets have {dim}."
            )
    facets = owned_facets(mesh, facet_tags, tag)
    mesh.topology.create_connectivity(dim, dim + 1)
    exterior = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    number, outside = reduce_array(comm, [len(facets), np.isin(facets, exterior).sum()])
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

    v = ufl.TestFunction(V)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=facet_tags, subdomain_id=tag)
    one = ufl.as_vector([1.0] * 3)
    weights = _assemble(V, ufl.inner(one, v) * ds)[:, 0]
    areas = _assemble(V, ufl.inner(ufl.FacetNormal(mesh), v) * ds)
    nodes = np.flatnonzero(weights > 0.0).astype(np.int32)
    lengths = np.linalg.norm(areas[nodes], axis=1)
    with errors_on_all_ranks(comm):
        folded = lengths <= 1e-6 * weights[nodes]
        if folded.any():
            where = V.tabulate_dof_coordinates()[nodes[folded][0]]
            raise PairingError(
                f"the surface with tag {tag} ({side} side) has no normal at {where}: the normals "
                "of the facets around that node cancel. Give the two faces of a thin sheet "
                "different tags."
            )
    return SurfaceNodes(
        nodes,
        V.tabulate_dof_coordinates()[nodes],
        weights[nodes],
        areas[nodes] / lengths[:, None],
    )


def owned_facets(mesh: Any, facet_tags: Any, tag: int) -> npt.NDArray[np.int32]:
    """Return the facets with a tag that this rank owns. Not collective."""
    facets: npt.NDArray[np.int32] = facet_tags.find(tag)
    mine = facets < mesh.topology.index_map(facet_tags.dim).size_local
    return np.asarray(facets[mine])


def _assemble(V: Any, form: Any) -> npt.NDArray[np.float64]:
    """Return the assembled form at the owned nodes, (nodes, 3)."""
    vector = fem.Function(V)
    fem.assemble_vector(vector.x.array, fem.form(form))
    vector.x.scatter_reverse(dolfinx.la.InsertMode.add)
    owned: npt.NDArray[np.float64] = vector.x.array.reshape(-1, 3)
    return owned[: V.dofmap.index_map.size_local]


def tangents(normals: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return orthonormal tangent pairs (n, 2, 3) for unit normals (n, 3). Not collective.

    The first tangent is the projection of the coordinate axis that is farthest from the normal.
    """
    axis = np.eye(3)[np.abs(normals).argmin(axis=1)]
    first = axis - np.einsum("ni,ni->n", axis, normals)[:, None] * normals
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normals, first)], axis=1)
