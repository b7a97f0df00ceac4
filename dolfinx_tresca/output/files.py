"""Grids of a solution in VTK's layout, and files of them for ParaView: `.vtu` and `.pvd`.

Pictures are made of the same grids.
"""

from __future__ import annotations

import math
import re
import shutil
import sys
import xml.etree.ElementTree as ET
import zlib
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from numbers import Real
from pathlib import Path
from typing import Any, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt

import dolfinx.plot
from dolfinx import fem
from dolfinx.mesh import MeshTags

from dolfinx_tresca._base.agreement import collective, comm_of
from dolfinx_tresca._base.arguments import check_type
from dolfinx_tresca._base.arrays import Array
from dolfinx_tresca._base.atomic_write import atomic_write, file_named_in_errors
from dolfinx_tresca._base.bodies import label_bodies
from dolfinx_tresca._base.compat import same_topology
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import ContactError, InputError, shown
from dolfinx_tresca.solution.evaluation import Evaluation
from dolfinx_tresca.solution.fields import IntegerFunction

ROOT = 0  #: the rank that gets the grids

#: Fields that users may add to the volume.
Field: TypeAlias = "fem.Function | MeshTags"

#: Mesh -> number of each cell's body; kept, since finding bodies takes longer than writing a step.
_LABELS: WeakKeyDictionary[Any, npt.NDArray[np.int64]] = WeakKeyDictionary()

#: Names and colours of the states, which ParaView's colour map editor imports: blue for stick,
#: orange for slip, light colours for open nodes.
STATE_COLOURS = Path(__file__).with_name("contact_state.json")

_ORDER = f"{sys.byteorder.capitalize()}Endian"
#: Attributes of VTK's files. Below version 2.2, readers reorder nodes of hexahedra of degree 2.
_HEADER = {"version": "2.2", "byte_order": _ORDER, "header_type": "UInt64"}

_TYPES = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}


def optional(name: str) -> Any:
    """Import a module that only pictures and `to_pyvista` need, or raise a ContactError."""
    try:
        return import_module(name)
    except (ImportError, AttributeError) as error:  # AttributeError: VTK lacks something
        package = name.partition(".")[0]
        raise ContactError(
            f"pictures and to_pyvista() need {package}, which does not import ({error}): install "
            f"python3-{package} (Debian) or {package} (conda, pip); `pip install -U pyvista` "
            "brings one that goes with its VTK."
        ) from error


@dataclass(frozen=True)
class Grid:
    """A mesh on one rank, with each node and cell once, and its fields, as VTK stores them.

    Attributes:
        dim: dimension of space, 2 or 3.
        points: (n, 3) nodes [length].
        cells: (m, 1 + k) number of nodes k, then the nodes in VTK's order.
        cell_types: (m,) VTK's numbers of the cell types.
        values: name -> (n,), (n, 3) or (n, 9) nodal values of a Function, padded with 0 in 2D.
        cell_values: name -> (m,), (m, 3) or (m, 9) values of a Function that is constant in cells.
    """

    dim: int
    points: Array
    cells: npt.NDArray[np.int64]
    cell_types: npt.NDArray[np.int64]
    values: dict[str, npt.NDArray[Any]]
    cell_values: dict[str, npt.NDArray[Any]]

    def to_pyvista(self) -> Any:
        """Return the `pyvista.UnstructuredGrid` with its point and cell data."""
        pyvista = optional("pyvista")
        grid = pyvista.UnstructuredGrid(self.cells.ravel(), self.cell_types, self.points)
        grid.point_data.update(self.values)
        grid.cell_data.update(self.cell_values)
        return grid


