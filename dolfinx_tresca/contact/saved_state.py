"""The file of a process of load steps, from which another run goes on.

The file is an archive of numpy arrays, which any number of ranks can read. Arrays named
"table/column" have a row for each node of the table; the column `PLACES` says which node that is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile, is_zipfile

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.atomic_write import atomic_write
from dolfinx_tresca._base.functions import owned_values, with_owned_values
from dolfinx_tresca._base.parallel import errors_on_all_ranks, reduce_array, summed_at_nodes
from dolfinx_tresca.contact.step_state import StepState
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.load_steps import SlipHistory
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.operators import PairOperators

#: Name and version of the format of the file.
FORMAT = "dolfinx_tresca state 8"

#: Name of the column of a table with the `surroundings` of its nodes.
PLACES = "places"

#: Two places count as the same if their distance is at most this fraction of the extent of all
#: nodes of the table. (Positions that are computed on other ranks differ by rounding only.)
SAME_PLACE = 1e-9


def write_state(
    path: Path, state: StepState, step: int = 0, material: Sequence[fem.Function] = ()
) -> None:
    """Write a state from which a solve begins (`StepState.at_start`). Collective.

    Multipliers and the slip origin are written as a pressure and two vectors for each smooth patch
    of the surface to which a node belongs, since tangents are arbitrary. No solution is written.
    """
    jump, history, accepted = state.jump, state.history, state.accepted
    places = surroundings(jump.system.V)
    displacements = {
        "configuration": state.configuration,
        "geometry": state.geometry,
        "accepted displacement": accepted.displacement,
        "displacement before": accepted.before,
        "accepted configuration": accepted.configuration,
    }
    columns = {f"nodes/{PLACES}": places}  # "table/column" -> rows of this rank's nodes
    columns |= {
        f"nodes/{name}": owned_values(u) for name, u in displacements.items() if u is not None
    }
    if history.begun:
        columns |= {f"nodes/slip of pair {k}": slip for k, slip in enumerate(history.slipped)}
    tractions = jump.nodal_vectors(state.multipliers * jump.stress_scale)
    origins = jump.nodal_vectors(history.origin * jump.length_scale)
    for k, pair in enumerate(jump.pairs):
        columns[f"pair {k}/{PLACES}"] = _contact_places(pair, places)
        columns[f"pair {k}/values"] = np.hstack([tractions[k], origins[k][:, 1:]])
    for k, function in enumerate([*_functions_of_unknowns(state), *material]):
        columns[f"function {k}/{PLACES}"] = surroundings(function.function_space)
        columns[f"function {k}/values"] = owned_values(function)
    gathered, laws = jump.comm.gather(columns), _laws(jump)
    with errors_on_all_ranks(jump.comm):
        if gathered is not None:
            content: dict[str, Any] = {"format": FORMAT, "laws": laws, "motions": accepted.motions}
            content["numbers"] = np.array([history.dissipation, history.begun, step])
            for name in columns:
                content[name] = np.concatenate([of_rank[name] for of_rank in gathered])
            with atomic_write(path) as new, new.open("wb") as stream:
                np.savez(stream, **content)


class SavedState:
    """A file that `write_state` has written.

    Attributes:
        step: the user's number of the load step.
        motions: (pairs, 3, 4) places of the obstacles at the accepted step.
        configuration, geometry: the attributes of `StepState`.
        material: the saved Functions of the material's history.
    """

    def __init__(self, path: Path, present: StepState, material: Sequence[fem.Function]) -> None:
        """Read a file for a problem; Functions `material` are on the saved spaces. Collective."""
        system, pairs = present.jump.system, len(present.jump.pairs)
        self._path, self._comm, self._system = path, system.comm, system
        unknowns = _functions_of_unknowns(present)
        spaces = [function.function_space for function in (*unknowns, *material)]
        self._content: dict[str, npt.NDArray[Any]] = {}
        with errors_on_all_ranks(self._comm):
            if self._comm.rank == 0:
                self._content = _read(path)
                # numbers of pairs, and of components of each Function, as in the problem?
                components = [space.dofmap.index_map_bs for space in spaces]
                saved = []
                for name, values in self._content.items():
                    if name.startswith("function") and name.endswith("values"):
                        saved.append(values.shape[1])
                saved_pairs = len(self._content["motions"])
                if saved != components or saved_pairs != pairs:
                    raise InputError(
                        f"the state in '{path}' is of a problem with {len(saved)} Function(s), of "
                        f"{saved} component(s), those of u and those given as material, and with "
                        f"{saved_pairs} pair(s), and here there are {len(components)}, of "
                        f"{components}, and {pairs} pair(s). Give the pairs, the mesh and the "
                        "space of that problem."
                    )
        names = "laws", "motions", "numbers"
        header = self._comm.bcast([self._content.get(name) for name in names])
        self._laws, self.motions, (self._dissipation, self._begun, step) = header
        self.step = int(step)
        self._places = surroundings(system.V)
        self._nodes = self._rows("nodes", self._places)
        self.configuration = with_owned_values(system.V, self._nodes["configuration"])
        self.geometry = with_owned_values(system.V, self._nodes["geometry"])
        functions = []
        for k, space in enumerate(spaces):
            rows = self._rows(f"function {k}", surroundings(space))
            functions.append(with_owned_values(space, rows["values"]))
        self._unknowns, self.material = functions[: len(unknowns)], functions[len(unknowns) :]

    def _rows(self, table: str, places: Array) -> dict[str, Array]:
        """Return column -> values (n, k) of a table at the `surroundings` of nodes. Collective."""
        # the first rank finds the rows of all ranks' nodes, and sends each rank its own rows
        places_of_ranks = self._comm.gather(places)
        tables: list[dict[str, Array]] = [{} for _ in range(self._comm.size)]
        with errors_on_all_ranks(self._comm):
            if places_of_ranks is not None:
                nodes = np.concatenate(places_of_ranks)
                saved = self._content.get(f"{table}/{PLACES}", np.zeros((0, nodes.shape[1])))
                same = saved.shape == nodes.shape
                if same:  # each node is at the place of a row, and each row at that of a node
                    extent = float(np.ptp(nodes, axis=0).max() if len(nodes) > 1 else 1.0)
                    rows = KDTree(saved).query(nodes, distance_upper_bound=SAME_PLACE * extent)[1]
                    same = len(np.unique(rows)) == len(rows) and rows.max(initial=-1) < len(saved)
                if not same:
                    raise InputError(
                        f"the state in '{self._path}' is of another mesh, of another degree or of "
                        f"other pairs: its {table} has {len(saved)} nodes or points, the problem "
                        f"{len(nodes)}, and they must be the same ones. For another mesh take "
                        "continue_from(solution)."
                    )
                ends = np.cumsum([len(of_rank) for of_rank in places_of_ranks])[:-1]
                for name, values in self._content.items():
                    if name.startswith(f"{table}/"):
                        column = name.partition("/")[2]
                        for rank, of_rank in enumerate(np.split(values[rows], ends)):
                            tables[rank][column] = of_rank
        return dict(self._comm.scatter(tables))

    def state(self, present: StepState) -> StepState:
        """Return the state in the file, with surfaces paired as in the present one. Collective."""
        jump = present.jump
        for number, (saved, law) in enumerate(zip(self._laws, _laws(jump), strict=True)):
            if saved != law:
                raise InputError(
                    f"the state in '{self._path}' is of a problem whose pair {number} "
                    f"{saved}; here it {law}, so that tractions and slip would be lost, or are "
                    "not known. Where friction comes or goes in a process let its bound or "
                    "coefficient change, from or to 0. Or begin with set_slip_origin(u) at the "
                    "last accepted displacement."
                )
        # of each contact node the pressure (1), the traction (d) and the slip origin (d)
        rows = []
        for k, pair in enumerate(jump.pairs):
            places = _contact_places(pair, self._places)
            rows.append(self._rows(f"pair {k}", places)["values"])
        dim = jump.system.V.mesh.geometry.dim
        tractions = jump.components([values[:, : 1 + dim] for values in rows])
        origin = jump.components([values[:, dim:] for values in rows])
        origin[~jump.is_tangential] = 0.0  # the column that is no component of it
        zeros = SlipHistory.none(jump).slipped
        slipped = tuple(self._nodes.get(f"slip of pair {k}", x) for k, x in enumerate(zeros))
        origin = origin / jump.length_scale
        history = SlipHistory(origin, slipped, float(self._dissipation), begun=bool(self._begun))
        displacements: list[fem.Function | None] = []  # None: the process had none to save
        for name in ("accepted displacement", "displacement before", "accepted configuration"):
            u = self._nodes.get(name)
            displacements.append(None if u is None else with_owned_values(self._system.V, u))
        displacement, before, configuration = displacements
        unknowns = present.unknowns
        if self._unknowns:
            w = self._unknowns[0]
            if self._system.component is not None:  # the parts of a mixed space were saved
                w = fem.Function(self._system.space)
                for i, values in enumerate(self._unknowns):
                    w.sub(i).interpolate(values)
            unknowns = w.x.array.copy()
        state = replace(present, unknowns=unknowns, multipliers=tractions / jump.stress_scale)
        state = state.after_step(history, displacement, configuration=configuration, before=before)
        return replace(state, solution=None)


def _functions_of_unknowns(state: StepState) -> list[fem.Function]:
    """Return copies of nonlinear bodies' displacement or mixed unknowns, if any. Collective."""
    if state.unknowns is None:
        return []
    system = state.jump.system
    w = fem.Function(system.space)
    w.x.array[:] = state.unknowns
    if system.component is None:
        return [w]
    return [w.sub(i).collapse() for i in range(w.function_space.num_sub_spaces)]


