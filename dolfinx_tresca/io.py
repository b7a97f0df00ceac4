"""Writing results for ParaView: XDMF, VTU, and VTX (ADIOS2)."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import dolfinx.io
from dolfinx import fem

from dolfinx_tresca._base import compat
from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.errors import InputError
from dolfinx_tresca.fields import SurfaceFields
from dolfinx_tresca.grid import ROOT, gather_grid, is_constant_in_cells

Functions: TypeAlias = Sequence[fem.Function]

VOLUME = "volume"
CONTACT = "contact"


def write(
    path: str | Path,
    u: fem.Function,
    surfaces: Sequence[SurfaceFields],
    cell_errors: fem.Function | None = None,
) -> None:
    """Write the displacement on the volume and the contact fields on the surfaces, for ParaView.

    The suffix says the format; the parent folder is made:

    * `.xdmf`, with a `.h5` beside it: one file with the blocks "volume" and "contact" (with several
      pairs "contact_1", "contact_2", ...). The values are those at the nodes of the mesh: on a mesh
      of straight cells a displacement of degree 2 is written in degree 1.
    * `.vtu`: `<stem>.vtu` and `<stem>_contact.vtu` (`<stem>_contact_1.vtu`, ...), written by the
      first rank, with pyvista.
    * `.bp`: `<stem>.bp` and `<stem>_contact.bp` in the VTX format, with ADIOS2.

    A displacement of degree 2 stays that in `.vtu` and `.bp`. Curved meshes stay curved in all
    formats: contact fields are then given at the middles of edges as well, also the state, as the
    mean of the ends. Vectors of 2D have a third component 0, as ParaView wants it. Without friction
    there are no fields "traction" and "slip".

    Collective.

    Args:
        path: the file; that of the first rank counts.
        u: displacement [length].
        surfaces: the fields of each pair.
        cell_errors: a function of degree 0, for the volume. `.bp` files can't hold it beside the
            displacement, and are written without.

    Raises:
        InputError: unknown suffix, DOLFINx without ADIOS2, or the file cannot be written.
        ContactError: there is no pyvista.
    """
    comm = u.function_space.mesh.comm
    path = Path(comm.bcast(str(path), root=ROOT))
    if path.suffix not in _WRITERS:
        raise InputError(
            f"write knows the suffixes {', '.join(_WRITERS)}, found '{path}': they say the format."
        )
    if path.suffix == ".bp" and not compat.has_adios2:
        raise InputError(
            f"'{path}' needs ADIOS2, and this DOLFINx has none: write .xdmf or .vtu instead."
        )
    names = [f"{CONTACT}_{i + 1}" for i in range(len(surfaces))] if len(surfaces) > 1 else [CONTACT]
    with errors_on_all_ranks(comm):
        if comm.rank == ROOT:
            _prepare(path)
    volume = [u] if cell_errors is None or path.suffix == ".bp" else [u, cell_errors]
    _WRITERS[path.suffix](path, volume, dict(zip(names, surfaces, strict=False)))


def _prepare(path: Path) -> None:
    """Make the folder and check that it takes files: parallel libraries may hang if not."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
        if path.suffix != ".bp":
            with path.open("ab"):
                pass
        elif path.is_file():
            raise FileExistsError("there is a file of this name, and VTX makes a folder")
    except OSError as error:
        raise InputError(
            f"cannot write '{path}': {error}. Choose another folder or name."
        ) from error


def _write_xdmf(path: Path, volume: Functions, surfaces: dict[str, SurfaceFields]) -> None:
    """Write one `.xdmf` with a grid for the volume and each surface. Collective."""
    grids: dict[str, Functions] = {VOLUME: volume}
    grids |= {name: surface.functions for name, surface in surfaces.items()}
    comm = volume[0].function_space.mesh.comm
    with dolfinx.io.XDMFFile(comm, path, "w") as file:
        for grid, functions in grids.items():
            with _mesh_name(functions[0].function_space.mesh, grid) as mesh:
                file.write_mesh(mesh)
                for function in map(_on_mesh_nodes, functions):
                    # the name is a path in the .h5 as well, so it must be unique in the file
                    alias = fem.Function(
                        function.function_space, function.x, name=f"{grid}.{function.name}"
                    )
                    file.write_function(alias, 0.0, f"/Xdmf/Domain/Grid[@Name='{grid}']")
    with errors_on_all_ranks(comm):
        if comm.rank == ROOT:
            _join_grids(path)


