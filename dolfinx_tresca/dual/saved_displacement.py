"""A displacement as rows of a file that no partition changes."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import KDTree

import dolfinx.la
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices


def values_of(u: fem.Function) -> Array:
    """Return the values (n, d) at this rank's own nodes. Not collective."""
    dim = u.function_space.dofmap.index_map_bs
    values: Array = u.x.array.reshape(-1, dim)[: u.function_space.dofmap.index_map.size_local]
    return values


def surroundings(V: Any) -> Array:
    """Return (n, 2 d) where this rank's own nodes and the cells round them are. Collective.

    The place of a node, and the mean place of the nodes of its cells, which tells nodes of two
    bodies that touch from each other. Neither partition nor refinement changes them, but for
    rounding.

    Args:
        V: the space of a displacement.
    """
    dim, cells = V.dofmap.index_map_bs, V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    points = V.tabulate_dof_coordinates()[:, :dim]
    nodes = V.dofmap.list[:cells]
    middles, count = fem.Function(V), fem.Function(V)
    for total, of_cells in ((middles, points[nodes].mean(axis=1)), (count, np.ones((cells, dim)))):
        at = np.repeat(of_cells, nodes.shape[1], axis=0)
        np.add.at(total.x.array.reshape(-1, dim), nodes.ravel(), at)
        total.x.scatter_reverse(dolfinx.la.InsertMode.add)
    return np.hstack([points[: len(values_of(count))], values_of(middles) / values_of(count)])


def same_nodes(known: Array, asked: Array, accuracy: float) -> Indices | None:
    """Return which row is that of each node; None unless they are the same. Not collective.

    Args:
        known: (n, 2 d) `surroundings` of nodes.
        asked: (n, 2 d) of nodes that are looked for.
        accuracy: distance that is rounding [length].
    """
    if known.shape != asked.shape:
        return None
    rows: Indices = np.arange(len(known))
    if np.abs(known - asked).max(initial=0.0) > accuracy:  # on other ranks
        rows = KDTree(known).query(asked, distance_upper_bound=accuracy)[1]
    found = len(np.unique(rows)) == len(rows) and rows.max(initial=-1) < len(known)
    return rows if found else None
