"""Multipliers and slip history in a file, for another run on any number of ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices
from dolfinx_tresca._base.atomic_write import atomic_write
from dolfinx_tresca._base.exchange import exchange
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array
from dolfinx_tresca._base.vertices import numbers_in_file
from dolfinx_tresca.dual.history.saved_displacement import (
    read_rows,
    rows_of,
    rows_of_functions,
    values_of,
)
from dolfinx_tresca.dual.history.saved_file import (
    FORMAT,
    MATERIAL,
    ROOT,
    SAME_PLACE,
    UNKNOWN,
    read_file,
)
from dolfinx_tresca.dual.history.slip_history import SlipHistory
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.errors import InputError


@dataclass(frozen=True)
class SavedState:
    """The multipliers and the history at which a solve starts.

    The file that `write` makes has one row for each contact node, with the node's pair, its number
    in the mesh file and its coordinates. The number is independent of the partition, except on
    refined meshes, where the coordinates identify a node. The tractions and slips in a row are
    vectors, since the tangents are arbitrary. Displacements and the slip of all steps have separate
    rows for all nodes.

    Attributes:
        multipliers: (size,) multipliers times `JumpOperator.stress_scale` [stress].
        history: slip and dissipation of the accepted load steps.
        step: a number chosen by the user, such as the number of the load step.
        displacements: displacements in the file, by name, such as the last accepted one.
        material: Functions of the material's history.
        unknowns: unknowns of a mixed space that are not displacements.
    """

    multipliers: Array
    history: SlipHistory
    step: int = 0
    displacements: Mapping[str, fem.Function] = field(default_factory=dict)
    material: Sequence[fem.Function] = ()
    unknowns: Sequence[fem.Function] = ()

    def write(self, path: Path, jump: JumpOperator, motions: Array) -> None:
        """Write the state; the file appears when it is complete. Collective.

        Args:
            path: path of the file.
            jump: B.
            motions: (pairs, 3, 4) positions of rigid obstacles (`RigidMotion.matrix`).

        Raises:
            InputError: the file cannot be written.
        """
        comm = jump.comm
        history = self.history
        V, origin = jump.system.V, history.origin * jump.length_scale
        values = np.zeros((0, 1 + 2 * V.mesh.geometry.dim))
        for pair, (n, t) in zip(jump.pairs, jump.slices, strict=True):
            pressure = np.zeros((len(pair.nodes), 1))
            pressure[pair.normal_node, 0] = self.multipliers[n]
            vectors = [pair.tangential_vectors(v[t]) for v in (self.multipliers, origin)]
            values = np.concatenate([values, np.hstack([pressure, *vectors])])
        keys, points = _rows(jump)
        columns = {"keys": keys, "points": points, "values": values}
        at_nodes = {name: values_of(u) for name, u in self.displacements.items()}
        if history.begun:
            at_nodes |= {_slipped(k): one for k, one in enumerate(history.slipped)}
        columns |= rows_of(V, at_nodes)
        columns |= rows_of_functions(self.material, MATERIAL)
        columns |= rows_of_functions(self.unknowns, UNKNOWN)
        laws = _laws(jump)
        parts = comm.gather(columns, root=ROOT)
        with errors_on_all_ranks(comm):
            if parts is not None:
                numbers = np.array([history.dissipation, history.begun, self.step])
                content: dict[str, Any] = {"format": FORMAT, "laws": laws, "numbers": numbers}
                content["motions"] = motions
                for name in columns:
                    content[name] = np.concatenate([part[name] for part in parts])
                size = sum(content[name].nbytes for name in columns)
                with atomic_write(path, size) as new, new.open("wb") as file:
                    np.savez(file, **content)

    @classmethod
    def read(cls, path: Path, jump: JumpOperator) -> SavedState:
        """Read multipliers, history and step from a file, at the contact nodes of B. Collective.

        The displacements and other Functions in the file are not read.

        Raises:
            InputError: the file cannot be read, or belongs to another mesh, other pairs or other
                kinds of laws.
        """
        comm, laws = jump.comm, _laws(jump)
        keys, points = _rows(jump)
        questions, source = exchange(comm, keys, np.full(len(keys), ROOT))
        places, _ = exchange(comm, points, np.full(len(keys), ROOT))
        dim = jump.system.V.mesh.geometry.dim
        answers: Array = np.zeros((0, 1 + 2 * dim))
        numbers: Array = np.zeros(3)
        with errors_on_all_ranks(comm):
            if comm.rank == ROOT:
                file = read_file(path)
                _check_laws(path, file["laws"], laws)
                rows = _rows_of(path, file, questions, places, answers.shape[1])
                answers, numbers = file["values"][rows], file["numbers"]
        values, _ = exchange(comm, answers, source)
        dissipation, begun, step = comm.bcast(numbers, root=ROOT)
        multipliers, origin = np.zeros((2, len(jump.gap)))
        first = 0
        for pair, (n, t) in zip(jump.pairs, jump.slices, strict=True):
            own = values[first : first + len(pair.nodes)]
            first += len(pair.nodes)
            multipliers[n] = own[pair.normal_node, 0]
            columns = np.split(own[:, 1:], 2, axis=1)
            for result, vectors in zip((multipliers, origin), columns, strict=True):
                result[t] = np.einsum("ri,ri->r", vectors[pair.tangent_node], pair.tangents)
        slipped = {_slipped(k): one for k, one in enumerate(SlipHistory.none(jump).slipped)}
        slipped |= read_rows(path, jump.system.V, list(slipped))
        history = SlipHistory(
            origin / jump.length_scale,
            tuple(slipped.values()),
            float(dissipation),
            begun=bool(begun),
        )
        return cls(multipliers, history, int(step))


def _slipped(pair: int) -> str:
    """Return the name of the array with the slip of all steps of a pair."""
    return f"slipped {pair}"


def read_motions(path: Path, comm: MPI.Comm, pairs: int) -> Array:
    """Return the positions (pairs, 3, 4) of rigid obstacles in a file. Collective.

    Raises:
        InputError: the file cannot be read, or belongs to a problem with another number of pairs.
    """
    motions = None
    with errors_on_all_ranks(comm):
        if comm.rank == ROOT:
            motions = read_file(path)["motions"]
            if len(motions) != pairs:
                raise InputError(
                    f"the state in '{path}' is of a problem with {len(motions)} pair(s), and here "
                    f"there are {pairs}. Give the pairs of that problem."
                )
    found: Array = comm.bcast(motions, root=ROOT)
    return found


def _laws(jump: JumpOperator) -> list[str]:
    """Return the kind of law of each pair, which determines its multipliers. Collective."""
    tangential_rows = reduce_array(jump.comm, np.array([len(pair.tangents) for pair in jump.pairs]))
    return [
        "is bonded" if pair.bonded else "has friction" if rows else "has no friction"
        for pair, rows in zip(jump.pairs, tangential_rows, strict=True)
    ]


def _rows(jump: JumpOperator) -> tuple[GlobalNumbers, Array]:
    """Return keys (n, 3) and coordinates (n, 3) of this rank's contact nodes of all pairs.

    A key has the pair, the node's number in the mesh file, and the number of the smooth patch of
    the surface: a node on a sharp edge belongs to several patches.
    """
    V = jump.system.V
    in_file, x = numbers_in_file(V), V.tabulate_dof_coordinates()
    keys, points = [np.zeros((0, 3), dtype=np.int64)], [np.zeros((0, 3))]
    for number, pair in enumerate(jump.pairs):
        nodes = pair.nodes
        # patches of a node come one after the other
        _, first, inverse = np.unique(nodes, return_index=True, return_inverse=True)
        patch = np.arange(len(nodes)) - first[inverse]
        keys.append(np.stack([np.full(len(nodes), number), in_file[nodes], patch], axis=1))
        points.append(x[nodes])
    return np.concatenate(keys), np.concatenate(points)


def _check_laws(path: Path, known: npt.NDArray[Any], laws: Sequence[str]) -> None:
    """Check that pairs have the same kinds of multipliers as in the file. Not collective.

    Raises:
        InputError: the kinds differ.
    """
    for number, (before, now) in enumerate(zip(known, laws, strict=False)):
        if before != now:
            raise InputError(
                f"the state in '{path}' is of a problem whose pair {number} {before}; here it "
                f"{now}, so that tractions and slip would be lost, or are not known. Where "
                "friction comes or goes in a process let its bound or coefficient change, from or "
                "to 0. Or begin with set_slip_origin(u) at the last accepted displacement."
            )


def _rows_of(
    path: Path, file: dict[str, npt.NDArray[Any]], keys: GlobalNumbers, points: Array, columns: int
) -> Indices:
    """Return for each contact node its row (n,) in a file. Not collective.

    Args:
        path: path of the file.
        file: contents of the file.
        keys: (n, 3) keys of the nodes, see `_rows`.
        points: (n, 3) coordinates of the nodes.
        columns: number of columns of values.

    Raises:
        InputError: the file has other nodes.
    """
    known, rows = file["keys"], None
    if known.shape == keys.shape and file["values"].shape == (len(keys), columns):
        size = float(np.ptp(points, axis=0).max() or 1.0) if len(points) else 1.0
        there = np.asarray(file["points"] / size, dtype=np.float64)
        rows = _same_rows(known, there, keys, np.asarray(points / size, dtype=np.float64))
    if rows is None:
        raise InputError(
            f"the state in '{path}' is of another mesh or of other pairs: it has {len(known)} "
            f"contact nodes, the problem {len(keys)}, and they must be the same ones. For another "
            "mesh take start_from(solution)."
        )
    return rows


def _same_rows(
    known: GlobalNumbers, places: Array, keys: GlobalNumbers, points: Array
) -> Indices | None:
    """Return for each node its row in the file; None if the nodes differ. Not collective.

    Nodes correspond if they have the same key and the same position. If the mesh file now numbers
    nodes differently, each node corresponds to the nearest node in the file. That node must be of
    the same pair and patch, have the same position, and correspond to no other node.

    Args:
        known: (n, 3) keys in the file: pair, number in the mesh file, and patch of the surface.
        places: (n, 3) coordinates in the file, divided by the size of the surface.
        keys: (n, 3) keys of the nodes.
        points: (n, 3) coordinates of the nodes, divided by the size of the surface.
    """
    by_key, order = (np.lexsort(rows.T) for rows in (known, keys))
    rows = np.empty(len(keys), dtype=np.intp)
    rows[order] = by_key
    if np.array_equal(known[rows], keys) and _near(places[rows], points):
        return rows
    # separates nodes of different pairs, and different patches of a node
    apart = 4.0 * np.array([[1, 0], [0, 0], [0, 1]])
    tree = KDTree(np.hstack([places, known @ apart]))
    found: Indices = tree.query(np.hstack([points, keys @ apart]))[1]
    one_each = len(np.unique(found)) == len(found)
    same = one_each and np.array_equal(known[found][:, [0, 2]], keys[:, [0, 2]])
    return found if same and _near(places[found], points) else None


def _near(places: Array, points: Array) -> bool:
    return bool(np.abs(places - points).max(initial=0.0) <= SAME_PLACE)
