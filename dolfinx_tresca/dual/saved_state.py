"""Multipliers and slip history in a file, for another run on any number of ranks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from dolfinx_tresca._base.arrays import Array, GlobalNumbers, Indices
from dolfinx_tresca._base.exchange import exchange
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca._base.vertices import numbers_in_file
from dolfinx_tresca._base.whole_files import whole_files
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.slip_history import SlipHistory
from dolfinx_tresca.errors import InputError

#: What files begin with; another number means another content.
FORMAT = "dolfinx_tresca state 1"

#: Distance of a node from its place in the file, over the size of the surface, that is rounding.
SAME_PLACE = 1e-9

ROOT = 0


@dataclass(frozen=True)
class SavedState:
    """What a solve starts from.

    In a file it has a row per contact node, with its pair, its number in the mesh file, which no
    partition changes, and its place, for meshes that were refined, whose numbers a partition does
    change; tractions and slips are vectors there, since tangents are a choice.

    Attributes:
        multipliers: (size,) times `JumpOperator.stress_scale` [stress].
        history: of the load steps.
        step: a number of the user's, such as that of the load step.
    """

    multipliers: Array
    history: SlipHistory
    step: int = 0

    def write(self, path: Path, jump: JumpOperator) -> None:
        """Write it; the file is there when it is complete. Collective.

        Raises:
            InputError: it cannot be written.
        """
        comm = jump.comm
        slip = self.history.origin * jump.length_scale
        values = np.zeros((0, 1 + 2 * jump.system.V.mesh.geometry.dim))
        for pair, (n, t) in zip(jump.pairs, jump.slices, strict=True):
            pressure = np.zeros((len(pair.nodes), 1))
            pressure[pair.normal_node, 0] = self.multipliers[n]
            vectors = [pair.tangential_vectors(v[t]) for v in (self.multipliers, slip)]
            values = np.concatenate([values, np.hstack([pressure, *vectors])])
        keys, points = _rows(jump)
        parts = comm.gather((keys, points, values), root=ROOT)
        with errors_on_all_ranks(comm):
            if parts is not None:
                rows = [np.concatenate(column) for column in zip(*parts, strict=True)]
                size = sum(row.nbytes for row in rows)
                numbers = np.array([self.history.dissipation, self.history.begun, self.step])
                with whole_files(path, size) as new, new.open("wb") as file:
                    np.savez(
                        file,
                        **{"format": FORMAT, "keys": rows[0], "points": rows[1]},
                        **{"values": rows[2], "numbers": numbers},
                    )

    @classmethod
    def read(cls, path: Path, jump: JumpOperator) -> SavedState:
        """Return what a file has for the contact nodes of B. Collective.

        Raises:
            InputError: it cannot be read, or is of another mesh or other pairs.
        """
        comm = jump.comm
        keys, points = _rows(jump)
        questions, source = exchange(comm, keys, np.full(len(keys), ROOT))
        places, _ = exchange(comm, points, np.full(len(keys), ROOT))
        answers: Array = np.zeros((0, 1 + 2 * jump.system.V.mesh.geometry.dim))
        numbers: Array = np.zeros(3)
        with errors_on_all_ranks(comm):
            if comm.rank == ROOT:
                answers, numbers = _found(path, questions, places, answers.shape[1])
        values, _ = exchange(comm, answers, source)
        dissipation, begun, step = comm.bcast(numbers, root=ROOT)
        multipliers, slip = np.zeros_like(jump.gap), np.zeros_like(jump.gap)
        first, dim = 0, jump.system.V.mesh.geometry.dim
        for pair, (n, t) in zip(jump.pairs, jump.slices, strict=True):
            own = values[first : first + len(pair.nodes)]
            first += len(pair.nodes)
            multipliers[n] = own[pair.normal_node, 0]
            for result, vectors in ((multipliers, own[:, 1 : 1 + dim]), (slip, own[:, 1 + dim :])):
                result[t] = np.einsum("ri,ri->r", vectors[pair.tangent_node], pair.tangents)
        history = SlipHistory(slip / jump.length_scale, float(dissipation), begun=bool(begun))
        return cls(multipliers, history, int(step))


def _rows(jump: JumpOperator) -> tuple[GlobalNumbers, Array]:
    """Return keys (n, 3) and places (n, 3) of this rank's contact nodes, those of all pairs.

    A key has the pair, the node's number in the mesh file, and which of its smooth patches it is.
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


def _found(
    path: Path, keys: GlobalNumbers, points: Array, columns: int
) -> tuple[Array, npt.NDArray[Any]]:
    """Return the values (n, columns) that a file has for keys, and its numbers. Not collective.

    Raises:
        InputError: see `SavedState.read`.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            if str(file["format"]) != FORMAT:
                raise ValueError(f"its format is {file['format']}")
            known, places, values, numbers = (
                file[name] for name in ("keys", "points", "values", "numbers")
            )
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(
            f"cannot read a state from '{path}': {error}. Give the file that save_state() wrote."
        ) from error
    rows = None
    if known.shape == keys.shape and values.shape == (len(keys), columns):
        size = np.float64(np.ptp(points, axis=0).max(initial=0.0) or 1.0)
        rows = _same_rows(known, places / size, keys, points / size)
    if rows is None:
        raise InputError(
            f"the state in '{path}' is of another mesh or of other pairs: it has {len(known)} "
            f"contact nodes, the problem {len(keys)}, and they must be the same ones. For another "
            "mesh take start_from(solution)."
        )
    return values[rows], numbers


def _same_rows(
    known: GlobalNumbers, places: Array, keys: GlobalNumbers, points: Array
) -> Indices | None:
    """Return the row of a file of each node; None unless they are the same. Not collective.

    Args:
        known: (n, 3) keys in the file.
        places: (n, 3) in the file, over the size of the surface.
        keys: (n, 3) that are looked for.
        points: (n, 3) alike.
    """
    by_key, order = (np.lexsort(rows.T) for rows in (known, keys))
    rows = np.empty(len(keys), dtype=np.intp)
    rows[order] = by_key
    if np.array_equal(known[rows], keys) and _near(places[rows], points):
        return rows
    # nodes of one pair apart from those of another, and so patches of a node
    apart = 4.0 * np.array([[1, 0], [0, 0], [0, 1]])
    tree = KDTree(np.hstack([places, known @ apart]))
    found: Indices = tree.query(np.hstack([points, keys @ apart]))[1]
    one_each = len(np.unique(found)) == len(found)
    same = one_each and np.array_equal(known[found][:, [0, 2]], keys[:, [0, 2]])
    return found if same and _near(places[found], points) else None


def _near(places: Array, points: Array) -> bool:
    return bool(np.abs(places - points).max(initial=0.0) <= SAME_PLACE)