def gather_grid(functions: Sequence[fem.Function]) -> Grid | None:
    """Return the grid of the whole mesh on rank `ROOT`, None on other ranks. Collective.

    All functions are on one mesh. The first one is a continuous Lagrange Function, and its nodes
    are those of the grid; each of the others is continuous and of the same degree, or of degree 0.
    """
    space = functions[0].function_space
    index_map = space.dofmap.index_map
    owned = slice(index_map.size_local)
    cells, cell_types, points = dolfinx.plot.vtk_mesh(space)
    cells = np.array(cells, dtype=np.int64).reshape(-1, 1 + space.dofmap.list.shape[1])
    nodes = cells[:, 1:]
    nodes[:] = index_map.local_to_global(nodes.astype(np.int32).ravel()).reshape(nodes.shape)
    order = np.arange(len(points))
    values: dict[str, npt.NDArray[Any]] = {}
    cell_values: dict[str, npt.NDArray[Any]] = {}
    for function in functions:
        # the rows of values on this rank: (n,), (n, d) or (n, d, d), with 0 as third components
        V, shape = function.function_space, function.ufl_shape
        rows: npt.NDArray[Any] = np.asarray(function.x.array).reshape(-1, *shape)
        if isinstance(function, IntegerFunction):
            rows = np.rint(rows).astype(np.int32)
        if shape:
            missing = [(0, 3 - components) for components in shape]
            rows = np.pad(rows, [(0, 0), *missing]).reshape(-1, 3 ** len(shape))
        if V.ufl_element().degree == 0:
            cell_values[function.name] = rows[: len(cells)]
        else:  # in the numbering of `space`, which has the same nodes
            order[space.dofmap.list] = V.dofmap.list
            values[function.name] = rows[order][owned]
    own = points[owned], cells, np.asarray(cell_types), *values.values(), *cell_values.values()
    gathered = space.mesh.comm.gather(own, root=ROOT)
    if gathered is None:
        return None
    # ranks own ascending ranges of global numbers: rows in rank order are in the order of numbers
    whole = [np.concatenate(arrays) for arrays in zip(*gathered, strict=True)]
    points, cells, cell_types = whole[:3]
    values = dict(zip(values, whole[3 : 3 + len(values)], strict=True))
    cell_values = dict(zip(cell_values, whole[3 + len(values) :], strict=True))
    return Grid(space.mesh.geometry.dim, points, cells, cell_types, values, cell_values)


def grids_of(solution: Evaluation, fields: Sequence[Field]) -> dict[str, Grid]:
    """Return name -> grid of a solution on the first rank, an empty dict on others. Collective.

    The grid "volume" has the displacement, each cell's number of its body, cell errors and the
    user's `fields`; its degree is at least that of curved cells. The grid "contact" is the surface
    of a single pair, of degree 1. If there are several pairs, each has a grid, named after the
    pair, with its number if the name is taken.
    """
    check_type("solution", solution, Evaluation, "what solve() has returned")
    u, surfaces = solution.u, solution.surfaces
    if isinstance(fields, fem.Function | MeshTags):
        raise InputError(f"fields must be a sequence: write [field] for '{fields.name}' alone.")
    mesh, V = u.function_space.mesh, u.function_space
    if mesh not in _LABELS:
        _LABELS[mesh] = 1 + label_bodies(V)[V.dofmap.list[:, 0]]  # counted from 1 as in messages
    bodies = IntegerFunction(fem.functionspace(mesh, ("DG", 0)), name="body")
    bodies.x.array[:] = _LABELS[mesh]
    volume = [u, bodies]
    if solution.cell_errors is not None:
        volume.append(solution.cell_errors)
    for field in fields:
        volume.append(_checked(field, u, [function.name for function in volume]))
    # nodal fields of a grid have one degree, the highest of them and of the mesh
    degrees = [function.function_space.ufl_element().degree for function in volume]
    degree = max(*degrees, int(mesh.ufl_domain().ufl_coordinate_element().degree))
    for number, function in enumerate(volume):
        if degrees[number] not in (0, degree):
            W = fem.functionspace(mesh, ("Lagrange", degree, function.ufl_shape))
            volume[number] = fem.Function(W, name=function.name)
            volume[number].interpolate(function)
            volume[number].x.scatter_forward()
    blocks = [("volume", volume)]
    names = ["contact"] if len(surfaces) == 1 else [surface.name for surface in surfaces]
    blocks += [(name, [*surface.functions]) for name, surface in zip(names, surfaces, strict=True)]
    grids: dict[str, Grid] = {}
    for number, (name, functions) in enumerate(blocks):
        grid = gather_grid(functions)
        if grid is None:
            continue
        word = re.sub(r"\W+", "_", name, flags=re.ASCII)[:60].strip("_") or f"block_{number}"
        while word in grids:
            word += f"_{number}"
        grids[word] = grid
    return grids