def _on_mesh_nodes(function: fem.Function) -> fem.Function:
    """Return a Function in the degree of the mesh, as XDMF wants it. Collective."""
    return _in_degree(function, _mesh_degree(function))


def _curved(function: fem.Function) -> fem.Function:
    """Return a Function whose nodes show the mesh as curved as it is. Collective."""
    degree = function.function_space.ufl_element().degree
    return _in_degree(function, max(degree, _mesh_degree(function)))


def _mesh_degree(function: fem.Function) -> int:
    """Return the degree of the geometry. Not collective."""
    domain = function.function_space.mesh.ufl_domain()
    return int(domain.ufl_coordinate_element().degree)


def _in_degree(function: fem.Function, degree: int) -> fem.Function:
    """Return a Function interpolated to another degree, if it is another one. Collective."""
    V = function.function_space
    if V.ufl_element().degree == degree or is_constant_in_cells(function):
        return function
    element = ("Lagrange", degree, function.ufl_shape)
    result = fem.Function(fem.functionspace(V.mesh, element), name=function.name)
    result.interpolate(function)
    result.x.scatter_forward()
    return result


@contextmanager
def _mesh_name(mesh: Any, name: str) -> Iterator[Any]:
    """Give the mesh a name for the length of a block; the user's own comes back."""
    before, mesh.name = mesh.name, name
    try:
        yield mesh
    finally:
        mesh.name = before


def _join_grids(path: Path) -> None:
    """Move all values to the grid of their mesh, and say that they are doubles.

    DOLFINx writes a time series for each Function, a block of its own in ParaView: pressure as
    colour and slip as arrows would not be on the same surface, and VTK's reader fails at it.
    Without a precision readers take floats.
    """
    tree = ET.parse(path)
    domain = tree.getroot().find("Domain")
    assert domain is not None
    meshes = {grid.get("Name"): grid for grid in domain.findall("Grid[@GridType='Uniform']")}
    for series in domain.findall("Grid[@GridType='Collection']"):
        mesh, name = series.get("Name", "").split(".", maxsplit=1)
        attribute = series.find("Grid/Attribute")
        assert attribute is not None
        attribute.set("Name", name)
        meshes[mesh].append(attribute)
        domain.remove(series)
    for item in domain.iter("DataItem"):
        item.set("NumberType", item.get("NumberType", "Float"))
        item.set("Precision", "8")
    ET.indent(tree)
    tree.write(path, encoding="utf-8", xml_declaration=True)


def _write_vtu(path: Path, volume: Functions, surfaces: dict[str, SurfaceFields]) -> None:
    """Write a `.vtu` for the volume and each surface, on the first rank. Collective."""
    comm = volume[0].function_space.mesh.comm
    for file, functions in _files(path, volume, surfaces).items():
        grid = gather_grid(list(map(_curved, functions)))
        with errors_on_all_ranks(comm):
            if grid is not None:
                grid.to_pyvista().save(file)


def _write_vtx(path: Path, volume: Functions, surfaces: dict[str, SurfaceFields]) -> None:
    """Write a `.bp` for the volume and each surface. Collective."""
    for file, functions in _files(path, volume, surfaces).items():
        comm = functions[0].function_space.mesh.comm
        with dolfinx.io.VTXWriter(comm, file, list(map(_curved, functions))) as writer:
            writer.write(0.0)


def _files(
    path: Path, volume: Functions, surfaces: dict[str, SurfaceFields]
) -> dict[Path, Functions]:
    """Return file -> its Functions, for formats with one mesh in a file."""
    files: dict[Path, Functions] = {path: volume}
    for name, surface in surfaces.items():
        files[path.with_name(f"{path.stem}_{name}{path.suffix}")] = surface.functions
    return files


_WRITERS: dict[str, Callable[[Path, Functions, dict[str, SurfaceFields]], None]] = {
    ".xdmf": _write_xdmf,
    ".vtu": _write_vtu,
    ".bp": _write_vtx,
}
