"""Node-to-node pairing: for surfaces whose meshes match."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

import dolfinx

from dolfinx_tresca._parallel import gather_rows, log, reduce_array
from dolfinx_tresca.errors import PairingError
from dolfinx_tresca.pair import ContactPair
from dolfinx_tresca.pairing.operators import FloatArray, IntArray, PairOperators
from dolfinx_tresca.surface.nodes import SurfaceNodes, owned_facets, surface_nodes, tangents

#: Distance across the normal, over the size of the node's area, up to which two nodes match.
#: Meshes that match meet to rounding; curved ones with a gap between them a little less well.
MATCH = 0.05

#: Part of a direction that must not be prescribed for the node to carry a multiplier along it.
FREE = 0.1


def pair_nodes(V: Any, prescribed: npt.NDArray[np.bool_], pair: ContactPair) -> PairOperators:
    """Return N, T and the gap of a pair with matching meshes. Collective.

    Each secondary node meets the primary node that lies on its normal. Secondary nodes that face no
    primary facet take no part: only the overlap of the surfaces is in contact.

    Args:
        V: vector space of degree 1.
        prescribed: (owned dofs,) those with a Dirichlet condition.
        pair: the surfaces.

    Raises:
        PairingError: the meshes do not match, the surfaces do not overlap or do not face each
            other, or all secondary nodes are prescribed.
    """
    comm = V.mesh.comm
    secondary = surface_nodes(V, pair.facet_tags, pair.secondary, "secondary")
    primary = surface_nodes(V, pair.facet_tags, pair.primary, "primary")
    first = V.dofmap.index_map.local_range[0]
    numbers = gather_rows(comm, (primary.nodes + first).astype(np.int64))
    points, normals = gather_rows(comm, primary.points), gather_rows(comm, primary.normals)
    facets = gather_rows(comm, _facet_points(V.mesh, pair))
    partner = _partners(comm, secondary, points, normals, facets)

    own = (secondary.nodes + first).astype(np.int64)
    free = ~prescribed.reshape(-1, 3)[secondary.nodes]
    takes_part = (partner >= 0) & free.any(axis=1) & (own != numbers[partner])
    counts = [len(own), (partner < 0).sum(), takes_part.sum()]
    total, beyond, number = reduce_array(comm, counts)
    if number == 0:
        raise PairingError(
            f"no node of the secondary side (tag {pair.secondary}) can carry a multiplier: of its "
            f"{total} nodes {beyond} face no facet of the primary side (tag {pair.primary}), and "
            "the displacement of the others is prescribed, or shared with the primary side."
        )
    log(
        comm,
        "pairing: node-to-node, %d of %d secondary nodes take part (%d face no primary node, "
        "%d are prescribed or shared)",
        *(number, total, beyond, total - beyond - number),
    )

    keep = np.flatnonzero(takes_part)
    partner, own, free = partner[keep], own[keep], free[keep]
    size = 3 * V.dofmap.index_map.size_global
    normal, normal_node = _free_normals(secondary.normals[keep], free)
    tangent, tangent_node = _free_tangents(normal, free)

    def rows(directions: FloatArray, node: IntArray) -> Any:
        columns = np.stack([own[node], numbers[partner[node]]], axis=1)[:, :, None] * 3 + np.arange(
            3
        )
        values = np.stack([directions, -directions], axis=1)
        pointers = np.arange(0, 6 * len(node) + 1, 6)
        return csr_array((values.ravel(), columns.ravel(), pointers), shape=(len(node), size))

    return PairOperators(
        nodes=secondary.nodes[keep],
        weights=secondary.weights[keep],
        normals=normal,
        gap=np.einsum("ni,ni->n", points[partner] - secondary.points[keep], normal),
        N=rows(normal[normal_node], normal_node),
        normal_node=normal_node,
        T=rows(tangent, tangent_node),
        tangents=tangent,
        tangent_node=tangent_node,
    )


def _facet_points(mesh: Any, pair: ContactPair) -> FloatArray:
    """Return the corners (facets, corners, 3) of this rank's facets of the primary side."""
    dim = pair.facet_tags.dim
    facets = owned_facets(mesh, pair.facet_tags, pair.primary)
    mesh.topology.create_connectivity(dim, 0)
    mesh.topology.create_connectivity(dim, dim + 1)
    mesh.topology.create_connectivity(dim + 1, dim)
    hexahedra = mesh.topology.cell_type == dolfinx.mesh.CellType.hexahedron
    if len(facets) == 0:  # DOLFINx 0.9 divides by zero for no entities
        return np.empty((0, 4 if hexahedra else 3, 3))
    corners: FloatArray = mesh.geometry.x[
        dolfinx.mesh.entities_to_geometry(mesh, dim, facets, False)
    ]
    # from tensor-product order to a walk round the quadrilateral
    return corners[:, [0, 1, 3, 2]] if hexahedra else corners