def _checked(field: Field, u: fem.Function, taken: Sequence[str]) -> fem.Function:
    """Check a field of the user and return it; tags of cells become a Function of degree 0."""
    mesh = u.function_space.mesh
    if not isinstance(field, fem.Function | MeshTags):
        raise InputError(
            "fields must be Functions, such as interpolated expressions, or MeshTags of cells, "
            f"found {shown(field)}."
        )
    if field.name in taken:
        raise InputError(
            f"there is a field '{field.name}' already: give yours another name, as in "
            "field.name = 'mine'."
        )
    if isinstance(field, MeshTags):
        if field.dim != mesh.topology.dim or not same_topology(field, mesh):
            raise InputError(f"'{field.name}' are no tags of the cells of this mesh.")
        function = IntegerFunction(fem.functionspace(mesh, ("DG", 0)), name=field.name)
        function.x.array[field.indices] = field.values
        return function
    V = field.function_space
    if not same_topology(V.mesh, mesh):
        raise InputError(f"'{field.name}' lives on another mesh than the displacement.")
    element = V.ufl_element()
    is_lagrange = element.family_name == "P" and (element.degree == 0 or not element.discontinuous)
    is_real = field.x.array.dtype.kind == "f"
    is_blocked = V.dofmap.bs == math.prod(field.ufl_shape)  # the components have the same nodes
    if not (is_real and is_lagrange and is_blocked):
        raise InputError(
            f"'{field.name}' must be a real Lagrange Function or one of degree 0 ('DG', 0), found "
            f"{element} of {field.x.array.dtype}: interpolate it."
        )
    return field


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
                time of the first `write` stay. The first rank decides.

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
        # entries of the `.pvd`, one for each grid and step; on the first rank, after a first step
        self._series: list[dict[str, str]] | None = None

    @collective(comm_of("solution"), ignored=("time",))
    def write(self, solution: Evaluation, time: float, *, fields: Sequence[Field] = ()) -> None:
        """Add a solution to the series, as its last step. Collective.

        Args:
            solution: the solution that `ContactProblem.solve` returned.
            time: time in any unit, larger than the previous one; the first rank's time counts.
            fields: see `ContactSolution.write`.

        Raises:
            InputError: the time is not a number, or not larger than the previous one; a field is of
                another kind, or the files cannot be written.
        """
        grids, comm = grids_of(solution, fields), solution.comm
        time, path = comm.bcast((time, str(self._path)), root=ROOT)
        if not isinstance(time, Real) or not self._latest_time < time < math.inf:
            latest = self._latest_time
            beyond = f" above {latest:g}, the last one" if latest > -math.inf else ""
            raise InputError(f"time must be a number{beyond}, found {time!r}.")
        self._path = Path(path)
        with errors_on_all_ranks(comm), file_named_in_errors(self._path):
            if comm.rank == ROOT:
                self._write_step(float(time), grids)
        self._latest_time = float(time)

    def _write_step(self, time: float, grids: Mapping[str, Grid]) -> None:
        """Write the grids of a step to a new folder, then the `.pvd` with this step; on one rank.

        Until it replaces the old `.pvd`, all files of older steps are as they were. After the first
        step, remove the files of steps that it does not list: of an older series or a killed run.
        """
        series: list[dict[str, str]] = []
        if self._series is not None:
            series = list(self._series)
        elif self._append and self._path.exists():
            # the steps of the existing series before this time
            try:
                entries = [item.attrib for item in ET.parse(self._path).iter("DataSet")]
                series = [entry for entry in entries if float(entry["timestep"]) < time]
            except (ET.ParseError, KeyError, ValueError) as error:
                raise InputError(
                    f"cannot add to '{self._path}', which is no series: {error!r}."
                ) from error
        series_folder = self._path.with_suffix("")
        step_number = 0
        while (series_folder / f"{step_number:04}").exists():
            step_number += 1
        folder = series_folder / f"{step_number:04}"
        folder.mkdir(parents=True)
        try:
            for number, (name, grid) in enumerate(grids.items()):
                write_vtu(folder / f"{name}.vtu", grid)
                file = f"{series_folder.name}/{folder.name}/{name}.vtu"
                entry = {"timestep": repr(time), "part": str(number), "name": name, "file": file}
                series.append(entry)
            shutil.copyfile(STATE_COLOURS, series_folder / "state.json")
            root = ET.Element("VTKFile", {"type": "Collection", **_HEADER})
            collection = ET.SubElement(root, "Collection")
            for entry in series:
                ET.SubElement(collection, "DataSet", entry)
            ET.indent(root)
            with atomic_write(self._path) as index:
                ET.ElementTree(root).write(index, encoding="utf-8", xml_declaration=True)
        except Exception:
            _remove_grids(folder)
            raise
        if self._series is None:
            kept = {Path(entry["file"]).parent.name for entry in series}
            for step in series_folder.glob("[0-9]*"):
                if step.name.isdecimal() and step.name not in kept:
                    _remove_grids(step)
        self._series = series


