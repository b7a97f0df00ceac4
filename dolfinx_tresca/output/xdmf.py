"""XDMF: one file with a grid for each block, and a `.h5` with all values."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dolfinx.io
from dolfinx import fem

from dolfinx_tresca._base.parallel import errors_on_all_ranks
from dolfinx_tresca.output.blocks import Blocks, in_degree, mesh_degree
from dolfinx_tresca.output.grid import ROOT


def write_xdmf(path: Path, blocks: Blocks) -> None:
    """Write one `.xdmf` with a grid for each block. Collective."""
    comm: MPI.Comm = next(iter(blocks.values()))[0].function_space.mesh.comm
    with dolfinx.io.XDMFFile(comm, path, "w") as file:
        for grid, functions in blocks.items():
            with _mesh_name(functions[0].function_space.mesh, grid) as mesh:
                file.write_mesh(mesh)
                for function in in_degree(functions, mesh_degree(mesh)):
                    # the name is a path in the .h5 as well, so it must be unique in the file
                    alias = fem.Function(
                        function.function_space, function.x, name=f"{grid}.{function.name}"
                    )
                    file.write_function(alias, 0.0, f"/Xdmf/Domain/Grid[@Name='{grid}']")
    with errors_on_all_ranks(comm):
        if comm.rank == ROOT:
            _join_grids(path)


@contextmanager
def _mesh_name(mesh: Any, name: str) -> Iterator[Any]:
    """Give a mesh another name inside a `with` block, and restore its name at the end."""
    before, mesh.name = mesh.name, name
    try:
        yield mesh
    finally:
        mesh.name = before


def _join_grids(path: Path) -> None:
    """Move all values to the grid of their mesh, and declare them as doubles.

    DOLFINx writes a time series for each Function, and ParaView shows each time series as a
    separate block. So pressure as colour and slip as arrows could not be shown on the same surface,
    and VTK's reader fails. Without a declared precision readers assume single precision.
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
