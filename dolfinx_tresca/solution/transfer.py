"""Slip of a solution at the nodes of another mesh."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np

import dolfinx
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.parallel import exchange
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.pairing.search.balls import bounding_box
from dolfinx_tresca.solution.fields import ContactState, SurfaceFields


def slip_from(surfaces: Sequence[SurfaceFields], jump: JumpOperator) -> list[Array]:
    """Return slip vectors and paths from a solution on another mesh. Collective.

    They are interpolated on the nearest facets, of the facets that have a node with multipliers.
    Nodes of the other mesh without a multiplier have no slip and are left out of the interpolation.
    At points on the facets linear fields are reproduced exactly, for instance at the midpoints of
    edges, where refined meshes have nodes. Values are zero at points whose distance from the
    surface exceeds the longest edge of the surface.

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
            result[rows.nodes] = _slips_at(fields, x[rows.operators.nodes])
    return np.split(result, np.cumsum(counts)[:-1])


def _slips_at(fields: SurfaceFields, points: Array) -> Array:
    """Return slip vectors and paths (n, d + 1) near points (n, 3) of this rank. Collective."""
    comm, V = fields.mesh.comm, fields.pressure.function_space
    corners = V.tabulate_dof_coordinates()[V.dofmap.list]
    edges = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3)
    reach = comm.allreduce(edges.max(initial=0.0), op=MPI.MAX)
    near = []
    for box in comm.allgather(bounding_box(corners.reshape(-1, 3))):
        outside = np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0)
        near.append(np.flatnonzero(np.linalg.norm(outside, axis=1) <= reach))
    asked = np.concatenate(near)
    ranks = np.repeat(np.arange(comm.size), [len(points_near) for points_near in near])
    questions, source = exchange(comm, points[asked], ranks)
    answers, _ = exchange(comm, _on_nearest_facets(fields, questions), source)

    # keep the answer of the rank with the nearest facet
    order = np.lexsort((answers[:, 0], asked))
    asked, nearest = np.unique(asked[order], return_index=True)
    answers = answers[order][nearest]
    close = answers[:, 0] <= reach
    result = np.zeros((len(points), answers.shape[1] - 1))
    result[asked[close]] = answers[close, 1:]
    return result


def _on_nearest_facets(fields: SurfaceFields, points: Array) -> Array:
    """Return distance, slip vector and path (n, d + 2) at the points of facets nearest to points.

    The facets are those of this rank; without any, distances are infinite. Collective.

    Args:
        fields: fields of a solution on any mesh, with friction.
        points: (n, 3) coordinates of the points [length].
    """
    mesh, V = fields.mesh, fields.pressure.function_space
    assert fields.slip is not None and fields.slip_path is not None
    carries = fields.state.x.array != ContactState.OUTSIDE
    slips = fields.slip.x.array.reshape(-1, mesh.geometry.dim)
    values = np.column_stack([carries, slips, fields.slip_path.x.array]) * carries[:, None]
    facets = np.flatnonzero(carries[V.dofmap.list].any(axis=1)).astype(np.int32)
    result = np.zeros((len(points), values.shape[1]))
    result[:, 0] = np.inf
    function = fem.Function(V)
    if len(points) == 0 or len(facets) == 0:
        return result
    trees = (
        dolfinx.geometry.bb_tree(mesh, mesh.topology.dim, entities=facets),
        dolfinx.geometry.create_midpoint_tree(mesh, mesh.topology.dim, facets),
    )
    cells: Indices = dolfinx.geometry.compute_closest_entity(*trees, mesh, points)
    corners = V.tabulate_dof_coordinates()[V.dofmap.list[cells]]
    away = [
        dolfinx.geometry.compute_distance_gjk(facet, point[None])
        for facet, point in zip(corners, points, strict=True)
    ]
    interpolated = np.zeros_like(result)
    for column, nodal in zip(interpolated.T, values.T, strict=True):
        function.x.array[:] = nodal
        column[:] = function.eval(points + away, cells).ravel()
    share = interpolated[:, :1]
    result[:, 1:] = interpolated[:, 1:] / np.where(share > 0.0, share, 1.0)
    result[:, 0] = np.linalg.norm(away, axis=1)
    return result
