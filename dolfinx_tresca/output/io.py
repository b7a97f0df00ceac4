"""Writing results for ParaView: grids (`.vtu`) and time series of named grids (`.pvd`)."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from dolfinx import fem

from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.atomic_write import atomic_write, file_named_in_errors
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.output.grid import (
    ROOT,
    VERTEX,
    Field,
    Grid,
    blocks_of,
    gather_grid,
    local_grid,
)
from dolfinx_tresca.output.vtu import DataSet, read_pvd, write_pvd, write_pvtu, write_vtu
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.fields import ContactState
from dolfinx_tresca.solution.forces import Resultant

#: State -> its name, and its colour as red, green and blue from 0 to 1: blue for stick, orange for
#: slip, light colours for open nodes.
STATE_COLOURS: dict[ContactState, tuple[str, tuple[float, float, float]]] = {
    ContactState.OUTSIDE: ("outside", (0.60, 0.60, 0.60)),
    ContactState.OPEN: ("open", (0.85, 0.85, 0.85)),
    ContactState.OPEN_STICK: ("open, sticks", (0.65, 0.81, 0.93)),
    ContactState.OPEN_SLIP: ("open, slips", (1.00, 0.80, 0.55)),
    ContactState.PRESSED: ("pressed", (0.55, 0.25, 0.60)),
    ContactState.STICK: ("sticks", (0.10, 0.35, 0.70)),
    ContactState.SLIP: ("slips", (0.85, 0.35, 0.00)),
    ContactState.BONDED: ("bonded", (0.20, 0.55, 0.25)),
}

#: Block of the forces between bodies.
FORCES = "forces_between_bodies"


def _comm_of_solution(given: Mapping[str, Any]) -> MPI.Comm | None:
    """Return the communicator of a solution, or None without a solution. Not collective."""
    return comm_of("u")({"u": getattr(given.get("solution"), "u", None)})


def _series_options(writer: SolutionWriter) -> dict[str, Any]:
    """Return the options of a series, which the ranks compare. Not collective."""
    return {"append": writer._append}


@collective(_comm_of_solution, ignored=("path",))
def write(path: str | Path, solution: Evaluation, *, fields: Sequence[Field] = ()) -> None:
    """Write displacement and contact fields for ParaView, as a `.pvd`.

    There is a block "volume" and, for the secondary surface of the pair, a block "contact"; with
    several pairs, there are blocks named after the pairs, such as "upper_on_lower". The parent
    folder is created. Beside the file is a folder, to which each rank writes its part of the grids
    as `.vtu`. The folder also has the names and colours of the states for ParaView (`state.json`).
    For several solutions see `SolutionWriter`.

    Displacements of degree 2 and curved meshes are kept: contact fields then have values at the
    middles of edges as well, and at the middle of an edge `state` has the value of one end of the
    edge. Vectors of 2D get a third component 0, as ParaView requires. Without friction there are no
    fields "traction" and "slip". With load steps there are "slip_increment" and "slip_path" as
    well, from the second step on.

    Beside the displacement the volume has `body`, the number of each cell's body, counted from 1 as
    in messages; `cell_errors`, if they were estimated; the requested fields; and the names of the
    bodies (field data `body_names`). With three or more bodies there is a block
    "forces_between_bodies": a point for each pair of bodies that push each other, with the `force`
    on the body with the lower number.

    Collective.

    Args:
        path: the file; the first rank's path counts.
        solution: the solution that `ContactProblem.solve` returned.
        fields: further fields of the volume, under their names: Lagrange Functions, or Functions of
            degree 0, on the mesh of the displacement, such as a von Mises stress; and `MeshTags` of
            its cells, such as materials, with 0 in cells without a tag.

    Raises:
        InputError: the suffix is unknown, a field is of another kind or has a name that is taken,
            or the file cannot be written.
    """
    blocks = blocks_of(solution, fields)
    path = solution.u.function_space.mesh.comm.bcast(str(path), root=ROOT)
    SolutionWriter(path)._add_step(solution, blocks, 0.0)


@collective(_comm_of_solution)
def to_pyvista(solution: Evaluation, *, fields: Sequence[Field] = ()) -> Any:
    """Return the named blocks of `write` as a `pyvista.MultiBlock` on the first rank. Collective.

    Args:
        solution: the solution that `ContactProblem.solve` returned.
        fields: see `write`.

    Returns:
        the whole model, gathered; None on other ranks.

    Raises:
        InputError: a field is of another kind or has a name that is taken.
        ContactError: pyvista is missing.
    """
    grids = _grids(solution, blocks_of(solution, fields), gather_grid)
    with errors_on_all_ranks(solution.u.function_space.mesh.comm):
        if not grids:
            return None
        converted = {name: grid.to_pyvista() for name, grid in grids.items()}
        import pyvista

        return pyvista.MultiBlock(converted)


class SolutionWriter:
    """Writes solutions, such as those of load steps, as one time series for ParaView.

    After each `write` the files are complete, even if the run is killed later. The first `write`
    begins a new series and removes an older series of the same name::

        writer = SolutionWriter("results/steps.pvd")
        for step, load in enumerate(loads):
            ...
            writer.write(problem.solve(), time=step)
    """

    def __init__(self, path: str | Path, *, append: bool = False) -> None:
        """Keep the path; nothing is read or written. Not collective.

        Args:
            path: the `.pvd`; the first rank's path counts.
            append: whether to continue an existing series, after a restart: its steps before the
                time of the first `write` stay.

        Raises:
            InputError: the suffix is not `.pvd`.
        """
        if Path(path).suffix != ".pvd":
            raise InputError(
                f"files for ParaView are '.pvd', found '{path}'; to_pyvista() returns the data for "
                "files of other kinds."
            )
        self._path = Path(path)
        self._append = append
        self._latest_time = -math.inf
        self._series: list[DataSet] | None = None  # on the first rank, after the first step

    @collective(_comm_of_solution, ignored=("time",), extra_values=_series_options)
    def write(self, solution: Evaluation, time: float, *, fields: Sequence[Field] = ()) -> None:
        """Add a solution. Collective.

        Args:
            solution: the solution that `ContactProblem.solve` returned.
            time: time in any unit, larger than the previous one; the first rank's time counts.
            fields: see `dolfinx_tresca.output.io.write`.

        Raises:
            InputError: the time is not a number, or not larger than the previous one; a field is of
                another kind, or the files cannot be written.
        """
        blocks = blocks_of(solution, fields)
        comm: MPI.Comm = solution.u.function_space.mesh.comm
        time, path = comm.bcast((time, str(self._path)), root=ROOT)
        if not isinstance(time, Real) or not self._latest_time < time < math.inf:
            beyond = f" above {self._latest_time:g}, the last one"
            raise InputError(
                f"time must be a number{beyond if self._latest_time > -math.inf else ''}, "
                f"found {time!r}."
            )
        self._path = Path(path)
        self._add_step(solution, blocks, float(time))
        self._latest_time = float(time)

    def _add_step(
        self, solution: Evaluation, blocks: Mapping[str, Sequence[fem.Function]], time: float
    ) -> None:
        """Write this rank's part of each grid to a new folder, and then an index with this step.

        Until the index replaces the old one, all files of the older steps are as they were.
        Collective.

        Raises:
            InputError: a file cannot be written, or the existing series cannot be continued.
        """
        comm: MPI.Comm = solution.u.function_space.mesh.comm
        grids = _grids(solution, blocks, local_grid)
        series: list[DataSet] = []
        folder = Path()
        with errors_on_all_ranks(comm), file_named_in_errors(self._path):
            if comm.rank == ROOT:
                series, folder = self._begin_step(time)
        folder = comm.bcast(folder, root=ROOT)
        cells = comm.gather({name: len(grid.cells) for name, grid in grids.items()}, root=ROOT)
        try:
            with errors_on_all_ranks(comm), file_named_in_errors(self._path):
                for name, grid in grids.items():
                    if comm.size == 1:
                        write_vtu(folder / f"{name}.vtu", grid)
                    elif len(grid.cells):
                        write_vtu(folder / f"{name}_{comm.rank}.vtu", grid)
            with errors_on_all_ranks(comm), file_named_in_errors(self._path):
                for name, grid in grids.items() if cells is not None else ():
                    file = f"{folder.parent.name}/{folder.name}/{name}.vtu"
                    if comm.size > 1:
                        ranks = [rank for rank, count in enumerate(cells) if count[name]]
                        pieces = [f"{name}_{rank}.vtu" for rank in ranks]
                        write_pvtu(folder / f"{name}.pvtu", grid, pieces)
                        file = file.replace(".vtu", ".pvtu")
                    series.append(DataSet(time, name, file))
                if cells is not None:
                    self._finish_step(series)
        except Exception:  # raised on all ranks
            if comm.rank == ROOT:
                _remove_grids(folder)
            comm.barrier()
            raise

    def _begin_step(self, time: float) -> tuple[list[DataSet], Path]:
        """Return the entries of earlier steps, and a new folder for the step. Not collective.

        Before the first step of a continued series, the index of older steps is read, and steps
        that are not before `time` are dropped.

        Raises:
            InputError: the older series cannot be read.
        """
        series = self._series or []
        if self._series is None and self._append and self._path.exists():
            try:
                series = [data for data in read_pvd(self._path) if data.time < time]
                for data in series:
                    int(_step_folder(data))
            except ValueError as error:  # also if the name of a folder is not a number
                raise InputError(f"cannot add to '{self._path}': {error}.") from error
        count = len({_step_folder(data) for data in series})
        folders = (self._path.with_suffix("") / f"{i:04}" for i in itertools.count(count))
        folder = next(folder for folder in folders if not folder.exists())
        folder.mkdir(parents=True)
        return [*series], folder

    def _finish_step(self, series: list[DataSet]) -> None:
        """Write the index of all steps; after the first step, remove other steps. Not collective.

        Other steps are those of an older series, and what a killed run has left.
        """
        folder = self._path.with_suffix("")
        (folder / "state.json").write_text(paraview_preset())
        with atomic_write(self._path) as index:
            write_pvd(index, series)
        if self._series is None:
            kept = {_step_folder(data) for data in series}
            for step in folder.glob("[0-9]*"):
                if step.name.isdecimal() and step.name not in kept:
                    _remove_grids(step)
        self._series = series


def paraview_preset() -> str:
    """Return the look-up table of states, which ParaView's colour map editor imports."""
    annotations: list[str] = []
    for state, (name, _) in STATE_COLOURS.items():
        annotations += [str(int(state)), name]
    colours = [x for _, colour in STATE_COLOURS.values() for x in colour]
    preset = {"Name": "contact state", "Annotations": annotations, "IndexedColors": colours}
    return json.dumps([preset], indent=1)


