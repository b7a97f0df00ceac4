"""Tractions and slip of a solution at the nodes of another mesh."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices, LocalNumbers, Mask
from dolfinx_tresca._base.parallel import exchange
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.pairing.search.balls import bounding_box
from dolfinx_tresca.solution.fields import ContactState, SurfaceFields


def stress_from(surfaces: Sequence[SurfaceFields], jump: JumpOperator) -> Array:
    """Return multipliers (size,) [stress] for a first guess, from tractions on another mesh.

    Collective.

    Args:
        surfaces: fields of the solution on the other mesh, one for each pair.
        jump: the operator B on the new mesh.
    """
    result = np.zeros(len(jump.gap))
    x = jump.system.V.tabulate_dof_coordinates()
    for rows, fields in zip(jump.by_pair, surfaces, strict=True):
        pair = rows.operators
        pressure, traction = tractions_at(fields, x[pair.nodes])
        result[rows.normal] = pressure[pair.normal_node]
        result[rows.tangential] = np.einsum("ni,ni->n", traction[pair.tangent_node], pair.tangents)
    return result


def slip_from(surfaces: Sequence[SurfaceFields], jump: JumpOperator) -> list[Array]:
    """Return slip vectors and paths from a solution on another mesh. Collective.

    Nodes of the other mesh without a multiplier have no slip and are left out of the interpolation.

    Args:
        surfaces: fields of the solution on the other mesh, one for each pair.
        jump: the operator B on the new mesh.

    Returns:
        slip vectors and lengths of paths (n, d + 1) at the nodes of each pair [length].
    """
    x = jump.system.V.tabulate_dof_coordinates()
    counts = [len(pair.nodes) for pair in jump.pairs]
    result = np.zeros((sum(counts), 1 + jump.system.V.mesh.geometry.dim))
    for rows, fields in zip(jump.by_pair, surfaces, strict=True):
        if fields.slip is not None and fields.slip_path is not None:
            carries = fields.state.x.array != ContactState.OUTSIDE
            values = np.column_stack([_values(fields, fields.slip), fields.slip_path.x.array])
            result[rows.nodes] = _values_at_points(fields, values, x[rows.operators.nodes], carries)
    return np.split(result, np.cumsum(counts)[:-1])


def tractions_at(fields: SurfaceFields, points: Array) -> tuple[Array, Array]:
    """Return pressures (n,) and tangential tractions (n, d) [stress] near points. Collective.

    They are zero at points whose distance from the surface exceeds the longest edge of the surface.

    Args:
        fields: fields of a solution on any mesh.
        points: (n, 3) points of this rank [length]; each rank has its own points.
    """
    tractions = _values(fields, fields.traction)
    values = np.column_stack([fields.pressure.x.array, tractions])
    interpolated = _values_at_points(fields, values, points, np.ones(len(values), dtype=np.bool_))
    return interpolated[:, 0], interpolated[:, 1:]


def _values(fields: SurfaceFields, function: fem.Function | None) -> Array:
    """Return the nodal vectors (nodes, d) of a function; zeros if it is None."""
    dim, count = fields.mesh.geometry.dim, len(fields.pressure.x.array)
    return np.zeros((count, dim)) if function is None else function.x.array.reshape(-1, dim)


def _values_at_points(fields: SurfaceFields, values: Array, points: Array, usable: Mask) -> Array:
    """Return values (n, k) interpolated on the facets nearest to points. Collective.

    Facets without a node that carries multipliers are left out, such as those of other pairs.
    At points on the facets linear fields are reproduced exactly, for instance at the midpoints of
    edges, where refined meshes have nodes. Values are zero at points whose distance from the
    surface exceeds the longest edge of the surface.

    Args:
        fields: fields of a solution on any mesh.
        values: (nodes, k) values at the nodes of the surface on this rank, ghosts included.
        points: (n, 3) points of this rank [length]; each rank has its own points.
        usable: (nodes,) whether the value of a node is used.
    """
    comm = fields.mesh.comm
    V = fields.pressure.function_space
    places = V.tabulate_dof_coordinates()
    reach = comm.allreduce(_longest_edge(places[V.dofmap.list]), op=MPI.MAX)
    boxes = comm.allgather(bounding_box(places))
    near = []
    for box in boxes:
        outside = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
        near.append(np.flatnonzero(np.linalg.norm(outside, axis=1) <= reach))
    asked = np.concatenate(near)
    ranks = np.repeat(np.arange(comm.size), [len(points_near) for points_near in near])
    questions, source = exchange(comm, points[asked], ranks)
    distance: Array = np.full(len(questions), np.inf)
    interpolated: Array = np.zeros((len(questions), values.shape[1]))
    carries = fields.state.x.array != ContactState.OUTSIDE
    facets = np.flatnonzero(carries[V.dofmap.list].any(axis=1)).astype(np.int32)
    if len(questions) and len(facets):
        nodes, weights, distance = _nearest_places(V, facets, places, questions)
        weights = weights * usable[nodes]
        total = weights.sum(axis=1)
        weights = weights / np.where(total > 0.0, total, 1.0)[:, None]
        interpolated = np.einsum("nc,nck->nk", weights, values[nodes])
    answers, _ = exchange(comm, np.column_stack([distance, interpolated]), source)

    # keep the answer of the rank with the nearest facet
    order = np.lexsort((answers[:, 0], asked))
    asked, nearest = np.unique(asked[order], return_index=True)
    answers = answers[order][nearest]
    close = answers[:, 0] <= reach
    result = np.zeros((len(points), values.shape[1]))
    result[asked[close]] = answers[close, 1:]
    return result


def _longest_edge(corners: Array) -> float:
    """Return the longest distance between two corners (n, corners, 3) of a facet."""
    sides = corners[:, :, None] - corners[:, None]
    return float(np.linalg.norm(sides, axis=3).max(initial=0.0))


def _nearest_places(
    V: fem.FunctionSpace, facets: LocalNumbers, places: Array, points: Array
) -> tuple[Indices, Array, Array]:
    """Return the points of facets of this rank that are nearest to given points. Not collective.

    Args:
        V: space of scalar functions of degree 1 on the mesh of the surface.
        facets: (m,) numbers of the facets, at least one.
        places: (nodes, 3) coordinates of the nodes [length].
        points: (n, 3) coordinates of the given points [length].

    Returns:
        nodes (n, corners) of the simplex that contains each nearest point, their weights
        (n, corners) there, whose sum is 1, and the distances (n,) from the given points [length].
    """
    mesh = V.mesh
    dim = mesh.topology.dim
    trees = (
        dolfinx.geometry.bb_tree(mesh, dim, entities=facets),
        dolfinx.geometry.create_midpoint_tree(mesh, dim, facets),
    )
    nearest = dolfinx.geometry.compute_closest_entity(*trees, mesh, points)
    count = V.dofmap.list.shape[1]
    simplices = [[0, 1, 3], [0, 3, 2]] if count == 4 else [[*range(count)]]  # of a quadrilateral
    nodes: Indices = np.asarray(V.dofmap.list)[nearest][:, simplices].astype(np.intp)
    corners = places[nodes]
    sides = corners[:, :, 1:] - corners[:, :, :1]
    arm = points[:, None] - corners[:, :, 0]
    gram = np.einsum("npai,npbi->npab", sides, sides)
    right = np.einsum("npai,npi->npa", sides, arm)
    inner = np.linalg.solve(gram, right[..., None])[..., 0]
    weights = np.concatenate([1.0 - inner.sum(axis=2, keepdims=True), inner], axis=2)
    weights = np.maximum(weights, 0.0)
    weights /= weights.sum(axis=2, keepdims=True)
    off = points[:, None] - np.einsum("npc,npci->npi", weights, corners)
    distance = np.linalg.norm(off, axis=2)
    best = distance.argmin(axis=1)
    row = np.arange(len(points))
    return nodes[row, best], weights[row, best], distance[row, best]
