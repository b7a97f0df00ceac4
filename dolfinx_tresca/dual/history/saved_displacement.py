"""Displacements and material history as rows of a file, independent of the partition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

import dolfinx.la
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.exchange import exchange
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.dual.history.saved_file import (
    MATERIAL,
    ROOT,
    SAME_PLACE,
    SURROUNDINGS,
    read_file,
)
from dolfinx_tresca.errors import InputError


def rows_of(V: Any, values: Mapping[str, Array]) -> dict[str, Array]:
    """Return name -> rows of the file for this rank's own nodes, to be written. Collective.

    The rows are the values, and the `surroundings` of the nodes.

    Args:
        V: the space of the displacement.
        values: (nodes, k) values at this rank's own nodes, by name.
    """
    return {SURROUNDINGS: surroundings(V), **values} if values else {}


def rows_of_functions(functions: Sequence[fem.Function], kind: str) -> dict[str, Array]:
    """Return name -> rows of the file for Functions, to be written. Collective.

    Args:
        functions: the Functions, on any spaces.
        kind: prefix of the names in the file: `MATERIAL` for the material's history, `UNKNOWN` for
            unknowns that are not displacements.
    """
    rows = {}
    for number, function in enumerate(functions):
        rows[f"{kind}{number}"] = values_of(function)
        rows[f"{kind}{number} at"] = surroundings(function.function_space)
    return rows


def read_functions(
    path: Path, functions: Sequence[fem.Function], comm: Any, kind: str
) -> list[Array]:
    """Return for each Function its values in a file, ghosts included. Collective.

    Args:
        path: path of the file.
        functions: Functions on the same spaces as the saved Functions; they are not changed.
        comm: the communicator.
        kind: prefix of the names in the file: `MATERIAL` for the material's history, `UNKNOWN` for
            unknowns that are not displacements.

    Raises:
        InputError: the file cannot be read, or belongs to another mesh, other Functions or another
            number of Functions.
    """
    names: set[str] = set()
    with errors_on_all_ranks(comm):
        if comm.rank == ROOT:
            names = {name for name in read_file(path) if name.startswith(kind)}
    found = len(comm.bcast(names, root=ROOT)) // 2
    if found != len(functions):
        raise InputError(
            f"the state in '{path}' has {found} Function(s) of the material, and material has "
            f"{len(functions)}: give the same ones to save_state and load_state."
            if kind == MATERIAL
            else f"the state in '{path}' has {found} unknown(s) beside the displacement, and the "
            f"problem has {len(functions)}: it is of a problem on another space."
        )
    result = []
    for number, function in enumerate(functions):
        name, V = f"{kind}{number}", function.function_space
        rows = read_rows(path, V, [name], at=f"{name} at")[name]
        saved, asked = rows.shape[1], V.dofmap.index_map_bs
        if saved != asked:
            raise InputError(
                f"Function {number + 1} of {len(functions)} in the state in '{path}' has {saved} "
                f"component(s), and the Function that is to receive it has {asked}: give the same "
                "ones to save_state and load_state, in the same order."
            )
        read = fem.Function(V)
        values_of(read)[:] = rows
        read.x.scatter_forward()
        result.append(read.x.array.copy())
    return result


def read_displacements(
    path: Path, V: Any, names: Sequence[str], at: str = SURROUNDINGS
) -> dict[str, fem.Function]:
    """Read displacements from a file; return name -> Function. Collective.

    Args:
        path: path of the file.
        V: space of the displacements.
        names: names of the arrays with nodal values in the file.
        at: name of the array with the `surroundings` of the nodes in the file.

    Raises:
        InputError: the file cannot be read, or belongs to another mesh or degree.
    """
    result = {}
    for name, values in read_rows(path, V, names, at).items():
        result[name] = fem.Function(V)
        values_of(result[name])[:] = values
        result[name].x.scatter_forward()
    return result


def read_rows(path: Path, V: Any, names: Sequence[str], at: str = SURROUNDINGS) -> dict[str, Array]:
    """Return name -> values (nodes, k) in a file for this rank's own nodes. Collective.

    Arrays that the file lacks are left out. Arguments and errors are those of `read_displacements`.
    """
    comm, file, columns = V.mesh.comm, {}, {}
    with errors_on_all_ranks(comm):
        if comm.rank == ROOT:
            file = read_file(path)
            columns = {name: file[name].shape[1] for name in names if name in file}
    columns = comm.bcast(columns, root=ROOT)
    if not columns:
        return {}
    here = surroundings(V)
    nodes, owner = exchange(comm, here, np.full(len(here), ROOT))
    answers: dict[str, Array] = {name: np.zeros((0, count)) for name, count in columns.items()}
    with errors_on_all_ranks(comm):
        if comm.rank == ROOT:
            rows = _rows(path, file[at], nodes)
            answers = {name: file[name][rows] for name in columns}
    return {name: exchange(comm, values, owner)[0] for name, values in answers.items()}


def _rows(path: Path, known: Array, nodes: Array) -> Indices:
    """Return for each node its row (n,) in a file. Not collective.

    Args:
        path: path of the file, for the message.
        known: (n, 2 d) `surroundings` in the file.
        nodes: (n, 2 d) `surroundings` of the nodes.

    Raises:
        InputError: the file has other nodes.
    """
    size = float(np.ptp(nodes, axis=0).max(initial=0.0) or 1.0)
    rows = same_nodes(known, nodes, SAME_PLACE * size)
    if rows is None:
        raise InputError(
            f"a displacement or material in '{path}' is of another mesh or of another degree: it "
            f"has {len(known)} nodes or points, the problem {len(nodes)}, and they must be the "
            "same ones."
        )
    return rows


def values_of(u: fem.Function) -> Array:
    """Return a view of a Function's values (n, d) at this rank's own nodes. Not collective."""
    dim = u.function_space.dofmap.index_map_bs
    values: Array = u.x.array.reshape(-1, dim)[: u.function_space.dofmap.index_map.size_local]
    return values


def surroundings(V: Any) -> Array:
    """Return two positions (n, 2 d) for each of this rank's own nodes or points. Collective.

    The first position, with d coordinates, is the position of the node itself. The second is the
    mean of the midpoints of the cells around the node, which distinguishes nodes of two bodies that
    touch. Together the positions identify a node on any partition, up to rounding, also on refined
    meshes, where the number of a node depends on the partition.

    Args:
        V: the space of a displacement, or of values at points of quadrature.
    """
    dim, cells = V.mesh.geometry.dim, V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    points = V.tabulate_dof_coordinates()[:, :dim]
    nodes, own = V.dofmap.list[:cells], V.dofmap.index_map.size_local
    middles, count = (dolfinx.la.vector(V.dofmap.index_map, dim) for _ in range(2))
    for total, of_cells in ((middles, points[nodes].mean(axis=1)), (count, np.ones((cells, dim)))):
        at = np.repeat(of_cells, nodes.shape[1], axis=0)
        np.add.at(total.array.reshape(-1, dim), nodes.ravel(), at)
        total.scatter_reverse(dolfinx.la.InsertMode.add)
    mean = (middles.array / np.maximum(count.array, 1.0)).reshape(-1, dim)
    return np.hstack([points[:own], mean[:own]])


def same_nodes(known: Array, asked: Array, accuracy: float) -> Indices | None:
    """Return for each node its row in a file; None if the nodes differ. Not collective.

    Args:
        known: (n, 2 d) `surroundings` in the file.
        asked: (n, 2 d) `surroundings` of the nodes.
        accuracy: distance up to which positions count as equal [length].
    """
    if known.shape != asked.shape:
        return None
    rows: Indices = np.arange(len(known))
    if np.abs(known - asked).max(initial=0.0) > accuracy:  # the file has another order
        rows = KDTree(known).query(asked, distance_upper_bound=accuracy)[1]
    found = len(np.unique(rows)) == len(rows) and rows.max(initial=-1) < len(known)
    return rows if found else None
