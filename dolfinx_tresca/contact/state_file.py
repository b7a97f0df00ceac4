"""The file of a state: tables of values at nodes, which any number of ranks can read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, is_zipfile

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

import dolfinx.la
from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices
from dolfinx_tresca._base.atomic_write import atomic_write
from dolfinx_tresca._base.parallel import errors_on_all_ranks, exchange
from dolfinx_tresca.errors import InputError

#: Name and version of the format of the file.
FORMAT = "dolfinx_tresca state 5"

#: Names of the arrays of the header: the kinds of laws of the pairs; dissipation, whether a step
#: was accepted, and the number of the step; and the places of rigid obstacles.
HEADER = ("laws", "numbers", "motions")

#: Name of the column of a table with the `surroundings` of its nodes.
PLACES = "places"

#: Two places count as the same if their distance is at most this fraction of the extent of all
#: nodes of the table. (Positions in other units, or on other ranks, differ by rounding only.)
SAME_PLACE = 1e-9

#: The rank that reads and writes files.
ROOT = 0


def write_file(
    path: Path,
    comm: Any,
    header: Mapping[str, npt.ArrayLike],
    tables: Mapping[str, Mapping[str, Array]],
) -> None:
    """Write a file, which appears when it is complete. Collective.

    Args:
        path: path of the file.
        comm: the communicator.
        header: name -> array, equal on all ranks.
        tables: name of a table -> name of a column -> this rank's rows; all tables have the column
            `PLACES`.

    Raises:
        InputError: the file cannot be written.
    """
    ranks = comm.gather(tables, root=ROOT)
    with errors_on_all_ranks(comm):
        if ranks is not None:
            content: dict[str, Any] = {"format": FORMAT, **header}
            for table, columns in tables.items():
                for name in columns:
                    rows = [tables_of_rank[table][name] for tables_of_rank in ranks]
                    content[f"{table}/{name}"] = np.concatenate(rows)
            size = sum(np.asarray(values).nbytes for values in content.values())
            with atomic_write(path, size) as new, new.open("wb") as stream:
                np.savez(stream, **content)


class StateFile:
    """A file that was read: its header, and its tables row by row.

    Attributes:
        path: path of the file.
        header: name -> array.
        columns: (table, column) -> number of values in a row.
    """

    def __init__(self, path: Path, comm: Any) -> None:
        """Read the file on the first rank. Collective.

        Raises:
            InputError: the file cannot be read, or holds no state.
        """
        self.path, self.comm = path, comm
        self._content: dict[str, npt.NDArray[Any]] = {}
        with errors_on_all_ranks(comm):
            if comm.rank == ROOT:
                self._content = _read(path)
        header = {name: self._content.get(name) for name in HEADER}
        columns = {
            tuple(name.split("/")): values.shape[1]
            for name, values in self._content.items()
            if "/" in name
        }
        self.header: dict[str, Any]
        self.columns: dict[tuple[str, str], int]
        self.header, self.columns = comm.bcast((header, columns), root=ROOT)

    def rows(self, table: str, places: Array, refusal: str) -> dict[str, Array]:
        """Return column -> values (n, k) of a table at this rank's nodes. Collective.

        Args:
            table: name of the table.
            places: (n, 2 d) `surroundings` of the nodes.
            refusal: beginning of the error if the nodes are others than in the file.

        Raises:
            InputError: all nodes of all ranks together are not those in the file.
        """
        widths = {
            name: width
            for (of_table, name), width in self.columns.items()
            if of_table == table and name != PLACES
        }
        nodes, owner = exchange(self.comm, places, np.full(len(places), ROOT))
        answers: dict[str, Array] = {name: np.zeros((0, k)) for name, k in widths.items()}
        with errors_on_all_ranks(self.comm):
            if self.comm.rank == ROOT:
                saved = self._content.get(f"{table}/{PLACES}", np.zeros((0, nodes.shape[1])))
                rows = same_nodes(saved, nodes)
                if rows is None:
                    raise InputError(
                        f"{refusal} in '{self.path}' is of another mesh, of another degree or of "
                        f"other pairs: it has {len(saved)} nodes or points, the problem "
                        f"{len(nodes)}, and they must be the same ones. For another mesh take "
                        "start_from(solution)."
                    )
                answers = {name: self._content[f"{table}/{name}"][rows] for name in widths}
        return {name: exchange(self.comm, values, owner)[0] for name, values in answers.items()}

    def functions(self, kind: str, functions: Sequence[fem.Function]) -> list[Array]:
        """Return for each Function its values in the file, ghosts included. Collective.

        Args:
            kind: "material" or "unknown", see `tables_of`.
            functions: Functions on the same spaces as the saved Functions; they are not changed.

        Raises:
            InputError: the file belongs to another mesh, other Functions or another number of
                Functions.
        """
        count = sum(table.startswith(f"{kind} ") for table, name in self.columns if name == PLACES)
        if count != len(functions):
            raise InputError(
                f"the state in '{self.path}' has {count} Function(s) of the material, and material "
                f"has {len(functions)}: give the same ones to save_state and load_state."
                if kind == "material"
                else f"the state in '{self.path}' has {count} unknown(s) beside the displacement, "
                f"and the problem has {len(functions)}: it is of a problem on another space."
            )
        result = []
        for number, function in enumerate(functions):
            V, table = function.function_space, f"{kind} {number}"
            values = self.rows(table, surroundings(V), f"a {kind} of the state")["values"]
            if values.shape[1] != V.dofmap.index_map_bs:
                raise InputError(
                    f"Function {number + 1} of {len(functions)} in the state in '{self.path}' has "
                    f"{values.shape[1]} component(s), and the Function that is to receive it has "
                    f"{V.dofmap.index_map_bs}: give the same ones to save_state and load_state, in "
                    "the same order."
                )
            result.append(function_of_rows(V, values).x.array.copy())
        return result


def _read(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays in a file by their names. Not collective.

    Raises:
        InputError: the file cannot be read, or holds no state.
    """
    try:
        with path.open("rb") as stream:
            if not is_zipfile(stream):  # numpy would propose to load it unsafely
                raise ValueError("it is no state, or its end is missing")
        with np.load(path, allow_pickle=False) as file:
            if "format" not in file.files:
                raise ValueError("it is no state")
            if str(file["format"]) != FORMAT:
                raise ValueError(
                    f"its format is '{file['format']}', and this version reads '{FORMAT}' only"
                )
            content = {name: file[name] for name in {*HEADER, *file.files} - {"format"}}
        _check(content)
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(
            f"cannot read a state from '{path}': {error}. Give the file that save_state() wrote."
        ) from error
    return content