def _read(path: Path) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays in a file by their names. Not collective."""
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
            content = {name: file[name] for name in file.files if name != "format"}
        for name, values in content.items():
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                raise ValueError(f"'{name}' has values that are NaN or infinite")
    except (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise InputError(
            f"cannot read a state from '{path}': {error}. Give the file that save_state() wrote."
        ) from error
    return content


def _laws(jump: JumpOperator) -> list[str]:
    """Return the kind of law of each pair as a clause; kinds differ in multipliers. Collective."""
    tangential_rows = reduce_array(jump.comm, np.array([len(pair.tangents) for pair in jump.pairs]))
    return [
        "is bonded" if pair.bonded else "has friction" if rows else "has no friction"
        for pair, rows in zip(jump.pairs, tangential_rows, strict=True)
    ]


def _contact_places(pair: PairOperators, places: Array) -> Array:
    """Return rows (n, 2 d + 1) that identify contact nodes: `surroundings` and a smooth patch."""
    # a node has an entry for each of its patches, one after the other, from `start` on
    _, start, row = np.unique(pair.nodes, return_index=True, return_inverse=True)
    return np.column_stack([places[pair.nodes], np.arange(len(pair.nodes)) - start[row]])


def surroundings(V: Any) -> Array:
    """Return two positions (n, 2 d) that identify each own node or point of this rank. Collective.

    They are its position and the mean of the midpoints of the cells around it, which distinguishes
    nodes of bodies that touch. (Numbers of nodes depend on the partition of the mesh.)
    """
    dim, cells = V.mesh.geometry.dim, V.mesh.topology.index_map(V.mesh.topology.dim).size_local
    points = V.tabulate_dof_coordinates()[:, :dim]
    nodes, own = V.dofmap.list[:cells], V.dofmap.index_map.size_local
    middles = np.column_stack([points[nodes].mean(axis=1), np.ones(cells)])
    of_cells = np.repeat(middles[:, None], nodes.shape[1], axis=1)
    # the last column counts the cells around a node, none around one that no cell has
    sums = summed_at_nodes(V.dofmap.index_map, nodes, of_cells)[:own]
    return np.hstack([points[:own], sums[:, :-1] / np.maximum(sums[:, -1:], 1.0)])