def _remove_grids(folder: Path) -> None:
    """Remove the files of a step, and its folder if it is empty then."""
    for file in folder.glob("*.vtu"):
        file.unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()


def write_vtu(path: Path, grid: Grid) -> None:
    """Write a grid as a `.vtu`: XML, whose arrays are compressed and in base 64."""
    root = ET.Element("VTKFile", {"type": "UnstructuredGrid", **_HEADER})
    root.set("compressor", "vtkZLibDataCompressor")
    whole = ET.SubElement(root, "UnstructuredGrid")
    counts = {"NumberOfPoints": str(len(grid.points)), "NumberOfCells": str(len(grid.cells))}
    piece = ET.SubElement(whole, "Piece", counts)
    nodes = grid.cells[:, 1:]
    sections: dict[str, dict[str, npt.NDArray[Any]]] = {
        "PointData": grid.values,
        "CellData": grid.cell_values,
        "Points": {"Points": grid.points},
        "Cells": {
            "connectivity": nodes.ravel(),
            "offsets": nodes.shape[1] * np.arange(1, len(nodes) + 1, dtype=np.int64),
            "types": grid.cell_types.astype(np.uint8),
        },
    }
    for section, arrays in sections.items():
        element = ET.SubElement(piece, section)
        for name, values in arrays.items():
            array = ET.SubElement(element, "DataArray", Name=name, format="binary")
            array.set("type", _TYPES[values.dtype.str[1:]])
            array.set("NumberOfComponents", str(values.shape[1] if values.ndim == 2 else 1))
            # VTK's compressed text of one block (ParaView 5.11 fails at raw data behind XML). The
            # header: number of blocks, size of a block, of a shorter last one, compressed size
            packed = zlib.compress(values.tobytes(), level=1)
            sizes = np.array([1, values.nbytes, 0, len(packed)], dtype=np.uint64)
            array.text = (b64encode(sizes.tobytes()) + b64encode(packed)).decode()
    # the active array: ParaView initially colours by it, warps by it, and draws it as arrows
    active = next(iter(grid.values))
    piece[0].attrib.update(Scalars=active, Vectors=active)
    ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