def _partners(
    comm: Any, secondary: SurfaceNodes, points: FloatArray, normals: FloatArray, facets: FloatArray
) -> npt.NDArray[np.intp]:
    """Return for each secondary node its primary node, -1 beyond the primary side. Collective."""
    x, n = secondary.points, secondary.normals
    size = np.sqrt(secondary.weights)
    number = min(8, len(points))
    near = cKDTree(points).query(x, k=number)[1].reshape(len(x), number)
    way = points[near] - x[:, None]
    along = np.einsum("nki,ni->nk", way, n)
    across = np.linalg.norm(way - along[:, :, None] * n[:, None], axis=2)
    facing = np.einsum("nki,ni->nk", normals[near], n) < 0.0
    # the least distance across the normal; of two as good the nearer, where both sides are tagged
    rank = np.where(facing, across + 1e-6 * np.abs(along), np.inf)
    best = (np.arange(len(x)), rank.argmin(axis=1))
    partner, distance, opposed = near[best], across[best] / size, facing[best]
    matched = (distance <= MATCH) & opposed
    faces = matched | _faces_any(x, n, facets)
    mismatch = np.where(faces & ~matched & opposed, distance, 0.0)
    worst = int(mismatch.argmax()) if len(mismatch) else 0
    report = (float(mismatch.max(initial=0.0)), x[worst].tolist() if len(x) else [],
              int((faces & ~matched & opposed).sum()))  # fmt: skip
    reports = comm.allgather(report)
    if sum(entry[2] for entry in reports) > 0:
        value, where, _ = max(reports)
        raise PairingError(
            f"the meshes of the two surfaces do not match: {sum(entry[2] for entry in reports)} "
            "secondary nodes face the primary side away from its nodes; the worst, at "
            f"{tuple(round(c, 6) for c in where)}, by {value:.2f} times its own size (allowed: "
            f"{MATCH}). Mesh both surfaces alike."
        )
    wrong, good = reduce_array(comm, [(faces & ~opposed).sum(), matched.sum()])
    if wrong > 0 and good == 0:
        raise PairingError(
            "the surfaces do not face each other: their outward normals point the same way. Check "
            "the tags."
        )
    _, times = np.unique(gather_rows(comm, partner[matched]), return_counts=True)
    if times.max(initial=1) > 1:
        raise PairingError(
            f"the meshes of the two surfaces do not match: {int((times > 1).sum())} primary nodes "
            "face more than one secondary node. Mesh both surfaces alike."
        )
    return np.where(matched, partner, -1)


def _faces_any(x: FloatArray, n: FloatArray, facets: FloatArray) -> npt.NDArray[np.bool_]:
    """Return for each point whether the line along its normal meets a nearby facet."""
    number = min(16, len(facets))
    near = cKDTree(facets.mean(axis=1)).query(x, k=number)[1].reshape(len(x), number)
    corners = facets[near] - x[:, None, None]
    following = np.roll(corners, -1, axis=2)
    turns = np.einsum("nfci,ni->nfc", np.cross(corners, following), n)
    rounding = 1e-9 * np.abs(turns).sum(axis=2, keepdims=True)
    inside = (turns > -rounding).all(axis=2) | (turns < rounding).all(axis=2)
    return np.asarray(inside.any(axis=1))


def _free_normals(normals: FloatArray, free: npt.NDArray[np.bool_]) -> tuple[FloatArray, IntArray]:
    """Return unit normals within the directions that are free, and the nodes that have such a one.

    At the edge of a curved surface on a symmetry plane the discrete normal leans out of the plane a
    little; without its prescribed part it is orthogonal to the tangents that are left.
    """
    movable = np.where(free, normals, 0.0)
    length = np.linalg.norm(movable, axis=1)
    has = length > FREE
    result = np.where(has[:, None], movable / np.where(has, length, 1.0)[:, None], normals)
    return result, np.flatnonzero(has).astype(np.int32)


def _free_tangents(normals: FloatArray, free: npt.NDArray[np.bool_]) -> tuple[FloatArray, IntArray]:
    """Return the tangents (n_tangential, 3) along which nodes can move, and the node of each."""
    pairs = tangents(normals)
    some = np.flatnonzero(~free.all(axis=1))
    keep = np.ones((len(normals), 2), dtype=np.bool_)
    # where part of the displacement is prescribed, turn the tangents into and out of that direction
    mobility = np.einsum("nai,ni,nbi->nab", pairs[some], free[some].astype(float), pairs[some])
    values, vectors = np.linalg.eigh(mobility)
    pairs[some] = np.einsum("nba,nbi->nai", vectors, pairs[some])
    keep[some] = values > FREE
    return pairs[keep], np.nonzero(keep)[0].astype(np.int32)
