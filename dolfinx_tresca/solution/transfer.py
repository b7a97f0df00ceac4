"""Tractions of a solution on one mesh at the nodes of another."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement

from mpi4py import MPI

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.exchange import exchange
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.solution.fields import SurfaceFields
from dolfinx_tresca.surface.box import Box


def stress_from(surfaces: Sequence[SurfaceFields], jump: JumpOperator) -> Array:
    """Return the multipliers (size,) [stress] that continue a solution on another mesh. Collective.

    Args:
        surfaces: the solution's, one of each pair.
        jump: on the mesh that goes on.
    """
    result = np.zeros(len(jump.scale))
    x = jump.system.V.tabulate_dof_coordinates()
    for pair, fields, (n, t) in zip(jump.pairs, surfaces, jump.slices, strict=True):
        pressure, traction = tractions_at(fields, x[pair.nodes])
        result[n] = pressure[pair.normal_node]
        result[t] = np.einsum("ni,ni->n", traction[pair.tangent_node], pair.tangents)
    return result


def tractions_at(fields: SurfaceFields, points: Array) -> tuple[Array, Array]:
    """Return pressures (n,) and tangential tractions (n, d) [stress] near points. Collective.

    Those of the next node or middle of an edge: exact where the points are such, as on meshes that
    were refined, whether or not they were moved to a curved surface. Zero where the surface is
    farther away than its longest edge.

    Args:
        fields: of a solution, on any mesh.
        points: (n, 3) of this rank; others have others [length].
    """
    comm, dim = fields.mesh.comm, fields.mesh.geometry.dim
    places, values, longest = _samples(fields)
    reach = comm.allreduce(longest, op=MPI.MAX)
    boxes = comm.allgather(Box.around(places).as_row())
    near = [
        np.flatnonzero(Box.of_row(row).near(points, np.full(len(points), reach))) for row in boxes
    ]
    asked = np.concatenate(near)
    ranks = np.repeat(np.arange(comm.size), [len(some) for some in near])
    questions, source = exchange(comm, points[asked], ranks)
    distance, sample = np.full(len(questions), np.inf), np.zeros(len(questions), dtype=np.intp)
    if len(places):
        distance, sample = cKDTree(places).query(questions)
    found = values[sample] if len(places) else np.zeros((len(questions), 1 + dim))
    answers, _ = exchange(comm, np.column_stack([distance, found]), source)

    # of several ranks' answers that of the nearest
    order = np.lexsort((answers[:, 0], asked))
    asked, first = np.unique(asked[order], return_index=True)
    answers = answers[order][first]
    close = answers[:, 0] <= reach
    result = np.zeros((len(points), 1 + dim))
    result[asked[close]] = answers[close, 1:]
    return result[:, 0], result[:, 1:]


def _samples(fields: SurfaceFields) -> tuple[Array, Array, float]:
    """Return nodes and middles of edges on this rank, pressure and traction there; a length.

    That is the one of the longest edge.
    """
    V, dim = fields.pressure.function_space, fields.mesh.geometry.dim
    x, pressure = V.tabulate_dof_coordinates(), fields.pressure.x.array
    traction = (
        np.zeros((len(x), dim))
        if fields.traction is None
        else fields.traction.x.array.reshape(-1, dim)
    )
    corners = V.dofmap.list
    pairs = combinations_with_replacement(range(corners.shape[1]), 2)
    one, other = np.concatenate([corners[:, list(pair)] for pair in pairs]).T
    values = np.column_stack([pressure, traction])
    longest = np.linalg.norm(x[one] - x[other], axis=1).max(initial=0.0)
    return 0.5 * (x[one] + x[other]), 0.5 * (values[one] + values[other]), float(longest)