def _step_folder(data: DataSet) -> str:
    """Return the name of the folder of a step: its number."""
    return Path(data.file).parent.name


def _remove_grids(folder: Path) -> None:
    """Remove the files of a step, and its folder if it is empty then. Not collective."""
    for pattern in ("*.vtu", "*.pvtu"):
        for file in folder.glob(pattern):
            file.unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()


def _grids(
    solution: Evaluation,
    blocks: Mapping[str, Sequence[fem.Function]],
    grid_of: Callable[[Sequence[fem.Function]], Grid | None],
) -> dict[str, Grid]:
    """Return grids of blocks, with names of bodies, and the forces between three or more bodies.

    For two bodies the force between them is already known as the force of their pair. Collective.

    Args:
        solution: the solution, with names of bodies and forces between them.
        blocks: name -> Functions.
        grid_of: function that returns a rank's part of a grid, or the whole grid on the first rank.

    Returns:
        name -> grid; empty on ranks without grids.
    """
    made = {name: grid_of(functions) for name, functions in blocks.items()}
    grids = {name: grid for name, grid in made.items() if grid is not None}
    if grids:
        grids["volume"] = replace(grids["volume"], texts={"body_names": solution.body_names})
        if len(solution.body_names) > 2 and solution.between_bodies:
            comm: MPI.Comm = solution.u.function_space.mesh.comm
            grids[FORCES] = _grid_of_forces(solution.between_bodies if comm.rank == ROOT else {})
    return grids


def _grid_of_forces(between_bodies: Mapping[tuple[int, int], Resultant]) -> Grid:
    """Return a grid of points, one for each pair of bodies, where their contact force acts.

    Not collective.

    The values are "force", the force on the body with the lower number, and the numbers of both
    bodies, counted from 1: "on_body" (the lower number) and "by_body".

    Args:
        between_bodies: (i, j) -> resultant on body i by body j, for i < j.
    """
    count = len(between_bodies)
    points, forces = np.zeros((2, count, 3))
    for row, resultant in enumerate(between_bodies.values()):
        points[row, : len(resultant.point)] = resultant.point
        forces[row, : len(resultant.force)] = resultant.force
    bodies = 1 + np.array([*between_bodies], dtype=np.int32).reshape(-1, 2)
    return Grid(
        dim=3,
        degree=1,
        points=points,
        cells=np.column_stack([np.ones(count, dtype=np.int64), np.arange(count)]),
        cell_types=np.full(count, VERTEX, dtype=np.uint8),
        values={"force": forces, "on_body": bodies[:, 0].copy(), "by_body": bodies[:, 1].copy()},
    )
