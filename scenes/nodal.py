"""Values at the nodes of one rank, or of all ranks in an order that any number of ranks gives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca import ContactSolution


def nodal(function: fem.Function) -> np.ndarray:
    """Return values at owned nodes, (n,) or (n, dim)."""
    dofmap = function.function_space.dofmap
    bs = dofmap.index_map_bs
    values: np.ndarray = function.x.array[: dofmap.index_map.size_local * bs]
    return values if bs == 1 else values.reshape(-1, bs)


def node_function(mesh: Any, values: Callable[[np.ndarray], np.ndarray]) -> fem.Function:
    """Return a scalar function of degree 1; `values` maps points (3, n) to values (n,)."""
    function = fem.Function(fem.functionspace(mesh, ("Lagrange", 1)))
    function.interpolate(values)
    return function


def surface_nodes_of(solution: ContactSolution) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return points, nodal fields and weights at owned surface nodes that carry multipliers."""
    surface = solution.surface
    points = surface.pressure.function_space.tabulate_dof_coordinates()
    state = nodal(surface.state)
    carries = state >= 0
    fields = {f.name: nodal(f)[carries] for f in surface.functions}
    fields["weights"] = surface.weights[: len(state)][carries]
    return points[: len(state)][carries], fields


def gathered(comm: MPI.Comm, *arrays: np.ndarray) -> list[np.ndarray]:
    """Return arrays with the rows of all ranks, in the order of the ranks. Collective."""
    return [np.concatenate(comm.allgather(np.asarray(array))) for array in arrays]


def global_vector(comm: MPI.Comm, keys: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Gather values from all ranks, sorted by rounded keys, such as points. Collective."""
    keys, values = gathered(comm, keys, values)
    return values[np.lexsort(np.round(keys, 9).T)]