def _check(content: Mapping[str, npt.NDArray[Any]]) -> None:
    """Check for contents that `write_file` never writes. Not collective.

    Raises:
        ValueError: values are not finite, or some values are missing.
    """
    for name, values in content.items():
        if values.dtype.kind not in "fiuU":
            raise ValueError(f"'{name}' has values of type {values.dtype}")
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise ValueError(f"'{name}' has values that are NaN or infinite")
        if "/" in name and len(values) != len(content[f"{name.split('/')[0]}/{PLACES}"]):
            raise ValueError(f"'{name}' must have as many rows as its table has places")
    pairs = len(content["laws"])
    for name, shape in (("numbers", (3,)), ("motions", (pairs, 3, 4))):
        if content[name].shape != shape:
            raise ValueError(f"'{name}' has shape {content[name].shape} and not {shape}")


def tables_of(kind: str, functions: Sequence[fem.Function]) -> dict[str, dict[str, Array]]:
    """Return the tables of Functions on any spaces, to be written. Collective.

    Args:
        kind: "material" for the material's history, "unknown" for unknowns of a mixed space that
            are not displacements.
        functions: the Functions.
    """
    return {
        f"{kind} {number}": {
            PLACES: surroundings(function.function_space),
            "values": values_of(function),
        }
        for number, function in enumerate(functions)
    }


def values_of(u: fem.Function) -> Array:
    """Return a view of a Function's values (n, d) at this rank's own nodes. Not collective."""
    dim = u.function_space.dofmap.index_map_bs
    values: Array = u.x.array.reshape(-1, dim)[: u.function_space.dofmap.index_map.size_local]
    return values


def function_of_rows(V: Any, rows: Array) -> fem.Function:
    """Return the Function with values (n, d) at each rank's own nodes. Collective."""
    result = fem.Function(V)
    values_of(result)[:] = rows
    result.x.scatter_forward()
    return result


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
        of_corners = np.repeat(of_cells, nodes.shape[1], axis=0)
        np.add.at(total.array.reshape(-1, dim), nodes.ravel(), of_corners)
        total.scatter_reverse(dolfinx.la.InsertMode.add)
    mean = (middles.array / np.maximum(count.array, 1.0)).reshape(-1, dim)
    return np.hstack([points[:own], mean[:own]])


def same_nodes(saved: Array, asked: Array) -> Indices | None:
    """Return for each node its row in a file; None if the nodes differ. Not collective.

    Args:
        saved: (n, 2 d) `surroundings` in the file.
        asked: (n, 2 d) `surroundings` of the nodes.
    """
    if saved.shape != asked.shape:
        return None
    accuracy = SAME_PLACE * float(np.ptp(asked, axis=0).max() if len(asked) > 1 else 1.0)
    rows: Indices = np.arange(len(saved))
    if np.abs(saved - asked).max(initial=0.0) > accuracy:  # the file has another order
        rows = KDTree(saved).query(asked, distance_upper_bound=accuracy)[1]
    matched = len(np.unique(rows)) == len(rows) and rows.max(initial=-1) < len(saved)
    return rows if matched else None
