"""The state of a process in a file, for another run on any number of ranks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from dolfinx import fem

from dolfinx_tresca._base.arrays import Array, Indices, LocalNumbers
from dolfinx_tresca._base.parallel import reduce_array
from dolfinx_tresca.contact.state_file import (
    PLACES,
    StateFile,
    function_of_rows,
    surroundings,
    tables_of,
    values_of,
    write_file,
)
from dolfinx_tresca.contact.step_state import StepState
from dolfinx_tresca.dual.jump import JumpOperator
from dolfinx_tresca.dual.slip_history import SlipHistory
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.pairing.operators import PairOperators
from dolfinx_tresca.stiffness.system import LinearSystem


def write_state(
    path: Path, state: StepState, step: int = 0, material: Sequence[fem.Function] = ()
) -> None:
    """Write the state from which a solve begins; see `StepState.at_start`. Collective.

    Displacements and slips are values at all nodes. Multipliers and the origin of friction are
    values at the contact nodes of each pair: a pressure and two vectors for each smooth patch of
    the surface to which the node belongs, since the tangents are arbitrary. The last solution is
    not written.

    Args:
        path: path of the file.
        state: the state.
        step: a number chosen by the user, such as the number of the load step.
        material: Functions of the material's history.

    Raises:
        InputError: the file cannot be written.
    """
    jump, history, accepted = state.jump, state.history, state.accepted
    system = jump.system
    at_rest, start = fem.Function(system.V), accepted.configuration
    displacements = {
        "configuration": _if_other(state.configuration, at_rest),
        "geometry": _if_other(state.geometry, at_rest),
        "accepted displacement": accepted.displacement,
        "displacement before": accepted.before,
        "accepted configuration": None if start is None else _if_other(start, state.configuration),
    }
    unknowns: Sequence[fem.Function] = ()
    if state.unknowns is not None:
        w = fem.Function(system.space)
        w.x.array[:] = state.unknowns
        displacements["u"] = system.displacement(w, "u")
        unknowns = () if system.component is None else system.component.other_parts(w)
    nodes = {name: values_of(u) for name, u in displacements.items() if u is not None}
    if history.begun:
        nodes |= {f"slip of pair {k}": slip for k, slip in enumerate(history.slipped)}
    places = surroundings(system.V)
    tables = {"nodes": {PLACES: places, **nodes}}
    origin = history.origin * jump.length_scale
    tractions = state.multipliers * jump.stress_scale
    for k, (pair, (n, t)) in enumerate(zip(jump.pairs, jump.slices, strict=True)):
        pressure = np.zeros((len(pair.nodes), 1))
        pressure[pair.normal_node, 0] = tractions[n]
        vectors = [pair.tangential_vectors(values[t]) for values in (tractions, origin)]
        contact_nodes, row, patch, patches = _patches(jump, pair)
        columns = 1 + 2 * vectors[0].shape[1]
        values = np.zeros((len(contact_nodes), patches, columns))
        values[row, patch] = np.hstack([pressure, *vectors])
        rows = values.reshape(len(contact_nodes), patches * columns)
        tables[f"pair {k}"] = {PLACES: places[contact_nodes], "values": rows}
    header: dict[str, npt.ArrayLike] = {
        "laws": _laws(jump),
        "numbers": np.array([history.dissipation, history.begun, step]),
        "motions": accepted.motions,
    }
    tables |= tables_of("material", material) | tables_of("unknown", unknowns)
    write_file(path, jump.comm, header, tables)


class SavedState(StateFile):
    """A file that `write_state` has written.

    Attributes:
        step: the number that was saved.
        motions: (pairs, 3, 4) places of the obstacles at the accepted step.
        configuration: displacement [length] at which pairs with finite sliding were paired.
        geometry: displacement [length] at which the other pairs were paired.
    """

    def __init__(self, path: Path, system: LinearSystem, pairs: int) -> None:
        """Read a file. Collective.

        Args:
            path: path of the file, the same on all ranks.
            system: the system K u = f of the problem that goes on from the state.
            pairs: number of its contact pairs.

        Raises:
            InputError: the file cannot be read, or belongs to another mesh or degree, or to a
                problem with another number of pairs.
        """
        super().__init__(path, system.comm)
        self._system, self._places = system, surroundings(system.V)
        self._nodes = self.rows("nodes", self._places, "the state")
        self.step, self.motions = int(self.header["numbers"][2]), self.header["motions"]
        none = np.zeros((len(self._places), system.V.dofmap.index_map_bs))
        self.configuration, self.geometry = (
            function_of_rows(system.V, self._nodes.get(name, none))
            for name in ("configuration", "geometry")
        )
        if len(self.motions) != pairs:
            raise InputError(
                f"the state in '{path}' is of a problem with {len(self.motions)} pair(s), and here "
                f"there are {pairs}. Give the pairs of that problem."
            )

    def _displacement(self, name: str) -> fem.Function | None:
        """Return a displacement [length] by its name in the file, or None. Collective."""
        rows = self._nodes.get(name)
        return None if rows is None else function_of_rows(self._system.V, rows)

    def state(self, present: StepState) -> StepState:
        """Return the state in the file. Collective.

        Args:
            present: a state whose surfaces are paired at `configuration`, `geometry` and `motions`.

        Raises:
            InputError: the file belongs to other pairs or other kinds of laws, or lacks a
                displacement that is needed.
        """
        jump, header = present.jump, self.header
        for number, (saved, law) in enumerate(zip(header["laws"], _laws(jump), strict=True)):
            if saved != law:
                raise InputError(
                    f"the state in '{self.path}' is of a problem whose pair {number} "
                    f"{saved}; here it {law}, so that tractions and slip would be lost, or are "
                    "not known. Where friction comes or goes in a process let its bound or "
                    "coefficient change, from or to 0. Or begin with set_slip_origin(u) at the "
                    "last accepted displacement."
                )
        multipliers, origin = np.zeros((2, len(jump.gap)))
        for k, (pair, (n, t)) in enumerate(zip(jump.pairs, jump.slices, strict=True)):
            nodes, row, patch, patches = _patches(jump, pair)
            rows = self.rows(f"pair {k}", self._places[nodes], "the state")["values"]
            columns = 1 + 2 * pair.tangents.shape[1]
            if rows.shape[1] != patches * columns:
                raise InputError(
                    f"the state in '{self.path}' is of a problem in which pair {k} has other "
                    "sharp edges. Give the pairs of that problem."
                )
            values = rows.reshape(len(nodes), patches, columns)[row, patch]
            multipliers[n] = values[pair.normal_node, 0]
            tractions_and_slips = np.split(values[:, 1:], 2, axis=1)
            for result, vectors in zip((multipliers, origin), tractions_and_slips, strict=True):
                result[t] = np.einsum("ri,ri->r", vectors[pair.tangent_node], pair.tangents)
        slips = enumerate(SlipHistory.none(jump).slipped)
        history = SlipHistory(
            origin / jump.length_scale,
            tuple(self._nodes.get(f"slip of pair {k}", zeros) for k, zeros in slips),
            float(header["numbers"][0]),
            begun=bool(header["numbers"][1]),
        )
        unknowns = None if present.unknowns is None else self._unknowns()
        state = replace(present, unknowns=unknowns, multipliers=multipliers / jump.stress_scale)
        state = state.after_step(history, self._displacement("accepted displacement"))
        configuration = self._displacement("accepted configuration")
        before = self._displacement("displacement before")
        accepted = replace(
            state.accepted, configuration=configuration, before=before, solution=None
        )
        return replace(state, accepted=accepted)

    def _unknowns(self) -> Array:
        """Return the values of all unknowns of nonlinear bodies, with ghosts. Collective.

        Raises:
            InputError: the file has no displacement, or other unknowns.
        """
        u, component = self._displacement("u"), self._system.component
        if u is None:
            raise InputError(
                f"the state in '{self.path}' has no displacement, since a ContactProblem "
                "wrote it; a NonlinearContactProblem needs one."
            )
        if component is None:
            return np.array(u.x.array)
        w = fem.Function(self._system.space)
        other_parts = component.other_parts(w)
        read = self.functions("unknown", other_parts)
        for function, values in zip(other_parts, read, strict=True):
            function.x.array[:] = values
        component.compose(w, u, other_parts)
        return np.array(w.x.array)


def _if_other(u: fem.Function, reference: fem.Function) -> fem.Function | None:
    """Return a Function if its values differ from those of a reference, or None. Collective."""
    differs = not np.array_equal(u.x.array, reference.x.array)
    return u if u.function_space.mesh.comm.allreduce(differs, op=MPI.LOR) else None


def _laws(jump: JumpOperator) -> list[str]:
    """Return the kind of law of each pair, which determines its multipliers. Collective."""
    tangential_rows = reduce_array(jump.comm, np.array([len(pair.tangents) for pair in jump.pairs]))
    return [
        "is bonded" if pair.bonded else "has friction" if rows else "has no friction"
        for pair, rows in zip(jump.pairs, tangential_rows, strict=True)
    ]


def _patches(jump: JumpOperator, pair: PairOperators) -> tuple[LocalNumbers, Indices, Indices, int]:
    """Return each contact node of a pair once, and where its smooth patches are. Collective.

    A node on a sharp edge belongs to several patches, which come one after the other.

    Returns:
        the nodes (k,); for each entry (n,) of `pair.nodes` its position among these and the number
        of its patch; and the largest number of patches of a node on all ranks.
    """
    nodes, start, row = np.unique(pair.nodes, return_index=True, return_inverse=True)
    patch = np.arange(len(pair.nodes)) - start[row]
    most = jump.comm.allreduce(int(patch.max(initial=0)) + 1, op=MPI.MAX)
    return nodes, row, patch, most
