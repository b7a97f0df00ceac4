"""Writing results for ParaView: PVD, VTU, XDMF, and VTX (ADIOS2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dolfinx.io
from dolfinx import fem

from dolfinx_tresca._base import compat
from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.atomic_write import atomic_write_on_all_ranks
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.output import body_forces
from dolfinx_tresca.output.blocks import (
    Blocks,
    Field,
    HasFields,
    blocks_of,
    curved,
    in_degree,
    unused_name,
)
from dolfinx_tresca.output.grid import ROOT, Grid, gather_grid, is_constant_in_cells, local_grid
from dolfinx_tresca.output.revolved import STEP, checked_angle, revolved
from dolfinx_tresca.output.series import Series
from dolfinx_tresca.output.state_colours import paraview_preset
from dolfinx_tresca.output.vtu import write_vtu
from dolfinx_tresca.output.xdmf import write_xdmf


def _comm_of_solution(given: Mapping[str, Any]) -> MPI.Comm | None:
    """Return the communicator of a solution, or None without a solution. Not collective."""
    return comm_of("u")({"u": getattr(given.get("solution"), "u", None)})


def _series_options(writer: SolutionWriter) -> dict[str, Any]:
    """Return the options of a series, which the ranks compare. Not collective."""
    return {"append": writer._append}


@collective(_comm_of_solution, ignored=("path",))
def write(
    path: str | Path,
    solution: HasFields,
    *,
    fields: Sequence[Field] = (),
    revolve: float | None = None,
    by_body: bool = False,
) -> None:
    """Write displacement and contact fields for ParaView.

    There is a block "volume" and, for the secondary surface of the pair, a block "contact"; with
    several pairs, there are blocks named after the pairs, such as "upper_on_lower". The suffix
    selects the format; the parent folder is created:

    * `.pvd`: best for ParaView, since its blocks have names. Beside the file is a folder, to which
      each rank writes its part of the grids. The folder also has the names and colours of the
      states for ParaView (`state.json`). For several solutions see `SolutionWriter`.
    * `.vtu`: `<stem>.vtu` and `<stem>_contact.vtu`, whole grids. The first rank gathers them, and
      needs about 1 kB of memory for each node of the whole mesh: on many ranks take `.pvd`.
    * `.xdmf`, with a `.h5` beside it: one file with all blocks. It has values at the nodes of the
      mesh: on a mesh of straight cells a displacement of degree 2 is written in degree 1.
    * `.bp`: `<stem>.bp` and `<stem>_contact.bp` in the VTX format, which needs ADIOS2 and has no
      fields of cells.

    Formats other than `.xdmf` keep degree 2 of a displacement. All formats keep curved meshes:
    contact fields then have values at the middles of edges as well, and at the middle of an edge
    `state` has the value of one end of the edge. Vectors of 2D get a third component 0, as ParaView
    requires. Without friction there are no fields "traction" and "slip". With load steps there are
    "slip_increment" and "slip_path" as well, from the second step on.

    Beside the displacement the volume has `body`, the number of each cell's body, counted from 1 as
    in messages; `cell_errors`, if they were estimated; and the requested fields. A `.pvd` also has
    the names of the bodies (field data `body_names`) and, with three or more bodies, a block
    "forces_between_bodies": a point for each pair of bodies that push each other, with the `force`
    on the body with the lower number.

    Collective.

    Args:
        path: the file; the first rank's path counts.
        solution: the solution that `ContactProblem.solve` returned.
        fields: further fields of the volume, under their names: Lagrange Functions, or Functions of
            degree 0, on the mesh of the displacement, such as a von Mises stress; and `MeshTags` of
            its cells, such as materials, with 0 in cells without a tag.
        revolve: angle in degrees, up to 360, by which bodies of revolution and their fields are
            turned about the y axis; only for `.pvd` and `.vtu`. The result is a grid in 3D of
            degree 1, whose first meridian is the mesh. None: the meridian alone is written.
        by_body: whether a `.pvd` has a block for each body, under its name in
            `solution.body_names`, instead of the block "volume". Each rank that has cells of a body
            then writes a file for this body.

    Raises:
        InputError: the suffix is unknown, DOLFINx has no ADIOS2, a field is of another kind or has
            a name that is taken, the angle is wrong, the format does not support `revolve` or
            `by_body`, or the file cannot be written.
    """
    blocks = blocks_of(solution, fields)
    angle = checked_angle(revolve, revolve is not None and solution.axisymmetric)
    comm = _comm(blocks)
    path = _agreed(comm, path)
    if path.suffix not in SUFFIXES:
        raise InputError(
            f"write knows the suffixes {', '.join(SUFFIXES)}, found '{path}': they say the format."
        )
    if path.suffix == ".bp" and not compat.has_adios2:
        raise InputError(
            f"'{path}' needs ADIOS2, and this DOLFINx has none: write .pvd, .vtu or .xdmf instead."
        )
    if path.suffix == ".pvd":  # a series is always complete
        _write_step(_series(path), solution, blocks, 0.0, angle, by_body)
        return
    if by_body:
        raise InputError(f"by_body needs a '.pvd', whose blocks have names, found '{path}'.")
    if angle and path.suffix != ".vtu":
        raise InputError(f"revolve needs a '.pvd' or a '.vtu', found '{path}'.")
    room = comm.allreduce(sum(map(_bytes, blocks.values()))) * max(1, math.ceil(angle / STEP))
    with atomic_write_on_all_ranks(comm, path, room) as new:
        if path.suffix == ".vtu":
            _write_vtu(new, blocks, angle)
        else:
            _WRITERS[path.suffix](new, blocks)


def _bytes(functions: Sequence[fem.Function]) -> int:
    """Return an upper bound of the bytes that this rank's part of a mesh with Functions needs.

    This bound is compared with the free space on the disk. Ghost nodes count, since VTX files
    contain them. Not collective.
    """
    V = functions[0].function_space
    maps = (V.dofmap.index_map, V.mesh.geometry.index_map())
    nodes = max(int(map.size_local + map.num_ghosts) for map in maps)
    cells, per_cell = map(int, compat.geometry_dofmap(V.mesh).shape)
    per_cell = max(per_cell, int(V.dofmap.list.shape[1]))
    numbers = nodes * (3 + 1) + cells * (per_cell + 2)  # points, cells, and tables for both
    for function in functions:
        count = cells if is_constant_in_cells(function) else nodes
        numbers += count * 3 ** len(function.ufl_shape)
    return numbers * 8 * 4 // 3 + 64 * 1024  # VTU has 4 bytes for 3 of the data, and headers


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
            raise InputError(f"a time series is a '.pvd', found '{path}'.")
        self._path = Path(path)
        self._append = append
        self._series: Series | None = None
        self._last = -math.inf

    @collective(_comm_of_solution, ignored=("time",), extra_values=_series_options)
    def write(
        self,
        solution: HasFields,
        time: float,
        *,
        fields: Sequence[Field] = (),
        revolve: float | None = None,
        by_body: bool = False,
    ) -> None:
        """Add a solution. Collective.

        Args:
            solution: the solution that `ContactProblem.solve` returned.
            time: time in any unit, larger than the previous one; the first rank's time counts.
            fields: see `dolfinx_tresca.output.io.write`.
            revolve: see `dolfinx_tresca.output.io.write`.
            by_body: see `dolfinx_tresca.output.io.write`.

        Raises:
            InputError: the time is not a number, or not larger than the previous one; a field is of
                another kind, the angle is wrong, or the files cannot be written.
        """
        blocks = blocks_of(solution, fields)
        angle = checked_angle(revolve, revolve is not None and solution.axisymmetric)
        comm = _comm(blocks)
        time = comm.bcast(time, root=ROOT)
        if not isinstance(time, Real) or not self._last < time < math.inf:
            raise InputError(
                "time must be a number"
                + (f" above {self._last:g}, the last one" if self._last > -math.inf else "")
                + f", found {time!r}."
            )
        if self._series is None:
            self._series = _series(_agreed(comm, self._path), append=self._append)
        _write_step(self._series, solution, blocks, float(time), angle, by_body)
        self._last = float(time)


@collective(_comm_of_solution)
def to_pyvista(
    solution: HasFields,
    *,
    fields: Sequence[Field] = (),
    revolve: float | None = None,
    by_body: bool = False,
) -> Any:
    """Return the named blocks of `write` as a `pyvista.MultiBlock` on the first rank. Collective.

    Args:
        solution: the solution that `ContactProblem.solve` returned.
        fields: see `write`.
        revolve: see `write`.
        by_body: see `write`.

    Returns:
        the whole model, gathered; None on other ranks.

    Raises:
        InputError: a field is of another kind or has a name that is taken, or the angle is wrong.
        ContactError: pyvista is missing.
    """
    blocks = blocks_of(solution, fields)
    angle = checked_angle(revolve, revolve is not None and solution.axisymmetric)
    gathered = {name: _gathered(functions, angle) for name, functions in blocks.items()}
    grids = {name: grid for name, grid in gathered.items() if grid is not None}
    with errors_on_all_ranks(_comm(blocks)):
        if not grids:
            return None
        grids = _with_bodies(grids, solution, here=True, by_body=by_body)
        found = {name: grid.to_pyvista() for name, grid in grids.items()}
        import pyvista

        return pyvista.MultiBlock(found)


def _comm(blocks: Blocks) -> MPI.Comm:
    comm: MPI.Comm = next(iter(blocks.values()))[0].function_space.mesh.comm
    return comm


def _agreed(comm: MPI.Comm, path: str | Path) -> Path:
    """Return the path of the first rank. Collective."""
    return Path(comm.bcast(str(path), root=ROOT))


def _series(path: Path, append: bool = False) -> Series:
    """Return a series with the colours of the states beside its steps. Not collective."""
    return Series(path, append=append, texts={"state.json": paraview_preset()})


def _write_step(
    series: Series, solution: HasFields, blocks: Blocks, time: float, angle: float, by_body: bool
) -> None:
    """Add a step to a series, with grids that are turned by an angle [degrees]. Collective."""
    grids = {name: local_grid(_shown(functions, angle)) for name, functions in blocks.items()}
    if angle:
        grids = {name: revolved(grid, angle) for name, grid in grids.items()}
    comm = _comm(blocks)
    series.write(comm, _with_bodies(grids, solution, comm.rank == ROOT, by_body), time)


def _with_bodies(
    grids: dict[str, Grid], solution: HasFields, here: bool, by_body: bool
) -> dict[str, Grid]:
    """Add names of bodies to grids, and with three or more bodies the forces between them.

    For two bodies the force between them is already known as the force of their pair. Not
    collective.

    Args:
        grids: name -> grid, with "volume" among them.
        solution: the solution, with names of bodies and forces between them.
        here: whether this rank writes the forces.
        by_body: whether a grid for each body replaces the grid "volume".
    """
    volume = replace(grids["volume"], texts={"body_names": solution.body_names})
    result = {**grids, "volume": volume}
    if by_body:
        del result["volume"]
        for number, name in enumerate(solution.body_names, 1):
            body = volume.part(volume.cell_values["body"] == number)
            named = replace(body, texts={"body_names": (name,)})
            result[unused_name(name, {*result, body_forces.NAME}, number)] = named
    if len(solution.body_names) > 2 and solution.between_bodies:
        result[body_forces.NAME] = body_forces.grid_of_forces(solution.between_bodies, here)
    return result


def _write_vtu(path: Path, blocks: Blocks, angle: float) -> None:
    """Write a `.vtu` for each block, on the first rank; `angle`: see `_gathered`. Collective."""
    for file, functions in _files(path, blocks).items():
        grid = _gathered(functions, angle)
        with errors_on_all_ranks(_comm(blocks)):
            if grid is not None:
                write_vtu(file, grid)


def _gathered(functions: Sequence[fem.Function], angle: float) -> Grid | None:
    """Return the whole grid, turned by an angle [degrees]; None except on the first rank.

    Collective.
    """
    grid = gather_grid(_shown(functions, angle))
    return revolved(grid, angle) if grid is not None and angle else grid


def _shown(functions: Sequence[fem.Function], angle: float) -> list[fem.Function]:
    """Interpolate Functions to the degree of files: 1 for revolved bodies, else see `curved`.

    Collective.

    Args:
        functions: Functions on the same mesh.
        angle: angle of revolution in degrees; 0: the bodies are drawn as they are.
    """
    return in_degree(functions, 1) if angle else curved(functions)


def _write_vtx(path: Path, blocks: Blocks) -> None:
    """Write a `.bp` for each block. Collective."""
    for file, functions in _files(path, blocks).items():
        at_nodes = [function for function in functions if not is_constant_in_cells(function)]
        with dolfinx.io.VTXWriter(_comm(blocks), file, curved(at_nodes)) as writer:
            writer.write(0.0)


def _files(path: Path, blocks: Blocks) -> dict[Path, list[fem.Function]]:
    """Return path -> Functions of the file, for formats with a file for each block."""
    return {
        path if i == 0 else path.with_name(f"{path.stem}_{name}{path.suffix}"): functions
        for i, (name, functions) in enumerate(blocks.items())
    }


#: Suffix -> writer, for formats that hold neither revolved grids nor time series.
_WRITERS: dict[str, Callable[[Path, Blocks], None]] = {
    ".xdmf": write_xdmf,
    ".bp": _write_vtx,
}

#: Suffixes of all formats.
SUFFIXES = (".pvd", ".vtu", *_WRITERS)
